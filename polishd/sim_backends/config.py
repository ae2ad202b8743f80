"""SIM.toml: what is simulated, and how nasty it is. Unknown keys are errors."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from polishd.model.errors import ConfigError

Vector = tuple[float, float, float]
Range = tuple[float, float]
NonNegative = Field(0.0, ge=0.0)


class Section(BaseModel):
    """A section whose unknown keys are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Plant(Section):
    """The part, where it lies, and the surface it starts with."""

    seed: int = 1
    speed: float = Field(60.0, gt=0.0, le=10000.0)
    part_id: str = "DEMO-100"
    aperture_mm: float = Field(100.0, gt=5.0)
    edge_mm: float = Field(3.0, ge=0.0)
    ring_mm: float = Field(15.0, ge=3.0)
    pitch_mm: float = Field(0.5, gt=0.05, le=1.0)
    rms_nm: float = Field(18.0, ge=0.0)
    pv_nm: float = Field(150.0, ge=0.0)
    origin_mm: Vector = (230.0, 160.0, 2085.0)
    rotation_rpy_deg: Vector = (180.0, 0.0, 0.0)
    program_offset_mm: Vector = (0.0, 0.0, 0.0)
    program_rotation_deg: float = 0.0


class Truth(Section):
    """Ranges that the hidden truth is drawn from; 0 makes a perfect machine."""

    rate: Range = (-0.10, 0.0)
    stiffness: float = Field(0.10, ge=0.0, lt=1.0)
    drift: float = Field(0.01, ge=0.0, lt=1.0)
    drift_period_s: float = Field(3000.0, gt=0.0)
    force_noise: float = Field(0.01, ge=0.0, lt=0.5)
    force_noise_s: float = Field(0.05, gt=0.0)
    map_noise_nm: float = Field(0.3, ge=0.0)
    accel_mm_s2: float = Field(1000.0, gt=0.0)
    accel_spread: float = Field(0.05, ge=0.0, lt=1.0)
    overhead_s: float = Field(0.005, ge=0.0)
    overhead_spread: float = Field(0.10, ge=0.0, lt=1.0)


class Faults(Section):
    """How a link and its device misbehave. Rates are per frame or reply sent, 0 = never."""

    jitter_s: float = NonNegative
    late_rate: float = Field(0.0, ge=0.0, le=1.0)
    late_s: float = NonNegative
    drop_rate: float = Field(0.0, ge=0.0, le=1.0)
    garble_rate: float = Field(0.0, ge=0.0, le=1.0)
    disconnect_every_s: float = NonNegative
    reboot_after_s: float = NonNegative


class ActuatorFaults(Faults):
    """What an actuator can do beyond that."""

    stuck_force_after_s: float = NonNegative
    """Seconds in contact after which the force falls to 60 % and stays there, whatever is asked."""


class MapFaults(Section):
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
    """-1: high is negative."""
    factor: float = Field(1.0, gt=0.0)
    """2: it gives wavefronts for surfaces."""


class Bump(Section):
    """A Gaussian bump of the artefact."""

    x_mm: float
    y_mm: float
    sigma_x_mm: float = Field(gt=0.0)
    sigma_y_mm: float = Field(gt=0.0)
    height_nm: float


class Artefact(Section):
    """A round flat with bumps, for ``--artefact``."""

    part_id: str = "ARTEFACT"
    diameter_mm: float = Field(100.0, gt=5.0)
    bumps: tuple[Bump, ...] = ()


class Robot(Section):
    """The robot controller."""

    kind: Literal["link", "linuxcnc"] = "link"
    """``linuxcnc``: a real LinuxCNC, in real time, in a network of its own (docs/protocols/linuxcnc.md)."""
    port: int = Field(28500, ge=0, le=65535)
    watchdog_s: float = Field(8.0, gt=0.0)
    window: int = Field(16384, ge=1)
    corner_deg: float = 30.0
    rapid_mm_s: float = Field(100.0, gt=0.0)
    max_feed_mm_s: float = Field(100.0, gt=0.0)
    x_mm: Range = (-150.0, 150.0)
    y_mm: Range = (-150.0, 150.0)
    z_mm: Range = (-2.0, 120.0)
    a_deg: Range = (-60.0, 60.0)
    home: tuple[float, float, float, float, float] = (0.0, 0.0, 60.0, 0.0, 0.0)
    """X Y Z (mm) A C (deg) at the very first start; later it is wherever it stood."""
    faults: Faults = Faults()


class Actuator(Section):
    """The voice-coil actuator. Its times go with the simulated clock."""

    kind: Literal["modbus_rtu", "modbus_tcp", "serial"] = "modbus_rtu"
    port: int = Field(0, ge=0, le=65535)
    baud: int = Field(115200, ge=1200)
    unit: int = Field(1, ge=1, le=247)
    land_s: float = Field(2.0, gt=0.0)
    lift_s: float = Field(4.0, gt=0.0)
    cling: float = Field(0.5, ge=0.0, lt=1.0)
    rest_n: float = Field(0.1, ge=0.0)
    faults: ActuatorFaults = ActuatorFaults()


class Spindle(Section):
    """The spindle drive."""

    kind: Literal["slcan", "socketcand"] = "slcan"
    port: int = Field(0, ge=0, le=65535)
    node: int = Field(5, ge=1, le=127)
    max_rpm: int = Field(3000, ge=1)
    spin_s: float = Field(3.0, gt=0.0)
    """From standstill to 1000 rpm, simulated clock."""
    stop_s: float = Field(0.5, gt=0.0)
    """And back."""
    watchdog_s: float = Field(1.0, gt=0.0)
    """Without a command for so long it stops by itself, wall time."""
    faults: Faults = Faults()


class Interferometer(Section):
    """The interferometer and its folder (``maps`` in the state folder)."""

    request_file: str = "measure.request"
    write_s: float = Field(0.2, ge=0.0)
    """Wall seconds that writing a file takes."""
    temporary_suffix: str = ".part"
    """Suffix while writing; empty: it writes slowly under the final name."""
    artefact: Artefact = Artefact()
    faults: MapFaults = MapFaults()


class SimConfig(Section):
    """The whole of SIM.toml."""

    plant: Plant = Plant()
    truth: Truth = Truth()
    robot: Robot = Robot()
    actuator: Actuator = Actuator()
    spindle: Spindle = Spindle()
    interferometer: Interferometer = Interferometer()


def load(path: Path) -> SimConfig:
    """Read SIM.toml; ConfigError names the file and the key."""
    try:
        return SimConfig.model_validate(tomllib.loads(path.read_text("utf-8-sig")))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"{path}: {error}") from error
    except ValidationError as error:
        first = error.errors()[0]
        raise ConfigError(f"{path}: {'.'.join(map(str, first['loc']))}: {first['msg']}") from error
