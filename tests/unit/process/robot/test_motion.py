"""Machine time against closed forms and against a plain simulation in small steps."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polishd.model.errors import ComputeError
from polishd.model.program import MoveTiming
from polishd.model.surface import FloatArray
from polishd.process.robot.motion import asked_time_s, delivered_time_s, learn_overhead_s, least_time_s, most_time_s
from polishd.process.toolpath.apertures import circle
from polishd.process.toolpath.paths import raster
from tests.unit.process.gaussian import envelope, program

A, V = 800.0, 50.0


def line(*lengths: float) -> FloatArray:
    x = np.concatenate([[0.0], np.cumsum(lengths)])
    return np.column_stack([x, 0 * x, 0 * x])


def test_one_block_from_rest_to_rest() -> None:
    # ramps of 50 / 800 s over 1.5625 mm each, the rest at 50 mm/s
    assert least_time_s(program(line(20.0)), envelope()) == pytest.approx(2 * V / A + (20 - V**2 / A) / V)
    # too short to reach the feed: a triangle
    assert least_time_s(program(line(1.0)), envelope()) == pytest.approx(2 * np.sqrt(1.0 / A))


def test_a_long_line_cut_into_blocks_takes_as_long_as_in_one_piece() -> None:
    whole = least_time_s(program(line(20.0)), envelope()).sum()
    assert least_time_s(program(line(*[0.5] * 40)), envelope()).sum() == pytest.approx(whole)


def test_blocks_far_from_the_ends_take_what_is_asked() -> None:
    points = line(*[1.0] * 50)
    asked = np.full(50, 0.1)
    taken = delivered_time_s(program(points), asked, envelope())
    np.testing.assert_allclose(taken[1:-1], 0.1, rtol=1e-12)
    assert taken[0] == pytest.approx(0.1 + 10 / A / 2)  # a ramp to 10 mm/s costs half the time it lasts


def test_a_step_of_feed_is_made_in_the_faster_block() -> None:
    taken = delivered_time_s(program(line(10.0, 10.0)), np.array([1.0, 0.25]), envelope())
    slow, fast = 10.0, 40.0
    first = slow / A + (10 - slow**2 / (2 * A)) / slow
    ramp_up, ramp_down = (fast**2 - slow**2) / (2 * A), fast**2 / (2 * A)
    second = (fast - slow) / A + fast / A + (10 - ramp_up - ramp_down) / fast
    np.testing.assert_allclose(taken, [first, second])


@pytest.mark.parametrize(
    ("angle_deg", "stops"), [(0, False), (29, False), (30, False), (31, True), (90, True), (180, True)]
)
def test_the_machine_stops_at_corners(angle_deg: float, stops: bool) -> None:
    a = np.radians(angle_deg)
    points = np.array([[0, 0, 0], [10, 0, 0], [10 + 10 * np.cos(a), 10 * np.sin(a), 0]])
    taken = least_time_s(program(points), envelope()).sum()
    apart = 2 * least_time_s(program(line(10.0)), envelope()).sum()
    assert taken == pytest.approx(apart if stops else least_time_s(program(line(20.0)), envelope()).sum())


def test_it_stops_at_gaps_and_where_a_block_does_not_move() -> None:
    whole = program(line(10.0, 10.0))
    hop = np.array([[0, 0, 0], [1e-3, 0, 0]])
    gap = replace(whole, start_mm=whole.start_mm + hop, end_mm=whole.end_mm + hop)
    apart = 2 * least_time_s(program(line(10.0)), envelope()).sum()
    assert least_time_s(gap, envelope()).sum() == pytest.approx(apart)
    still = least_time_s(program(line(10.0, 0.0, 10.0)), envelope())
    assert still.sum() == pytest.approx(apart)
    assert still[1] == 0
    everywhere = least_time_s(program(line(10.0, 0.0, 10.0)), envelope(corner_deg=180))
    np.testing.assert_allclose(everywhere, still)


def test_each_block_takes_its_overhead() -> None:
    points = line(*[1.0] * 20)
    base = delivered_time_s(program(points), np.full(20, 0.1), envelope())
    more = delivered_time_s(program(points), np.full(20, 0.1), envelope(block_overhead_s=0.003))
    np.testing.assert_allclose(more, base + 0.003)


def test_a_dwell_on_the_spot_takes_its_time_and_the_overhead() -> None:
    dwells = program(np.zeros((10, 3)), 0.2, "dwell")
    limits = envelope(block_overhead_s=0.01)
    np.testing.assert_allclose(delivered_time_s(dwells, np.full(10, 0.2), limits), 0.21)
    np.testing.assert_allclose(least_time_s(dwells, limits), 0.01)
    np.testing.assert_allclose(most_time_s(dwells, limits), limits.max_pass_s)


def test_a_dwell_takes_the_move_that_leads_to_it_from_rest_to_rest() -> None:
    dwells = program(line(*[1.0] * 9), 0.2, "dwell")
    move = 2 * np.sqrt(1.0 / A)
    np.testing.assert_allclose(delivered_time_s(dwells, np.full(10, 0.2), envelope()), [0.2, *[0.2 + move] * 9])


def timed(stops: bool, share: float = 0.0, resolution_s: float = 0.001) -> MoveTiming:
    return MoveTiming(0.05, 250.0, resolution_s, share, np.full(20, stops))


def test_a_move_that_is_programmed_to_stop_is_run_from_rest_to_rest() -> None:
    path = program(line(*[1.0] * 20))
    asked = np.full(20, 0.1)
    blended = delivered_time_s(replace(path, timing=timed(stops=False)), asked, envelope())
    np.testing.assert_allclose(blended, delivered_time_s(path, asked, envelope()))
    stopped = delivered_time_s(replace(path, timing=timed(stops=True)), asked, envelope())
    np.testing.assert_allclose(stopped, 0.1 + 10 / A)


def test_a_blend_takes_its_share_and_what_is_asked_makes_up_for_it() -> None:
    path, limits = program(line(*[1.0] * 20)), envelope(block_overhead_s=0.004)
    plain = delivered_time_s(path, np.full(20, 0.1), limits)
    shared = replace(path, timing=timed(stops=False, share=-0.1))
    np.testing.assert_allclose(delivered_time_s(shared, np.full(20, 0.1), limits), 0.9 * (plain - 0.004) + 0.004)
    wanted = np.full(20, 0.15)
    asked = asked_time_s(shared, wanted, limits)
    np.testing.assert_allclose(delivered_time_s(shared, asked, limits)[1:-1], 0.15)


def test_no_move_takes_less_than_its_time_can_state() -> None:
    path = replace(program(line(*[0.01] * 20)), timing=timed(stops=False, resolution_s=0.05))
    np.testing.assert_allclose(least_time_s(path, envelope()), 0.05)


def test_most_time_is_that_of_the_smallest_feed_and_never_below_the_least() -> None:
    points = line(2.0, 0.0, 1.0)
    most, least = most_time_s(program(points), envelope()), least_time_s(program(points), envelope())
    np.testing.assert_allclose(most, [4.0, 0.0, 2.0])
    assert (most >= least).all()
    fast = envelope(min_feed_mm_s=49.9, accel_mm_s2=1.0)
    assert (most_time_s(program(points), fast) >= least_time_s(program(points), fast)).all()


def simulated(lengths: FloatArray, feeds: FloatArray, accel: float, step: float = 1e-4) -> float:
    """Total time by the largest speed at each of many places on a straight line, passes written out."""
    edges = np.concatenate([[0], np.cumsum(lengths)])
    s = np.arange(step / 2, edges[-1], step)
    limit = feeds[np.minimum(np.searchsorted(edges, s, side="right") - 1, len(feeds) - 1)]
    square = limit**2
    for order in (range(len(s)), range(len(s) - 1, -1, -1)):
        last = 0.0
        reach = step / 2
        for k in order:
            square[k] = min(square[k], last + 2 * accel * reach)
            last, reach = square[k], step
    return float((step / np.sqrt(square)).sum())


@settings(max_examples=10)
@given(st.lists(st.tuples(st.integers(1, 20), st.floats(1, 60)), min_size=1, max_size=6))
def test_any_straight_path_against_small_steps(blocks: list[tuple[int, float]]) -> None:
    lengths, feeds = np.array([0.05 * b[0] for b in blocks]), np.array([b[1] for b in blocks])
    taken = delivered_time_s(program(line(*lengths)), lengths / feeds, envelope(max_feed_mm_s=60.0))
    assert taken.sum() == pytest.approx(simulated(lengths, feeds, A), rel=0.02)


@settings(max_examples=50)
@given(st.lists(st.tuples(st.floats(0.01, 5), st.floats(0, 2), st.floats(0, 180)), min_size=2, max_size=30))
def test_never_sooner_than_asked_nor_than_the_largest_feed(blocks: list[tuple[float, float, float]]) -> None:
    turn = np.cumsum(np.radians([b[2] for b in blocks]))
    steps = np.array([b[0] for b in blocks])[:, None] * np.column_stack([np.cos(turn), np.sin(turn), 0 * turn])
    path = program(np.vstack([np.zeros(3), np.cumsum(steps, axis=0)]))
    asked = np.array([b[1] for b in blocks])
    taken = delivered_time_s(path, asked, envelope())
    assert (taken >= asked * (1 - 1e-9)).all()
    assert (taken >= path.length_mm / V * (1 - 1e-9)).all()
    slower = delivered_time_s(path, asked * 2 + 0.1, envelope())
    assert slower.sum() >= taken.sum()


def test_overhead_is_learned_from_what_was_executed() -> None:
    points = raster(circle(20), 1.0, 1.0)
    path = program(points)
    rng = np.random.default_rng(0)
    asked = 0.05 + 0.1 * rng.random(path.n)
    executed = delivered_time_s(path, asked, envelope(block_overhead_s=0.004)) + 2e-4 * rng.standard_normal(path.n)
    executed[::17] = np.nan
    executed[::29] += 3.0  # a hold
    assert learn_overhead_s(path, asked, executed, envelope(block_overhead_s=0.1)) == pytest.approx(0.004, abs=1e-4)
    assert learn_overhead_s(path, asked, executed - 0.1, envelope()) == 0
    executed[9:] = np.nan
    assert learn_overhead_s(path, asked, executed, envelope(block_overhead_s=0.1)) == 0.1


@pytest.mark.parametrize("asked", [np.zeros(3), np.array([0.1, -0.1]), np.array([0.1, np.nan])])
def test_times_that_cannot_be(asked: FloatArray) -> None:
    with pytest.raises(ComputeError, match="each of the 2 timed points needs a finite time"):
        delivered_time_s(program(line(1.0, 1.0)), asked, envelope())
    with pytest.raises(ComputeError, match="executed times are"):
        learn_overhead_s(program(line(1.0, 1.0)), np.ones(2), np.ones(3), envelope())


@pytest.mark.parametrize(("radius_mm", "at_least", "cpu_s"), [(50.0, 8_000, 0.05), (224.0, 158_000, 2.0)])
def test_it_is_quick(radius_mm: float, at_least: int, cpu_s: float) -> None:
    path = program(raster(circle(2 * radius_mm), 1.0, 1.0))
    assert path.n > at_least
    asked = np.full(path.n, 0.1)
    best = np.inf
    for _ in range(3):
        begin = time.process_time()
        delivered_time_s(path, asked, envelope())
        best = min(best, time.process_time() - begin)
    assert best < cpu_s
