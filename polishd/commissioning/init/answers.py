"""Answers for a new cell: keys of a cell's file, and a few keys of ``polishd init``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, field_validator, model_validator

from polishd.commissioning.init.arms import ARMS
from polishd.commissioning.init.makers import FRAMES, MAKERS, FrameForm
from polishd.config.fields import Angle, ConfigSection, Positive, Text, as_tuple
from polishd.config.toml_loader import TomlDocument, TomlSource, did_you_mean, join_words, load_toml, loads_toml


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


FrameValues = Annotated[tuple[float, ...], BeforeValidator(as_tuple)]


class MakerKeys(ConfigSection):
    """Keys of [robot] in addition to those of a cell. A line `robot = "abb"` is the same as `maker = "abb"`."""

    maker: Text | None = None
    """Maker of the robot: its driver, the language and an arm."""
    wobj: FrameValues | None = None
    """Of abb: the part's work object, x, y, z in mm and q1 to q4."""
    base: FrameValues | None = None
    """Of kuka: the part's base, X, Y, Z in mm and A, B, C in deg."""
    uframe: FrameValues | None = None
    """Of fanuc: the part's user frame, X, Y, Z in mm and W, P, R in deg."""
    user_frame: FrameValues | None = None
    """Of yaskawa: the part's user frame, X, Y, Z in mm and Rx, Ry, Rz in deg."""
    frame: FrameValues | None = None
    """Of staubli: the part's frame, x, y, z in mm and rx, ry, rz in deg."""
    feature: FrameValues | None = None
    """Of ur: the part's feature p[...], x, y, z in m and the rotation vector in rad."""

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.maker is not None and self.maker not in MAKERS:
            raise ValueError(
                f"maker: there is no robot {self.maker!r}{did_you_mean(self.maker, MAKERS)} There are: "
                f"{join_words(MAKERS)}; of any other write [robot] with its type"
            )
        form = None if self.maker is None else MAKERS[self.maker].frame
        for name, one in FRAMES.items():
            values = getattr(self, name)
            if values is None:
                continue
            if one is not form:
                own = f"; it has {form.key}" if form is not None else ""
                raise ValueError(f"{name}: is no frame of maker = {self.maker!r}{own}")
            one.check(values)
        return self

    @property
    def given_frame(self) -> tuple[FrameForm, FrameValues] | None:
        """The part's frame in the maker's terms, if it is answered."""
        found = ((one, getattr(self, name)) for name, one in FRAMES.items())
        return next(((one, values) for one, values in found if values is not None), None)


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

    make: Literal["raster", "spiral", "concentric", "random", "none"] = "raster"
    """The program to make if `path` names none. `random` has half the line distance of the others."""
    cross_deg: Annotated[float, Field(ge=1, le=179)] | None = None
    """Of `raster`: angle to a second raster of the same pass."""
    phase: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Shift of the lines, in line distances; not of `random`. [1]"""
    seed: Annotated[int, Field(ge=0)] = 0
    """Of `random`: another path for another number. [1]"""

    @model_validator(mode="after")
    def _of_shape(self) -> Self:
        if self.cross_deg is not None and self.make != "raster":
            raise ValueError(f'cross_deg: goes with make = "raster", not with "{self.make}"; remove it')
        if self.phase and self.make == "random":
            raise ValueError('phase: does not go with make = "random"; set another seed instead')
        if self.seed and self.make != "random":
            raise ValueError(f'seed: goes with make = "random", not with "{self.make}"; remove it')
        return self


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

    robot: MakerKeys = MakerKeys()
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
        if name == "robot" and isinstance(section, str):
            own[name] = {"maker": section}
        elif name == "spot":
            own[name] = section
        elif name in OwnKeys.model_fields and isinstance(section, Mapping):
            known = type(OwnKeys.model_fields[name].default).model_fields
            mine = {key for key, value in section.items() if key in known and not isinstance(value, Mapping)}
            own[name] = {key: value for key, value in section.items() if key in mine}
            cell[name] = {key: value for key, value in section.items() if key not in mine}
        else:
            cell[name] = section
    return Answers(cell, OwnKeys.of(own, source), source)
