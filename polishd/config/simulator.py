"""SIM.toml: what is simulated, and how nasty it is. Its reader is the simulator; the daemon never sees it."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, PrivateAttr, model_validator

from polishd.config.cell import load_config, overlay
from polishd.config.fields import (
    BumpSection,  # fmt: skip
    ConfigSection,  # fmt: skip
    Dip,
    Force,
    Name,  # fmt: skip
    NotNegative,  # fmt: skip
    OpticKeys,
    Pair,  # fmt: skip
    Positive,  # fmt: skip
    ShareOrNone,  # fmt: skip
    Speed,
    Text,  # fmt: skip
    Texts,  # fmt: skip
    Vector,
    as_tuple,  # fmt: skip
    require_cells,
)
from polishd.config.process_sections import ContactKeys, HybridSection, KinematicsSection, robot_of
from polishd.config.simulator_cell import CellValues, add_devices, add_physics
from polishd.config.simulator_faults import FaultSection
from polishd.config.table_files import read_tif
from polishd.config.toml_loader import TomlDocument, TomlSource, key_lines, load_toml
from polishd.model.errors import ConfigError
from polishd.model.process import MeasuredTif, Projection, RobotModel, ToolProcess
from polishd.util.files import toml_text

# The section of SIM.toml that says what else is wrong with tool, contact and robot: ranges, each off by default.


class Effects(ConfigSection):
    """What the controller assumes and the machine does not do; sizes have no source but the shop's experience."""

    rate_field: ShareOrNone = 0.0
    """Largest change of the removal rate from the part's center to its rim, in either direction: a smooth field. [1]"""
    pad_half_life_s: Positive | None = None
    """Contact time in which the pad loses half of its rate; left out: it does not wear."""
    warm_up: ShareOrNone = 0.0
    """Share of the rate that a cold tool lacks. [1]"""
    warm_up_s: Positive = 300.0
    """Contact time in which that falls to 37 %."""
    spot_shift_mm: NotNegative = 0.0
    """How far the spot lies off where the tool says; its direction is drawn."""
    spot_frame: Literal["tool", "part"] = "tool"
    """Whether that direction turns with the lean of the spindle, or stays with the part."""
    spot_turn_deg: Annotated[float, Field(ge=0, le=45)] = 0.0
    """How far the spot is turned about the normal, either way."""
    spot_skew: ShareOrNone = 0.0
    """How much more is removed at the rim that the bonnet slides towards, and less where it comes from, or the other
    way round. [1]"""
    bonnet_pressure: Annotated[float, Field(ge=0, lt=0.5)] = 0.0
    """How far the bonnet's pressure, and with it its modulus, is off, either way, relative: a soft one makes a wide and
    flat spot. [1]"""
    robot_error_mm: NotNegative = 0.0
    """How far the tool's tip lies off where the robot says, across the normal: a smooth field of its workspace. An arm
    that was not calibrated has some 0.3 mm (ISO 9283 accuracy of pose)."""
    robot_error_deg: Annotated[float, Field(ge=0, le=5)] = 0.0
    """How far the spindle leans off, likewise; some 0.02."""
    robot_error_wave_mm: Positive = 400.0
    """Length of the shortest wave of that field; the longest is three times as long."""
    vibration_mm: NotNegative = 0.0
    """Radius of a fast circle that the tool's tip runs: it smears the spot."""
    seat_shift_mm: NotNegative = 0.0
    """How far the part lies off its seat, across its normal; its direction is drawn."""
    compliance: ShareOrNone = 0.0
    """How far the compliance along the normal is off the robot's, either way, relative. [1]"""
    eq_44: Pair = (0.0, 1.0)
    """How much of what paper eq. 44 says is lost as depth where the robot gives way: 1 all of it; 0 constant depth,
    which statics gives for an actuator that holds its force. One with friction or a stiff guide is between; drawn
    between the two. [1]"""
    friction: Pair = (0.2, 0.5)
    """Coefficient of friction between bonnet and part: it pulls the tip sideways as far as the robot gives way; drawn
    between the two. [1]"""
    speed_ripple: Annotated[float, Field(ge=0, lt=0.5)] = 0.0
    """Amplitude of a sine of the spindle's speed, relative. [1]"""
    speed_ripple_s: Positive = 2.0
    """Its period, contact time."""
    force_ripple: Annotated[float, Field(ge=0, lt=0.5)] = 0.0
    """Amplitude of a sine of the force, which no sensor sees, relative. [1]"""
    force_ripple_s: Positive = 3.0
    """Its period, contact time."""
    force_lag_s: NotNegative = 0.0
    """Process time by which the true force lags behind what the actuator exerts and measures: when the tool lands, and
    where the part comes or goes, by its tilt or the robot's error along the normal (`robot_error_mm`). 0: it
    follows."""
    guide_friction_n: NotNegative = 0.0
    """Dry friction of the actuator's guide, which it does not measure: the true force is so much smaller where the part
    goes and larger where it comes, by the same causes."""

    @model_validator(mode="after")
    def _are_ranges(self) -> Self:
        for name, (least, most), end in (("eq_44", self.eq_44, 1.0), ("friction", self.friction, 2.0)):
            if not 0.0 <= least <= most <= end:
                raise ValueError(
                    f"{name}: [{least:g}, {most:g}] is no range within 0 to {end:g}; give the lower one first"
                )
        return self


# The section of SIM.toml that says what the interferometer adds to the part's true heights: all off by default.


class InstrumentErrors(ConfigSection):
    """Errors of the instrument in every map. Sizes in nm are RMS over the circle about the part."""

    tilt_nm: NotNegative = 0.0
    """Largest tilt of the part in each set-up, along x and along y."""
    power_nm: float = 0.0
    """Power of its reference."""
    astigmatism_nm: NotNegative = 0.0
    """Astigmatism of its reference, ..."""
    astigmatism_deg: float = 20.0
    """... high along this direction."""
    coma_nm: NotNegative = 0.0
    """Coma of its reference, along x."""
    mount_nm: NotNegative = 0.0
    """Print-through of three points of the mount: a trefoil, ..."""
    mount_turns: bool = False
    """... which turns with the part, or stays with the instrument."""
    mount_anew: bool = False
    """... whose size and direction are drawn again for each map, with `mount_nm` as their RMS; nothing turns."""
    magnification: Annotated[float, Field(gt=-0.1, lt=0.1)] = 0.0
    """Relative error of the stated magnification. [1]"""
    distortion: Annotated[float, Field(gt=-0.1, lt=0.1)] = 0.0
    """Relative error of the magnification at the part's rim, which grows with the square of the radius. [1]"""
    retrace_nm_per_urad: float = 0.0
    """Height error of a slope along x, because the reflected beam takes another way. [nm/urad]"""
    slope_noise_nm_per_urad: NotNegative = 0.0
    """Noise of a sample by the slope there, beside `hidden_truth.map_noise_nm`. [nm/urad]"""
    dead_pixels: ShareOrNone = 0.0
    """Share of the samples that never have data. [1]"""


# The sections of SIM.toml that say what is physical: the part, how its tool removes, and the hidden truth.

_TOOL = ToolProcess()
CLOSEST = 0.8
"""A part that is concave by more than this share of the bonnet's own curvature is touched all round: no spot."""
MOST_OF_RADIUS = 0.99
"""So near to its end may a sphere or an ellipsoid come under the part and its ring."""


class Plant(OpticKeys):
    """The part, its position, and its surface at the start."""

    seed: int = 1
    """Seed of all hidden values: the same number gives the same cell. [1]"""
    speed: Annotated[float, Field(gt=0, le=10000)] = 60.0
    """Process seconds per wall second while the robot runs. [1]"""
    part_id: str = "DEMO-100"
    """The part's name in the maps; `part.id` of the cell must be the same."""
    aperture_mm: Annotated[float, Field(gt=5, le=5000)] | None = 100.0
    """Diameter of a round part, if no other key states the outline."""
    edge_mm: NotNegative = 3.0
    """Width of the edge zone that the true RMS and PV in the logs exclude."""
    ring_mm: Annotated[float, Field(ge=3, le=1000)] = 15.0
    """Width of the flush waster around the part: room for landing pads and overrun."""
    pitch_mm: Annotated[float, Field(gt=0.05, le=1)] = 0.5
    """Of the true surface, and of the maps."""
    patch_mm: Annotated[tuple[float, float, Positive], BeforeValidator(as_tuple)] | None = None
    """Center (x, y) and side of a square of the part that is kept on samples of `patch_pitch_mm`, too, where the lines
    of the path show. The plant writes its map, as an instrument with that magnification takes it, to `patch.dat` of the
    state folder with each map. Left out: none is kept."""
    patch_pitch_mm: Annotated[float, Field(ge=0.005, le=1)] = 0.08
    """Of the samples of `patch_mm`: a twentieth of the spot's radius shows three harmonics of the lines."""
    rms_nm: NotNegative = 18.0
    """Of the surface at the start, in the clear aperture; 0: it starts flat."""
    pv_nm: NotNegative = 150.0
    """Peak to valley of the same; one bump makes up what the RMS does not give."""
    origin_mm: Vector = (230.0, 160.0, 2085.0)
    """True position of the part's center in the robot's base frame. The cell assumes `part.origin_mm`."""
    rotation_rpy_deg: Vector = (180.0, 0.0, 0.0)
    """How it truly lies there, intrinsic x-y'-z''; `part.rotation_rpy_deg` of the cell."""
    seat_height_mm: float = 0.0
    """How much higher the part sits than all of that says, along its normal; negative: lower."""
    seat_tilt_deg: Pair = (0.0, 0.0)
    """And how it is tilted there, about its x and y."""
    part_missing: bool = False
    """No part lies in its ring: the tool finds nothing to press on. Maps show one all the same."""
    program_offset_mm: Vector = (0.0, 0.0, 0.0)
    """Where the program's frame truly lies on the part; `program.offset_mm` of the cell."""
    program_rotation_deg: float = 0.0
    """How it truly lies there; `program.rotation_deg` of the cell."""

    @property
    def reach_mm(self) -> float:
        """From the vertex to the farthest of part and ring."""
        return math.hypot(*self.off_axis_mm) + self.outline.radius_mm + self.ring_mm

    @model_validator(mode="after")
    def _can_be_simulated(self) -> Self:
        across_mm = 2 * (self.outline.radius_mm + self.ring_mm)
        require_cells(across_mm, across_mm, self.pitch_mm, "pitch_mm")
        if self.patch_mm is not None:
            x, y, side = self.patch_mm
            require_cells(side, side, self.patch_pitch_mm, "patch_pitch_mm")
            if math.hypot(x, y) + side > self.outline.radius_mm + self.ring_mm:
                raise ValueError(f"patch_mm: {side:g} mm about {x:g}, {y:g} mm is not all on the part and its ring")
        return self

    @model_validator(mode="after")
    def _is_a_surface(self) -> Self:
        radius = self.curvature_radius_mm
        if radius is not None and (1 + self.conic) * self.reach_mm**2 >= (MOST_OF_RADIUS * radius) ** 2:
            raise ValueError(
                f"curvature_radius_mm: {radius:g} mm is no surface out to {self.reach_mm:g} mm, where the ring ends"
            )
        return self


class Truth(ConfigSection):
    """Ranges that the hidden truth is drawn from; 0 makes a perfect machine."""

    rate: Pair = (-0.10, 0.0)
    """Lowest and highest of what the removal rate is off Preston's nominal constant, relative. [1]"""
    stiffness: ShareOrNone = 0.10
    """How far each stiffness of the robot is off its nominal value, either way, relative. [1]"""
    drift: ShareOrNone = 0.01
    """Amplitude of a slow sine of the removal rate, relative. [1]"""
    tool_wear: ShareOrNone = 0.0
    """Share of its removal rate that the tool has lost. [1]"""
    drift_period_s: Positive = 3000.0
    """Period of that drift, process time; drawn within 20 % of it."""
    force_noise: Annotated[float, Field(ge=0, lt=0.5)] = 0.01
    """Scatter of the force, relative. [1]"""
    force_noise_s: Positive = 0.05
    """Correlation time of that scatter, process time."""
    map_noise_nm: NotNegative = 0.3
    """Scatter of each sample of a map."""
    thermal_nm: float = 0.0
    """Height of the warm part's rim above its center right after a pass."""
    thermal_s: Positive = 300.0
    """Time in which that falls to 37 %, simulated clock."""
    accel_mm_s2: Positive = 1000.0
    """What the robot truly accelerates with."""
    accel_spread: ShareOrNone = 0.05
    """How far off that it is drawn, either way, relative. [1]"""
    overhead_s: NotNegative = 0.005
    """Time that a block takes beyond its motion."""
    overhead_spread: ShareOrNone = 0.10
    """How far off that it is drawn, either way, relative. [1]"""


class SimContactSection(ContactKeys):
    """The tool, and how it removes: Hertz's contact and Preston's equation, or a spot that was measured."""

    tif: Text | None = None
    """File of a measured TIF, as `polishd calibrate tif` writes it: the tool removes that instead of Hertz's spot."""
    force_n: Force = _TOOL.force_n
    """Force at which that TIF was measured."""
    rpm: Speed = _TOOL.rpm
    """Speed of the spindle at which it was measured."""
    dip_deg: Dip = _TOOL.dip_deg
    """Angle between spindle and normal at which it was measured."""
    projection: Projection = "linear"
    """How the robot's compliance becomes the way that it gives along the normal: `compliance.projection` of a cell."""

    def tool(self) -> ToolProcess:
        """As the plant takes it."""
        given = {name: value for name, value in self if name not in {"preston", "tif", "projection"}}
        return ToolProcess(preston_cm2_per_n=self.preston, **given)


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

    kind: Literal["link", "linuxcnc", "universal_robots", "opcua", "ads", "modbus", "abb_rws", "kuka_kvp"] = "link"
    """``linuxcnc``: a real LinuxCNC, in real time, in a separate network (docs/protocols/linuxcnc.md). ``opcua``,
    ``ads``, ``modbus``: a PLC that loads files from ``programs`` of the state folder (docs/protocols/plc_robot.md).
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


class SimConfig(TomlDocument):
    """The whole of sim.toml."""

    cell: Text | None = None
    """The cell's file. Part, tool, robot, instrument, protocols and addresses are read from it, and times are within
    its limits. A key that is in this file too is the machine's true value. Left out: the defaults of this page."""
    plant: Plant = Plant()
    hidden_truth: Truth = Truth()
    effects: Effects = Effects()
    process: SimContactSection = SimContactSection()
    kinematics: KinematicsSection = HybridSection()
    robot: SimRobotSection = SimRobotSection()
    actuator: SimActuatorSection = SimActuatorSection()
    spindle: SimSpindleSection = SimSpindleSection()
    interferometer: SimInterferometerSection = SimInterferometerSection()
    loader: SimLoaderSection | None = None
    force_sensor: SimForceSensorSection | None = None
    monitor: SimMonitorSection | None = None
    fault: Annotated[tuple[FaultSection, ...], BeforeValidator(as_tuple)] = ()
    _not_simulated: Mapping[str, ConfigError] = PrivateAttr(default_factory=dict)

    @model_validator(mode="after")
    def _fits(self) -> Self:
        radius_mm, tool_mm = self.plant.curvature_radius_mm, self.process.tool_radius_mm
        if radius_mm is not None and tool_mm / radius_mm > CLOSEST:
            raise ValueError(f"plant: into a radius of {radius_mm:g} mm a bonnet of {tool_mm:g} mm does not fit")
        return self

    @property
    def path(self) -> Path:
        """Absolute path of the file."""
        return self._path

    def robot_model(self) -> RobotModel:
        """The robot as it is on paper: `hidden_truth.stiffness` draws what it truly is. ConfigError as of a cell's."""
        return robot_of(self.kinematics, self.resolve)

    def measured_tif(self) -> MeasuredTif | None:
        """What the tool removes, where that was measured; ConfigError where its file is none."""
        return None if self.process.tif is None else read_tif(self.resolve(self.process.tif))

    def require_simulated(self, devices: Collection[str] | None = None) -> None:
        """Raise ConfigError if one of these devices cannot be simulated as the cell has it; None: any device."""
        for device, error in self._not_simulated.items():
            if devices is None or device in devices:
                raise error


def load_simulator(
    path: Path, model_of: Callable[[Mapping[str, Any]], type[SimConfig]] = lambda _: SimConfig
) -> SimConfig:
    """Read sim.toml and the cell that it names. ``model_of`` returns the model for the sections.

    Raises:
        ConfigError: one line per problem of either file, ``FILE:LINE: section.key: what is wrong; what to do``.
    """
    raw, source, values = _read(path)
    if values is not None:
        add_devices(values)
        raw, source = _laid_over(raw, source, values)
    made = model_of(raw).of(raw, source)
    made._path = path.absolute()
    made._not_simulated = {} if values is None else values.not_simulated
    return made


def require_simulated(path: Path) -> None:
    """Raise ConfigError if a device of the cell that sim.toml names cannot be simulated as the cell has it."""
    _, _, values = _read(path)
    if values is not None:
        add_devices(values)
        for error in values.not_simulated.values():
            raise error


def load_plant(path: Path) -> tuple[dict[str, Any], TomlSource]:
    """Return the sections of sim.toml with the values of its cell, for a plant without links, and their source.

    Raises:
        ConfigError: a file cannot be read, or the cell is invalid.
    """
    raw, source, values = _read(path)
    return (raw, source) if values is None else _laid_over(raw, source, values)


def _read(path: Path) -> tuple[dict[str, Any], TomlSource, CellValues | None]:
    raw, source = load_toml(path)
    named = raw.pop("cell", None)
    if named is None:
        return raw, source, None
    if not isinstance(named, str):
        problem = (
            f"this is a cell's file. Use polishd rehearse {path}"
            if isinstance(named, dict)
            else f"must be the name of a file, not {named!r}. Correct it."
        )
        raise ConfigError(source.error(("cell",), problem))
    cell = path.parent / Path(named).expanduser()
    try:
        toml_text(cell)
    except ConfigError as error:
        raise ConfigError(source.error(("cell",), str(error))) from error
    values = CellValues(load_config(cell), path.parent, raw)
    add_physics(values)
    return raw, source, values


def _laid_over(raw: Mapping[str, Any], source: TomlSource, values: CellValues) -> tuple[dict[str, Any], TomlSource]:
    """Return the cell's values with those of sim.toml laid over them, and their source."""
    sections = deepcopy(values.sections)
    overlay(sections, raw)
    cell = values.cell.source
    own = key_lines(source.text)
    elsewhere = tuple((here, there) for here, there in values.locations if here not in own)
    return sections, replace(cell, included=(*cell.included, source), written_at=elsewhere)
