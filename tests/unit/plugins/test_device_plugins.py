"""The device types of our plugins: their options are strict, and they build closed devices."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pluggy
import pydantic
import pytest

from polishd import hookspecs
from polishd.api import (
    ConfigError,
    Device,
    DeviceContext,
    DeviceType,
    ForceActuator,
    ForceSensor,
    Monitor,
    Robot,
    SensorTimes,
    Spindle,
)
from polishd.plugins import devices, voice_coil
from tests.fakes.cia402 import EDS

PRESS = {"n_per_permille": 0.05, "mm_per_increment": 0.001, "balance_n": 2.0}
DRIVE: dict[str, Any] = {"address": "slcan:x", "eds": str(EDS), "node": 5}

LINE_DRIVE = Path(__file__).resolve().parents[3] / "examples" / "line_drive.toml"
GOOD: list[tuple[str, dict[str, Any], type[Any]]] = [
    ("robot_link", {"address": "tcp://127.0.0.1:28500"}, Robot),
    ("universal_robots", {"address": "tcp://10.0.0.2:30004"}, Robot),
    ("kuka_kvp", {"address": "tcp://10.0.0.2:7000", "delivery": "folder:r1"}, Robot),
    ("universal_robots", {"address": "tcp://ur:30004", "rate_hz": 500.0, "first_register": 30}, Robot),
    ("abb_rws", {"address": "tcp://10.0.0.3:80"}, Robot),
    ("abb_rws", {"address": "tcp://irc:443", "version": "2.0", "progress": "polling", "user": "Admin"}, Robot),
    ("voice_coil_modbus", {"address": "serial:sim/actuator?baud=115200", "unit": 1}, ForceActuator),
    ("voice_coil_modbus", {"address": "tcp://127.0.0.1:502", "watchdog_ms": 300, "landing_s": 5.0}, ForceActuator),
    ("voice_coil_serial", {"address": "serial:/dev/ttyUSB0"}, ForceActuator),
    ("actuator_profile", {"profile": "voice_coil_modbus", "address": "serial:/dev/ttyUSB0", "unit": 9}, ForceActuator),
    ("actuator_profile", {"profile": str(LINE_DRIVE), "address": "tcp://127.0.0.1:4001"}, ForceActuator),
    ("spindle_profile", {"profile": "delta_ms300", "address": "serial:x?parity=even", "pole_pairs": 2}, Spindle),
    ("force_sensor_profile", {"profile": "laumas_tlb", "address": "tcp://127.0.0.1:502", "tare_s": 2.0}, ForceSensor),
    ("cia402_spindle", {**DRIVE, "address": "socketcand://127.0.0.1:29536/can0"}, Spindle),
    (
        "force_sensor_profile",
        {"profile": "force_sensor_line", "address": "serial:sim/force_sensor", "delay_s": 0.5},
        ForceSensor,
    ),
    ("monitor_line", {"address": "tcp://127.0.0.1:4001"}, Monitor),
    ("cia402_spindle", {**DRIVE, "rpm_per_unit": 0.1}, Spindle),
    ("cia402_actuator", {**DRIVE, **PRESS, "node": 127, "lift": "position"}, ForceActuator),
]
BAD_OPTIONS: list[tuple[str, dict[str, Any]]] = [
    ("robot_link", {}),
    ("robot_link", {"address": 5}),
    ("robot_link", {"address": "tcp://a:1", "adress": "tcp://a:1"}),
    ("universal_robots", {"address": "tcp://a:1", "rate_hz": 1000.0}),
    ("universal_robots", {"address": "tcp://a:1", "first_register": 44}),
    ("kuka_kvp", {"address": "tcp://a:1"}),
    ("kuka_kvp", {"address": "tcp://a:1", "delivery": "folder:r1", "poll_ms": 1.0}),
    ("universal_robots", {"address": "tcp://a:1", "tool_z": "up"}),
    ("universal_robots", {"address": "tcp://a:1", "dashboard_port": 0}),
    ("abb_rws", {"address": "tcp://a:1", "version": "3.0"}),
    ("abb_rws", {"address": "tcp://a:1", "progress": "guess"}),
    ("voice_coil_modbus", {"address": "tcp://a:1", "unit": 0}),
    ("voice_coil_modbus", {"address": "tcp://a:1", "unit": "1"}),
    ("voice_coil_modbus", {"address": "tcp://a:1", "watchdog_ms": 50}),
    ("voice_coil_serial", {"address": "serial:x", "unit": 1}),
    ("voice_coil_serial", {"address": "serial:x", "landing_s": 0.0}),
    ("cia402_spindle", {**DRIVE, "node": 128}),
    ("voice_coil_serial", {"address": "serial:x", "unpowered": "falls"}),
    ("force_sensor_profile", {"profile": "force_sensor_line", "address": "serial:x", "silence_s": 0.1}),
    ("monitor_line", {"address": "serial:x", "signals": []}),
    ("cia402_spindle", {"address": "slcan:x", "node": 5}),
    ("cia402_spindle", {**DRIVE, "lift": "spring"}),
    ("cia402_actuator", DRIVE),
    ("cia402_actuator", {**DRIVE, **PRESS, "lift": "crane"}),
]
BAD_ADDRESSES = [
    ("robot_link", "serial:x"),
    ("robot_link", "28500"),
    ("universal_robots", "slcan:x"),
    ("abb_rws", "http://a:80"),
    ("voice_coil_modbus", "slcan:x"),
    ("voice_coil_serial", "socketcand://a:1/can0"),
    ("monitor_line", "socketcand://a:1/can0"),
]


@pytest.fixture(scope="module")
def types() -> dict[str, DeviceType]:
    manager = pluggy.PluginManager(hookspecs.PROJECT)
    manager.add_hookspecs(hookspecs)
    for plugin in (devices, voice_coil):
        assert plugin.POLISHD_API == hookspecs.API_VERSION
        manager.register(plugin)
    manager.check_pending()
    declared = [kind for kinds in manager.hook.polishd_device_types() for kind in kinds]
    assert len({kind.name for kind in declared}) == len(declared)
    return {kind.name: kind for kind in declared}


def context(folder: Path) -> DeviceContext:
    return DeviceContext(base_dir=folder, state_dir=folder / "state", part_id="P-1", readers=())


@pytest.mark.parametrize(("name", "options", "port"), GOOD)
def test_devices_are_built_closed(
    types: dict[str, DeviceType], tmp_path: Path, name: str, options: dict[str, Any], port: type[Any]
) -> None:
    kind = types[name]
    device = kind.build(kind.options(**options), context(tmp_path))
    assert isinstance(device, Device)
    assert isinstance(device, port)


@pytest.mark.parametrize(("name", "port"), [(n, p) for n, _, p in GOOD])
def test_ports_are_declared(types: dict[str, DeviceType], name: str, port: type[Any]) -> None:
    ports = {Robot: "robot", ForceActuator: "actuator", Spindle: "spindle", ForceSensor: "force_sensor"}
    assert types[name].port == {**ports, ForceSensor: "force_sensor", Monitor: "monitor"}[port]


@pytest.mark.parametrize(("name", "options"), BAD_OPTIONS)
def test_options_are_strict(types: dict[str, DeviceType], name: str, options: dict[str, Any]) -> None:
    with pytest.raises(pydantic.ValidationError):
        types[name].options(**options)


@pytest.mark.parametrize(("name", "address"), BAD_ADDRESSES)
def test_other_addresses_are_config_errors(
    types: dict[str, DeviceType], tmp_path: Path, name: str, address: str
) -> None:
    kind = types[name]
    options = kind.options(address=address)
    with pytest.raises(ConfigError, match="address"):
        kind.build(options, context(tmp_path))


def test_what_devices_state_is_what_their_sections_say(types: dict[str, DeviceType], tmp_path: Path) -> None:
    def built(name: str, **options: Any) -> Any:
        return types[name].build(types[name].options(**options), context(tmp_path))

    tool = built("voice_coil_serial", address="serial:x", unpowered="stays")
    assert tool.times.unpowered == "stays"
    assert built("voice_coil_serial", address="serial:x").times.unpowered == "lifts"
    sensor = built(
        "force_sensor_profile", profile="force_sensor_line", address="serial:x", silence_s=0.4, delay_s=0.2, tare_s=3.0
    )
    assert sensor.times == SensorTimes(silence_s=0.4, delay_s=0.2, tare_s=3.0)
    assert built("monitor_line", address="serial:x", silence_s=5.0).times.silence_s == 5.0
    linuxcnc = built("linuxcnc", address="tcp://127.0.0.1:5007", program_dir="programs")
    assert not linuxcnc.times.lifts
    assert built("robot_link", address="tcp://127.0.0.1:28500").times.lifts


@pytest.mark.parametrize(
    ("name", "options", "said"),
    [
        ("spindle_profile", {"profile": "voice_coil_modbus"}, "is of an actuator, not of a spindle"),
        ("actuator_profile", {"profile": "voice_coil_mod"}, "is not known; did you mean 'voice_coil_modbus'"),
        ("actuator_profile", {"profile": "none.toml"}, r"none\.toml"),
        ("actuator_profile", {"profile": str(LINE_DRIVE), "unit": 2}, "uses lines, which have no unit number"),
        (
            "actuator_profile",
            {"profile": "voice_coil_modbus", "address": "slcan:x"},
            "is reached over serial: or tcp://",
        ),
        (
            "actuator_profile",
            {"profile": "voice_coil_modbus", "address": "serial:x?parity=mark"},
            "parity 'mark' is none",
        ),
    ],
)
def test_profiles_that_do_not_fit_are_config_errors(
    types: dict[str, DeviceType], tmp_path: Path, name: str, options: dict[str, Any], said: str
) -> None:
    kind = types[name]
    with pytest.raises(ConfigError, match=said):
        kind.build(kind.options(**{"address": "serial:x", **options}), context(tmp_path))


def test_times_are_the_profiles_where_the_cell_says_nothing(types: dict[str, DeviceType], tmp_path: Path) -> None:
    kind = types["actuator_profile"]
    options = {"profile": str(LINE_DRIVE), "address": "serial:x", "landing_s": 3.0}
    times = kind.build(kind.options(**options), context(tmp_path)).times
    assert (times.landing_s, times.watchdog_s, times.retract_s) == (3.0, 1.0, 5.0)


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("cia402_spindle", {"address": "tcp://a:1"}, "slcan: or socketcand://"),
        ("cia402_spindle", {"address": "slcan:x?bitrate=1"}, "address"),
        ("cia402_spindle", {"address": "slcan:x?bitrate=50000"}, "at least 125000 bit/s"),
        ("cia402_spindle", {"controller_node": 5}, "controller_node 5 is the drive's node number"),
        ("cia402_spindle", {"rpm_per_unit": 0.0}, "rpm_per_unit is 0"),
        ("cia402_spindle", {"rpm_per_unit": 1e-320}, "rpm_per_unit is 9.99989e-321"),
        ("cia402_spindle", {"eds": "none.eds"}, "none.eds: cannot be read"),
        ("cia402_spindle", {"acceleration_rpm_s": 0.01, "rpm_per_unit": 1.0}, None),
        ("cia402_actuator", {"mm_per_increment": 0.0}, "mm_per_increment is 0"),
        ("cia402_actuator", {"landing_n": 0.01}, None),
    ],
)
def test_drives_are_built_from_what_makes_sense(
    types: dict[str, DeviceType], tmp_path: Path, name: str, options: dict[str, Any], message: str | None
) -> None:
    kind = types[name]
    given = kind.options(**{**DRIVE, **(PRESS if name == "cia402_actuator" else {}), **options})
    if message is None:
        assert isinstance(kind.build(given, context(tmp_path)), Device)
    else:
        with pytest.raises(ConfigError, match=message):
            kind.build(given, context(tmp_path))


def test_a_drive_without_the_mode_that_is_needed_is_a_config_error(
    types: dict[str, DeviceType], tmp_path: Path
) -> None:
    """Reported with the file, before anything is connected."""
    (tmp_path / "torque.eds").write_text(EDS.read_text().replace("[60FF]", "[5FFF]"))
    options = {**DRIVE, "eds": "torque.eds"}
    with pytest.raises(ConfigError, match=r"torque.eds: object 60FFh is missing"):
        types["cia402_spindle"].build(types["cia402_spindle"].options(**options), context(tmp_path))
    actuator = types["cia402_actuator"]
    assert isinstance(actuator.build(actuator.options(**options, **PRESS), context(tmp_path)), Device)
