"""The hybrid robot's elastic numbers: how its members give way, each by itself (paper eq. 2-15)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from polishd.model.robot import HybridRobot
from polishd.model.surface import FloatArray
from polishd.process.robot.refusal import require_number


class Beam(NamedTuple):
    """What the UP limb's end gives way in the motions that it resists, ``C_c``, as multiples: see `BEAMS`."""

    shear: float
    cross: float
    turn: float


BEAMS = {"exact": Beam(1 / 3, 1 / 2, 1.0), "paper": Beam(1 / 12, 1 / 4, 3 / 4)}
"""Of ``L^3/EI``, ``n_u L^2/EI`` and ``n_u^2 L/EI``.

"exact": Euler-Bernoulli beam whose U joint carries no moment about its axes, so that the moment at its end is -F L.
"paper": eq. 6-8, ``C_c = S_c K_c^-1 S_c'`` with the cantilever under a force alone, ``W = [[0, -3/(2L)], [3/(2L), 0]]``
and ``K_c = diag(3EI/L^3, 3EI/L^3, GJ/L)``, and S_c corrected: its rows are ``[1 - L W21, -L W22, 0]``,
``[L W11, 1 + L W12, 0]`` and ``[n.u W11 + n.v W21, n.u W12 + n.v W22, n.w]``. Four times too stiff in bending.
"""


ELASTIC = (
    ("up_bending_n_mm2", "N mm^2"),
    ("up_torsion_n_mm2", "N mm^2"),
    ("a_stiffness_n_mm_per_rad", "N mm/rad"),
    ("c_stiffness_n_mm_per_rad", "N mm/rad"),
)
"""Keys and units of a robot's stiffnesses beside its limbs'."""


class Stiffnesses(NamedTuple):
    """The robot's elastic numbers, found positive; those of `ELASTIC` in their order."""

    beam: Beam
    bending_n_mm2: float
    torsion_n_mm2: float
    a_n_mm_per_rad: float
    c_n_mm_per_rad: float


def stiffnesses_of(robot: HybridRobot) -> Stiffnesses:
    """Raises ComputeError that names the first stiffness which is not above 0, with its value and unit."""
    return Stiffnesses(BEAMS[robot.beam], *(_positive(robot, name, unit) for name, unit in ELASTIC))


def limb_stiffness_n_per_mm(robot: HybridRobot, limb_mm: FloatArray) -> FloatArray:
    """Axial stiffness of limbs of these lengths, mm: constant, or EA / length (eq. 12: K_a); N/mm."""
    stiffness = _positive(robot, *limb_key(robot))
    return np.full_like(limb_mm, stiffness) if robot.limb_ea_n is None else np.asarray(stiffness / limb_mm)


def limb_key(robot: HybridRobot) -> tuple[str, str]:
    """Key and unit of what makes the limbs stiff."""
    return ("limb_stiffness_n_per_mm", "N/mm") if robot.limb_ea_n is None else ("limb_ea_n", "N")


def _positive(robot: HybridRobot, name: str, unit: str) -> float:
    value = getattr(robot, name)
    require_number(f"the robot's {name}", value, unit, above=0.0)
    return float(value)
