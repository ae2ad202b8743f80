"""One pass of the simulated cell in the language of a robot, on a controller that loads files."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import numpy as np
import pytest

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles
from polishd.plugin_loader import load_cell
from polishd.programs.options import EncodingOption
from tests.system.agreement import passes
from tests.system.cell_rig import Daemon, account, events, summary
from tests.system.plc_robot_rig import running, write_language_cell
from tests.system.sim_rig import wait_for
from tests.system.test_kuka_kvp import robot_pid

pytestmark = [pytest.mark.system, pytest.mark.slow]

FAR = 320
"""Number of lines of the file that are compared: head, approach and some of the pass."""
ONE_PASS = {"tolerance_nm": 50.0, "max_cycles": 1}
"""Permitted RMS after the pass, of 100 nm before it."""


def require_agreement_of_points(files: DemoFiles) -> None:
    """The journal's time of a point, a move and its wait, agrees with the plant's.

    The controller says when each line began. Only points that end between two reports share their time by the plan.
    """
    config, hooks = load_cell(files.cell)
    program = hooks.program_formats()[config.program.format].read(config.program_path.read_bytes(), "program")
    (one,) = passes(files.state_dir / "journal.sqlite")
    (book,) = (book for book in account(files)["programs"] if book["sha256"] == one.sha256)
    seen_s, edges = np.array(book["contact_s"])[: len(one.run_s)], [program.block[0] - 1, *program.block]
    ours, plants = (np.diff(np.cumsum(times_s)[edges]) for times_s in (np.nan_to_num(one.run_s), seen_s))
    assert (one.touched[program.block] == 1).all()
    assert np.median(np.abs(ours - plants)) < 1e-3
    assert np.quantile(np.abs(ours - plants), 0.95) < 0.1
    assert ours.sum() == pytest.approx(plants.sum(), abs=0.01)


@pytest.mark.parametrize(
    ("language", "encoding", "ending"), [("inform", "dwell", "POLISH.JBI"), ("val3", "feed", "polish.pgx")]
)
def test_a_pass_in_the_robots_own_language_is_accounted_for(
    tmp_path: Path, language: str, encoding: EncodingOption, ending: str
) -> None:
    files = write_language_cell(tmp_path / "cell", language, encoding, **ONE_PASS)
    with running(files, 4.0), Daemon(files, "--no-hold") as daemon:
        assert daemon.wait() == 0, daemon.output.read_text()
        require_agreement_of_points(files)
        log = events(files)
    assert summary(files)["outcome"] == "in_tolerance"
    assert (files.sim_dir / "programs" / ending).is_file()
    loaded = [event for event in log if event["event"] == "program_loaded"]
    assert loaded, "the controller read the program"
    names = [event["event"] for event in log]
    assert names.index("tool_landed") < names.index("tool_lifted")


@pytest.mark.parametrize(("language", "encoding"), [("inform", "dwell"), ("val3", "dwell")])
def test_an_emergency_stop_in_contact_takes_the_tool_off(
    tmp_path: Path, language: str, encoding: EncodingOption
) -> None:
    files = write_language_cell(tmp_path / "cell", language, encoding, **ONE_PASS)
    with running(files, 2.0):
        with Daemon(files, "--no-hold") as daemon:
            daemon.wait_in_contact(FAR)
            os.kill(robot_pid(files), signal.SIGUSR1)
            assert daemon.wait() in (5, 7), daemon.output.read_text()
            assert "emergency stop" in daemon.output.read_text()
        wait_for(lambda: events(files, "tool_landed", "tool_lifted")[-1]["event"] == "tool_lifted", "the tool lifted")
        last = {event["event"]: k for k, event in enumerate(events(files))}
    assert last["tool_landed"] < last["force_zero"] < last["tool_lifted"]
