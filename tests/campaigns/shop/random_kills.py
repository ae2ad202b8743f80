"""Random failures of a shop, drawn from the seed: which process is killed, when, and when it is restarted."""

from __future__ import annotations

import random
import time
from collections import Counter
from collections.abc import Mapping, Sequence

from polishd.model.errors import ConfigError
from polishd.shop import parts
from polishd.shop.database import Database
from tests.system.shop_rig import Process, Shop

BETWEEN, AWAY = (0.2, 1.0), (0.0, 0.5)
"""Times between and after kills, relative to the time of a part, which is longer on a busy machine."""
LONGEST_S = 120.0
SHARES = {"daemon": 5, "shop": 3, "link": 2}
RELEASED = 0.2
"""Share of kills after which the operator takes a part back from its cell."""


class Luck:
    """Random kills and restarts of processes."""

    def __init__(self, seed: str, shop: Shop, processes: Mapping[str, Sequence[Process]]) -> None:
        self._luck, self._shop, self._processes = random.Random(seed), shop, processes
        self.part_s = 10.0
        """Present time per part."""
        self._next_s = time.monotonic() + self._draw(BETWEEN)
        self._back_s: dict[Process, float] = {}
        """When each killed process is started again."""
        self.killed: Counter[str] = Counter()
        self.releases = 0

    def strike(self) -> None:
        """Kill a process if its time has come."""
        if time.monotonic() < self._next_s:
            return
        self._next_s = time.monotonic() + self._draw(BETWEEN)
        kind = self._luck.choices(list(SHARES), list(SHARES.values()))[0]
        process = self._luck.choice(self._processes[kind])
        away_s = self._draw(AWAY)
        if process.up:
            process.kill()
            self.killed[kind] += 1
            self._back_s[process] = time.monotonic() + away_s
        if self._luck.random() < RELEASED:
            self._release()

    def start_again(self) -> None:
        """Restart the processes whose time has come, as systemd does."""
        for process in (one for several in self._processes.values() for one in several):
            if not process.up and time.monotonic() >= self._back_s.get(process, 0.0):
                process.start()

    def _draw(self, span: tuple[float, float]) -> float:
        return self._luck.uniform(*span) * min(self.part_s, LONGEST_S)

    def _release(self) -> None:
        claimed = self._shop.rows("SELECT job FROM part WHERE state = 'claimed'")
        if not claimed:
            return
        job = self._luck.choice(claimed)[0]
        try:
            with Database.open(self._shop.folder / "state") as database, database.transaction() as sql:
                parts.release(sql, job, "the campaign", "another cell shall have it", gone=False)
        except ConfigError:
            return  # its cell has begun it meanwhile
        self.releases += 1
