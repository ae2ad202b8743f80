"""Sections of SIM.toml for the simulated devices: protocol, address, times, ranges, and faults of maps and parts."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from polishd.config.fields import (
    BumpSection,
    ConfigSection,
    Name,
    NotNegative,
    Pair,
    Positive,
    ShareOrNone,
    Text,
    Texts,
    as_tuple,
)
from polishd.config.simulator_physics import InstrumentErrors

Port = Annotated[int, Field(ge=0, le=65535)]


class MapFaults(ConfigSection):
    """What an interferometer does to those who read its folder."""

    preallocate: bool = False
    """The file has its full length, zeros, from the start."""
    duplicate_first: bool = False
    """Drops the last map again, under a new name, before each map but the first."""
    wrong_part_first: bool = False
    """Drops a map of another part before each map."""
    mirror: bool = False
    """Its arrays are flipped left-right, ..."""
    rotation_deg: Literal[0, 90, 180, 270] = 0
    """... then turned counter-clockwise."""
    sign: Literal[1, -1] = 1
    """-1: high is negative. [1]"""
    factor: Positive = 1.0
    """Of all heights; 2: it gives wavefronts for surfaces. [1]"""


class Artefact(ConfigSection):
    """A round flat with bumps, for ``--artefact``."""

    part_id: str = "ARTEFACT"
    """Its name in the map."""
    diameter_mm: Annotated[float, Field(gt=5, le=5000)] = 100.0
    """Of the flat."""
    bumps: Annotated[tuple[BumpSection, ...], BeforeValidator(as_tuple)] = ()
    """What stands on it: `[artefact]` of the instrument's profile says the same."""


class SimRobotSection(ConfigSection):
    """The robot controller."""

    kind: Literal["link", "linuxcnc", "universal_robots", "opcua", "ads", "modbus", "hses", "abb_rws", "kuka_kvp"] = (
        "link"
    )
    """``linuxcnc``: a real LinuxCNC, in real time, in a separate network (docs/protocols/linuxcnc.md). ``opcua``,
    ``ads``, ``modbus``, ``hses``: a PLC that loads files from ``programs`` of the state folder
    (docs/protocols/plc_robot.md).
    ``abb_rws``: an ABB controller with Robot Web Services. ``kuka_kvp``: a KUKA controller behind
    C3 Bridge; it loads files from ``programs``, too (docs/protocols/kuka_kvp.md)."""
    port: Port = 28500
    """TCP port on loopback; 0: any that is free. RTDE's, with universal_robots; over ADS, which has one port only,
    28500 = 111 * 256 + 84 is the address 127.111.84.1. [1]"""
    dashboard_port: Port = 0
    """Of universal_robots; 0: `port` + 1. [1]"""
    primary_port: Port = 0
    """Of universal_robots: the primary client interface; 0: `port` + 2. [1]"""
    rotary_axes_carry: Literal["tool", "table"] = "tool"
    """Of linuxcnc, what A and C turn: the tool, or the part on a tilting rotary table (its ``xyzac-trt-kins``). [1]"""
    cycle_hz: Literal[125, 500] = 500
    """Of universal_robots: how often it controls; 125 is a CB3. [Hz]"""
    rws: Literal["1.0", "2.0"] = "1.0"
    """Of abb_rws: version of Robot Web Services."""
    report_ms: Positive = 20.0
    """Of such a PLC: interval of its reports, wall time."""
    read_ahead_lines: Annotated[int, Field(ge=0, le=1_000_000)] = 0
    """Of such a PLC: the line that it shows runs so far ahead of the motion. [1]"""
    watchdog_s: Positive = 8.0
    """It stops when it has heard nothing for so long, wall time."""
    window: Annotated[int, Field(ge=1, le=10_000_000)] = 16384
    """Blocks that it holds ahead of the motion. [1]"""
    corner_deg: float = 30.0
    """Change of direction beyond which it stops at a block's end."""
    rapid_mm_s: Positive = 100.0
    """Speed of moves without a feed."""
    max_feed_mm_s: Positive = 100.0
    """Feeds above it are cut to it."""
    x_mm: Pair = (-150.0, 150.0)
    """Range of X; a program that leaves it is refused."""
    y_mm: Pair = (-150.0, 150.0)
    """Range of Y."""
    z_mm: Pair = (-2.0, 120.0)
    """Range of Z."""
    a_deg: Pair = (-60.0, 60.0)
    """Range of A."""
    home: Annotated[tuple[float, float, float, float, float], BeforeValidator(as_tuple)] = (0.0, 0.0, 60.0, 0.0, 0.0)
    """X, Y, Z, A and C at the very first start; later it is wherever it stood. [mm, mm, mm, deg, deg]"""


class SimActuatorSection(ConfigSection):
    """The voice-coil actuator. Its times go with the simulated clock."""

    kind: Literal["modbus_rtu", "modbus_tcp", "serial", "slcan", "socketcand", "profile", "profile_tcp"] = "modbus_rtu"
    """What it speaks: the cell's `voice_coil_modbus` on a line or over TCP, `voice_coil_serial`, `cia402_actuator`,
    whose bus is reached through a serial adapter or a daemon, or what a device profile says."""
    profile: Text = "profile.toml"
    """File of the device profile, for `profile` and `profile_tcp`."""
    port: Port = 0
    """TCP port on loopback, for modbus_tcp, socketcand and profile_tcp; 0: any that is free. [1]"""
    baud: Annotated[int, Field(ge=1200, le=12_000_000)] = 115200
    """Pace of the serial line. [bit/s]"""
    unit: Annotated[int, Field(ge=1, le=247)] = 1
    """Modbus unit number. [1]"""
    node: Annotated[int, Field(ge=1, le=127)] = 6
    """CANopen node number. [1]"""
    land_s: Positive = 2.0
    """From engaging to the part."""
    lift_s: Positive = 4.0
    """From force off to its rest."""
    stick_share: ShareOrNone = 0.5
    """Share of that in which the tool still rests on the part, ... [1]"""
    resting_force_n: NotNegative = 0.1
    """... with its own weight."""
    unpowered: Literal["lifts", "stays"] = "lifts"
    """What its tool does where its process is killed, which is its power cut."""


class SimSpindleSection(ConfigSection):
    """The spindle drive."""

    kind: Literal["slcan", "socketcand", "profile", "profile_tcp"] = "slcan"
    """How the CAN bus of its CiA 402 drive is reached: a serial adapter, or a daemon over TCP. `profile` and
    `profile_tcp` have the protocol of a device profile."""
    profile: Text = "profile.toml"
    """File of the device profile, for `profile` and `profile_tcp`."""
    unit: Annotated[int, Field(ge=0, le=247)] | None = None
    """Modbus unit number; left out: the profile's. [1]"""
    pole_pairs: Annotated[int, Field(ge=1, le=24)] = 1
    """Of the motor, for a profile that counts in Hz. [1]"""
    port: Port = 0
    """TCP port on loopback, for socketcand and profile_tcp; 0: any that is free. [1]"""
    node: Annotated[int, Field(ge=1, le=127)] = 5
    """CANopen node number. [1]"""
    max_rpm: Annotated[int, Field(ge=1, le=200_000)] = 3000
    """Fastest that it turns; more is refused."""
    spin_s: Positive = 3.0
    """From standstill to 1000 rpm with a profile, simulated clock. `cia402_spindle` sets the ramps of its drive."""
    stop_s: Positive = 0.5
    """And back with a profile: its quick stop."""
    watchdog_s: Positive = 1.0
    """Time without a command after which a drive with a profile stops, wall time."""


class SimInterferometerSection(ConfigSection):
    """The interferometer and its folder (``maps`` in the state folder)."""

    kind: Literal["watched_folder"] = "watched_folder"
    """How maps reach the cell."""
    request_file: str = "measure.request"
    """A file of this name in the folder asks for a map; `metrology.request_file` of the cell."""
    write_s: NotNegative = 0.2
    """Wall seconds that writing a file takes."""
    temporary_suffix: str = ".part"
    """Suffix while writing; empty: it writes slowly under the final name."""
    artefact: Artefact = Artefact()
    faults: MapFaults = MapFaults()
    errors: InstrumentErrors = InstrumentErrors()


class SimLineSection(ConfigSection):
    """How a small device is reached."""

    kind: Literal["tcp", "serial"] = "tcp"
    """Its line."""
    port: Port = 0
    """TCP port on loopback; 0: any that is free. [1]"""
    baud: Annotated[int, Field(ge=1200, le=12_000_000)] = 115200
    """Pace of the serial line. [bit/s]"""


class SimForceSensorSection(SimLineSection):
    """A force sensor beside the actuator: it feels what truly acts."""

    offset_n: float = 6.0
    """What hangs on it."""
    noise_n: NotNegative = 0.02
    """Scatter of its conversions."""
    latency_s: NotNegative = 0.03
    """Its filter's delay."""
    range_n: Positive = 60.0
    """Beyond it a fault bit is set."""


class SimSignal(ConfigSection):
    """A signal of the simulated monitor."""

    value: float | bool
    """What it is: a number, or a state. [in its own unit]"""
    changes_to: float | bool | Literal["?"] | None = None
    """What it becomes; `"?"`: its transducer breaks. [in its own unit]"""
    after_s: NotNegative = 0.0
    """Seconds in contact after which it does; 0: only when the process is sent SIGUSR1."""
    duration_s: NotNegative = 0.0
    """For how long, wall time; 0: from then on."""
    noise: NotNegative = 0.0
    """Scatter of a number. [in its own unit]"""


SEVEN: Mapping[str, SimSignal] = {
    "slurry_flow": SimSignal(value=1.5, noise=0.02),
    "slurry_temperature": SimSignal(value=21.0, noise=0.05),
    "bonnet_pressure": SimSignal(value=0.8, noise=0.002),
    "chuck_vacuum": SimSignal(value=82.0, noise=0.2),
    "guard_closed": SimSignal(value=True),
    "emergency_stop_clear": SimSignal(value=True),
    "cell_empty": SimSignal(value=True),
}
"""Signals of a monitor whose section names none: l/min, degC, bar, kPa below the air's, and states."""


class SimMonitorSection(SimLineSection):
    """A monitor of the cell's signals, with the seven of examples/monitored_cell.toml and those that are named here."""

    signals: Mapping[Name, SimSignal] = {}


class LoaderFaults(ConfigSection):
    """Faults of a loader, by the requested part; a part is dropped, or jams, once."""

    wrong: Texts = ()
    """Parts in whose place it brings another, and says so."""
    wrong_part_unnoticed: Texts = ()
    """Parts in whose place it brings another, and does not notice."""
    dropped: Texts = ()
    """Parts that it drops on the way."""
    jammed: Texts = ()
    """Parts over which it jams."""


class SimLoaderSection(SimLineSection):
    """The part loader. Its times go with the simulated clock."""

    parts: Texts = ()
    """Parts in its magazine; left out: any requested part."""
    load_s: Positive = 30.0
    """Time from its place to the seat and back."""
    unload_s: Positive = 20.0
    """And back."""
    watchdog_s: Positive = 5.0
    """It moves, and hears nothing for so long, wall time: it stops."""
    faults: LoaderFaults = LoaderFaults()
