"""A map less the form wanted: on the map's own samples, wherever the part lies in it."""

from __future__ import annotations

import numpy as np
import pytest

from polishd.model.errors import MapError
from polishd.model.surface import FloatArray, Grid, SurfaceMap
from polishd.process.metrology.resampling import Registration
from polishd.process.metrology.tolerance import subtract_nominal


def form_nm(x: FloatArray, y: FloatArray) -> FloatArray:
    return 3.0 * x - 2.0 * y + 0.5 * x * y  # bilinear: interpolation is exact


NOMINAL = SurfaceMap(form_nm(*np.meshgrid(Grid(61, 61, 1.0).x_mm, Grid(61, 61, 1.0).y_mm)), 1.0)


@pytest.mark.parametrize(
    "lies", [Registration(), Registration(0.0, (1.3, -0.7)), Registration(30.0, (-2.0, 1.1)), Registration(-90.0)]
)
def test_a_part_of_the_wanted_form_has_no_error_wherever_it_lies(lies: Registration) -> None:
    grid = Grid(40, 50, 0.5)
    turn = np.radians(lies.rotation_deg)
    right, up = np.meshgrid(grid.x_mm - lies.shift_mm[0], grid.y_mm - lies.shift_mm[1])
    x, y = np.cos(turn) * right + np.sin(turn) * up, np.cos(turn) * up - np.sin(turn) * right
    error = np.random.default_rng(3).normal(0.0, 5.0, grid.shape)
    error[4, 5] = np.nan
    found = subtract_nominal(SurfaceMap(form_nm(x, y) + error, 0.5), NOMINAL, lies)
    np.testing.assert_allclose(found.height_nm, error, atol=1e-9)


def test_where_the_form_says_nothing_there_is_no_error() -> None:
    large = SurfaceMap(np.zeros((200, 200)), 0.5)
    found = subtract_nominal(large, NOMINAL, Registration())
    inside = np.maximum(*np.abs(np.meshgrid(large.grid.x_mm, large.grid.y_mm))) <= 30.0
    np.testing.assert_array_equal(found.valid, inside)


def test_both_need_a_scale() -> None:
    flat = SurfaceMap(np.zeros((9, 9)), 1.0)
    for surface, nominal in ((flat, SurfaceMap(np.zeros((9, 9)), None)), (SurfaceMap(np.zeros((9, 9)), None), flat)):
        with pytest.raises(MapError, match="lateral scale"):
            subtract_nominal(surface, nominal, Registration())
