"""The whole simulated cell on a FANUC controller with RMI: safe whatever happens, and to its tolerance."""

from __future__ import annotations

import json
import os
import shutil
import signal
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles, free_port, simulated_cell
from tests.commissioned import forged
from tests.patience import SOON_S
from tests.system.cell_rig import Daemon, account, events, summary, with_keys
from tests.system.fanuc_rmi_rig import RIMMED, dwell_cell, write_files
from tests.system.sim_rig import alive, wait_for
from tests.system.test_daemon import require_safe_order
from tests.system.test_queue import polishd, queue
from tests.system.test_rehearsal import rehearsed

pytestmark = [pytest.mark.system, pytest.mark.full]

DEVICE, SAFETY = 5, 7
ONE_PASS = {"tolerance_nm": 0.01, "max_cycles": 1}
EARLY = 6
PATIENT = {
    "robot": {"silence_s": 6.0, "watchdog_s": 60.0},
    "actuator": {"silence_s": 0.8, "watchdog_ms": 1200},
    "machine": {"least_point_s": 0.7},
    "job": {"stream_ahead_s": 2.0},
}
EXAMPLES = Path(__file__).parents[2] / "examples"


def press(files: DemoFiles, number: signal.Signals) -> None:
    os.kill(int(json.loads((files.sim_dir / "pids.json").read_text())["robot"]), number)


def few(faults: Mapping[str, Any], first: str) -> list[Any]:
    """In real time each takes a minute: all but the first are slow."""
    return [first, *(pytest.param(name, marks=pytest.mark.slow) for name in faults if name != first)]


Happens = Callable[[DemoFiles], object]
STANDS: dict[str, tuple[Happens, str]] = {
    "emergency stop": (lambda files: press(files, signal.SIGUSR1), "fault|servos"),
    "pause": (lambda files: press(files, signal.SIGUSR2), "paused at the controller"),
    "manual": (lambda files: press(files, signal.SIGALRM), "fault|teach pendant"),
    "power cut": (lambda files: press(files, signal.SIGKILL), "127.0.0.1"),
}
OVERRIDES = {
    "override 50 %": {"what": "override", "percent": 50.0, "contact_s": 5.0},
    "override 0 %": {"what": "override", "percent": 0.0, "contact_s": 5.0},
    "stands, reports running": {"what": "stand", "contact_s": 5.0},
    "unplugged": {"what": "unplug", "contact_s": 5.0, "duration_s": 60.0},
}


@pytest.mark.parametrize("fault", few(STANDS, "emergency stop"))
def test_contact_is_left_at_once_and_the_daemon_says_why(tmp_path: Path, fault: str) -> None:
    happens, said = STANDS[fault]
    with dwell_cell(tmp_path / "cell", **ONE_PASS) as files:
        with Daemon(files, "--no-hold") as daemon:
            daemon.wait_in_contact(EARLY)
            happens(files)
            assert daemon.wait() in (DEVICE, SAFETY), daemon.output.read_text()
            assert any(one in daemon.output.read_text() for one in said.split("|"))
        wait_for(lambda: events(files, "tool_landed", "tool_lifted")[-1]["event"] == "tool_lifted", "the tool lifted")
        log = events(files)
        last = {event["event"]: k for k, event in enumerate(log)}
        assert last["tool_landed"] < last["force_zero"] < last["tool_lifted"]
        assert "motion_started" not in [event["event"] for event in log[last["tool_lifted"] :]]


@pytest.mark.parametrize("fault", few(OVERRIDES, "stands, reports running"))
def test_slow_standing_and_lost_robots_are_left(tmp_path: Path, fault: str) -> None:
    with dwell_cell(tmp_path / "cell", OVERRIDES[fault], **ONE_PASS) as files:
        with Daemon(files, "--no-hold") as daemon:
            assert daemon.wait() in (DEVICE, SAFETY), daemon.output.read_text()
        wait_for(lambda: events(files, "tool_landed", "tool_lifted")[-1]["event"] == "tool_lifted", "the tool lifted")
        log = [event["event"] for event in events(files)]
        assert "force_on" not in log[len(log) - 1 - log[::-1].index("tool_lifted") :]


def test_a_daemon_that_dies_leaves_a_robot_that_ends_what_it_holds_and_moves_no_more(tmp_path: Path) -> None:
    with dwell_cell(tmp_path / "cell", **ONE_PASS) as files:
        with Daemon(files) as daemon:
            daemon.wait_in_contact(EARLY)
            daemon.end(signal.SIGKILL)
        wait_for(lambda: events(files, "motion_started", "motion_stopped")[-1]["event"] == "motion_stopped", "rest")
        require_safe_order(events(files))
        before = len(events(files))
        with Daemon(files) as daemon:
            daemon.wait_for_state("held")
            assert not [e for e in events(files)[before:] if e["event"] in ("motion_started", "force_on")]
            daemon.end()
        assert not alive(daemon.process.pid)


@pytest.mark.slow
def test_the_seat_is_touched_off_at_three_places_by_tp_programs(tmp_path: Path) -> None:
    with dwell_cell(tmp_path / "cell", part=RIMMED, touch_off=True, **ONE_PASS) as files:
        with Daemon(files, "--no-hold") as daemon:
            daemon.wait_in_contact(EARLY)
            daemon.end()
        wait_for(lambda: events(files, "motion_started", "motion_stopped")[-1]["event"] == "motion_stopped", "rest")
    touched = account(files)["stands"][:3]
    assert json.loads((files.run_dir / "cycle-00/touch_off.json").read_text())["seat"]
    assert all(stand["most_n"] <= 1.5 and stand["most_rpm"] == 0.0 for stand in touched), touched
    assert [(round(stand["x_mm"]), round(stand["y_mm"])) for stand in touched] == [(0, 5), (-4, -2), (4, -2)], touched


@pytest.mark.slow
@pytest.mark.timeout(10 * SOON_S)
def test_a_queue_of_two_parts_is_polished_one_program_after_the_other(tmp_path: Path) -> None:
    """In real time: a pass takes a minute and a half."""
    files = write_files(tmp_path / "cell", part=RIMMED)
    loader = f'\n[loader]\ntype = "loader_line"\naddress = "tcp://127.0.0.1:{free_port()}"\n'
    files.cell.write_text(with_keys(files.cell.read_text() + loader, {"metrology": {"timeout_s": 8.0}}))
    with files.sim.open("a") as sim:
        sim.write("\n[loader.faults]\n")
    options = ["--state", str(files.sim_dir), "--seed", "1", "--speed", "1"]
    with simulated_cell(files.sim, options, files.out / "sim.stderr"):
        for name, part in (("one", "P-1"), ("two", "P-2")):
            job = files.out / f"{name}.toml"
            job.write_text(f'[job]\nid = "{name}"\ntolerance_nm = 45.0\nmax_cycles = 3\n[part]\nid = "{part}"\n')
            added = polishd("queue", "add", files.cell, job)
            assert added.returncode == 0, added.stderr
        with Daemon(files, "--queue", "--until-empty") as daemon:
            assert daemon.process.wait(8 * SOON_S) == 0, daemon.output.read_text()
        assert {name: job["state"] for name, job in queue(files).items()} == {"one": "accepted", "two": "accepted"}
        assert len(events(files, "initialized")) >= 2, "a part takes a pass at least"


@pytest.mark.slow
@pytest.mark.timeout(6 * SOON_S)
def test_the_example_is_rehearsed_to_its_tolerance(tmp_path: Path) -> None:
    """In real time: a pass takes two and a half minutes. On a busy computer all devices are silent at times."""
    cell = Path(shutil.copytree(EXAMPLES / "fanuc_rmi", tmp_path / "fanuc_rmi")) / "cell.toml"
    cell.write_text(with_keys(cell.read_text(), PATIENT))
    forged(Path(shutil.copy(EXAMPLES / "instrument.toml", tmp_path)))
    with rehearsed(cell) as files:
        with Daemon(files, "--no-hold") as daemon:
            assert daemon.process.wait(4 * SOON_S) == 0, daemon.output.read_text()
        require_safe_order(events(files))
    assert summary(files)["outcome"] == "in_tolerance"
