"""Programs of single moves on the part, for tests of the removal along a path."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from polishd.model.process import SHIPPED_OPTIONS, Placement
from polishd.model.program import Program
from polishd.model.surface import FloatArray
from polishd.process.frames import dipped_axes, rotation_from_rpy_deg

DIP = np.radians(15.0)
PLACEMENT = Placement((300.0, 220.0, 2315.0), rotation_from_rpy_deg(180.0, 0.0, 0.0))


def program(start: ArrayLike, end: ArrayLike, azimuth: ArrayLike = 0.0) -> Program:
    """A program of moves from (n, 2) to (n, 2) mm with the spindle leaning towards the (n,) azimuth, rad."""
    start, end = (np.column_stack([a, np.zeros(len(a))]) for a in np.broadcast_arrays(*np.atleast_2d(start, end)))
    n = len(end)
    azimuth = np.broadcast_to(azimuth, n)
    axis = np.stack([np.cos(azimuth) * np.sin(DIP), np.sin(azimuth) * np.sin(DIP), np.full(n, np.cos(DIP))], axis=1)
    index = np.arange(n)
    return Program(b"", "", "p", "rs274", "feed", index + 1, index, start, end, axis, np.ones(n), n, 600.0)


def inward_program(start: ArrayLike, end: ArrayLike) -> Program:
    """Return such a program on the shipped part with the spindle leaning towards the base's z axis."""
    moves = program(start, end)
    base = moves.end_mm * [1, -1, -1] + np.array(PLACEMENT.origin_mm)
    return program(start, end, np.arctan2(base[:, 1], -base[:, 0]))


def raster(step: float, half: float = 50.0) -> Program:
    line = np.arange(-half, half + 1e-9, step)
    x, y = np.meshgrid(line, line)
    start, end = (np.stack([a.ravel(), b.ravel()], axis=1) for a, b in ((x[:, :-1], y[:, :-1]), (x[:, 1:], y[:, 1:])))
    return inward_program(start, end)


def inward_axis(tip_mm: FloatArray, normal: FloatArray, dip_deg: float) -> FloatArray:
    """(n, 3) tool axes dipped towards the base's z axis, all in the base frame."""
    return dipped_axes(SHIPPED_OPTIONS, Placement((0.0, 0.0, 0.0), np.eye(3)), tip_mm, normal, dip_deg)
