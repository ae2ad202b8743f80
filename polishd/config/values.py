"""What the values of all files are: types with their ranges, and the section, which is a table of them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, StringConstraints, field_validator


def as_tuple(value: Any) -> Any:
    """TOML has lists, frozen models have tuples."""
    return tuple(value) if isinstance(value, list) else value


def _ordered(value: tuple[float, float]) -> tuple[float, float]:
    """A range whose low end is below its high end."""
    low, high = value
    if not math.isfinite(high - low) or low >= high:
        raise ValueError(f"[{low}, {high}] is no range; give [low, high] with low < high")
    return value


LARGEST, SMALLEST = 1e15, 1e-12
"""Of any number in a file, and of one that must be positive: beyond that products overflow, or vanish."""


def _not_tiny(value: float) -> float:
    """A positive number that can be divided by."""
    if 0 < value < SMALLEST:
        raise ValueError(f"{value:g} is too small; give at least {SMALLEST:g}")
    return value


def _require_usable(value: Any) -> None:
    """ValueError where a number, in whatever lists and tables, is too large to be counted with."""
    if isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) > LARGEST:
        said = f"{value:g}" if isinstance(value, float) else f"a whole number of {value.bit_length()} bits"
        raise ValueError(f"{said} is too large; give at most {LARGEST:g}")
    if isinstance(value, (tuple, list)):
        for item in value:
            _require_usable(item)
    elif isinstance(value, Mapping):
        for item in value.values():
            _require_usable(item)


MOST_CELLS = 16_000_000
"""Cells of a grid over a part: 4000 along each side."""


def require_cells(wide_mm: float, high_mm: float, pitch_mm: float, key: str) -> None:
    """ValueError where a grid of that pitch has more cells than a computer can work with."""
    cells = (wide_mm / pitch_mm + 1) * (high_mm / pitch_mm + 1)
    if cells > MOST_CELLS:
        least_mm = math.sqrt(wide_mm * high_mm / MOST_CELLS)
        raise ValueError(
            f"{key}: {pitch_mm:g} mm makes a grid of {cells:.2g} cells over {wide_mm:g} mm x {high_mm:g} mm, at most "
            f"{MOST_CELLS:.2g} can be computed; give at least {least_mm:.2g} mm"
        )


Name = Annotated[str, StringConstraints(min_length=1, max_length=64, pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")]
Text = Annotated[str, StringConstraints(min_length=1)]
Texts = Annotated[tuple[Text, ...], BeforeValidator(as_tuple)]
Positive = Annotated[float, Field(gt=0), AfterValidator(_not_tiny)]
NotNegative = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(gt=0, lt=1)]
ShareOrNone = Annotated[float, Field(ge=0, lt=1)]
Angle = Annotated[float, Field(ge=-360, le=360)]
Seconds = Annotated[float, Field(gt=0, le=3600), AfterValidator(_not_tiny)]
Force = Annotated[float, Field(ge=0.01, le=500)]
Speed = Annotated[float, Field(gt=0, le=20000), AfterValidator(_not_tiny)]
Size = Annotated[float, Field(ge=0.1, le=5000)]
"""Of a part, or of what is as large, mm."""
Dip = Annotated[float, Field(ge=0, lt=90)]
Pair = Annotated[tuple[float, float], BeforeValidator(as_tuple)]
Vector = Annotated[tuple[float, float, float], BeforeValidator(as_tuple)]
Angles = Annotated[tuple[Angle, Angle, Angle], BeforeValidator(as_tuple)]
Range = Annotated[
    tuple[float, float],
    BeforeValidator(as_tuple),
    AfterValidator(_ordered),
    Field(json_schema_extra={"range": "first < second"}),
]


class ConfigSection(BaseModel):
    """What all sections share: unknown keys, wrong types, NaN and infinity are errors; values never change."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    @field_validator("*", mode="after")
    @classmethod
    def _usable(cls, value: Any) -> Any:
        _require_usable(value)
        return value


class BumpSection(ConfigSection):
    """A Gaussian bump of an artefact; a hollow where its height is negative."""

    x_mm: float
    """Its centre, right of the artefact's."""
    y_mm: float
    """Its centre, above the artefact's."""
    sigma_x_mm: Positive
    """Standard deviation along its own x: at this distance 61 % of the height are left."""
    sigma_y_mm: Positive
    """Standard deviation along its own y."""
    height_nm: float
    """Its height over the flat."""
