"""The controller's block store and its planned legs: speeds at junctions, times, stops and braking."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.sim_backends.robot.program_reader import Pose, Reader
from polishd.sim_backends.robot.trajectory import (
    DWELL,
    MOVE,
    NONE,
    PAUSE,
    BlockColumns,
    Cursor,
    Limits,
    braking,
    plan,
    rows,
)

HOME: Pose = (0.0, 0.0, 0.0, 0.0, 0.0)
ACCEL = 1000.0


def path_of(*lines: bytes, batch: int = 1000, corner_deg: float = 30.0) -> BlockColumns:
    """A path with all of these lines accepted, some at a time."""
    path = BlockColumns(
        len(lines), HOME, Limits(ACCEL, 0.0, corner_deg, rapid_mm_s=100.0, max_feed_mm_s=50.0, speed=1.0)
    )
    reader = Reader(HOME)
    blocks = [reader.read(line) for line in lines]
    for at in range(0, len(blocks), batch):
        path.append(blocks[at : at + batch])
    return path


MIXED = (b"G21 G90", b"G1 X1 F600", b"X2", b"Y1", b"G4 P0.5", b"X3", b"M0", b"G0 X9", b"G93 G1 X10 F60", b"M2")


def test_kinds_lengths_and_times() -> None:
    path = path_of(*MIXED)
    assert path.kind.tolist() == [NONE, MOVE, MOVE, MOVE, DWELL, MOVE, PAUSE, MOVE, MOVE, NONE]
    assert path.length.tolist() == pytest.approx([0, 1, 1, 1, 0, 1, 0, 6, 1, 0])
    assert path.feed[[1, 2, 3]].tolist() == [10.0, 10.0, 10.0]
    assert path.feed[7] == 100.0, "a rapid"
    assert path.feed[8] == pytest.approx(1.0), "a minute divided by F"
    assert path.seconds.tolist() == [0, 0, 0, 0, 0.5, 0, 0, 0, 0, 0]
    assert path.accepted == path.blocks == 10


def test_a_feed_above_the_machines_is_the_machines() -> None:
    assert path_of(b"G1 X1 F99999").feed.tolist() == [50.0]


def test_junctions_stop_at_corners_dwells_pauses_and_the_end() -> None:
    entry = path_of(*MIXED).entry
    assert entry[2] == 100.0, "straight on at the feed"
    assert entry[3] == entry[4] == entry[5] == entry[6] == 0.0


@pytest.mark.parametrize(("turn_deg", "stops"), [(0, False), (29, False), (31, True), (90, True), (180, True)])
def test_the_corner_decides_by_its_angle(turn_deg: float, stops: bool) -> None:
    x, y = 1 + math.cos(math.radians(turn_deg)), math.sin(math.radians(turn_deg))
    path = path_of(b"G1 X1 F600", b"X%.9f Y%.9f" % (x, y))
    assert bool(path.entry[1] == 0.0) is stops


@given(st.integers(1, 10))
def test_batches_leave_no_trace(batch: int) -> None:
    whole, parts = path_of(*MIXED), path_of(*MIXED, batch=batch)
    for name in ("kind", "pose", "length", "feed", "seconds", "entry"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(parts, name), err_msg=name)


def test_turning_on_the_spot_takes_time() -> None:
    path = path_of(b"G1 A10 F600")
    assert path.length.tolist() == [10.0]


LENGTHS = st.lists(st.tuples(st.floats(0.01, 5.0), st.floats(60.0, 3000.0)), min_size=1, max_size=12)


def straight(chain: list[tuple[float, float]]) -> BlockColumns:
    """Feed moves one after the other along X."""
    at = np.cumsum([length for length, _ in chain])
    return path_of(*(b"G1 X%.6f F%.4f" % (x, feed) for x, (_, feed) in zip(at, chain, strict=True)))


@pytest.mark.full
@given(LENGTHS, st.floats(0.0, 0.01))
def test_legs_follow_each_other_and_cover_the_path(chain: list[tuple[float, float]], overhead_s: float) -> None:
    path = straight(chain)
    path.limits = replace(path.limits, overhead_s=overhead_s)
    legs = plan(path, Cursor(), 3.0, until=None)
    assert legs.start_s[0] == 3.0
    np.testing.assert_allclose(legs.start_s[1:], legs.end_s[:-1])
    assert (legs.end_s - legs.start_s >= path.length / path.feed - 1e-9).all(), "no faster than the feed"
    assert legs.shape.v_out[-1] == 0.0, "it is able to stop at the end of what it knows"
    assert legs.stop == len(chain) - 1
    moved = rows(path, legs, 0, len(chain), (3.0, float(legs.end_s[-1])))
    assert (moved[:, 2] - moved[:, 1]).sum() == pytest.approx(legs.end_s[-1] - 3.0)
    assert (np.diff(moved[:, 3]) >= -1e-9).all(), "never back"
    assert np.abs(np.diff(moved[:, 3])).max(initial=0.0) < 0.6


@pytest.mark.full
@given(LENGTHS, st.data())
def test_it_stops_before_the_commanded_block(chain: list[tuple[float, float]], data: st.DataObject) -> None:
    until = data.draw(st.integers(1, len(chain)))
    legs = plan(straight(chain), Cursor(), 0.0, until=until)
    assert legs.stop == until - 1
    assert legs.shape.v_out[until - 1] == pytest.approx(0.0, abs=1e-9)
    assert legs.reached(1e9) == until


@given(LENGTHS, st.floats(0.05, 0.95))
def test_braking_takes_the_distance_that_the_acceleration_needs(chain: list[tuple[float, float]], share: float) -> None:
    path = straight(chain)
    legs = plan(path, Cursor(), 0.0, until=None)
    at_s = share * float(legs.end_s[-1])
    k = min(legs.reached(at_s), len(chain) - 1)
    done_mm, done_s, speed = legs.state(k, at_s)
    down = braking(path, Cursor(int(legs.block[k]), done_mm, done_s, speed), at_s)
    assert down.end_s[-1] - at_s == pytest.approx(speed / ACCEL, abs=1e-6)
    assert down.shape.v_out[-1] == pytest.approx(0.0, abs=1e-3)
    travelled = (down.shape.v_in + down.shape.v_out) / 2.0 * down.shape.t_down
    assert travelled.sum() == pytest.approx(speed**2 / (2.0 * ACCEL), abs=1e-6)
    if len(down.block) > 1:
        assert down.completes[:-1].all(), "blocks that it runs over while braking are executed"


def test_a_hold_inside_a_dwell_keeps_what_is_left_of_it() -> None:
    path = path_of(b"G4 P2", b"M2")
    legs = plan(path, Cursor(), 0.0, until=None)
    done_mm, done_s, speed = legs.state(0, 0.75)
    assert (done_mm, done_s, speed) == (0.0, pytest.approx(0.75), 0.0)
    rest = plan(path, Cursor(0, 0.0, done_s, 0.0), 10.0, until=None)
    assert rest.end_s[0] - 10.0 == pytest.approx(1.25)
