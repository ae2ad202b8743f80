"""The whole simulated cell on a Universal Robots controller: safe whatever happens."""

from __future__ import annotations

import json
import os
import signal
import socket
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles
from polishd.config.cell import load_config
from polishd.sim_backends.universal_robots.device import DATA, SET_INPUTS, VERSION, pack
from tests.system.cell_rig import Daemon, events
from tests.system.sim_rig import alive, wait_for
from tests.system.test_daemon import require_safe_order
from tests.system.universal_robots_rig import dwell_cell

pytestmark = [pytest.mark.system, pytest.mark.full]

DEVICE, SAFETY = 5, 7
ONE_PASS = {"tolerance_nm": 0.01, "max_cycles": 1}
EARLY = 40


def options(files: DemoFiles) -> dict[str, Any]:
    """Keys of [robot]."""
    return dict(load_config(files.cell).robot.model_dump())


def robot_pid(files: DemoFiles) -> int:
    return int(json.loads((files.sim_dir / "pids.json").read_text())["robot"])


def say(files: DemoFiles, port: str, *messages: bytes) -> None:
    """Send a command from another client."""
    found = options(files)
    number = int(found["address"].rpartition(":")[2]) if port == "rtde" else int(found[port])
    with socket.create_connection(("127.0.0.1", number)) as client:
        for message in messages:
            client.sendall(message)
        client.shutdown(socket.SHUT_WR)
        while client.recv(4096):  # to its end: what is left unread would take the messages back
            pass


def slow_down(files: DemoFiles) -> None:
    names = b"speed_slider_mask,speed_slider_fraction"
    value = pack(DATA, b"\1" + struct.pack(">Id", 1, 0.5))
    say(files, "rtde", pack(VERSION, b"\0\2"), pack(SET_INPUTS, names), value)


def another_script(files: DemoFiles) -> None:
    say(files, "primary_port", b"def other():\n  sleep(30)\nend\n")


Happens = Callable[[DemoFiles], object]

MOVES_ON: dict[str, tuple[Happens, str]] = {"slider": (slow_down, "speed slider is at 50 %")}
"""Events after which the robot continues, so that the tool leaves the part before the robot stops."""
STANDS: dict[str, tuple[Happens, str]] = {
    "emergency stop": (lambda files: os.kill(robot_pid(files), signal.SIGUSR1), "switched off"),
    "pause": (lambda files: os.kill(robot_pid(files), signal.SIGUSR2), "paused at the controller"),
    "stop": (lambda files: say(files, "dashboard_port", b"stop\n"), "stopped at the controller"),
    "another script": (another_script, "another program"),
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
    with dwell_cell(tmp_path / "cell", speed=2.0, cut_s=1.0, **ONE_PASS) as files:
        with Daemon(files, "--no-hold") as daemon:
            assert daemon.wait() in (DEVICE, SAFETY), daemon.output.read_text()
        assert events(files, "wire_cut")
        wait_for(lambda: events(files, "motion_started", "motion_stopped")[-1]["event"] == "motion_stopped", "rest")
        require_safe_order(events(files))


def test_a_daemon_that_dies_is_noticed_by_the_controller_after_the_tool_is_up(tmp_path: Path) -> None:
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


LONG = 20_000
"""Number of moves of a script; the controller reports each in a separate line."""
TURN_S = 0.5


def test_a_controller_that_reads_a_long_script_goes_on_answering(tmp_path: Path) -> None:
    """The loop that the servers share measures that none of its turns was long."""
    moves = "\n".join(
        f"  write_output_integer_register(25, {k})\n  movel(p[{k % 100 / 1e4}, 0, 0.06, 3.14159, 0, 0], a=1, v=0.01)"
        for k in range(LONG)
    )
    with dwell_cell(tmp_path / "cell", speed=1.0) as files:
        say(files, "primary_port", f"def polishd():\n{moves}\nend\n".encode())
        wait_for(lambda: events(files, "program_loaded"), "the script")
        (loaded,) = events(files, "program_loaded")
    assert (loaded["blocks"], loaded["runs"]) == (LONG, True)
    assert loaded["longest_turn_s"] < TURN_S
