"""A real LinuxCNC in contact, with its own feed override turned at a pendant, and feed inhibited by an interlock."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles
from tests.interop.peers import Peer
from tests.system.cell_rig import (
    PATIENT,
    events,
    summary,
    whole_account,
    with_faults,
    with_keys,
    write_small,
)
from tests.system.linuxcnc_rig import linuxcnc_cell, take
from tests.system.sim_rig import wait_for
from tests.system.test_faults import require_off_the_part

PEER = Peer("LinuxCNC", "linuxcncrsh", "controller (feed override, feed inhibit)", "Debian", "linuxcnc-uspace")
pytestmark = [PEER.needed, pytest.mark.system, pytest.mark.timeout(300)]

SAFETY = 7
MOST_NM = 150.0
NO_PROGRESS_S = 0.5
"""Limit that ends the pass in tests of a standstill; on a busy machine other tests need a longer one."""
CONTACT_S = 3.0
"""Contact time before the event: on a busy machine LinuxCNC resumes late."""


def write_files(folder: Path, robot: Mapping[str, float] = PATIENT["robot"], **fault: Any) -> DemoFiles:
    """Write the files of a job of one pass with this fault of the robot."""
    files = write_small(folder, patient=False, tolerance_nm=5.0, max_cycles=1)
    take(files)
    files.cell.write_text(with_keys(files.cell.read_text(), {**PATIENT, "robot": robot}))
    files.sim.write_text(with_faults(files.sim.read_text(), {"device": "robot", **fault}))
    return files


def polished(folder: Path, robot: Mapping[str, float] = PATIENT["robot"], **fault: Any) -> tuple[DemoFiles, int, str]:
    """The files, the daemon's exit code and its output."""
    files = write_files(folder, robot, **fault)
    with linuxcnc_cell(files) as cell, cell.daemon() as daemon:
        wait_for(lambda: daemon.process.poll() is not None, "the daemon's end", 200.0)
        return files, daemon.wait(), daemon.output.read_text()


def require_left(files: DemoFiles) -> None:
    """The tool is off before motion is stopped, and the part has lost no more than it may."""
    assert events(files, "fault_begins")
    require_off_the_part(files)
    pit = whole_account(files)["pit"]
    assert 0.0 < pit["peak_nm"] < MOST_NM


@pytest.mark.parametrize("percent", [0.0, 50.0])
def test_a_feed_override_turned_in_contact_is_read_and_contact_left(tmp_path: Path, percent: float) -> None:
    files, code, said = polished(tmp_path / "cell", what="override", percent=percent, contact_s=CONTACT_S)
    assert code == SAFETY, said
    assert f"speed override is {percent:.0f}%" in summary(files)["reason"]
    require_left(files)


def test_a_feed_that_is_inhibited_is_no_progress_and_contact_left(tmp_path: Path) -> None:
    """LinuxCNC reports its program as running, at 100 %."""
    prompt = {**PATIENT["robot"], "no_progress_s": NO_PROGRESS_S}
    files, code, said = polished(tmp_path / "cell", prompt, what="stand", contact_s=CONTACT_S)
    assert code == SAFETY, said
    assert "robot does not advance" in summary(files)["reason"]
    require_left(files)


def test_a_low_feed_override_refuses_contact(tmp_path: Path) -> None:
    files = write_files(tmp_path / "cell", what="override", percent=50.0, at_s=0.0)
    with linuxcnc_cell(files) as cell, cell.daemon() as daemon:
        reason = daemon.wait_for_state("held")["reason"]
        daemon.end()
    assert "speed override is 50%" in reason
    assert "robot.least_override" in reason
    assert not events(files, "tool_landed", "force_on", "motion_started")
