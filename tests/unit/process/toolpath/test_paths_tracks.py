"""Short tracks joined to one path."""

from __future__ import annotations

import numpy as np
import pytest

from polishd.model.process import FLAT, Optic
from polishd.process.toolpath.paths import BETWEEN, TURN_DEG, Track, join_tracks

TRACKS = (Track((-20.0, 0.0), 0.0, 8.0), Track((20.0, 5.0), 90.0, 8.0, 45.0), Track((20.0, 5.0), 90.0, 8.0, -45.0))


def test_each_track_is_there_whole_and_straight() -> None:
    path = join_tracks(FLAT, TRACKS, 60.0, 0.8)
    for number, track in enumerate(TRACKS):
        moves = np.flatnonzero(path.track == number)
        assert (np.diff(moves) == 1).all()
        points = path.points_mm[moves[0] : moves[-1] + 2, :2]
        ends = track.ends_mm()
        assert np.allclose(points[[0, -1]], ends) or np.allclose(points[[0, -1]], ends[::-1])
        assert np.linalg.norm(np.diff(points, axis=0), axis=1).sum() == pytest.approx(8.0)
        assert (path.turn_deg[moves[0] : moves[-1] + 2] == track.turn_deg).all()


def test_moves_are_short_and_turn_little() -> None:
    path = join_tracks(FLAT, TRACKS, 60.0, 0.8)
    length = np.linalg.norm(np.diff(path.points_mm, axis=0), axis=1)
    assert (length > 0.0).all(), "no feed says how long a move of no length takes"
    assert (length <= 0.8 + 1e-9).all()
    assert np.abs(np.diff(path.turn_deg)).max() <= TURN_DEG


def test_it_lands_and_leaves_beside_the_part() -> None:
    path = join_tracks(FLAT, TRACKS, 60.0, 0.8)
    assert np.hypot(*path.points_mm[[0, -1], :2].T) == pytest.approx(60.0)
    assert path.track[0] == path.track[-1] == BETWEEN
    centred = join_tracks(FLAT, [Track((4.0, 0.0), 0.0, 8.0)], 60.0, 0.8)
    assert np.hypot(*centred.points_mm[[0, -1], :2].T) == pytest.approx(60.0), "also from the very centre"


def test_the_nearer_end_comes_first() -> None:
    path = join_tracks(FLAT, [Track((-20.0, 0.0), 0.0, 8.0), Track((-10.0, 0.0), 180.0, 8.0)], 60.0, 0.8)
    second = path.points_mm[np.flatnonzero(path.track == 1)[0], :2]
    assert second == pytest.approx([-14.0, 0.0])


def test_a_lean_is_turned_about_the_normal() -> None:
    optic = Optic(-400.0)
    path = join_tracks(optic, TRACKS, 60.0, 0.8)
    own = np.tile([0.0, -np.sin(0.2), np.cos(0.2)], (len(path.points_mm), 1))
    axes = path.axes(optic, own)
    on = np.append(path.track, BETWEEN) == 0
    assert np.allclose(axes[on], own[on]), "the first keeps the tool's lean"
    assert np.linalg.norm(axes, axis=1) == pytest.approx(np.ones(len(axes)))
    flat = join_tracks(FLAT, TRACKS, 60.0, 0.8)
    axes = flat.axes(FLAT, own)
    lean = np.degrees(np.arctan2(axes[:, 1], axes[:, 0])) - np.degrees(np.arctan2(own[:, 1], own[:, 0]))
    assert (lean + 180) % 360 - 180 == pytest.approx(flat.turn_deg, abs=1e-9)
