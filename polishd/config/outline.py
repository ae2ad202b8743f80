"""Keys that say a part's outline: the same of a cell's part and of a simulated one."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import Annotated, Any, Self

from pydantic import BeforeValidator, Field, model_validator

from polishd.config.values import ConfigSection, Size, as_tuple
from polishd.model.errors import ComputeError
from polishd.model.outline import Circle, Outline, hexagon, polygon, rectangle

OUTLINES = ("aperture_mm", "rectangle_mm", "hexagon_mm", "polygon_mm", "polygon_file")
"""Each says the outline: what has one has no other."""
Corners = tuple[tuple[float, float], ...]
Coordinate = Annotated[float, Field(ge=-5000, le=5000)]
Corner = Annotated[tuple[Coordinate, Coordinate], BeforeValidator(as_tuple)]


class OutlineKeys(ConfigSection):
    """The outline of a part about its centre."""

    aperture_mm: Size | None = None
    """Diameter of a round part."""
    hole_mm: Size | None = None
    """Diameter of a round hole in the middle of a round part; what lies in it is no part."""
    rectangle_mm: Annotated[tuple[Size, Size], BeforeValidator(as_tuple)] | None = None
    """Instead of `aperture_mm`: sides of a rectangular part, along its x and y."""
    hexagon_mm: Size | None = None
    """Instead: width across flats of a regular hexagon; two of its corners lie on the part's x."""
    polygon_mm: Annotated[tuple[Corner, ...], BeforeValidator(as_tuple), Field(max_length=10_000)] | None = None
    """Instead: corners (x, y) of any other, in order around it."""

    @model_validator(mode="after")
    def _has_one_outline(self) -> Self:
        first, *more = self._given or [""]
        if more:
            raise ValueError(f"{more[0]}: {first} says the part's outline already; keep one of both")
        if not first and self.aperture_mm is None:
            raise ValueError(
                "aperture_mm: is missing; add it: aperture_mm = ...; of a part that is not round instead one of "
                f"{', '.join(OUTLINES[1:])}"
            )
        if self.hole_mm is not None and self.outline_key != "aperture_mm":
            raise ValueError(f"hole_mm: goes with aperture_mm, not with {first}; leave it out")
        try:
            if first != "polygon_file":
                _ = self.outline
        except ComputeError as error:
            raise ValueError(f"{'hole_mm' if self.hole_mm is not None else first}: {error}") from error
        return self

    @property
    def outline_key(self) -> str:
        """The key that says the outline."""
        return (self._given or [OUTLINES[0]])[0]

    @property
    def _given(self) -> list[str]:
        return [key for key in OUTLINES if key in self.model_fields_set and getattr(self, key) is not None]

    @property
    def outline(self) -> Outline:
        """What these keys say; ComputeError where they name a file, which has to be read."""
        return _made(self.outline_key, getattr(self, self.outline_key), (self.hole_mm or 0.0) / 2)


def as_keys(outline: Outline) -> Mapping[str, Any]:
    """The keys that say this outline without a file."""
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
    raise ComputeError(f"{key} = {value!r} has to be read first")
