"""Every way out of contact, in a whole cell in real time: what happened in which order, and what it cost the part.

The simulated actuator lifts as slowly as it is told to; the plant's own account says what the part lost from the
moment of the cause on. One case is one simulated cell and one daemon, as processes.
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
"""Executed in contact before the cause."""
SETTLE_S = 60.0
"""For a machine that is busy with other things."""
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
    """A cell in contact, about to be disturbed."""

    files: DemoFiles
    daemon: Daemon
    wire: proxy.Wire
    loop: asyncio.AbstractEventLoop
    """The wire's own."""

    def press(self, device: str, number: signal.Signals) -> None:
        """A button of that device's simulator."""
        os.kill(json.loads((self.files.sim_dir / "pids.json").read_text())[device], number)

    def order(self, verb: str) -> None:
        """As the command line does; the answer comes when it is obeyed."""

        def ask() -> None:
            with contextlib.suppress(LinkError):  # the cell is ended once it rests
                client.request(self.files.state_dir, verb, 60.0)

        threading.Thread(target=ask, daemon=True).start()

    def lose_journal(self) -> None:
        """No file of the daemon may grow any more: the next commit fails."""
        resource.prlimit(self.daemon.process.pid, resource.RLIMIT_FSIZE, (1, 1))

    def cut_robot(self) -> None:
        """A half-open link: nothing comes through any more, and nobody is told."""
        self.loop.call_soon_threadsafe(self.wire.flows.clear)

    def terminate_twice(self) -> None:
        """Somebody is impatient."""
        self.daemon.process.send_signal(signal.SIGTERM)
        self.daemon.process.send_signal(signal.SIGTERM)


@dataclass(frozen=True, slots=True)
class Way:
    """One way out of contact."""

    name: str
    cause: Callable[[Rig], object]
    stands_s: float = 0.0
    """Longest standing contact that this way may cost: motion has ended before anybody was asked."""
    lifts: bool = True
    """The actuator lifts in the end."""
    ends: bool = True
    """The daemon does; else it is held."""
    tells: bool = True
    """The daemon can journal how it ended; else the next start does."""
    forgets: bool = False
    """The robot is another one by then, as far as the journal knows."""


WAYS = (
    Way("force fault", lambda rig: rig.press("actuator", signal.SIGUSR1)),
    Way("spindle fault", lambda rig: rig.press("spindle", signal.SIGUSR1)),
    Way("actuator's wire cut", lambda rig: rig.press("actuator", signal.SIGSTOP)),
    Way("actuator hung, pressing", lambda rig: rig.press("actuator", signal.SIGUSR2), lifts=False),
    Way("robot link lost", Rig.cut_robot),
    Way("robot stands", lambda rig: rig.press("robot", signal.SIGUSR2), stands_s=20.0),
    Way("journal lost", Rig.lose_journal, tells=False),
    Way("hold", lambda rig: rig.order("hold"), ends=False),
    Way("stop", lambda rig: rig.order("stop")),
    Way("SIGTERM twice", Rig.terminate_twice),
    Way("kill -9", lambda rig: rig.daemon.process.kill(), tells=False),
    Way("emergency stop", lambda rig: rig.press("robot", signal.SIGUSR1), stands_s=20.0),
    Way("estop by order", lambda rig: rig.order("estop"), stands_s=20.0, ends=False),
)


FORGOTTEN = Way("kill -9, and the robot forgets", lambda rig: rig.daemon.process.kill(), tells=False, forgets=True)


@dataclass(frozen=True, slots=True)
class Cost:
    """What a case came to. Times in s after the cause."""

    way: str
    lift_s: float
    order: list[tuple[float, str]]
    contact_s: float
    standing_s: float
    standing_nm: float
    peak_nm: float
    """Deepest place that was polished since the cause, along the program too."""
    touched_s: float
    """When the tool last touched the part, whoever took it off."""
    disagreements: list[str]
    """Of the journal with the plant's account."""
    as_before: list[str]
    """The same of a journal that holds only what was told before contact was left, as it used to be."""
    uncertain: int
    """Blocks of which nobody knows whether the tool touched."""
    left: int
    """Blocks of contact that were still to come when it was left."""

    def at(self, what: str) -> float | None:
        """When it happened first; None where it did not."""
        return next((at_s for at_s, told in self.order if told == what), None)


def measure(way: Way, lift_s: float, folder: Path) -> Cost:
    """Bring a cell into contact, cause it, and read the plant's account once everything rests."""
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
    """Motion has stopped, and the tool is up where it will be."""

    def rests() -> bool:
        last = {event["event"]: k for k, event in enumerate(events(rig.files))}
        landed = last.get("tool_landed", -1)
        up = last.get("retracted", -1) > landed or not way.lifts
        return up and last.get("motion_stopped", -1) > landed

    if way.name == "actuator's wire cut":
        wait_for(lambda: rig.daemon.process.poll() is not None, "the daemon's end", SETTLE_S)
        rig.press("actuator", signal.SIGCONT)  # the wire is whole again: what it did meanwhile is told
    wait_for(rests, f"the cell to come to rest after {way.name}", SETTLE_S)


def _until_settled(rig: Rig, way: Way) -> None:
    """The daemon has journalled what it knows, and where it could not, the next one has."""
    if not way.ends:
        rig.daemon.wait_for_state("held")
    else:
        wait_for(lambda: rig.daemon.process.poll() is not None, "the daemon's end", SETTLE_S)
    if way.forgets:
        with contextlib.closing(connect(rig.files.state_dir / "journal.sqlite")) as journal:
            journal.execute("UPDATE pass SET boot_id = 'of another boot'")
    if not way.tells:
        with Daemon(rig.files) as again:
            again.wait_for_state("held")


def _cost(way: Way, lift_s: float, caused_s: float, files: DemoFiles) -> Cost:
    told = account(files)["way_out"]
    order = [
        (round(event["mono_s"] - caused_s, 2), SHOWN[event["device"], event["event"]])
        for event in events(files)
        if (event["device"], event["event"]) in SHOWN and event["mono_s"] >= caused_s
    ]
    firsts = [pair for k, pair in enumerate(order) if pair[1] not in {word for _, word in order[:k]}]
    figures = (told["contact_s"], told["standing_s"], told["standing_peak_nm"], told["peak_nm"])
    figures = (*figures, told["until_s"] - caused_s)
    journal, books = files.state_dir / "journal.sqlite", account(files)["programs"]
    (run,) = passes(journal)
    seen = (disagreements(journal, books), disagreements(_as_before(journal), books))
    left = run.contact[1] - int(np.flatnonzero(run.touched == 1)[-1]) - 1
    rounded = (round(figure, 3) for figure in figures)
    return Cost(way.name, lift_s, firsts, *rounded, *seen, run.uncertain.size, left)


def _as_before(journal: Path) -> Path:
    """A copy that knows nothing of what ran while contact was left."""
    copy = journal.with_name("as-before.sqlite")
    with contextlib.closing(sqlite3.connect(journal)) as whole, contextlib.closing(connect(copy)) as file:
        whole.backup(file)
        file.execute("DELETE FROM segment WHERE touched IS NOT 1")
        file.execute("UPDATE pass SET uncertain_from = NULL, uncertain_to = NULL")
    return copy


@contextmanager
def _wire(target: int) -> Iterator[tuple[proxy.Wire, asyncio.AbstractEventLoop]]:
    """The robot behind a wire that can be cut, in a loop of its own."""
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
    """A row a case, for docs/reference/results.md."""
    rows = []
    for cost in costs:
        order = ", ".join(f"{what} {at_s:.1f}" for at_s, what in cost["order"])
        figures = f"{cost['standing_s']:.2f} | {cost['standing_nm']:.0f} | {cost['peak_nm']:.0f}"
        rows.append(f"| {cost['way']} | {cost['lift_s']:g} | {order} | {figures} |\n")
    return HEADER + "".join(rows)


def rows_of(page: str) -> list[list[str]]:
    """The cells of the table in the page."""
    written = page.partition(BEGIN)[2].partition(END)[0].removeprefix(HEADER)
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in written.splitlines()]


def write_page(folder: Path) -> None:
    """Put the table of what was saved into docs/reference/results.md. SystemExit where nothing was."""
    rows = load(folder)
    if not rows:
        sys.exit(f"nothing was measured: no files in {folder}, and the page stays as it is. Run make ways-out.")
    before, _, rest = PAGE.read_text().partition(BEGIN)
    after = rest.partition(END)[2]
    PAGE.write_text(before + BEGIN + table(rows) + END + after)


def save(cost: Cost, folder: Path) -> None:
    """For the table."""
    folder.mkdir(parents=True, exist_ok=True)
    name = f"{cost.way.replace(' ', '-').replace(chr(39), '').replace(',', '')}-{cost.lift_s:g}.json"
    (folder / name).write_text(json.dumps(asdict(cost), indent=1))


def load(folder: Path) -> list[dict[str, Any]]:
    """What was saved, in the order of ``WAYS``."""
    names = [way.name for way in WAYS]
    found = [json.loads(path.read_text()) for path in folder.glob("*.json")]
    return sorted(found, key=lambda cost: (names.index(cost["way"]), cost["lift_s"]))


SAVED = Path("build/ways-out")

if __name__ == "__main__":
    write_page(SAVED)
