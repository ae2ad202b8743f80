"""The whole simulated cell on a FANUC controller with RMI: safe whatever happens, and to its tolerance."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles
from tests.system.cell_rig import Daemon, account, events
from tests.system.fanuc_rmi_rig import RIMMED, dwell_cell
from tests.system.sim_rig import alive, wait_for
from tests.system.test_daemon import require_safe_order

pytestmark = [pytest.mark.system, pytest.mark.full]

DEVICE, SAFETY = 5, 7
ONE_PASS = {"tolerance_nm": 0.01, "max_cycles": 1}
EARLY = 6


def press(files: DemoFiles, number: signal.Signals) -> None:
    os.kill(int(json.loads((files.sim_dir / "pids.json").read_text())["robot"]), number)


def few(faults: Mapping[str, Any], first: str) -> list[Any]:
    """Return the cases; each takes a minute in real time, so that all but the first are slow."""
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
