"""A part that is not round, placed in a map by its sides: shifted, turned, chipped, cut off, and another part."""

from __future__ import annotations

import numpy as np
import pytest

from polishd.model.errors import MapError
from polishd.model.instrument import Instrument
from polishd.model.outline import Circle, Polygon, hexagon, polygon, rectangle
from polishd.model.surface import FloatArray, Grid, SurfaceMap
from polishd.process.metrology.registration import fit_polygon, register
from polishd.process.metrology.resampling import Registration

GRID = Grid(180, 240, 0.25)
PARTS = {
    "rectangle": rectangle(40, 24),
    "square": rectangle(30, 30),
    "hexagon": hexagon(28.0),
    "with a corner off": polygon([(15, 12), (-15, 12), (-15, -12), (5, -12), (15, -2)]),
    "hollow": polygon([(-15, -12), (15, -12), (15, 2), (3, 2), (3, 12), (-15, 12)]),
}
TURN_DEG, SHIFT_MM = 1.3, (1.37, -0.84)


def seen(part: Polygon, turn_deg: float = TURN_DEG, shift_mm: tuple[float, float] = SHIFT_MM) -> FloatArray:
    """(ny, nx) 0 on the part, NaN beside it."""
    x, y = Registration(turn_deg, shift_mm).on_part_mm(GRID)
    return np.where(part.inside_mm(x, y) > 0, 0.0, np.nan)


def off(found: Registration, turn_deg: float = TURN_DEG, shift_mm: tuple[float, float] = SHIFT_MM) -> float:
    """How far the farthest of centre and turn is wrong, pixels: the turn at 20 mm."""
    away = np.hypot(found.shift_mm[0] - shift_mm[0], found.shift_mm[1] - shift_mm[1])
    return float(max(away, 20 * np.radians(abs(found.rotation_deg - turn_deg)))) / GRID.pitch_mm


@pytest.mark.parametrize("name", PARTS)
def test_a_part_is_found_to_a_tenth_of_a_pixel(name: str) -> None:
    found = fit_polygon(seen(PARTS[name]), GRID.pitch_mm, PARTS[name], 1.0)
    assert off(found) < 0.15
    assert found.scale == pytest.approx(1.0, abs=0.01)
    assert found.residual_mm < 0.15
    assert found.by == "aperture"


@pytest.mark.parametrize("what", ["hole", "clamp", "chipped", "cut by the frame"])
def test_what_is_missing_moves_it_little(what: str) -> None:
    part = PARTS["rectangle"]
    height = seen(part)
    if what == "hole":
        height[70:100, 100:140] = np.nan
    if what == "clamp":
        height[30:60, 100:115] = np.nan
    if what == "chipped":
        height[:60, :60] = np.nan
    if what == "cut by the frame":
        height, cut = height[:, 50:], -50 / 2 * GRID.pitch_mm
        found = fit_polygon(height, GRID.pitch_mm, part, 1.0)
        assert off(found, shift_mm=(SHIFT_MM[0] + cut, SHIFT_MM[1])) < 0.3
        return
    assert off(fit_polygon(height, GRID.pitch_mm, part, 1.0)) < 0.3


@pytest.mark.parametrize(
    ("shown", "says"),
    [
        (rectangle(42, 26), "2.0[0-9]+ mm larger across than a rectangle of 40 x 24 mm, 1 mm allowed"),
        (rectangle(38, 22), "smaller across than a rectangle of 40 x 24 mm"),
        (rectangle(24, 40), "is not that of a rectangle of 40 x 24 mm"),
        (hexagon(30), "is not that of a rectangle of 40 x 24 mm"),
    ],
)
def test_another_part_is_refused(shown: Polygon, says: str) -> None:
    with pytest.raises(MapError, match=says):
        fit_polygon(seen(shown), GRID.pitch_mm, PARTS["rectangle"], 1.0)


def test_two_sides_that_say_nothing_along_them_are_refused() -> None:
    strip = seen(rectangle(100, 24), 0.0, (0.0, 0.0))
    with pytest.raises(MapError, match="does not say where the part lies in all directions"):
        fit_polygon(strip, GRID.pitch_mm, rectangle(100, 24), 1.0)
    with pytest.raises(MapError, match="too few to place it"):
        fit_polygon(np.zeros(GRID.shape), GRID.pitch_mm, rectangle(100, 24), 1.0)


def test_a_profile_registers_by_the_parts_own_outline_unless_it_names_a_diameter() -> None:
    part = PARTS["hexagon"]
    by_outline = Instrument("shop", register_by="aperture", max_turn_deg=2.0)
    assert off(register(SurfaceMap(seen(part), GRID.pitch_mm), by_outline, part)) < 0.15
    with pytest.raises(MapError, match="is turned by 2"):
        register(SurfaceMap(seen(part, 2.5), GRID.pitch_mm), by_outline, part)
    stop = np.where(Circle(18.0).contains(*GRID.axes_mm), 0.0, np.nan)
    through_stop = Instrument("shop", register_by="aperture", aperture_mm=36.0)
    assert register(SurfaceMap(stop, GRID.pitch_mm), through_stop, part).rotation_deg == 0
