"""Answers for a new cell: keys of a cell's file, and a few keys of ``polishd init``."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, field_validator, model_validator

from polishd.config.fields import Angle, ConfigSection, Positive, Text
from polishd.config.toml_loader import TomlDocument, TomlSource, did_you_mean, join_words, load_toml, loads_toml

# Six-axis arms whose makers publish their Denavit-Hartenberg rows.

UR = "Universal Robots, 'DH Parameters for calculations of kinematics and dynamics'"
GIVES_MM_PER_N = 1e-3
"""Deflection of the outstretched arm's tip by an unmeasured joint: less than that of any arm."""
UNKNOWN_N_MM_PER_RAD = 1e9
"""Joint stiffness of an arm without known rows, for a reach of 1 m."""


@dataclass(frozen=True, slots=True)
class ArmModel:
    """A maker's arm."""

    title: str
    dh: tuple[tuple[float, float, float, float], ...]
    """Rows ``(a_mm, alpha_deg, d_mm, theta_zero_deg)``, base to flange, the standard convention."""
    home_deg: tuple[float, ...]
    """Joint angles at which the flange looks down, well away from singular poses."""
    turn_deg: float
    """Range of each joint to either side, deg."""
    source: str

    def keys(self) -> Mapping[str, Any]:
        """Return its keys of [kinematics]."""
        return {
            "type": "serial",
            "dh": self.dh,
            "joint_limits_deg": ((-self.turn_deg, self.turn_deg),) * len(self.dh),
            "home_deg": self.home_deg,
        }


def as_if_rigid(dh: Sequence[Sequence[float]], tool_length_mm: float) -> tuple[float, ...]:
    """Return joint stiffnesses, N mm/rad, of an arm with these rows and unmeasured stiffness."""
    reach_mm = sum(math.hypot(row[0], row[2]) for row in dh) + tool_length_mm
    return (float(f"{reach_mm**2 / GIVES_MM_PER_N:.2g}"),) * len(dh)


def _universal_robots(model: str, *lengths_mm: float) -> ArmModel:
    """Its rows from the six lengths in which its arms differ: d1, a2, a3, d4, d5, d6."""
    d1, a2, a3, d4, d5, d6 = lengths_mm
    rows = (
        (0.0, 90.0, d1, 0.0),
        (a2, 0.0, 0.0, 0.0),
        (a3, 0.0, 0.0, 0.0),
        (0.0, 90.0, d4, 0.0),
        (0.0, -90.0, d5, 0.0),
        (0.0, 0.0, d6, 0.0),
    )
    return ArmModel(f"Universal Robots {model}", rows, (0.0, -110.0, 110.0, -90.0, -90.0, 0.0), 360.0, UR)


ARMS: Mapping[str, ArmModel] = {
    "ur5": _universal_robots("UR5", 89.159, -425.0, -392.25, 109.15, 94.65, 82.3),
    "ur10": _universal_robots("UR10", 127.3, -612.0, -572.3, 163.941, 115.7, 92.2),
    "ur5e": _universal_robots("UR5e", 162.5, -425.0, -392.2, 133.3, 99.7, 99.6),
    "ur10e": _universal_robots("UR10e", 180.7, -612.7, -571.55, 174.15, 119.85, 116.55),
    "ur16e": _universal_robots("UR16e", 180.7, -478.4, -360.0, 174.15, 119.85, 116.55),
}
"""By the name that an answer gives. Further arms need a data sheet whose rows are sure."""


class ArmKeys(ConfigSection):
    """Keys of [kinematics] in addition to those of a cell."""

    arm: Text | None = None
    """A known arm, with its type, rows, limits and home position."""

    @field_validator("arm")
    @classmethod
    def _known(cls, name: str | None) -> str | None:
        if name is not None and name not in ARMS:
            raise ValueError(
                f"there is no arm {name!r}{did_you_mean(name, ARMS)} There are: {join_words(ARMS)}; of any other write "
                'type = "serial" and its rows (docs/tutorials/rehearsed-cell.md)'
            )
        return name


class SampleKeys(ConfigSection):
    """Keys of [instrument] in addition to those of a cell."""

    sample: Text | None = None
    """A map of this instrument, the source of its profile, and of the part's size and name if [part] has none."""
    sample_units: Text | None = None
    """Units of its positions and heights, such as `mm,nm`, if the file has none."""
    sample_pitch_mm: Positive | None = None
    """Width of its pixels on the part, if the file has no lateral scale."""


class MakeKeys(ConfigSection):
    """Keys of [program] in addition to those of a cell."""

    make: Literal["raster", "spiral", "none"] = "raster"
    """The program to make if `path` names none."""


class SpotKeys(ConfigSection):
    """A removal spot that was measured: two maps and the time between, or a file of the rate."""

    before: Text | None = None
    """Map before the spot."""
    after: Text | None = None
    """Map after it."""
    seconds: Positive | None = None
    """Time on the spot."""
    file: Text | None = None
    """Instead: an `.npz` of `polishd calibrate tif`, or an array of nm/s (`.npy`, or text with rows), row 0 the top."""
    pitch_mm: Positive | None = None
    """Pitch of an array file other than `.npz`."""
    depth_ratio: Annotated[float, Field(gt=0, le=1)] = 1.0
    """Gamma at the spot; 1 for a rigid machine. [1]"""
    azimuth_deg: Angle = 0.0
    """Direction of the spindle's inclination, counter-clockwise from the map's x."""

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        maps = (self.before, self.after, self.seconds)
        if self.file is None and None in maps:
            raise ValueError("before: give before, after and seconds, or a file of the rate")
        if self.file is not None and any(maps):
            raise ValueError("file: cannot be combined with maps; keep one of both")
        if self.file is not None and (self.pitch_mm is None) != self.file.endswith(".npz"):
            raise ValueError("pitch_mm: an array file needs it, an .npz has its own; add or remove it")
        return self


class OwnKeys(TomlDocument):
    """Keys of answers in addition to those of a cell."""

    kinematics: ArmKeys = ArmKeys()
    instrument: SampleKeys = SampleKeys()
    program: MakeKeys = MakeKeys()
    spot: SpotKeys | None = None


@dataclass(frozen=True, slots=True)
class Answers:
    """Answers from a file or a dialog."""

    cell: Mapping[str, Any]
    """Keys of the cell by section, not validated yet."""
    own: OwnKeys
    """The others."""
    source: TomlSource
    """The text, used to locate errors."""

    @property
    def folder(self) -> Path:
        """Base folder of its files."""
        return Path(self.source.file).absolute().parent


def read_answers(path: Path) -> Answers:
    """A file of answers; ConfigError, ``FILE:LINE: key: what is wrong; what to do``, where keys of init's own are."""
    return _answers(*load_toml(path))


def answers_of(text: str, path: Path) -> Answers:
    """The same of a text that is to stand in that file."""
    return _answers(*loads_toml(text, path))


def _answers(raw: dict[str, Any], source: TomlSource) -> Answers:
    cell, own = {}, {}
    for name, section in raw.items():
        if name == "spot":
            own[name] = section
        elif name in OwnKeys.model_fields and isinstance(section, Mapping):
            known = type(OwnKeys.model_fields[name].default).model_fields
            own[name] = {key: value for key, value in section.items() if key in known}
            cell[name] = {key: value for key, value in section.items() if key not in known}
        else:
            cell[name] = section
    return Answers(cell, OwnKeys.of(own, source), source)
