"""One fault in contact: run a cell and its daemon as processes, and judge how contact ended or went on.

Times of the fault, the first reaction and force off are from the simulators' logs; the reason is the daemon's.
"""

from __future__ import annotations

import json
import math
import os
import signal
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles, simulated_cell
from polishd.config.cell import load_config
from polishd.config.simulator_faults import PANEL
from tests.campaigns.faults.links import KILL, LINKS
from tests.system.agreement import disagreements
from tests.system.cell_rig import Daemon, events, summary, whole_account, with_faults
from tests.system.sim_rig import wait_for

CONTACT_S = 0.8
"""In contact before the fault, wall time."""
GOES_ON = 2.5
"""Multiple of the link's limit: a pass that executes blocks so long after a fault counts as continued."""
END_S = 60.0
FORCE_OFF_S = 0.2
"""Longest permitted time from the first reaction to force off."""
LATE_S = 0.5
"""Permitted delay of the reaction on a busy machine."""
STOPPED_S = 1.0
"""Longest permitted time until the daemon notices a stop at the robot's panel."""
NO_POWER = "actuator_lost"
"""Without power the actuator's spring lifts the tool."""
REACTIONS = {"retract", "force_off", "force_zero", "contact_lost", "watchdog", "spindle_ramping", "motion_stopped"}
OFF = {"force_off", "force_zero", "contact_lost", NO_POWER}
UP = {"tool_lifted", "retracted", "contact_lost", NO_POWER}
PRESSES = {"tool_landed", "force_on", "engage"}
STANDS = {"motion_stopped", "robot_lost"}
STOPS_FIRST = "guard_closed"
"""Signal of these cells that leads to an emergency stop: motion stops at once."""


@dataclass(frozen=True, slots=True)
class Finding:
    """Result of a case. Times in s."""

    link: str
    fault: str
    noticed: str
    """Reason that the daemon gave; empty where the pass continued."""
    detection_s: float | None
    """From the fault to the cell's first reaction."""
    limit_s: float
    force_off_s: float | None
    """From that to no more than the tool's own weight."""
    outcome: str
    wrong: list[str]
    load: float | None = None
    """Of the computer, processes a core, over the last minute: on one that is busy all times are longer."""


def measure(link: str, fault: str, folder: Path) -> Finding:
    """Bring a cell into contact, and inject the fault."""
    chosen = LINKS[link]
    files = chosen.files(folder)
    kills = chosen.faults[fault]["what"] == KILL
    scripted = [] if kills else [{**chosen.fault(fault), "contact_s": CONTACT_S}]
    files.sim.write_text(with_faults(files.sim.read_text(), *scripted))
    options = ["--state", str(files.sim_dir), "--seed", "3", "--speed", f"{chosen.speed:g}"]
    with simulated_cell(files.sim, options, folder / "sim.stderr"):
        with Daemon(files, "--no-hold") as daemon:
            if kills:
                kill(daemon, CONTACT_S)
            wait_for(lambda: _acted(files) or daemon.process.poll() is not None, f"{fault} on the {link}", END_S)
            assert events(files, "tool_landed"), daemon.output.read_text()
            within_s = math.inf if chosen.must_end(fault) else GOES_ON * chosen.silence_s
            ended = daemon.process.poll
            wait_for(lambda: ended() is not None or _polished_on(files, within_s), "an end, or that it goes on", END_S)
            went_on = daemon.process.poll() is None
            code = daemon.end() if went_on else daemon.wait()
        wait_for(lambda: _rests(files), "the cell to rest", END_S)
        if kills:  # a killed daemon journals nothing: the next start does
            with Daemon(files) as daemon:
                daemon.wait_for_state("held")
        return _finding(link, fault, files, went_on=went_on, code=code)


def kill(daemon: Daemon, contact_s: float) -> None:
    """Kill the daemon so long after the tool landed; the plant marks the moment."""
    files = daemon.files
    wait_for(lambda: events(files, "tool_landed") or daemon.process.poll() is not None, "contact", END_S)
    assert events(files, "tool_landed"), daemon.output.read_text()
    time.sleep(contact_s)  # the case is: so long in contact
    plant = int(json.loads((files.sim_dir / "pids.json").read_text())["plant"])
    daemon.process.kill()
    os.kill(plant, signal.SIGUSR2)  # at once: on a busy computer the daemon would polish on while the mark is awaited
    daemon.process.wait()
    wait_for(lambda: events(files, "pit_marked"), "the mark")


def _acted(files: DemoFiles) -> dict[str, Any] | None:
    """Return the simulators' first event of the fault."""
    return next(iter(events(files, "fault_begins", "fault_acts", "pit_marked")), None)


def _polished_on(files: DemoFiles, after_s: float) -> bool:
    """Whether blocks were executed long after the fault."""
    acted = _acted(files)
    runs = [event["mono_s"] for event in events(files, "blocks")]
    return acted is not None and bool(runs) and runs[-1] - acted["mono_s"] > after_s


def _rests(files: DemoFiles) -> bool:
    """Whether the tool is up and the robot at rest."""
    place = _last_place(_log(files))
    return place(UP) > place({"tool_landed"}) and place(STANDS) > place({"motion_started"})


def _log(files: DemoFiles) -> list[dict[str, Any]]:
    """Return the simulators' log, in which a loss of power names its device."""
    log = events(files)
    return [e | {"event": f"{e['device']}_lost"} if e["event"] == "lost" else e for e in log]


def _finding(link: str, fault: str, files: DemoFiles, *, went_on: bool, code: int) -> Finding:
    log, acted = _log(files), _acted(files)
    since_s = acted["mono_s"] if acted else 0.0
    after = [event for event in log if event["mono_s"] >= since_s]
    what = LINKS[link].faults[fault]["what"]
    noticed = "" if went_on else _without_folder(reason(files, killed=what == KILL), files)
    reacted_s = None if went_on else first(after, REACTIONS - (STANDS if what in PANEL else set()))
    off_s = None if went_on else first(after, OFF)
    wrong = list(_wrong(link, fault, files, after, acted=acted is not None, noticed=noticed, went_on=went_on))
    limit_s = watchdog_s(files) if what == KILL else STOPPED_S if what in PANEL else LINKS[link].silence_s
    detection_s = None if reacted_s is None else round(reacted_s - since_s, 3)
    force_off_s = None if off_s is None or reacted_s is None else round(max(off_s - reacted_s, 0.0), 3)
    if force_off_s is not None and force_off_s > FORCE_OFF_S:
        wrong.append(f"force off {force_off_s} s after it was noticed")
    is_timed = LINKS[link].must_end(fault) and (_is_loss(fault) or what in {*PANEL, KILL})
    if is_timed and detection_s is not None and detection_s > limit_s + LATE_S:
        wrong.append(f"noticed after {detection_s} s, limit {limit_s} s")
    outcome = "goes on" if went_on else f"contact left, exit code {code}"
    return Finding(link, fault, noticed, detection_s, limit_s, force_off_s, outcome, wrong, load())


def reason(files: DemoFiles, *, killed: bool) -> str:
    """What ended contact: the daemon's reason, or the device whose watchdog acted first where the daemon was killed."""
    if not killed:
        return str(summary(files)["reason"])
    return "".join(f"watchdog of the {event['device']}" for event in events(files, "watchdog")[:1])


def watchdog_s(files: DemoFiles) -> float:
    """Of the cell's actuator."""
    keys = load_config(files.cell).actuator.model_dump()
    return float(keys["watchdog_s"] if "watchdog_s" in keys else keys["watchdog_ms"] / 1e3)


def _without_folder(text: str, files: DemoFiles) -> str:
    """Return the text without the temporary folders of the case."""
    return text.replace(f"{files.sim_dir}/", "...").replace(f"{files.out}", "...")


def load() -> float:
    """Return the processes that wait for a core, per core."""
    return round(os.getloadavg()[0] / (os.cpu_count() or 1), 1)


def _is_loss(fault: str) -> bool:
    return fault in {"hangs", "unplugged", "reboots", "all garbled", "all lost"}


def first(log: Sequence[Mapping[str, Any]], names: set[str]) -> float | None:
    """Return the time of the first of these events, by the simulators' clock."""
    return next((float(event["mono_s"]) for event in log if event["event"] in names), None)


def _wrong(
    link: str,
    fault: str,
    files: DemoFiles,
    after: Sequence[Mapping[str, Any]],
    *,
    acted: bool,
    noticed: str,
    went_on: bool,
) -> Iterator[str]:
    """Yield what must hold after any fault and does not."""
    if not acted:
        yield "contact ended before the fault acted"
        return
    if went_on and LINKS[link].must_end(fault):
        yield "not noticed"
    if "Traceback" in files.daemon_log.read_text():
        yield "the daemon raised"
    place = _last_place(after)
    off, up = place(OFF), place(UP)
    if off < 0 or up < 0:
        yield "the tool stayed on the part"
    still = place({"motion_stopped"})
    lifted = any(event.get("detail") == "lift" for event in after if event["event"] == "motion_stopped")
    stood = LINKS[link].device == "robot" and LINKS[link].faults[fault]["what"] in {"reboot", *PANEL}
    if STOPS_FIRST not in noticed and not stood and not lifted and 0 <= still < place({"tool_lifted", "contact_lost"}):
        yield "motion stopped before the tool was up"
    if place(PRESSES) > up:
        yield "it pressed again"
    if place({"motion_started"}) > place(STANDS):
        yield "it moved again"
    yield from disagreeing(files, link)


def _last_place(log: Sequence[Mapping[str, Any]]) -> Callable[[set[str]], int]:
    last = {event["event"]: k for k, event in enumerate(log)}
    return lambda names: max(last.get(name, -1) for name in names)


def disagreeing(files: DemoFiles, link: str) -> Iterator[str]:
    """Yield what was polished twice, and where journal and plant differ."""
    books = whole_account(files)["programs"]
    for book in books:
        if book["loads"] != 1:
            yield f"program {book['sha256'][:8]} was loaded {book['loads']} times"
    by_model = LINKS[link].driver == "plc_robot"
    yield from disagreements(files.state_dir / "journal.sqlite", books, by_model=by_model, least_s=LINKS[link].least_s)
