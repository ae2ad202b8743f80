"""Types of config values with their ranges, and the base class of all sections."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from typing import Annotated, Any, Self

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

from polishd.model.errors import ComputeError
from polishd.model.outline import Circle, Outline, hexagon, polygon, rectangle
from polishd.model.process import FLAT


def as_tuple(value: Any) -> Any:
    """Turn a list, as TOML has it, into a tuple, as frozen models need it."""
    return tuple(value) if isinstance(value, list) else value


def _ordered(value: tuple[float, float]) -> tuple[float, float]:
    """Check that the low end of a range is below its high end."""
    low, high = value
    if not math.isfinite(high - low) or low >= high:
        raise ValueError(f"[{low}, {high}] is not a range; give [low, high] with low < high")
    return value


LARGEST, SMALLEST = 1e15, 1e-12
"""Largest number in a file, and smallest positive one: beyond them products overflow or underflow."""


def _not_tiny(value: float) -> float:
    """Check that a positive number is large enough to divide by."""
    if 0 < value < SMALLEST:
        raise ValueError(f"{value:g} is too small; give at least {SMALLEST:g}")
    return value


def _require_usable(value: Any) -> None:
    """Raise ValueError if a number, also in lists and tables, is too large to compute with."""
    if isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) > LARGEST:
        shown = f"{value:g}" if isinstance(value, float) else f"a whole number of {value.bit_length()} bits"
        raise ValueError(f"{shown} is too large; give at most {LARGEST:g}")
    if isinstance(value, (tuple, list)):
        for item in value:
            _require_usable(item)
    elif isinstance(value, Mapping):
        for item in value.values():
            _require_usable(item)


MOST_CELLS = 16_000_000
"""Cells of a grid over a part: 4000 along each side."""


def require_cells(wide_mm: float, high_mm: float, pitch_mm: float, key: str) -> None:
    """Raise ValueError if a grid of that pitch has too many cells to compute."""
    cells = (wide_mm / pitch_mm + 1) * (high_mm / pitch_mm + 1)
    if cells > MOST_CELLS:
        least_mm = math.sqrt(wide_mm * high_mm / MOST_CELLS)
        raise ValueError(
            f"{key}: {pitch_mm:g} mm makes a grid of {cells:.2g} cells over {wide_mm:g} mm x {high_mm:g} mm; at most "
            f"{MOST_CELLS:.2g} can be computed. Set at least {least_mm:.2g} mm"
        )


LONGEST_NAME = 64
Name = Annotated[str, StringConstraints(min_length=1, max_length=LONGEST_NAME, pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")]
Text = Annotated[str, StringConstraints(min_length=1)]
Texts = Annotated[tuple[Text, ...], BeforeValidator(as_tuple)]


def _file_names(value: Any) -> Any:
    """Check one file name, or a list of at least one: a union of types would report each of them."""
    names = as_tuple(value)
    listed = names if isinstance(names, tuple) else (names,)
    if not listed or not all(isinstance(name, str) and name for name in listed):
        raise ValueError('must be the name of a file, or a list of them, such as ["a.rnc", "b.rnc"]')
    return names


FileNames = Annotated[Text | tuple[Text, ...], BeforeValidator(_file_names)]
"""One file, or several in order."""
Positive = Annotated[float, Field(gt=0), AfterValidator(_not_tiny)]
NotNegative = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(gt=0, lt=1)]
ShareOrNone = Annotated[float, Field(ge=0, lt=1)]
Angle = Annotated[float, Field(ge=-360, le=360)]
Seconds = Annotated[float, Field(gt=0, le=3600), AfterValidator(_not_tiny)]
Force = Annotated[float, Field(ge=0.01, le=500)]
Speed = Annotated[float, Field(gt=0, le=20000), AfterValidator(_not_tiny)]
Size = Annotated[float, Field(ge=0.1, le=5000)]
"""Size of a part or artefact, mm."""
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
    """Base of all sections: frozen; unknown keys, wrong types, NaN and infinity are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False, defer_build=True)
    """Models are built at their first use: a cell has few of the device types and profiles."""

    @field_validator("*", mode="after")
    @classmethod
    def _usable(cls, value: Any) -> Any:
        _require_usable(value)
        return value


class BumpSection(ConfigSection):
    """A Gaussian bump of an artefact; a hollow if its height is negative."""

    x_mm: float
    """Its center, to the right of the artefact's center."""
    y_mm: float
    """Its center, above the artefact's center."""
    sigma_x_mm: Positive
    """Standard deviation along its x axis: the distance at which 61 % of the height are left."""
    sigma_y_mm: Positive
    """Standard deviation along its y axis."""
    height_nm: float
    """Its height over the flat."""


# Keys of a part's outline, for a cell's part and for a simulated one.

OUTLINES = ("aperture_mm", "rectangle_mm", "hexagon_mm", "polygon_mm", "polygon_file")
"""Keys that define the outline: a part has exactly one."""
Corners = tuple[tuple[float, float], ...]
Coordinate = Annotated[float, Field(ge=-5000, le=5000)]
Corner = Annotated[tuple[Coordinate, Coordinate], BeforeValidator(as_tuple)]


class OutlineKeys(ConfigSection):
    """The outline of a part about its center."""

    aperture_mm: Size | None = None
    """Diameter of a round part."""
    hole_mm: Size | None = None
    """Diameter of a round hole in the middle of a round part."""
    rectangle_mm: Annotated[tuple[Size, Size], BeforeValidator(as_tuple)] | None = None
    """Instead of `aperture_mm`: sides of a rectangular part along its x and y."""
    hexagon_mm: Size | None = None
    """Instead of `aperture_mm`: width across flats of a regular hexagon with two corners on the part's x axis."""
    polygon_mm: Annotated[tuple[Corner, ...], BeforeValidator(as_tuple), Field(max_length=10_000)] | None = None
    """Instead of `aperture_mm`: corners (x, y) of a polygon, in order around it."""

    @model_validator(mode="after")
    def _has_one_outline(self) -> Self:
        first, *more = self._given or [""]
        if more:
            raise ValueError(f"{more[0]}: {first} defines the part's outline already; keep one of both")
        if not first and self.aperture_mm is None:
            raise ValueError(
                "aperture_mm: is missing; add it: aperture_mm = ..., or, if the part is not round, one of "
                f"{', '.join(OUTLINES[1:])}"
            )
        if self.hole_mm is not None and self.outline_key != "aperture_mm":
            raise ValueError(f"hole_mm: needs aperture_mm, not {first}; remove it")
        try:
            if first != "polygon_file":
                _ = self.outline
        except ComputeError as error:
            raise ValueError(f"{'hole_mm' if self.hole_mm is not None else first}: {error}") from error
        return self

    @property
    def outline_key(self) -> str:
        """The key that defines the outline."""
        return (self._given or [OUTLINES[0]])[0]

    @property
    def _given(self) -> list[str]:
        return [key for key in OUTLINES if key in self.model_fields_set and getattr(self, key) is not None]

    @property
    def outline(self) -> Outline:
        """The outline by these keys. ComputeError if they name a file, which must be read first."""
        return _made(self.outline_key, getattr(self, self.outline_key), (self.hole_mm or 0.0) / 2)


class OpticKeys(OutlineKeys):
    """Outline and surface of a part."""

    curvature_radius_mm: float | None = FLAT.radius_mm
    """Vertex radius of the optic, positive if it is concave. Left out: flat."""
    conic: float = FLAT.conic
    """Conic constant: 0 a sphere, -1 a paraboloid. [1]"""
    even: Annotated[tuple[float, ...], BeforeValidator(as_tuple)] = FLAT.even
    """Even aspheric terms A4, A6, ..., positive up. [mm^-3, mm^-5, ...]"""
    off_axis_mm: Pair = FLAT.offset_mm
    """Position of the part's center from the vertex, in the parent's x and y."""


def as_keys(outline: Outline) -> Mapping[str, Any]:
    """Return the keys that define this outline without a file."""
    if not isinstance(outline, Circle):
        return {"polygon_mm": outline.corners_mm}
    hole = {"hole_mm": 2 * outline.hole_mm} if outline.hole_mm else {}
    return {"aperture_mm": 2 * outline.radius_mm, **hole}


@functools.lru_cache(maxsize=16)
def _made(key: str, value: Any, hole_mm: float) -> Outline:
    match key:
        case "aperture_mm":
            return Circle(value / 2, hole_mm)
        case "rectangle_mm":
            return rectangle(*value)
        case "hexagon_mm":
            return hexagon(value)
        case "polygon_mm":
            return polygon(value)
    raise ComputeError(f"{key} = {value!r} must be read first")
