"""The whole simulated cell on a KUKA controller: safe whatever happens."""

from __future__ import annotations

import json
import os
import signal
import socket
import struct
from collections.abc import Callable
from pathlib import Path

import pytest

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles
from polishd.config.cell import load_config
from tests.system.cell_rig import Daemon, events
from tests.system.kuka_rig import dwell_cell
from tests.system.sim_rig import alive, wait_for
from tests.system.test_daemon import require_safe_order

pytestmark = [pytest.mark.system, pytest.mark.full]

DEVICE, SAFETY = 5, 7
ONE_PASS = {"tolerance_nm": 0.01, "max_cycles": 1}
EARLY = 40


def robot_pid(files: DemoFiles) -> int:
    return int(json.loads((files.sim_dir / "pids.json").read_text())["robot"])


def say(files: DemoFiles, kind: int, payload: bytes) -> bytes:
    """Send a request from another client."""
    port = int(str(load_config(files.cell).robot.model_dump()["address"]).rpartition(":")[2])
    with socket.create_connection(("127.0.0.1", port)) as client:
        client.sendall(struct.pack(">HHB", 7, 1 + len(payload), kind) + payload)
        return client.recv(4096)


def slow_down(files: DemoFiles) -> None:
    assert say(files, 1, b"\0\7$OV_PRO\0\00250")[-1] == 1


def stop_key(files: DemoFiles) -> None:
    assert say(files, 10, b"\3\0\1")[-1] == 1


Happens = Callable[[DemoFiles], object]

MOVES_ON: dict[str, tuple[Happens, str]] = {"override": (slow_down, "override is at 50 %")}
"""Events after which the robot continues, so that the tool leaves the part before the robot stops."""
STANDS: dict[str, tuple[Happens, str]] = {
    "emergency stop": (lambda files: os.kill(robot_pid(files), signal.SIGUSR1), "a stop message is active"),
    "manual mode": (lambda files: os.kill(robot_pid(files), signal.SIGUSR2), "mode T1"),
    "stop key": (stop_key, "stopped at the controller"),
    "power cut": (lambda files: os.kill(robot_pid(files), signal.SIGKILL), "127.0.0.1"),
}
"""Events at which the robot stops: the daemon takes the force off at once."""


@pytest.mark.parametrize("fault", [*MOVES_ON, *STANDS])
def test_contact_is_left_at_once_and_the_daemon_says_why(tmp_path: Path, fault: str) -> None:
    happens, said = {**MOVES_ON, **STANDS}[fault]
    with dwell_cell(tmp_path / "cell", speed=2.0, **ONE_PASS) as files:
        with Daemon(files, "--no-hold") as daemon:
            daemon.wait_in_contact(EARLY)
            happens(files)
            assert daemon.wait() in (DEVICE, SAFETY), daemon.output.read_text()
            assert said in daemon.output.read_text()
        wait_for(lambda: events(files, "tool_landed", "tool_lifted")[-1]["event"] == "tool_lifted", "the tool lifted")
        log = events(files)
        last = {event["event"]: k for k, event in enumerate(log)}
        assert last["tool_landed"] < last["force_zero"] < last["tool_lifted"]
        if fault in MOVES_ON:
            require_safe_order(log)
        after = log[last["tool_lifted"] :]
        assert "motion_started" not in [event["event"] for event in after]


def test_a_lost_link_is_left_before_motion_stops_and_nothing_moves_by_itself(tmp_path: Path) -> None:
    with dwell_cell(tmp_path / "cell", speed=2.0, cut_s=3.0, **ONE_PASS) as files:
        with Daemon(files, "--no-hold") as daemon:
            assert daemon.wait() in (DEVICE, SAFETY), daemon.output.read_text()
        assert events(files, "wire_cut")
        wait_for(lambda: events(files, "motion_started", "motion_stopped")[-1]["event"] == "motion_stopped", "rest")
        require_safe_order(events(files))


def test_a_daemon_that_dies_is_noticed_by_the_shipped_watchdog_after_the_tool_is_up(tmp_path: Path) -> None:
    with dwell_cell(tmp_path / "cell", speed=1.0, watchdog_s=12.0, **ONE_PASS) as files:
        with Daemon(files) as daemon:
            daemon.wait_in_contact(EARLY)
            daemon.end(signal.SIGKILL)
        wait_for(lambda: events(files, "motion_started", "motion_stopped")[-1]["event"] == "motion_stopped", "rest")
        require_safe_order(events(files))
        before = len(events(files))
        with Daemon(files) as daemon:
            said = daemon.wait_for_state("held")["reason"]
            assert "estimated: the robot has no record of this pass" in said
            assert not [e for e in events(files)[before:] if e["event"] in ("motion_started", "force_on")]
            daemon.end()
        assert not alive(daemon.process.pid)
