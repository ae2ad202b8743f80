"""An independent force sensor and monitors in a whole cell: contact ends in order, and the faulty device is named.

What acts is the plant's: the actuator's own word and the sensor's may both be wrong.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles, simulated_cell, with_values
from polishd.daemon.socket import client
from tests.system.agreement import require_agreement
from tests.system.cell_rig import ONE_PASS, Daemon, account, events, summary, with_faults, with_keys, write_small
from tests.system.sim_rig import wait_for
from tests.system.test_daemon import polishd
from tests.system.test_faults import SAFETY, Fault, require_off_the_part

pytestmark = [pytest.mark.system, pytest.mark.full]

SENSOR = """
[force_sensor]
type = "force_sensor_profile"
profile = "force_sensor_line"
address = "serial:sim/force_sensor"
silence_s = {silence_s}
delay_s = {delay_s}
max_difference_n = 1.5
alarm_delay_s = 1.5
"""
PATIENT: Mapping[str, float] = {"silence_s": 3.0, "delay_s": 1.0}
PROMPT: Mapping[str, float] = {"silence_s": 0.5, "delay_s": 1.0}
MONITOR = """
[monitor]
type = "monitor_line"
address = "serial:sim/monitor"
silence_s = 5.0

[signals.slurry_flow]
unit = "l/min"
before = {{ min = 1.0 }}
in_contact = {{ min = 0.8 }}
action = "{action}"

[signals.guard_closed]
before = {{ state = true, wait_s = 1.0 }}
in_contact = {{ state = true, alarm_delay_s = 0.0 }}
action = "estop"
"""


@contextlib.contextmanager
def watched_cell(
    out: Path, cell: str, sim: str, faults: Sequence[Fault] = (), *, speed: int = 10, **job: Any
) -> Iterator[DemoFiles]:
    """Run a simulator with the small part and additions to both files for the duration of the block."""
    files = write_small(out, **{**ONE_PASS, **job})
    text = with_values(files.cell.read_text() + cell, {"limits": {"force_alarm_delay_s": 1.3}})
    files.cell.write_text(text)
    files.sim.write_text(with_faults(files.sim.read_text() + sim, *faults))
    options = ["--state", str(files.sim_dir), "--seed", "2", "--speed", str(speed)]
    with simulated_cell(files.sim, options, files.out / "sim.stderr"):
        yield files


def sensed(files: DemoFiles) -> list[tuple[float, float]]:
    """Return the forces of actuator and sensor, in N, of each block that touched and has both."""
    with contextlib.closing(sqlite3.connect(files.state_dir / "journal.sqlite")) as journal:
        rows = "SELECT force_n, sensor_force_n FROM segment WHERE touched = 1 AND sensor_force_n IS NOT NULL"
        return list(journal.execute(rows))


def press(files: DemoFiles, device: str, number: signal.Signals) -> None:
    os.kill(json.loads((files.sim_dir / "pids.json").read_text())[device], number)


def test_a_sensor_that_agrees_is_tared_reported_and_recorded(tmp_path: Path) -> None:
    sim = '[force_sensor]\nkind = "serial"\n[monitor]\nkind = "serial"\n'
    cell = SENSOR.format(**PATIENT) + MONITOR.format(action="lift")
    with watched_cell(tmp_path / "cell", cell, sim) as files:
        checked = json.loads(polishd("check", str(files.cell), "--json").stdout)
        assert "force_sensor: at most 1.5 N apart" in checked["force"]
        assert "guard_closed of monitor: before contact on" in checked["signals"]
        assert {"force_sensor.silence_s", "force_sensor.alarm_delay_s"} < {row["key"] for row in checked["time limits"]}
        probed = json.loads(polishd("probe", str(files.cell), "--json").stdout)
        assert probed["force_sensor"]["model"] == "simulated F1"
        assert probed["signals"]["guard_closed"] == "on"
        assert probed["signals"]["slurry_flow"].endswith("l/min")
        with Daemon(files) as daemon:
            daemon.wait_in_contact()
            status = client.request(files.state_dir, "status")
            assert status["signals"]["slurry_flow"]["wrong"] == ""
            assert status["devices"]["monitor"]["used"] is True
            assert daemon.wait() in {0, 1}, daemon.output.read_text()
        (tared, *_) = events(files, "sensor_tared")
        assert tared["zero_n"] == pytest.approx(6.0, abs=0.1)
    both = sensed(files)
    assert len(both) > 100
    apart_n = sorted(abs(sensor_n - force_n) for force_n, sensor_n in both)
    # Each force is the last one received when the block ended: on a busy machine one may be older while force rises.
    assert apart_n[len(both) // 2] < 0.5
    assert apart_n[int(0.95 * len(both))] < 1.0, apart_n[-20:]
    header = next(files.run_dir.glob("cycle-00/executed.csv")).read_text().splitlines()[0]
    assert header.endswith("sensor_force_n")


WRONG_DEVICES = ("actuator", "force sensor")


def drift(device: str) -> Fault:
    """Return a drift of 2 N/s that begins half a second after contact."""
    return {"device": device, "what": "drift", "contact_s": 0.5, "drift_n_s": 2.0}


@pytest.mark.parametrize("device", WRONG_DEVICES)
def test_a_wrong_force_ends_contact_in_the_safe_order_and_its_device_is_named(tmp_path: Path, device: str) -> None:
    sim = '[force_sensor]\nkind = "serial"\n'
    faults = [drift(device.replace(" ", "_"))]
    with watched_cell(tmp_path / "cell", SENSOR.format(**PATIENT), sim, faults, speed=4) as files:
        with Daemon(files) as daemon:
            assert daemon.wait() == SAFETY, daemon.output.read_text()
        require_off_the_part(files)
        assert [event["what"] for event in events(files, "fault_begins")] == ["drift"]
    reason = summary(files)["reason"]
    assert "the forces disagree: the actuator reads " in reason
    assert "the set point is 12 N" in reason
    assert reason.endswith(f"the {device} is probably wrong"), reason


SILENT: dict[str, list[Fault]] = {
    "converts no more": [{"device": "force_sensor", "what": "halt", "contact_s": 0.5}],
    "its process hangs": [],
}


@pytest.mark.parametrize("how", SILENT)
def test_a_sensor_that_falls_silent_ends_contact(tmp_path: Path, how: str) -> None:
    sim = '[force_sensor]\nkind = "serial"\n'
    with watched_cell(tmp_path / "cell", SENSOR.format(**PROMPT), sim, SILENT[how]) as files:
        with Daemon(files) as daemon:
            if how == "its process hangs":
                daemon.wait_in_contact(50)
                press(files, "force_sensor", signal.SIGSTOP)
            assert daemon.wait() == 5, daemon.output.read_text()
        require_off_the_part(files)
        if how == "its process hangs":
            press(files, "force_sensor", signal.SIGCONT)
    assert "force_sensor" in summary(files)["reason"] or "force sensor" in summary(files)["reason"]


def test_a_flow_that_stops_in_contact_ends_the_pass(tmp_path: Path) -> None:
    sim = '[monitor]\nkind = "serial"\n[monitor.signals.slurry_flow]\nvalue = 1.5\nchanges_to = 0.0\nafter_s = 1.0\n'
    with watched_cell(tmp_path / "cell", MONITOR.format(action="lift"), sim) as files:
        with Daemon(files) as daemon:
            assert daemon.wait() == SAFETY, daemon.output.read_text()
        require_off_the_part(files)
        (changed,) = events(files, "signal_changes")
        assert changed["signal"] == "slurry_flow"
    assert "slurry_flow is 0 l/min, must be at least 0.8 l/min in contact" in summary(files)["reason"]


def test_a_guard_that_opens_stops_motion_at_once_and_holds_the_cell(tmp_path: Path) -> None:
    """The cell stays held while the guard is open, however often the operator resumes."""
    sim = '[monitor]\nkind = "serial"\n[monitor.signals.guard_closed]\nvalue = true\nchanges_to = false\n'
    with watched_cell(tmp_path / "cell", MONITOR.format(action="hold"), sim) as files, Daemon(files) as daemon:
        daemon.wait_in_contact(50)
        press(files, "monitor", signal.SIGUSR1)
        status = daemon.wait_for_state("held")
        assert status["reason"].startswith("SignalFault: guard_closed is off, must be on in contact")
        wait_for(lambda: events(files, "retracted"), "the lift")
        log = [event["event"] for event in events(files)]
        changed = log.index("signal_changes")
        assert log.index("motion_stopped", changed) < log.index("retracted", changed), "motion first"
        landings = log.count("tool_landed")
        client.request(files.state_dir, "resume", 60.0)
        wait_for(lambda: "before contact guard_closed is off" in daemon.status().get("reason", ""), "held again")
        assert events(files, "tool_landed")[landings:] == []
        assert daemon.end() in {0, 1, 5}


def test_nothing_moves_before_the_slurry_flows(tmp_path: Path) -> None:
    sim = '[monitor]\nkind = "serial"\n[monitor.signals.slurry_flow]\nvalue = 0.2\nchanges_to = 1.5\n'
    with watched_cell(tmp_path / "cell", MONITOR.format(action="lift"), sim) as files, Daemon(files) as daemon:
        wait_for(lambda: "slurry_flow is 0.2 l/min" in str(daemon.status().get("signals")), "the signal in the status")
        wait_for(lambda: events(files, "map_dropped"), "a map")
        assert events(files, "engage", "motion_started") == []
        press(files, "monitor", signal.SIGUSR1)
        daemon.wait_in_contact(20)
        assert daemon.end() == 1


def test_a_tool_that_stays_without_power_is_taken_off_by_the_robot(tmp_path: Path) -> None:
    """The actuator loses power while 12 N act: motion continues until the robot has lifted the tool."""
    files = write_small(tmp_path / "cell", **ONE_PASS)
    files.cell.write_text(with_keys(files.cell.read_text(), {"actuator": {"unpowered": "stays"}}))
    files.sim.write_text(with_keys(files.sim.read_text(), {"actuator": {"unpowered": "stays"}}))
    options = ["--state", str(files.sim_dir), "--seed", "2", "--speed", "2"]
    with simulated_cell(files.sim, options, files.out / "sim.stderr"):
        with Daemon(files) as daemon:
            daemon.wait_in_contact(40)
            press(files, "plant", signal.SIGUSR1)
            wait_for(lambda: events(files, "way_out_marked"), "the mark")
            press(files, "actuator", signal.SIGKILL)
            assert daemon.wait() == 5, daemon.output.read_text()
            stopped = wait_for(lambda: events(files, "motion_stopped"), "standstill")[-1]
        way_out = wait_for(lambda: account(files)["way_out"], "the account")
    assert stopped["detail"] == "lift"
    assert way_out["contact_s"] > 0.0, "it went on pressing"
    assert way_out["standing_s"] <= 0.05
    require_agreement(files)
