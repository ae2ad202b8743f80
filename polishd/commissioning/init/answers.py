"""The answers that a cell is made from: a cell's own sections and keys, and a few of ``polishd init``'s own."""

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
"""A joint that nobody has measured lets the tip of the outstretched arm give way by so much: less than any arm does."""
UNKNOWN_N_MM_PER_RAD = 1e9
"""The same of an arm of which not even the rows are known: its reach is taken for 1 m."""


@dataclass(frozen=True, slots=True)
class ArmModel:
    """A maker's arm."""

    title: str
    dh: tuple[tuple[float, float, float, float], ...]
    """Rows ``(a_mm, alpha_deg, d_mm, theta_zero_deg)``, base to flange, the standard convention."""
    home_deg: tuple[float, ...]
    """Joint angles at which the flange looks down, well away from singular poses."""
    turn_deg: float
    """How far each joint turns to either side, deg."""
    source: str

    def keys(self) -> Mapping[str, Any]:
        """What [kinematics] says of it."""
        return {
            "type": "serial",
            "dh": self.dh,
            "joint_limits_deg": ((-self.turn_deg, self.turn_deg),) * len(self.dh),
            "home_deg": self.home_deg,
        }


def as_if_rigid(dh: Sequence[Sequence[float]], tool_length_mm: float) -> tuple[float, ...]:
    """Joint stiffnesses, N mm/rad, of an arm with these rows whose stiffness nobody has measured."""
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
    """What [kinematics] may say besides a cell's own keys."""

    arm: Text | None = None
    """An arm whose rows are known: type, rows, limits and home are its own."""

    @field_validator("arm")
    @classmethod
    def _known(cls, name: str | None) -> str | None:
        if name is not None and name not in ARMS:
            raise ValueError(
                f"there is no arm {name!r}{did_you_mean(name, ARMS)} There are: {join_words(ARMS)}; of any other write "
                'type = "serial" and its rows (docs/quickstart.md)'
            )
        return name


class SampleKeys(ConfigSection):
    """What [instrument] may say besides a cell's own keys."""

    sample: Text | None = None
    """A map of this instrument: its profile is begun from it, and the part's size and name where [part] has none."""
    sample_units: Text | None = None
    """Units of its places and heights, as `mm,nm`, where the file does not say them."""
    sample_pitch_mm: Positive | None = None
    """Width of its pixels on the part, where the file has no lateral scale at all."""


class MakeKeys(ConfigSection):
    """What [program] may say besides a cell's own keys."""

    make: Literal["raster", "spiral", "none"] = "raster"
    """The program to make where `path` names none."""


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
    """Of an array that is not an `.npz`."""
    depth_ratio: Annotated[float, Field(gt=0, le=1)] = 1.0
    """Gamma where the spot was made; 1: on a rigid machine. [1]"""
    azimuth_deg: Angle = 0.0
    """Where the spindle leaned, counter-clockwise from the map's x."""

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        maps = (self.before, self.after, self.seconds)
        if self.file is None and None in maps:
            raise ValueError("before: give before, after and seconds, or a file of the rate")
        if self.file is not None and any(maps):
            raise ValueError("file: is given beside maps; keep one of both")
        if self.file is not None and (self.pitch_mm is None) != self.file.endswith(".npz"):
            raise ValueError("pitch_mm: goes with an array file, which needs it; an .npz has its own")
        return self


class OwnKeys(TomlDocument):
    """What answers may say besides a cell's keys."""

    kinematics: ArmKeys = ArmKeys()
    instrument: SampleKeys = SampleKeys()
    program: MakeKeys = MakeKeys()
    spot: SpotKeys | None = None


@dataclass(frozen=True, slots=True)
class Answers:
    """What was answered."""

    cell: Mapping[str, Any]
    """The cell's own keys, by section; not judged yet."""
    own: OwnKeys
    """The others."""
    source: TomlSource
    """The text, which says where a key stands."""

    @property
    def folder(self) -> Path:
        """Where files that it names are looked for."""
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
