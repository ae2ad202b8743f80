"""Run a session: three simulated cells and their shop polish further parts while processes are killed at random."""

from __future__ import annotations

import contextlib
import random
import shutil
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from polishd.commissioning.rehearsal.simulated_cell import simulated_cell
from polishd.shop import parts
from polishd.shop.database import Database
from tests.campaigns.shop.judge import OVER, has_unsent_events, lost_or_twice, polished, twice
from tests.campaigns.shop.random_kills import Luck
from tests.system.shop_rig import Shop, ShopCell, write_shop_cell
from tests.system.sim_rig import wait_for

CELLS = ("north", "south", "west")
LOOK_S = 0.25
PART_S = 120.0
"""Time limit of a session for each of its parts, and twice that for the start."""
LOOKS = 5
"""Number of comparisons with the journals while these still grow."""
PATIENCE = 6
"""Number of times that the operator resumes a job before setting it aside."""


@dataclass(slots=True)
class Came:
    """Result of a session."""

    session: int
    parts: int
    verdicts: dict[str, int] = field(default_factory=dict)
    passes: int = 0
    torn: int = 0
    events: int = 0
    """Number of events of all journals that the shop has."""
    kills: dict[str, int] = field(default_factory=dict)
    releases: int = 0
    given_back: int = 0
    resumed: int = 0
    seconds: float = 0.0
    wrong: list[str] = field(default_factory=list)


class Session:
    """Session in the folder of the campaign, where shop and journals stay from session to session."""

    def __init__(self, folder: Path, seed: int, number: int, speed: float) -> None:
        self._folder, self._seed, self._number, self._speed = folder, seed, number, speed
        self._shop = Shop(folder / "shop")
        self._cells: list[ShopCell] = []
        self._resumed: Counter[str] = Counter()

    def run(self, count: int, leave: Callable[[], bool], say: Callable[[str], None]) -> Came:
        """Polish parts and return the result. When ``leave`` is true, remove waiting parts and complete the rest."""
        came, began_s = Came(self._number, count), time.monotonic()
        names = [f"S{self._seed}-{self._number:02d}-{number:02d}" for number in range(count)]
        before = self._counts()
        with contextlib.ExitStack() as kept:
            for index, name in enumerate(CELLS):
                self._cells.append(kept.enter_context(self._cell(name, index)))
            processes = {
                "daemon": [cell.daemon for cell in self._cells],
                "link": [cell.link for cell in self._cells],
                "shop": [self._shop.server],
            }
            for process in (one for several in processes.values() for one in several):
                kept.callback(process.kill)
            luck = Luck(f"{self._seed} {self._number}", self._shop, processes)
            self._shop.add([(name, name) for name in names], self._tolerance_nm(), cycles=4)
            try:
                self._work(names, luck, leave, say)
                luck.start_again()
                wait_for(
                    lambda: not (luck.start_again() or has_unsent_events(self._shop, self._cells)),
                    "the last reports",
                    120.0,
                )
            except AssertionError as error:
                came.wrong.append(f"stuck: {error}: {[cell.status() for cell in self._cells]}")
            came.kills, came.releases = dict(luck.killed), luck.releases
            came.resumed = self._resumed.total()
            came.wrong += self._lost_or_twice()
            self._by_the_plants(came, names)
        self._count(came, names, before)
        came.seconds = round(time.monotonic() - began_s, 1)
        return came

    def _work(self, names: list[str], luck: Luck, leave: Callable[[], bool], say: Callable[[str], None]) -> None:
        began_s, before = time.monotonic(), sum(state in OVER for state in self._shop.states().values())
        end_s, done = began_s + PART_S * (len(names) + 2), before
        while True:
            luck.start_again()
            luck.strike()
            if leave():
                self._take_out()
            for cell in self._cells:
                self._visit(cell)
            over = sum(state in OVER for state in self._shop.states().values())
            if over > done:
                done = over
                luck.part_s = len(CELLS) * (time.monotonic() - began_s) / (over - before)
                say(f"{over} parts are over; killed {dict(luck.killed)}, resumed {self._resumed.total()}")
            if all(self._shop.states()[name] in OVER for name in names):
                return
            assert time.monotonic() < end_s, f"the parts do not end: {self._shop.states()}"
            time.sleep(LOOK_S)

    def _lost_or_twice(self) -> list[str]:
        """Return the differences, compared again while restarted daemons still send events."""
        for _ in range(LOOKS):
            wrong = lost_or_twice(self._shop, self._cells)
            if not wrong or not has_unsent_events(self._shop, self._cells):
                return wrong
            with contextlib.suppress(AssertionError):  # then it is reported as lost
                wait_for(lambda: not has_unsent_events(self._shop, self._cells), "the last reports", 120.0)
        return wrong

    def _take_out(self) -> None:
        """Remove the parts that no cell has claimed."""
        with Database.open(self._shop.folder / "state") as database, database.transaction() as sql:
            for row in sql.rows("SELECT job FROM part WHERE state = 'waiting'"):
                parts.remove(sql, row["job"], "the campaign", "the session ends")

    def _visit(self, cell: ShopCell) -> None:
        """Resume a held cell, as an operator does; set a job aside that is held repeatedly."""
        status = cell.status()
        if status.get("state") != "held":
            return
        job = f"{cell.name} {status.get('job')}"
        self._resumed[job] += 1
        if self._resumed[job] > PATIENCE and status.get("job"):
            cell.put_aside(str(status["job"]))
        else:
            cell.resume()

    @contextlib.contextmanager
    def _cell(self, name: str, index: int) -> Iterator[ShopCell]:
        out = self._folder / name
        files = write_shop_cell(out, name, self._shop)
        shutil.rmtree(files.sim_dir, ignore_errors=True)
        options = ["--state", str(files.sim_dir), "--seed", str(1000 * self._number + 10 * self._seed + index)]
        with simulated_cell(files.sim, [*options, "--speed", f"{self._speed:g}"], files.out / "sim.stderr"):
            yield ShopCell(name, files)

    def _tolerance_nm(self) -> float:
        return random.Random(f"{self._seed} {self._number}").choice((2.0, 3.0, 5.0))

    def _by_the_plants(self, came: Came, names: list[str]) -> None:
        found = {cell.name: polished(cell) & set(names) for cell in self._cells}
        came.wrong += twice(found)
        begun = {cell.name: {name for (name,) in cell.rows("SELECT DISTINCT name FROM job JOIN pass ON job.id = job")}
                 for cell in self._cells}  # fmt: skip
        for cell, touched in found.items():
            came.wrong += [f"{part}: polished in {cell}, whose journal has no pass" for part in touched - begun[cell]]

    def _counts(self) -> Counter[str]:
        if not (self._shop.folder / "state" / "shop.sqlite").exists():
            return Counter()
        sql = "SELECT 'passes', count(*) FROM pass UNION SELECT 'torn', count(*) FROM pass WHERE how != 'done' UNION "
        sql += "SELECT 'events', count(*) FROM event UNION SELECT 'back', count(*) FROM claim WHERE how = 'given back'"
        return Counter(dict(self._shop.rows(sql)))

    def _count(self, came: Came, names: list[str], before: Counter[str]) -> None:
        now = self._counts()
        came.passes, came.torn = now["passes"] - before["passes"], now["torn"] - before["torn"]
        came.events, came.given_back = now["events"] - before["events"], now["back"] - before["back"]
        rows = dict(self._shop.rows("SELECT job, verdict FROM part WHERE state != 'removed'"))
        came.verdicts = dict(Counter(rows[name] for name in names if name in rows))
        came.parts = sum(came.verdicts.values())
