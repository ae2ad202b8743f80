"""Signals and the force sensor in a cell's file: what is wrong is placed; what is right reaches the daemon."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from polishd.config.cell import CellConfig, device_options, load_config
from polishd.daemon.assembly import build_cell, contact_limits, require_time_limits
from polishd.drivers.cia402.device_types import SIMULATED_EDS
from polishd.model.devices import SignalLimits, SignalRange
from polishd.model.errors import ConfigError
from polishd.plugin_loader import load_own

EXAMPLE = (Path(__file__).parents[3] / "examples" / "monitored_cell.toml").read_text()
SEVEN = (
    "slurry_flow", "slurry_temperature", "bonnet_pressure", "chuck_vacuum", "guard_closed", "emergency_stop_clear",
    "cell_empty",
)  # fmt: skip


def loaded(tmp_path: Path, text: str) -> CellConfig:
    path = tmp_path / "cell.toml"
    path.write_text(text)
    (tmp_path / "drive.eds").write_bytes(SIMULATED_EDS.read_bytes())
    return load_config(path)


@pytest.fixture
def config(tmp_path: Path) -> CellConfig:
    return loaded(tmp_path, EXAMPLE)


def test_the_example_has_the_seven_signals(config: CellConfig) -> None:
    assert tuple(config.signals) == SEVEN
    assert {section.action for section in config.signals.values()} == {"notify", "hold", "lift", "estop"}


def test_limits_reach_the_daemon(config: CellConfig) -> None:
    cell = build_cell(config, load_own())
    found = {limits.name: limits for limits in cell.signals.limits}
    assert found["slurry_flow"] == SignalLimits(
        "slurry_flow",
        "monitor.slurry",
        "slurry_flow",
        "l/min",
        SignalRange(min=1.0),
        60.0,
        SignalRange(min=0.8),
        1.0,
        "lift",
    )
    assert (found["chuck_vacuum"].monitor, found["chuck_vacuum"].signal) == ("monitor.cabinet", "AI4")
    assert found["guard_closed"].in_contact == SignalRange(state=True)
    assert list(cell.devices)[-3:] == ["force_sensor", "monitor.slurry", "monitor.cabinet"]
    assert cell.used["force_sensor"] == "force_sensor"
    assert "monitor" not in cell.used, "all of them count"
    assert cell.uses("monitor.slurry")
    assert cell.uses("monitor.cabinet")


def test_a_signal_may_measure_the_force_and_nothing_else_be_asked_of_it(tmp_path: Path) -> None:
    text = EXAMPLE + '\n[signals.spindle_load]\nmonitor = "cabinet"\nsignal = "AI7"\nunit = "N"\nmeasures = "force"\n'
    cell = build_cell(loaded(tmp_path, text), load_own())
    (found,) = (limits for limits in cell.signals.limits if limits.measures_force)
    assert (found.name, found.signal, found.in_contact) == ("spindle_load", "AI7", None)
    assert str(found) == "spindle_load of monitor.cabinet: force on the part"
    with pytest.raises(ConfigError, match=r"signals.spindle_load.unit: is 'kg'; a signal that measures the force"):
        loaded(tmp_path, text.replace('unit = "N"', 'unit = "kg"'))


def test_the_band_of_the_force_sensor_reaches_the_daemon(tmp_path: Path, config: CellConfig) -> None:
    limits = contact_limits(config)
    assert (limits.apart_n, limits.apart_s) == (1.0, 0.5)
    several = EXAMPLE.replace("[force_sensor]", "[force_sensor.flange]").replace(
        "max_difference_n = 1.0", "max_difference_n = 2.5"
    )
    limits = contact_limits(loaded(tmp_path, several + '[roles]\nforce_sensor = "flange"\n'))
    assert limits.apart_n == 2.5


@pytest.mark.parametrize(
    ("old", "new", "line", "says"),
    [
        (
            'monitor = "slurry"\n',
            "",
            "[signals.slurry_flow]",
            "monitor: is missing: there are 'cabinet', 'slurry'",
        ),
        ('monitor = "slurry"', 'monitor = "slury"', 'monitor = "slury"', "there is no 'slury'; did you mean 'slurry'?"),
        (
            "min = 1.0, wait_s",
            "mim = 1.0, wait_s",
            "before = { mim",
            "signals.slurry_flow.before.mim: unknown key; did",
        ),
        ("min = 20.0, max = 22.0", "min = 22.0, max = 20.0", "before = { min = 22", "before.min: must be at most max"),
        ("{ min = 75.0 }", "{ wait_s = 1.0 }", "before = { wait_s", "before: "),
        ("{ state = true, wait_s", "{ state = true, min = 1.0, wait_s", "before = { state = true, min", "state: "),
        ('action = "lift"', 'action = "left"', 'action = "left"', "'left' is not allowed"),
        ("in_contact = { min = 0.8, alarm_delay_s = 1.0 }\n", "", 'action = "lift"', "action: needs in_contact"),
        (
            "max_difference_n = 1.0",
            "max_difference_n = 0.0",
            "max_difference_n = 0.0",
            "force_sensor.max_difference_n: 0.0 is out of range",
        ),
        ("[job]", '[roles]\nmonitor = "slurry"\n\n[job]', 'monitor = "slurry"', "roles.monitor: unknown key"),
    ],
)
def test_what_is_wrong_is_placed(tmp_path: Path, old: str, new: str, line: str, says: str) -> None:
    text = EXAMPLE.replace(old, new, 1)
    with pytest.raises(ConfigError) as caught:
        loaded(tmp_path, text)
    places = [str(n) for n, found in enumerate(text.splitlines(), 1) if found.startswith(line)]
    assert str(caught.value).split(":")[1] in places
    assert says in str(caught.value)


def test_a_signal_without_any_monitor_is_reported(tmp_path: Path, example: str) -> None:
    with pytest.raises(ConfigError, match=r"signals\.flow: .*the cell has no \[monitor\]"):
        loaded(tmp_path, example + "\n[signals.flow]\nbefore = { min = 1.0 }\n")


def test_one_monitor_has_no_name(tmp_path: Path, example: str) -> None:
    one = (
        example
        + '\n[monitor]\ntype = "monitor_line"\naddress = "tcp://127.0.0.1:1"\n[signals.flow]\nbefore = { min = 1.0 }\n'
    )
    assert loaded(tmp_path, one).signals["flow"].limits("flow").monitor == "monitor"
    with pytest.raises(ConfigError, match=r"signals\.flow\.monitor: there is one monitor, without a name; remove"):
        loaded(tmp_path, one + 'monitor = "plc"\n')


def test_keys_of_the_port_and_of_the_type_are_known_together(tmp_path: Path) -> None:
    config = loaded(tmp_path, EXAMPLE.replace("max_difference_n = 1.0", "max_diference_n = 1.0"))
    with pytest.raises(ConfigError) as caught:
        device_options(config, "force_sensor", load_own().device_types())
    assert "force_sensor.max_diference_n: unknown key; did you mean 'max_difference_n'?" in str(caught.value)


def test_keys_above_several_sensors_belong_to_none(tmp_path: Path) -> None:
    text = EXAMPLE.replace("[force_sensor]", "[force_sensor]\nalarm_delay_s = 1.0\n[force_sensor.flange]")
    with pytest.raises(ConfigError, match=r"force_sensor\.alarm_delay_s: "):
        loaded(tmp_path, text)


# what follows for time limits


def refused(tmp_path: Path, text: str) -> str:
    config = loaded(tmp_path, text)
    with pytest.raises(ConfigError) as caught:
        require_time_limits(config, build_cell(config, load_own()))
    return str(caught.value)


def test_the_example_holds(config: CellConfig) -> None:
    chain = require_time_limits(config, build_cell(config, load_own()))
    assert [limit.key for limit in chain][:3] == [
        "force_sensor.silence_s",
        "force_sensor.alarm_delay_s",
        "limits.force_alarm_delay_s",
    ]


def test_a_grace_that_a_landing_outlasts_is_refused(tmp_path: Path) -> None:
    said = refused(tmp_path, EXAMPLE.replace("delay_s = 0.1", "delay_s = 0.4"))
    assert "force_sensor.alarm_delay_s: actuator and force sensor may disagree for: 0.5 s; at least 0.7 s" in said
    assert "limits.force_alarm_delay_s: force may be off its set point for: 0.3 s; at least 0.55 s" in said


def test_an_actuator_that_presses_without_power_is_refused_by_its_place(tmp_path: Path) -> None:
    text = EXAMPLE.replace('unpowered = "lifts"', 'unpowered = "presses"')
    line = next(n for n, found in enumerate(text.splitlines(), 1) if found.startswith('unpowered = "presses"'))
    said = refused(tmp_path, text)
    assert said.startswith(
        f"{tmp_path / 'cell.toml'}:{line}: actuator.unpowered: an actuator that presses without power"
    )


@pytest.mark.parametrize(("robot", "fits"), [("robot_link", True), ("linuxcnc", False)])
def test_one_that_stays_needs_a_robot_that_lifts(tmp_path: Path, robot: str, fits: bool) -> None:
    text = EXAMPLE.replace('unpowered = "lifts"', 'unpowered = "stays"')
    text = text.replace('type = "robot_link"', f'type = "{robot}"' + ("" if fits else '\nprogram_dir = "programs"'))
    config: Any = loaded(tmp_path, text)
    if fits:
        require_time_limits(config, build_cell(config, load_own()))
    else:
        assert "actuator.unpowered: a tool that stays on the part without power needs a robot" in refused(
            tmp_path, text
        )
