"""The sections of a cell's configuration: one frozen model each, with its ranges in the types."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    StringConstraints,
    field_validator,
    model_validator,
)

from polishd.model.dwell import Choice

MOST_FEED_MM_S = 1000.0
MOST_ACCEL_MM_S2 = 20_000.0
"""Two g: beyond both a number is a mistake, and times are planned that no machine keeps."""


def as_tuple(value: Any) -> Any:
    """TOML has lists, frozen models have tuples."""
    return tuple(value) if isinstance(value, list) else value


def as_tuples(value: Any) -> Any:
    """The same for a list of lists."""
    return tuple(map(as_tuple, value)) if isinstance(value, list) else value


def _feed(value: float) -> float:
    if value > MOST_FEED_MM_S:
        raise ValueError(
            f"{value:g} mm/s is faster than any polishing robot; must be at most {MOST_FEED_MM_S:g} mm/s: "
            f"if the data sheet says {value:g} mm/min, write {value / 60:.6g}"
        )
    return value


def _ordered(value: tuple[float, float]) -> tuple[float, float]:
    """A range whose low end is below its high end."""
    low, high = value
    if not math.isfinite(high - low) or low >= high:
        raise ValueError(f"[{low}, {high}] is no range; give [low, high] with low < high")
    return value


Name = Annotated[str, StringConstraints(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")]
Text = Annotated[str, StringConstraints(min_length=1)]
Texts = Annotated[tuple[Text, ...], BeforeValidator(as_tuple)]
Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Angle = Annotated[float, Field(ge=-360, le=360)]
Vector = Annotated[tuple[float, float, float], BeforeValidator(as_tuple)]
Angles = Annotated[tuple[Angle, Angle, Angle], BeforeValidator(as_tuple)]
Range = Annotated[tuple[float, float], BeforeValidator(as_tuple), AfterValidator(_ordered)]


class Section(BaseModel):
    """What all sections share: unknown keys, wrong types, NaN and infinity are errors; values never change."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


@dataclass(frozen=True, slots=True)
class Port:
    """Marks a section of the cell as one for devices, and says what is asked of them."""

    protocol: type
    acts: bool = True
    """They press, move or turn: they are made safe. Else they only look."""


class DeviceSection(Section):
    """A device: its type, and the raw options that the type's own model judges (see ``device_options``).

    Or a table of several, by names of the user's: ``[robot.left]`` and ``[robot.right]`` are such sections each.
    """

    model_config = ConfigDict(extra="allow", frozen=True, strict=True)
    type: Text | None = None
    """A device type that a loaded plugin has; its plugin says which other keys there are."""

    @model_validator(mode="after")
    def _one_or_several(self) -> Self:
        if self.type is None and not self.tables:
            raise ValueError("type: is missing; add it: type = ...")
        return self

    @property
    def tables(self) -> dict[str, dict[str, Any]]:
        """Of a table of several: each one's keys, as they stand in the file."""
        return {} if self.type else {k: v for k, v in (self.model_extra or {}).items() if isinstance(v, dict)}

    def devices(self, port: str) -> dict[str, DeviceSection]:
        """By name: its dotted section."""
        if self.type is not None:
            return {port: self}
        return {f"{port}.{name}": DeviceSection.model_validate(keys) for name, keys in self.tables.items()}


class CellSection(Section):
    """Who this cell is, and where it keeps its state."""

    name: Name
    state_dir: Text
    run_dir: Text | None = None


class PluginsSection(Section):
    """The plugins to load, by entry-point name."""

    load: Annotated[tuple[Text, ...], BeforeValidator(as_tuple), Field(min_length=1)]

    @field_validator("load")
    @classmethod
    def _once(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"named twice: {', '.join(map(repr, twice))}; name each plugin once")
        return names


class InstrumentSection(Section):
    """The instrument whose maps the cell polishes by."""

    profile: Text | None = None
    """Its profile's file; without one `run` refuses."""
    spike_mads: NotNegative = 0.0
    """How far off the surface a sample is a spike, in scaled median absolute deviations; 0: none is looked for."""


class PartSection(Section):
    """The part, and where it lies in the robot's base frame."""

    id: Text
    aperture_mm: Annotated[float, Field(gt=0, le=5000)]
    edge_mm: NotNegative = 3.0
    rim: Literal["ring", "free"] = "ring"
    alignment: Literal["piston", "tilt", "power"] = "tilt"
    nominal: Text | None = None
    """A map of the form wanted, where that is not flat in the interferometer's eyes."""
    origin_mm: Vector
    rotation_rpy_deg: Angles
    curvature_radius_mm: float | None = None
    conic: float = 0.0
    even: Annotated[tuple[float, ...], BeforeValidator(as_tuple)] = ()
    off_axis_mm: Annotated[tuple[float, float], BeforeValidator(as_tuple)] = (0.0, 0.0)

    @model_validator(mode="after")
    def _has_clear_aperture(self) -> Self:
        if 2 * self.edge_mm >= self.aperture_mm:
            raise ValueError("edge_mm: no clear aperture is left; edge_mm must be less than half of aperture_mm")
        radius = self.curvature_radius_mm
        if radius is not None and (1 + self.conic) * (self.aperture_mm / 2) ** 2 >= radius**2:
            raise ValueError(f"curvature_radius_mm: {radius:g} mm is no surface of {self.aperture_mm:g} mm aperture")
        return self


class ProgramSection(Section):
    """The part program, and how its frame lies on the part: ``part = rotation_z @ program + offset``."""

    path: Text
    format: Text = "rs274"
    dialects: Texts = ()
    """Profiles of the user's own (TOML), which ``format`` may then name."""
    covers: Literal["aperture", "zone"] = "aperture"
    """``zone``: it leaves a part of the clear aperture alone on purpose."""
    offset_mm: Vector = (0.0, 0.0, 0.0)
    rotation_deg: Angle = 0.0


class MachineSection(Section):
    """What the machine can do, from its data sheet, on the safe side."""

    max_feed_mm_s: Annotated[float, Field(gt=0), AfterValidator(_feed)]
    min_feed_mm_s: Positive
    accel_mm_s2: Annotated[float, Field(gt=0, le=MOST_ACCEL_MM_S2)]
    block_overhead_s: Annotated[float, Field(ge=0, le=1)] = 0.0
    corner_deg: Annotated[float, Field(ge=0, le=180)] = 30.0
    x_mm: Range
    y_mm: Range
    z_mm: Range

    @model_validator(mode="after")
    def _feeds_ordered(self) -> Self:
        if self.min_feed_mm_s >= self.max_feed_mm_s:
            raise ValueError("min_feed_mm_s: must be less than max_feed_mm_s; exchange or mend them")
        return self


class DwellSection(Section):
    """How the dwell is solved, and by whom it is checked."""

    solver: Text = "auto"
    cross_check: str = "qp"
    regularisation: NotNegative = 1e-4
    extension: Literal["none", "nearest", "c1", "gerchberg_papoulis"] = "c1"
    within_s: Annotated[float, Field(gt=0, le=3600)] = 120.0
    kkt_tolerance: Annotated[float, Field(gt=0, lt=1)] = 1e-4
    choose: Choice = "least"
    budget_s: Positive | None = None
    target_nm: Positive | None = None
    curve: bool = False

    @model_validator(mode="after")
    def _chosen(self) -> Self:
        for rule, key in (("budget", "budget_s"), ("target", "target_nm")):
            if (self.choose == rule) != (getattr(self, key) is not None):
                raise ValueError(f'{key}: goes with choose = "{rule}", and only with it')
        return self

    @model_validator(mode="after")
    def _independent(self) -> Self:
        if self.cross_check == self.solver:
            raise ValueError('cross_check: must be another solver than dwell.solver, or "" for none')
        return self


class JobSection(Section):
    """What is to be reached, and with how much effort."""

    id: Name
    tolerance_nm: Positive
    tolerance_period_mm: NotNegative = 0.0
    lsf_period_mm: Positive = 33.0
    max_cycles: Annotated[int, Field(ge=1, le=100)] = 4
    lookahead_s: Annotated[float, Field(ge=0.2, le=600)] = 8.0


class LimitsSection(Section):
    """What must never happen to the part."""

    force_band: Annotated[float, Field(gt=0, lt=1)] = 0.25
    force_grace_s: Annotated[float, Field(ge=0, le=10)] = 0.3
    max_removal_nm: Positive = 1000.0
    max_pass_s: Positive = 86400.0
    """A day: a metre's pass takes 17 h, and a removal rate that is wrong by the unit's factor of 100 days."""
    max_rate_change: Annotated[float, Field(gt=0, lt=1)] = 0.4
