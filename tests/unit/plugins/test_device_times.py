"""Times of our own devices: one default each, and rows of the time limits by keys that the device's section has."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest

from polishd.daemon.cell.time_limits import TimeLimits
from polishd.hookspecs import DeviceContext, DeviceType
from polishd.model.devices import ActuatorTimes, LoaderTimes, MonitorTimes, RobotTimes, SensorTimes, SpindleTimes
from polishd.plugin_loader import load_own
from tests.fakes.cia402 import EDS

TIMES: dict[str, Any] = {
    "actuator": ActuatorTimes(),
    "robot": RobotTimes(),
    "spindle": SpindleTimes(),
    "force_sensor": SensorTimes(),
    "loader": LoaderTimes(),
    "monitor": MonitorTimes(),
}
OTHER = {
    ("cia402_actuator", "silence_s"): "a drive is asked four things for each reading",
    ("universal_robots", "silence_s"): "RTDE reports 10 times a second or more",
    ("fanuc_rmi", "watchdog_s"): "it stops after the instructions that it holds",
    ("kuka_kvp", "silence_s"): "the proxy answers at once",
    ("linuxcnc", "silence_s"): "linuxcncrsh answers at once",
    ("linuxcnc", "stop_s"): "it stops with its own acceleration",
}
"""Defaults that are another one on purpose."""
KINDS = {name: kind for name, kind in load_own().device_types().items() if kind.port in TIMES}
ADDRESSES = {
    "cia402_spindle": "slcan:x?bitrate=500000",
    "cia402_actuator": "slcan:x?bitrate=500000",
}
MORE: dict[str, dict[str, Any]] = {
    "cia402_spindle": {"eds": str(EDS), "node": 5},
    "cia402_actuator": {
        "eds": str(EDS),
        "node": 6,
        "n_per_permille": 0.05,
        "mm_per_increment": 0.001,
        "balance_n": 2.0,
    },
    "actuator_profile": {"profile": "voice_coil_serial"},
    "spindle_profile": {"profile": "delta_ms300"},
}


@pytest.mark.parametrize("name", KINDS)
def test_a_default_is_the_one_of_the_port(name: str) -> None:
    kind = KINDS[name]
    for field in fields(TIMES[kind.port]):
        option = kind.options.model_fields.get(field.name)
        if option is not None and not option.is_required() and (name, field.name) not in OTHER:
            default = getattr(TIMES[kind.port], field.name)
            assert option.default in {default, None}, f"{name}.{field.name}"


def built(name: str, kind: DeviceType, folder: Path) -> Any:
    """Such a device, with nothing behind its address."""
    address = ADDRESSES.get(name, "serial:x")
    options = kind.options.model_validate({"address": address, **MORE.get(name, {})})
    return kind.build(options, DeviceContext(folder, folder, "part", ()))


@pytest.mark.parametrize("name", [name for name, kind in KINDS.items() if kind.port in {"actuator", "spindle"}])
def test_each_limit_has_a_key_of_the_devices_own_section(name: str, tmp_path: Path) -> None:
    kind = KINDS[name]
    times = {port: TIMES[port] for port in ("actuator", "robot", "spindle")}
    limits = TimeLimits(**times | {kind.port: built(name, kind, tmp_path).times})
    keys = [limit.key for limit in limits.chain(8.0) if limit.key.startswith(f"{kind.port}.")]
    assert keys
    assert {key.partition(".")[2] for key in keys} <= set(kind.options.model_fields)
