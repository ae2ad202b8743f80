"""Short tracks over a part, each with a lean of its own, joined to one path that stays in contact."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from polishd.model.process import Optic
from polishd.model.program import IntArray
from polishd.model.surface import FloatArray
from polishd.process.optics import unit_normals
from polishd.process.paths.spacing import on_optic

TURN_DEG = 20.0
"""Most that the lean turns in one move of the way to the next track."""
HERE_MM = 1.0
BETWEEN = -1
"""The track of a move that is on none."""


@dataclass(frozen=True, slots=True)
class Track:
    """A straight line to be polished slowly."""

    middle_mm: tuple[float, float]
    along_deg: float
    """Its direction, counterclockwise from x."""
    length_mm: float
    turn_deg: float = 0.0
    """Of the spindle's lean about the normal, from where it leans by itself, counterclockwise."""

    def ends_mm(self, *, backwards: bool = False) -> FloatArray:
        """(2, 2) first and last point."""
        angle = np.radians(self.along_deg)
        half = self.length_mm / 2 * np.array([np.cos(angle), np.sin(angle)])
        ends = np.array([self.middle_mm - half, self.middle_mm + half])
        return ends[::-1] if backwards else ends


@dataclass(frozen=True, slots=True)
class Joined:
    """A path of m points."""

    points_mm: FloatArray
    """(m, 3) on the optic."""
    turn_deg: FloatArray
    """(m,) of the lean."""
    track: IntArray
    """(m - 1,) which track each move is of, by its place in the sequence; `BETWEEN`: none."""

    def axes(self, optic: Optic, own: FloatArray) -> FloatArray:
        """(m, 3) tool axes: ``own`` (m, 3), as the tool leans by itself, turned about the normals."""
        normals = unit_normals(optic, self.points_mm[:, :2])
        return np.asarray(
            scipy.spatial.transform.Rotation.from_rotvec(np.radians(self.turn_deg)[:, None] * normals).apply(own)
        )


def join_tracks(optic: Optic, tracks: Sequence[Track], landing_mm: float, step_mm: float) -> Joined:
    """From a landing point so far from the part's centre over all tracks to another; moves of ``step_mm`` at most."""
    places, turns, owners = _corners(tracks, landing_mm)
    plane, turn, track = [places[:1]], [turns[:1]], []
    for k, owner in enumerate(owners):
        length, swing = np.linalg.norm(places[k + 1] - places[k]), abs(turns[k + 1] - turns[k])
        count = max(int(np.ceil(length / step_mm)), int(np.ceil(swing / TURN_DEG)), 1)
        share = np.arange(1, count + 1)[:, None] / count
        plane.append(places[k] + share * (places[k + 1] - places[k]))
        turn.append(turns[k] + share[:, 0] * (turns[k + 1] - turns[k]))
        track.append(np.full(count, owner))
    return Joined(on_optic(optic, np.vstack(plane)), np.concatenate(turn), np.concatenate(track))


def _corners(tracks: Sequence[Track], landing_mm: float) -> tuple[FloatArray, FloatArray, list[int]]:
    """Of the path: (2 t + 2, 2) places, (2 t + 2,) turns, and the track of each way between.

    The nearer end of a track comes first, but for one that is where the path is: a way needs its length.
    """
    places: list[FloatArray] = []
    for track in tracks:
        ends = track.ends_mm()
        first, last = (float(np.linalg.norm(end - places[-1])) for end in ends) if places else (0.0, np.inf)
        back = (last < first and last > HERE_MM) or (bool(places) and first <= HERE_MM)
        places += list(track.ends_mm(backwards=back))
    way = [_outside(places[0], landing_mm), *places, _outside(places[-1], landing_mm)]
    own = [track.turn_deg for track in tracks for _ in range(2)]
    return np.array(way), np.array([own[0], *own, own[-1]]), list(_owners(len(tracks)))


def _owners(count: int) -> Iterator[int]:
    for k in range(count):
        yield from (BETWEEN, k)
    yield BETWEEN


def _outside(place: FloatArray, landing_mm: float) -> FloatArray:
    """The nearest landing point."""
    away = float(np.linalg.norm(place))
    return np.asarray(place / away * landing_mm) if away > 0 else np.array([landing_mm, 0.0])
