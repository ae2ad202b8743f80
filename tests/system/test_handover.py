"""The whole simulated cell with a robot whose controller loads files: what happens when it is held."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path

import numpy as np
import pytest

from tests.system.agreement import disagreements, passes
from tests.system.cell_rig import Daemon, account, events, summary
from tests.system.handover_rig import running, write_files
from tests.system.sim_rig import wait_for

pytestmark = pytest.mark.system


@pytest.mark.full
def test_a_feed_hold_in_contact_takes_the_tool_off_and_nothing_goes_on_by_itself(tmp_path: Path) -> None:
    """And the seat is proved before, as with any robot."""
    files = write_files(tmp_path / "cell", "opcua", 30.0, touch_off=True, tolerance_nm=0.01, max_cycles=1)
    with running(files, 4.0), Daemon(files) as daemon:
        daemon.wait_in_contact(60)
        pids = json.loads((files.sim_dir / "pids.json").read_text())
        os.kill(pids["robot"], signal.SIGUSR2)
        assert daemon.wait() == 5, daemon.output.read_text()
        log = events(files)
        stands = account(files)["stands"]
    assert "the feed is held at the controller" in summary(files)["reason"]
    assert len(stands) >= 3, "the seat was proved"
    names = [event["event"] for event in log]
    left = names[max(k for k, name in enumerate(names) if name == "button") :]
    assert left.index("motion_stopped") < left.index("force_zero") < left.index("tool_lifted")
    assert "motion_started" not in left, "nothing goes on by itself"


@pytest.mark.full
@pytest.mark.parametrize("kind", ["opcua", "ads"])
def test_a_daemon_that_is_killed_takes_no_block_as_not_executed(tmp_path: Path, kind: str) -> None:
    """The controller remembers nothing for the next one: all that the tool can have touched meanwhile is uncertain."""
    files = write_files(tmp_path / "cell", kind, 30.0, tolerance_nm=0.01, max_cycles=1)
    with running(files, 4.0):
        with Daemon(files) as daemon:
            daemon.wait_in_contact(60)
            daemon.end(signal.SIGKILL)
        wait_for(lambda: events(files, "tool_lifted"), "the lift by the actuator's own watchdog")
        with Daemon(files) as daemon:
            said = daemon.wait_for_state("held")["reason"]
            daemon.end()
        wait_for(lambda: events(files, "motion_started", "motion_stopped")[-1]["event"] == "motion_stopped", "rest")
        found = disagreements(files.state_dir / "journal.sqlite", account(files)["programs"])
    assert [one for one in found if "not touched" in one] == []  # when a block ended is known to a report's time
    assert "as far as the tool can have come: the robot does not remember" in said
    (one,) = passes(files.state_dir / "journal.sqlite")
    assert one.uncertain.size > 0
    assert one.uncertain[0] == np.flatnonzero(one.run_s)[-1] + 1, "the first one that nobody was told of"
