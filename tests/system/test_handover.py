"""The whole simulated cell with a robot whose controller loads files: what happens when it is held."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path

import pytest

from tests.system.cell_rig import Daemon, account, events, summary
from tests.system.handover_rig import running, write_files

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
