"""One pass of the simulated cell in a robot's own language, on a controller that loads files."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from polishd.programs.options import EncodingOption
from tests.system.agreement import require_agreement
from tests.system.cell_rig import Daemon, events, summary
from tests.system.plc_robot_rig import running, write_language_cell
from tests.system.sim_rig import wait_for
from tests.system.test_kuka_kvp import robot_pid

pytestmark = [pytest.mark.system, pytest.mark.slow]

ONE_PASS = {"tolerance_nm": 0.01, "max_cycles": 1}


@pytest.mark.parametrize(
    ("language", "encoding", "ending"), [("inform", "feed", "POLISH.JBI"), ("val3", "dwell", "polish.pgx")]
)
def test_a_pass_in_the_robots_own_language_is_accounted_for(
    tmp_path: Path, language: str, encoding: EncodingOption, ending: str
) -> None:
    files = write_language_cell(tmp_path / "cell", language, encoding, **ONE_PASS)
    with running(files, 8.0), Daemon(files, "--no-hold") as daemon:
        assert daemon.wait() == 0, daemon.output.read_text()
        require_agreement(files)
        log = events(files)
    assert summary(files)["outcome"] == "cycles_used"
    assert (files.sim_dir / "programs" / ending).is_file()
    loaded = [event for event in log if event["event"] == "program_loaded"]
    assert loaded, "the controller read the program"
    names = [event["event"] for event in log]
    assert names.index("tool_landed") < names.index("tool_lifted")


@pytest.mark.parametrize(("language", "encoding"), [("inform", "dwell"), ("val3", "feed")])
def test_an_emergency_stop_in_contact_takes_the_tool_off(
    tmp_path: Path, language: str, encoding: EncodingOption
) -> None:
    files = write_language_cell(tmp_path / "cell", language, encoding, **ONE_PASS)
    with running(files, 2.0):
        with Daemon(files, "--no-hold") as daemon:
            daemon.wait_in_contact(20)
            os.kill(robot_pid(files), signal.SIGUSR1)
            assert daemon.wait() in (5, 7), daemon.output.read_text()
            assert "emergency stop" in daemon.output.read_text()
        wait_for(lambda: events(files, "tool_landed", "tool_lifted")[-1]["event"] == "tool_lifted", "the tool lifted")
        last = {event["event"]: k for k, event in enumerate(events(files))}
    assert last["tool_landed"] < last["force_zero"] < last["tool_lifted"]
