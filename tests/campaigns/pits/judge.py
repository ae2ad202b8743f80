"""One fault in contact at speed 1: when it was noticed, when the force was off, and what the part lost beyond plan.

Times are of the simulators' own log, the removal is the plant's own account (``pit`` of dwell_account.json), the bound
is what ``polishd check --json`` prints for the cell.
"""

from __future__ import annotations

import json
import math
import re
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles
from polishd.config.simulator_faults import PANEL, WIRES
from tests.campaigns.faults.judge import LATE_S, OFF, REACTIONS, STANDS, STOPPED_S, UP, first, kill, load, watchdog_s
from tests.campaigns.faults.judge import reason as reason_of
from tests.campaigns.faults.links import KILL
from tests.campaigns.pits.cases import CONTACT_S, LINKS
from tests.system.cell_rig import account, events, summary
from tests.system.sim_rig import wait_for

MOST_NM = 150.0
"""No row above it."""
WITHIN = 1.2
"""Times the bound, at most."""
END_S = 300.0
"""Of a pass at speed 1, on a machine that is busy."""
PROGRAM = "removal of the program as it is"
LIE = "if the actuator misreads its force"
"""Fact of ``check``: what an actuator costs that presses up to process.force_max_n and reads the set point."""


@dataclass(frozen=True, slots=True)
class Finding:
    """A row of the table. Times in s from the first wrong moment; None: it was not noticed."""

    link: str
    fault: str
    noticed: str
    """The daemon's reason."""
    notice_s: float | None
    no_force_s: float | None
    removed_nm: float
    """Beyond plan at the worst place."""
    bound_nm: float
    wrong: list[str]
    load: float


def measure(link: str, fault: str, folder: Path) -> Finding:
    """Bring a cell into contact, and let it happen."""
    chosen = LINKS[link]
    files = chosen.files(folder, fault)
    checked = check(files)
    with chosen.running(files) as daemon, daemon() as process:
        wait_for(lambda: events(files, "tool_landed") or process.process.poll() is not None, "contact", END_S)
        assert events(files, "tool_landed"), process.output.read_text()
        if chosen.faults[fault]["what"] == KILL:
            kill(process, CONTACT_S)
        wait_for(lambda: process.process.poll() is not None, f"the end of the pass after: {fault}", END_S)
        wait_for(lambda: _rests(files), "the cell to rest", END_S)
    return _finding(link, fault, files, account(files)["pit"], checked)  # whole, once the simulator has ended


def check(files: DemoFiles) -> Mapping[str, Any]:
    """Answer of ``polishd check --json``."""
    command = [sys.executable, "-m", "polishd.cli.app", "check", str(files.cell), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=END_S)
    assert done.returncode == 0, done.stdout + done.stderr
    return dict(json.loads(done.stdout))


def bound_nm(checked: Mapping[str, Any], planned_nm: float | None = None) -> float:
    """Removal that the check states: of a standing robot, or of a lying actuator that nothing can notice.

    That of an actuator it states for the program as it is: it grows with what is planned at the worst place.
    """
    if planned_nm is None:
        return float(checked["pit"]["removal_nm"])
    more_nm = float(re.findall(r"removes ([\d.]+) nm more", checked[LIE])[-1])
    return planned_nm * more_nm / float(checked[PROGRAM].split()[0])


def _rests(files: DemoFiles) -> bool:
    """The tool is up, and nothing moves."""
    last = {event["event"]: k for k, event in enumerate(events(files))}
    up = max(last.get(name, -1) for name in UP)
    return up > last.get("tool_landed", -1) and last.get("motion_stopped", -1) > last.get("motion_started", -1)


def _finding(
    link: str,
    fault: str,
    files: DemoFiles,
    pit: Mapping[str, Any] | None,
    checked: Mapping[str, Any],
) -> Finding:
    log, unnoticed, what = events(files), fault in LINKS[link].unnoticed, LINKS[link].faults[fault]["what"]
    reason = reason_of(files, killed=what == KILL)
    begun_s, landed_s = first(log, {"fault_begins", "pit_marked"}), first(log, {"tool_landed"})
    assert begun_s is not None, "the fault did not begin"
    assert landed_s is not None
    wrong_s = max(begun_s, landed_s)
    assert not unnoticed or summary(files)["outcome"] == "cycles_used", f"the pass did not end: {reason}"
    left = [event for event in log if landed_s <= event["mono_s"] < wrong_s and event["event"] == "retract"]
    assert not left, f"contact was left before the fault: {reason}"
    after = [event for event in log if event["mono_s"] >= wrong_s]
    lost = () if what in WIRES else ("LinkError",)
    assert not reason.startswith((*lost, "HostFault")), f"this computer was too busy: {reason}"
    # to the end of the pass, where the tool is lifted anyway
    ran_on = what != KILL and summary(files)["outcome"] == "cycles_used"
    reactions = REACTIONS - (STANDS if what in PANEL else set())
    notice_s, off_s = (None, None) if ran_on else (first(after, reactions), first(after, OFF))
    assert pit is not None, "the plant knows of no fault"
    removed_nm = max(pit["part_nm"] if unnoticed else pit["peak_nm"], 0.0)  # of a whole pass: it ends off the part
    limit_nm = bound_nm(checked, pit["planned_nm"] if unnoticed else None)
    wrong = []
    if notice_s is None and not unnoticed:
        wrong.append("not noticed")
    within_s = {KILL: watchdog_s(files), **dict.fromkeys(PANEL, STOPPED_S)}.get(what, math.inf) + LATE_S
    if notice_s is not None and notice_s - wrong_s > within_s:
        wrong.append(f"noticed after {notice_s - wrong_s:.2f} s, limit {within_s:g} s")
    if removed_nm > MOST_NM:
        wrong.append(f"{removed_nm:.0f} nm, more than {MOST_NM:g} nm")
    if removed_nm > WITHIN * limit_nm:
        wrong.append(f"{removed_nm / limit_nm:.2f} times the bound")
    return Finding(
        link,
        fault,
        reason.replace(f"{files.out}/", ""),
        None if notice_s is None else round(notice_s - wrong_s, 3),
        None if off_s is None else round(off_s - wrong_s, 3),
        round(removed_nm, 1),
        round(limit_nm, 1),
        wrong,
        load(),
    )
