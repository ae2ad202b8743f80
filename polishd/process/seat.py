"""The seat of a part: three places where the tool met it, against where they should be."""

from __future__ import annotations

import numpy as np
import scipy

from polishd.model.errors import ComputeError
from polishd.model.handling import PartSeat, TouchOff
from polishd.model.outline import Outline
from polishd.model.surface import FloatArray

TRIED = 257
"""Points from the centre to the rim, among which one that is deep enough is found."""
FLATTEST = 1e-3
"""Below it, relative to the part's size, three places lie so nearly on a line that no tilt can be told."""


def rim_places_mm(outline: Outline, edge_mm: float) -> FloatArray:
    """(3, 2) places on the middle of the rim that the clear aperture leaves out, a third of a turn apart."""
    turn = np.radians([90.0, 210.0, 330.0])
    towards = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    reach = [_reach_mm(outline, edge_mm / 2, x, y) for x, y in towards]
    return np.asarray(np.array(reach)[:, None] * towards, dtype=np.float64)


def _reach_mm(outline: Outline, inside_mm: float, x: float, y: float) -> float:
    """How far from the centre the farthest point in this direction is that lies so far inside the rim."""

    def deeper(reach_mm: float) -> float:
        return float(outline.inside_mm(reach_mm * x, reach_mm * y)) - inside_mm

    tried = np.linspace(0.0, outline.radius_mm, TRIED)
    inner = max((reach for reach in tried if deeper(reach) > 0), default=0.0)
    return float(scipy.optimize.brentq(deeper, inner, outline.radius_mm, xtol=1e-12))


def seat_of(asked: TouchOff, early_mm: FloatArray) -> PartSeat:
    """How the part sits, from how much earlier (3,) than it should the actuator met it at each place.

    A small move of a rigid body, by ``t`` along z and turned by ``w`` about x and y, lifts the surface at ``p`` along
    its normal ``n`` by ``n.(t + w x p) = n_z t + w.(p x n)``: three places give the three.

    Raises ComputeError where they cannot be told apart: the places lie on a line.
    """
    off_mm = early_mm * asked.lean
    matrix = _moves(asked)
    if not separate_seat_terms(asked):
        raise ComputeError("the three places of the touch-off lie on a line: no tilt can be told; move one of them")
    height_mm, about_x, about_y = np.linalg.solve(matrix, off_mm)
    rise = float(np.hypot(about_x, about_y)) * asked.rim_mm
    return PartSeat(
        height_mm=float(height_mm),
        tilt_deg=(float(np.degrees(about_x)), float(np.degrees(about_y))),
        off_mm=tuple(map(float, off_mm)),
        worst_mm=abs(float(height_mm)) + rise,
    )


def separate_seat_terms(asked: TouchOff) -> bool:
    """Whether the places say height and both tilts."""
    return bool(abs(np.linalg.det(_moves(asked) / [1.0, asked.rim_mm, asked.rim_mm])) > FLATTEST)


def _moves(asked: TouchOff) -> FloatArray:
    """(3, 3): what of each place a unit of height, and of turn about x and y in rad, is along the normal."""
    turned = np.cross(asked.places_mm, asked.normal)
    return np.column_stack([asked.normal[:, 2], turned[:, 0], turned[:, 1]])
