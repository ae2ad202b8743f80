"""Starts after an external change: a robot that serves another client, a run folder that was deleted."""

from __future__ import annotations

import json
import shutil
import signal
from pathlib import Path

import pytest

from polishd.commissioning.rehearsal.simulated_cell import simulated_cell
from polishd.daemon.socket import client
from tests.system.cell_rig import Daemon, events, small_cell, summary, with_keys, write_small
from tests.system.sim_rig import RobotClient, wait_for


@pytest.mark.full
def test_a_pass_that_was_killed_goes_on_though_its_run_folder_was_deleted(tmp_path: Path) -> None:
    with small_cell(tmp_path / "cell", seed=2, speed=20.0) as files:
        with Daemon(files) as daemon:
            daemon.wait_in_contact()
            assert daemon.end(signal.SIGKILL) == -signal.SIGKILL
        shutil.rmtree(files.run_dir)
        before = len(events(files))
        with Daemon(files) as daemon:
            held = daemon.wait_for_state("held")
            assert "interrupted" in held["reason"]
            assert held["unsafe"] == []
            assert not [e for e in events(files)[before:] if e["event"] in ("motion_started", "force_on")]
            assert client.request(files.state_dir, "resume")["state"] == "polishing"
            assert daemon.wait() == 0, daemon.output.read_text()
    assert summary(files)["outcome"] == "in_tolerance"


@pytest.mark.full
def test_a_new_job_that_is_started_held_begins_with_resume(tmp_path: Path) -> None:
    with small_cell(tmp_path / "cell", seed=2, speed=20.0) as files, Daemon(files, "--start-held") as daemon:
        held = daemon.wait_for_state("held")
        assert held["reason"] == "the daemon was started without an order to move"
        assert not events(files, "motion_started", "force_on")
        assert client.request(files.state_dir, "resume")["state"] == "polishing"
        daemon.wait_in_contact()


@pytest.mark.full
def test_a_robot_that_serves_another_client_is_waited_for_and_status_says_so(tmp_path: Path) -> None:
    """The watchdog is long: the lease ends when the other client disconnects, not because this machine is slow."""
    files = write_small(tmp_path / "cell")
    files.cell.write_text(with_keys(files.cell.read_text(), {"robot": {"watchdog_s": 120.0}}))
    with simulated_cell(files.sim, ["--state", str(files.sim_dir), "--seed", "2"], files.out / "sim.stderr"):
        other = RobotClient(json.loads((files.sim_dir / "endpoints.json").read_text())["robot"], role="writer")
        with Daemon(files) as daemon:
            waits = wait_for(lambda: (s := daemon.status()).get("reason") and s, "word of the robot")
            assert waits["state"] == "starting"
            assert waits["reason"].startswith("robot still serves its last client; the daemon retries for up to 128 s")
            other.close()
            daemon.wait_for_state("polishing")
            assert daemon.end() == 1
        assert "starting: robot still serves its last client" in daemon.output.read_text()
