"""Measure every way to leave contact in a whole cell in real time: the order of events and the removal it causes.

The simulated actuator lifts in a given time; the plant's record has the removal from the moment of the cause on.
One case is one simulated cell and one daemon, as processes.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import resource
import signal
import sqlite3
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles, simulated_cell, with_values
from polishd.config.cell import load_config
from polishd.daemon.journal.store import connect
from polishd.daemon.socket import client
from polishd.model.errors import LinkError
from tests.fakes import proxy
from tests.system.agreement import disagreements, passes
from tests.system.cell_rig import Daemon, account, events, with_keys, write_small
from tests.system.sim_rig import wait_for

LIFTS_S = (0.5, 4.0, 10.0)
BLOCKS = 60
"""Number of blocks that are executed in contact before the cause."""
SETTLE_S = 60.0
"""Time limit on a busy machine."""
SHOWN = {
    ("spindle", "spindle_ramping"): "spindle off",
    ("spindle", "spindle_fault"): "spindle off",
    ("actuator", "watchdog"): "actuator's watchdog",
    ("actuator", "force_off"): "force off",
    ("actuator", "tool_lifted"): "tool off",
    ("actuator", "contact_lost"): "tool off",
    ("actuator", "retracted"): "lift confirmed",
    ("robot", "watchdog"): "robot's watchdog",
    ("robot", "motion_stopped"): "motion stops",
}


@dataclass(frozen=True, slots=True)
class Rig:
    """Cell in contact with the actions that end contact."""

    files: DemoFiles
    daemon: Daemon
    wire: proxy.Wire
    loop: asyncio.AbstractEventLoop
    """Event loop of the wire."""

    def press(self, device: str, number: signal.Signals) -> None:
        """Press a button of that device's simulator."""
        os.kill(json.loads((self.files.sim_dir / "pids.json").read_text())[device], number)

    def order(self, verb: str) -> None:
        """Send a request, as the command line does; the answer comes when the command is done."""

        def ask() -> None:
            with contextlib.suppress(LinkError):  # the cell is ended once it rests
                client.request(self.files.state_dir, verb, 60.0)

        threading.Thread(target=ask, daemon=True).start()

    def lose_journal(self) -> None:
        """Forbid the daemon's files to grow: the next commit fails."""
        resource.prlimit(self.daemon.process.pid, resource.RLIMIT_FSIZE, (1, 1))

    def cut_robot(self) -> None:
        """Make the link half-open: it drops all data without an error on either side."""
        self.loop.call_soon_threadsafe(self.wire.flows.clear)

    def terminate_twice(self) -> None:
        """Send SIGTERM twice, as an impatient operator does."""
        self.daemon.process.send_signal(signal.SIGTERM)
        self.daemon.process.send_signal(signal.SIGTERM)


@dataclass(frozen=True, slots=True)
class Way:
    """One way to leave contact."""

    name: str
    cause: Callable[[Rig], object]
    stands_s: float = 0.0
    """Permitted contact at standstill: motion has ended before the daemon can act."""
    lifts: bool = True
    """Whether the actuator lifts in the end."""
    ends: bool = True
    """Whether the daemon ends; else it is held."""
    reports: bool = True
    """Whether the daemon can journal its end; else the next start does."""
    forgets: bool = False
    """Whether the robot has another boot id than in the journal."""


WAYS = (
    Way("force fault", lambda rig: rig.press("actuator", signal.SIGUSR1)),
    Way("spindle fault", lambda rig: rig.press("spindle", signal.SIGUSR1)),
    Way("actuator's wire cut", lambda rig: rig.press("actuator", signal.SIGSTOP)),
    Way("actuator hung, pressing", lambda rig: rig.press("actuator", signal.SIGUSR2), lifts=False),
    Way("robot link lost", Rig.cut_robot),
    Way("robot stands", lambda rig: rig.press("robot", signal.SIGUSR2), stands_s=20.0),
    Way("journal lost", Rig.lose_journal, reports=False),
    Way("hold", lambda rig: rig.order("hold"), ends=False),
    Way("stop", lambda rig: rig.order("stop")),
    Way("SIGTERM twice", Rig.terminate_twice),
    Way("kill -9", lambda rig: rig.daemon.process.kill(), reports=False),
    Way("emergency stop", lambda rig: rig.press("robot", signal.SIGUSR1), stands_s=20.0),
    Way("estop by order", lambda rig: rig.order("estop"), stands_s=20.0, ends=False),
)


FORGOTTEN = Way("kill -9, and the robot forgets", lambda rig: rig.daemon.process.kill(), reports=False, forgets=True)


@dataclass(frozen=True, slots=True)
class Cost:
    """Result of a case. Times in s after the cause."""

    way: str
    lift_s: float
    order: list[tuple[float, str]]
    contact_s: float
    standing_s: float
    standing_nm: float
    peak_nm: float
    """Deepest removal since the cause, including that along the program."""
    touched_s: float
    """When the tool last touched the part."""
    disagreements: list[str]
    """Contradictions between the journal and the plant's record."""
    as_before: list[str]
    """Contradictions of a journal that has only the reports from before contact was left."""
    uncertain: int
    """Number of blocks for which contact is unknown."""
    left: int
    """Number of blocks of contact that remained when contact was left."""

    def at(self, what: str) -> float | None:
        """Return when an event happened first; None where it did not happen."""
        return next((at_s for at_s, name in self.order if name == what), None)


def measure(way: Way, lift_s: float, folder: Path) -> Cost:
    """Bring a cell into contact, cause the event, and read the plant's record once everything is at rest."""
    files = write_small(folder, patient=False)
    slow = {"retract_s": lift_s + 1.0} if lift_s > 4.0 else {}
    target = urlsplit(load_config(files.cell).robot.model_dump()["address"]).port or 0
    with _wire(target) as (link, loop):
        cell: dict[str, dict[str, Any]] = {
            "actuator": slow,
            "robot": {"address": f"tcp://127.0.0.1:{link.port}"},
            "job": {},
        }
        if slow:
            cell["robot"]["watchdog_s"], cell["job"]["stream_ahead_s"] = lift_s + 4.0, lift_s + 4.0
        files.cell.write_text(with_values(files.cell.read_text(), cell))
        sim = {"actuator": {"lift_s": lift_s}, "robot": {"port": target}}
        files.sim.write_text(with_keys(files.sim.read_text(), sim))
        options = ["--state", str(files.sim_dir), "--seed", "3", "--speed", "1"]
        with simulated_cell(files.sim, options, folder / "sim.stderr"), Daemon(files) as daemon:
            daemon.wait_in_contact(BLOCKS)
            rig = Rig(files, daemon, link, loop)
            rig.press("plant", signal.SIGUSR1)
            wait_for(lambda: events(files, "way_out_marked"), "the mark")
            caused_s = time.monotonic()
            way.cause(rig)
            _until_at_rest(rig, way)
            _until_settled(rig, way)
    return _cost(way, lift_s, caused_s, files)


def _until_at_rest(rig: Rig, way: Way) -> None:
    """Wait until motion has stopped, and the tool is up where the actuator lifts."""

    def rests() -> bool:
        last = {event["event"]: k for k, event in enumerate(events(rig.files))}
        landed = last.get("tool_landed", -1)
        up = last.get("retracted", -1) > landed or not way.lifts
        return up and last.get("motion_stopped", -1) > landed

    if way.name == "actuator's wire cut":
        wait_for(lambda: rig.daemon.process.poll() is not None, "the daemon's end", SETTLE_S)
        rig.press("actuator", signal.SIGCONT)  # the wire is intact again: the simulator reports its events
    wait_for(rests, f"the cell to come to rest after {way.name}", SETTLE_S)


def _until_settled(rig: Rig, way: Way) -> None:
    """Wait until the daemon has completed the journal; where it cannot, start another one that does."""
    if not way.ends:
        rig.daemon.wait_for_state("held")
    else:
        wait_for(lambda: rig.daemon.process.poll() is not None, "the daemon's end", SETTLE_S)
    if way.forgets:
        with contextlib.closing(connect(rig.files.state_dir / "journal.sqlite")) as journal:
            journal.execute("UPDATE pass SET boot_id = 'of another boot'")
    if not way.reports:
        with Daemon(rig.files) as again:
            again.wait_for_state("held")


def _cost(way: Way, lift_s: float, caused_s: float, files: DemoFiles) -> Cost:
    way_out = account(files)["way_out"]
    order = [
        (round(event["mono_s"] - caused_s, 2), SHOWN[event["device"], event["event"]])
        for event in events(files)
        if (event["device"], event["event"]) in SHOWN and event["mono_s"] >= caused_s
    ]
    firsts = [pair for k, pair in enumerate(order) if pair[1] not in {word for _, word in order[:k]}]
    figures = (way_out["contact_s"], way_out["standing_s"], way_out["standing_peak_nm"], way_out["peak_nm"])
    figures = (*figures, way_out["until_s"] - caused_s)
    journal, books = files.state_dir / "journal.sqlite", account(files)["programs"]
    (run,) = passes(journal)
    seen = (disagreements(journal, books), disagreements(_as_before(journal), books))
    left = run.contact[1] - int(np.flatnonzero(run.touched == 1)[-1]) - 1
    rounded = (round(figure, 3) for figure in figures)
    return Cost(way.name, lift_s, firsts, *rounded, *seen, run.uncertain.size, left)


def _as_before(journal: Path) -> Path:
    """Return a copy without the blocks that ran while contact was left."""
    copy = journal.with_name("as-before.sqlite")
    with contextlib.closing(sqlite3.connect(journal)) as whole, contextlib.closing(connect(copy)) as file:
        whole.backup(file)
        file.execute("DELETE FROM segment WHERE touched IS NOT 1")
        file.execute("UPDATE pass SET uncertain_from = NULL, uncertain_to = NULL")
    return copy


@contextmanager
def _wire(target: int) -> Iterator[tuple[proxy.Wire, asyncio.AbstractEventLoop]]:
    """Connect the robot through a wire that can be cut, in a separate thread with its event loop."""
    made: list[tuple[proxy.Wire, asyncio.AbstractEventLoop, asyncio.Event]] = []
    ready = threading.Event()

    async def serve() -> None:
        over = asyncio.Event()
        async with proxy.wire(target) as link:
            made.append((link, asyncio.get_running_loop(), over))
            ready.set()
            await over.wait()

    thread = threading.Thread(target=lambda: asyncio.run(serve()), daemon=True)
    thread.start()
    ready.wait(10.0)
    link, loop, over = made[0]
    try:
        yield link, loop
    finally:
        loop.call_soon_threadsafe(over.set)
        thread.join(10.0)


HEADER = """\
| way out | lift s | s after the cause | standing s | dug standing, nm | deepest place, nm |
|---|---|---|---|---|---|
"""
BEGIN, END = "<!-- written by make ways-out -->\n", "<!-- end of what make ways-out writes -->"
PAGE = Path(__file__).parents[2] / "docs" / "reference" / "results.md"


def table(costs: Sequence[Mapping[str, Any]]) -> str:
    """Return the table for docs/reference/results.md, with a row for each case."""
    rows = []
    for cost in costs:
        order = ", ".join(f"{what} {at_s:.1f}" for at_s, what in cost["order"])
        figures = f"{cost['standing_s']:.2f} | {cost['standing_nm']:.0f} | {cost['peak_nm']:.0f}"
        rows.append(f"| {cost['way']} | {cost['lift_s']:g} | {order} | {figures} |\n")
    return HEADER + "".join(rows)


def rows_of(page: str) -> list[list[str]]:
    """Return the cells of the table in the page."""
    written = page.partition(BEGIN)[2].partition(END)[0].removeprefix(HEADER)
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in written.splitlines()]


def write_page(folder: Path) -> None:
    """Write the table of the saved results to docs/reference/results.md. SystemExit where there are none."""
    rows = load(folder)
    if not rows:
        sys.exit(f"nothing was measured: no files in {folder}, and the page stays as it is. Run make ways-out.")
    before, _, rest = PAGE.read_text().partition(BEGIN)
    after = rest.partition(END)[2]
    PAGE.write_text(before + BEGIN + table(rows) + END + after)


def save(cost: Cost, folder: Path) -> None:
    """Save a result for the table."""
    folder.mkdir(parents=True, exist_ok=True)
    name = f"{cost.way.replace(' ', '-').replace(chr(39), '').replace(',', '')}-{cost.lift_s:g}.json"
    (folder / name).write_text(json.dumps(asdict(cost), indent=1))


def load(folder: Path) -> list[dict[str, Any]]:
    """Return the saved results in the order of ``WAYS``."""
    names = [way.name for way in WAYS]
    found = [json.loads(path.read_text()) for path in folder.glob("*.json")]
    return sorted(found, key=lambda cost: (names.index(cost["way"]), cost["lift_s"]))


SAVED = Path("build/ways-out")

if __name__ == "__main__":
    write_page(SAVED)
