"""The look-ahead profile: physical, and as fast as its limits allow."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.sim_backends.robot.trajectory import along, junctions, trapezoids

ACCEL = 1000.0


def test_one_move_from_rest_to_rest_is_a_trapezoid() -> None:
    squared = junctions(np.array([10.0]), np.array([0.0, 0.0]), 0.0, ACCEL)
    shape = trapezoids(np.array([10.0]), np.array([50.0]), squared, ACCEL)
    assert shape.t_up[0] == pytest.approx(0.05)
    assert shape.seconds[0] == pytest.approx(10.0 / 50.0 + 50.0 / ACCEL)


def test_a_short_move_never_reaches_its_feed() -> None:
    squared = junctions(np.array([1.0]), np.array([0.0, 0.0]), 0.0, ACCEL)
    shape = trapezoids(np.array([1.0]), np.array([100.0]), squared, ACCEL)
    assert shape.v_top[0] == pytest.approx(np.sqrt(1000.0))
    assert shape.seconds[0] == pytest.approx(2 * np.sqrt(1.0 / ACCEL))


def test_a_straight_chain_is_one_trapezoid() -> None:
    length, feed = np.full(100, 0.1), np.full(100, 50.0)
    cap = np.concatenate([[0.0], np.full(99, 2500.0), [0.0]])
    shape = trapezoids(length, feed, junctions(length, cap, 0.0, ACCEL), ACCEL)
    assert shape.seconds.sum() == pytest.approx(10.0 / 50.0 + 50.0 / ACCEL)


moves = st.lists(st.tuples(st.floats(0.0, 5.0), st.floats(0.5, 100.0)), min_size=1, max_size=30)


@given(moves)
def test_limits_are_kept_and_every_millimetre_is_travelled(chain: list[tuple[float, float]]) -> None:
    length, feed = (np.array(column) for column in zip(*chain, strict=True))
    cap = np.concatenate([[0.0], np.minimum(feed[1:], feed[:-1]) ** 2, [0.0]])
    squared = junctions(length, cap, 0.0, ACCEL)
    shape = trapezoids(length, feed, squared, ACCEL)
    assert (squared <= cap + 1e-6).all()
    assert (np.abs(np.diff(squared)) <= 2 * ACCEL * length + 1e-6).all()
    k = np.arange(len(length))
    travelled, speed = along(shape, k, shape.seconds)
    moving = length > 1e-9
    assert np.allclose(travelled[moving], length[moving], atol=1e-6)
    assert np.allclose(speed[moving], shape.v_out[moving], atol=1e-4)
    assert (shape.v_top <= feed + 1e-6).all() or not moving.all()


def test_it_starts_at_the_speed_it_has() -> None:
    length = np.full(5, 2.0)
    squared = junctions(length, np.array([0.0, 900.0, 900.0, 900.0, 900.0, 0.0]), 400.0, ACCEL)
    assert squared[0] == 400.0
    assert squared[-1] == 0.0


def test_moves_of_no_length_take_no_time() -> None:
    length = np.array([1.0, 0.0, 1.0])
    cap = np.array([0.0, 100.0, 100.0, 0.0])
    shape = trapezoids(length, np.full(3, 10.0), junctions(length, cap, 0.0, ACCEL), ACCEL)
    assert shape.seconds[1] == 0.0
    assert shape.v_in[1] == pytest.approx(shape.v_in[2])
