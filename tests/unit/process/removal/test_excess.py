"""Excess removal: summed over the spot's footprint, judged against the plan, the same for every shape of spot."""

from __future__ import annotations

import numpy as np
import pytest

from polishd.model.process import ToolProcess
from polishd.model.surface import FloatArray
from polishd.process.removal.excess import ExcessMap
from polishd.process.removal.measured_tif import spot_figures
from tests.unit.process.gaussian import program

SPOT = spot_figures(ToolProcess(force_n=12.0))
POINT_S = 0.08


def raster(tracks: int = 21, points: int = 60, pitch_mm: float = 0.5) -> FloatArray:
    """Tracks 1 mm apart, to and fro."""
    x = np.arange(points + 1) * pitch_mm
    rows = [np.column_stack([x[:: 1 if k % 2 == 0 else -1], np.full(x.size, k), 0 * x]) for k in range(tracks)]
    return np.concatenate(rows)


def excess_map(floor_nm: float = 5.0, share: float = 0.0) -> ExcessMap:
    path = program(raster(), POINT_S)
    return ExcessMap(path, path.time_s, SPOT, floor_nm=floor_nm, share=share)


def test_a_standing_tool_removes_its_peak_rate() -> None:
    found = excess_map()
    limit_s = 5.0 / SPOT.peak_nm_s
    assert found.beyond(300, 0.99 * limit_s) is None
    over = found.beyond(300, 1.01 * limit_s)
    assert over is not None
    assert over.excess_nm == pytest.approx(5.05)
    middle = (raster()[300] + raster()[301]) / 2
    assert (over.x_mm, over.y_mm) == pytest.approx(tuple(middle[:2]), abs=1.0)


def test_slow_points_pile_up_where_their_spots_overlap_and_nowhere_else() -> None:
    """A hundred points slow by 20 ms on one track, or a hundred over the whole path."""
    near, far = excess_map(floor_nm=20.0), excess_map(floor_nm=20.0)
    for point in range(600, 660):
        near.add(point, 0.02)
    for point in range(0, far.n, far.n // 60):
        far.add(point, 0.02)
    assert any(near.beyond(point) for point in range(600, 660))
    assert not any(far.beyond(point) for point in range(far.n))
    assert near.worst() > 1.0 > far.worst()


@pytest.mark.parametrize(("slow", "wrong"), [(0.09, False), (0.11, True)])
def test_a_tenth_slower_everywhere_is_a_tenth_of_the_plan_everywhere(slow: float, wrong: bool) -> None:
    found = excess_map(floor_nm=0.01, share=0.1)
    for point in range(found.n):
        found.add(point, slow * POINT_S)
    assert (found.worst() > 1.0) is wrong


def test_what_one_point_took_too_long_the_next_may_take_less() -> None:
    """Reports of a block's end come a little late: over 1260 points the sum is hardly more than for one of them."""
    found, late_s = excess_map(floor_nm=1.0), 0.029
    for point in range(found.n):
        found.add(point, late_s if point % 2 else -late_s)
    assert found.worst() < 1.5 * late_s * SPOT.peak_nm_s


def test_what_is_allowed_besides_comes_on_top() -> None:
    found = excess_map()
    found.add(300, 0.1)
    allowed_nm = 0.1 * SPOT.peak_nm_s
    assert found.beyond(300, 4.0 / SPOT.peak_nm_s, allowed_nm=allowed_nm) is None
    assert found.beyond(300, 6.0 / SPOT.peak_nm_s, allowed_nm=allowed_nm) is not None


def test_what_each_point_may_take_besides_is_no_excess() -> None:
    found = excess_map()
    for point in range(found.n):
        found.add(point, 0.03)
    assert found.worst() > 1.0
    assert found.worst(overhead_s=0.03) == pytest.approx(0.0, abs=1e-9)
    assert found.beyond(300) is not None
    assert found.beyond(300, overhead_s=0.03) is None
    assert found.beyond(300, 0.1, overhead_s=0.03) is not None


def test_off_the_part_nothing_is_judged() -> None:
    path = program(raster(), POINT_S)
    found = ExcessMap(path, path.time_s, SPOT, floor_nm=5.0, on_part=lambda x, y: x + 0 * y > 25.0)
    assert found.beyond(0, 60.0) is None, "30 mm away"
    assert found.beyond(59, 60.0) is not None


def test_a_fresh_map_has_the_same_limits_and_no_excess() -> None:
    found = excess_map()
    found.add(300, 10.0)
    assert found.fresh().beyond(300) is None
    assert found.fresh().beyond(300, 6.0 / SPOT.peak_nm_s) is not None
    assert found.beyond(300) is not None
