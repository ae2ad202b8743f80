"""The campaign of kills: a cell whose daemon, worker and devices are killed, stopped and starved, again and again.

Every attack is followed by the same questions: does everything come to rest, has the tool stood on the part, has any
block been in contact that the journal does not know of, and does the next start come up held and go on.
"""

from __future__ import annotations

import contextlib
import math
import random
import re
import socket
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from polishd.commissioning.rehearsal.simulated_cell import simulated_cell, with_values
from tests.campaigns.crash.killed_daemon import WHERE
from tests.campaigns.site import EXTENDED, LOOK_S, Site
from tests.system.cell_rig import with_keys, write_small
from tests.time_limits import SOON_S

CELLS = 3
"""Side by side: they mostly wait for their watchdogs."""
SPEED = 30.0
COMMITS = 60
"""At which of its first commits a daemon is killed: the first pass begins at about the thirtieth."""
QUICK = {
    "robot": {"silence_s": 1.2, "watchdog_s": 3.0},
    "actuator": {"silence_s": 0.6, "watchdog_ms": 1000, "retract_s": 1.0},
    "spindle": {"silence_s": 1.0, "watchdog_s": 1.0},
    "job": {"stream_ahead_s": 3.0},
}
"""Real time, as short as a busy machine allows: one that is too slow for it leaves contact, which is an attack, too."""
STANDS_S = 0.05
"""Longest that a tool may stand on the part where motion goes on: a corner at which the robot turns."""
CLAIMED = re.compile(r": touched in (\S+) s; the plant saw (\S+) s$")
"""A contradiction that costs no block twice: the journal has a contact that was none."""
NEVER = 3.0
"""So long an attack may have no effect."""


@dataclass(slots=True)
class Count:
    """What was done, and what came of it."""

    attacks: Counter[str] = field(default_factory=Counter)
    kills: int = 0
    in_contact: int = 0
    """Of the attacks: while the tool was on its way to the part, or on it."""
    went_on: int = 0
    """Starts that came up held and went on when they were ordered to."""
    finished: int = 0
    """Jobs that went on to their end."""
    bad: Counter[str] = field(default_factory=Counter)
    examples: list[str] = field(default_factory=list)
    dug_s: float = 0.0
    """Longest that the tool stood on the part after an attack."""

    def wrong(self, kind: str, what: str) -> None:
        """One more."""
        self.bad[kind] += 1
        self.examples.append(f"{kind}: {what}")


@dataclass(frozen=True, slots=True)
class Attack:
    """One way to hurt a cell, with the daemon not yet running; it has ended when this returns."""

    name: str
    do: Callable[[Campaign], None]
    share: int
    kills: bool = True
    stands_s: float = STANDS_S


def moved_since(events: Sequence[Mapping[str, Any]], since_s: float) -> list[Mapping[str, Any]]:
    """What moved or pressed after that time, but for the end of a landing that was ordered before it."""
    moved, landing = [], False
    for event in events:
        name, after = event["event"], event["mono_s"] > since_s
        if (after and name in {"motion_started", "engage"}) or (after and name == "force_on" and not landing):
            moved.append(event)
        if name in {"engage", "force_on", "tool_lifted", "retract"}:
            landing = name == "engage" and not after
    return moved


class Campaign:
    """One cell, and what befalls it."""

    def __init__(self, site: Site, luck: random.Random, count: Count, number: int) -> None:
        self.site, self.luck, self.count = site, luck, count
        self._number = number
        """Of the attack, over all parts: which commit is next."""
        self._told: set[str] = set()
        """Contradictions that were counted."""
        self._attacks: list[tuple[float, Attack]] = []
        """And when they began, on ``time.monotonic``."""
        self._dug: set[int] = set()
        """Those whose standing was counted as wrong."""

    def attack(self, attack: Attack) -> None:
        """Do it, and ask."""
        self._number += 1
        self._attacks.append((time.monotonic(), attack))
        self.count.attacks[attack.name] += 1
        self.count.kills += attack.kills
        try:
            attack.do(self)
        finally:
            self.site.kill()
        self._ask(attack)

    def strike(self) -> None:
        """Now: count where the tool is."""
        self.count.in_contact += self.site.log.last("actuator", EXTENDED)

    def _ask(self, attack: Attack) -> None:
        self.site.rest()
        name = f"{attack.name} {self._number}"
        for said in self.site.contradictions():
            if said not in self._told:
                self._told.add(said)
                claimed = (found := CLAIMED.search(said)) is not None and float(found[2]) < float(found[1])
                self.count.wrong("claimed" if claimed else "twice_unmarked", f"{name}: {said}")
        self._ask_where_it_stood()

    def _ask_where_it_stood(self) -> None:
        """Of each attack so far: the plant may write down later how one of them ended."""
        stands, ends = self.site.stands(), [begun_s for begun_s, _ in self._attacks[1:]] + [math.inf]
        for number, ((begun_s, attack), end_s) in enumerate(zip(self._attacks, ends, strict=True)):
            stood_s = sum(seconds for from_s, seconds in stands if begun_s <= from_s < end_s)
            self.count.dug_s = max(self.count.dug_s, stood_s)
            if stood_s > attack.stands_s and number not in self._dug:
                self._dug.add(number)
                name = f"{attack.name}, {len(self._attacks) - number - 1} before attack {self._number}"
                self.count.wrong("dug", f"{name}: the tool stood for {stood_s:.2f} s")

    def begin(self) -> None:
        """Have the daemon that was started polish: it comes up held if its job is under way, and nothing moves."""
        site = self.site
        held, since_s = site.job_under_way(), time.monotonic()
        while not site.ended:
            state = site.state().get("state")
            if state == "held":
                self._require_still(since_s)
                site.order("resume")
                self.count.went_on += 1
                return
            if state == "polishing" and not held:
                return
            if state == "polishing" and held:
                self.count.wrong("not_held", f"attack {self._number}: it goes on by itself")
                return
            time.sleep(LOOK_S)

    def _require_still(self, since_s: float) -> None:
        """By the time of what happened: the plant writes late what every device has vouched for."""
        if moved := moved_since(self.site.log.look(), since_s):
            self.count.wrong("not_held", f"attack {self._number}: {moved[0]}")

    def until_contact(self) -> None:
        """And then as long again as luck will have it."""
        self.until("tool_landed")
        time.sleep(self.luck.uniform(0.0, 1.5))

    def until(self, event: str) -> None:
        """A device's next event of this name, or the daemon's end."""
        site, before = self.site, len(self.site.log.look())
        end_s = time.monotonic() + SOON_S
        while not site.ended and not any(e["event"] == event for e in site.log.look()[before:]):
            assert time.monotonic() < end_s, f"{event} does not come"
            self._go_on()

    def until_ended(self, within_s: float = NEVER) -> None:
        """Or not: then it did the daemon no harm."""
        end_s = time.monotonic() + within_s
        while not self.site.ended and time.monotonic() < end_s:
            self._go_on()

    def _go_on(self) -> None:
        """Wait a little; an error that a person can mend is mended."""
        if self.site.state().get("state") == "held":
            self.site.order("resume")
        time.sleep(LOOK_S)

    def finish(self) -> None:
        """To the end of the job, undisturbed: one start must do."""
        end = Attack("end", Campaign.finish, 0)
        self._attacks.append((time.monotonic(), end))
        journal = self.site.journal()
        ((job,),) = journal.execute("SELECT max(id) FROM job").fetchall()
        ((done,),) = journal.execute("SELECT count(*) FROM pass WHERE job = ? AND how = 'done'", (job,)).fetchall()
        journal.close()
        self.site.change(max_cycles=done + 1)
        self.site.start()
        self.begin()
        assert self.site.process is not None
        code = self.site.process.wait(SOON_S)
        if code not in {0, 1, 6} or self.site.job_under_way():
            self.count.wrong("stuck", f"after attack {self._number} the job does not end: exit code {code}")
        self.count.finished += 1
        self._ask(end)

    def commit(self) -> int:
        """The commit at which the next daemon is killed: each in turn."""
        return self._number // len(WHERE) % COMMITS + 1

    def where(self) -> str:
        """On which side of it."""
        return WHERE[self._number % len(WHERE)]


@contextmanager
def attacked_cell(folder: Path, seed: int) -> Iterator[Site]:
    """A cell whose watchdogs are quick, running."""
    files = write_small(folder, patient=False, tolerance_nm=0.01, max_cycles=100)
    files.cell.write_text(with_keys(files.cell.read_text(), QUICK))
    files.sim.write_text(with_values(files.sim.read_text(), {"actuator": {"lift_s": 4.0}}))
    port = _port()
    files.cell.write_text(with_values(files.cell.read_text(), {"robot": {"address": f"tcp://127.0.0.1:{port}"}}))
    options = ["--state", str(files.sim_dir), "--seed", str(seed), "--speed", f"{SPEED:g}"]
    with simulated_cell(files.sim, options, files.out / "sim.stderr"):
        site = Site(files)
        try:
            yield site
        finally:
            site.close()


def _port() -> int:
    """Return a free port that the system gives to no process unasked: while the robot is down it stays free."""
    while True:
        with (
            contextlib.suppress(OSError),
            socket.create_server(("127.0.0.1", random.randrange(20_000, 32_000))) as free,
        ):
            return int(free.getsockname()[1])
