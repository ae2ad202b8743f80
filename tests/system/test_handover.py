"""The whole simulated cell with a robot whose controller loads files: what it told against what truly was."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polishd.console.demo_files import DemoFiles
from tests.system.agreement import disagreements, passes
from tests.system.cell_rig import Daemon, account, events, summary
from tests.system.handover_rig import running, write_files
from tests.system.sim_rig import wait_for
from tests.system.test_daemon import require_safe_order

pytestmark = pytest.mark.system

APERTURE_MM = 20.0
SPEED = 8.0


def polished(out: Path, kind: str) -> DemoFiles:
    """Two passes, whatever they reach."""
    files = write_files(out, kind, APERTURE_MM, tolerance_nm=0.01, max_cycles=2)
    with running(files, SPEED), Daemon(files) as daemon:
        assert daemon.wait() == 1, daemon.output.read_text()
    return files


def told_and_true_s(files: DemoFiles, cycle: int) -> tuple[np.ndarray, np.ndarray]:
    """Contact of each block, by the driver and by the plant, s."""
    rows = np.genfromtxt(files.run_dir / f"cycle-{cycle:02d}" / "executed.csv", delimiter=",", names=True)
    true = np.array(account(files)["programs"][cycle]["contact_s"])
    told = np.zeros(len(true))
    np.add.at(told, rows["seq"].astype(int), (rows["end_s"] - rows["start_s"]) * (rows["contact"] == 1))
    return told, true


def cycles(files: DemoFiles) -> list[dict[str, Any]]:
    return list(summary(files)["cycles"])


@pytest.mark.full
def test_controllers_that_load_files_polish_as_one_that_is_streamed_to(tmp_path: Path) -> None:
    """Over OPC UA and over ADS: all time is accounted for, what was learned predicts the pass, the part is as good."""
    streamed = cycles(polished(tmp_path / "link", "link"))[-1]["rms_nm"]
    for kind in ("opcua", "ads"):
        files = polished(tmp_path / kind, kind)
        require_safe_order(events(files))
        for cycle in (0, 1):
            told, true = told_and_true_s(files, cycle)
            assert told.sum() == pytest.approx(true.sum(), rel=1e-3)
        second = cycles(files)[1]
        assert second["executed_s"] == pytest.approx(second["dwell_s"], rel=0.01)
        assert cycles(files)[-1]["rms_nm"] == pytest.approx(streamed, rel=0.1)


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
