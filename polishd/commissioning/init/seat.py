"""Where a part may lie before the robot of a new cell: the place assumed, or the nearest one that is reached."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from polishd.config.cell import CellConfig
from polishd.model.errors import ComputeError
from polishd.model.process import HybridRobot, MeasuredCompliance, Placement, SerialRobot, Vector
from polishd.model.surface import FloatArray
from polishd.process.frames import points_to_base
from polishd.process.robot.compliance import reachable
from polishd.process.robot.hybrid import geometry_of, solve_pose
from polishd.process.robot.serial import reach_mm
from polishd.process.toolpath.apertures import on_optic, tool_axes

BEYOND_MM = 10.0
"""How far beyond the part's rim the tool has to come: overrun and landing of a made path are 6 mm, and some room."""
OFF_AXIS_MM = 30.0
"""A tool that leans towards the base's z axis turns round over it: a part stays so far off it."""
CLEAR_DEG = 0.5
"""So far a hybrid robot's wrist stays off A = 0: points of a path lie between those that are looked at."""
FINE_MM, COARSE_MM = 5.0, 40.0
"""Distance of the points of a part that are looked at: before a hybrid robot, whose wrist is singular at places only
some mm wide, and before another, whose inverse kinematics takes time."""
FINEST_MM, FEW = 1.0, 8
"""The same where no place is clear of singular poses: then so many are looked at as finely as a path goes."""
RIM_POINTS = 8
"""Looked at first: a place that is out of reach mostly is so at the rim."""
STEP_MM = 50.0, 100.0
"""From one place to the next, away from the base's z axis and along it."""
FAR_MM = 600.0
"""How far from the first place others are looked for."""
SHARES = tuple(share / 10 for share in range(9, 0, -1))
"""Of a part's size, tried in turn where all of it lies nowhere within reach."""
NEAREST = 30, 4
"""Places at which an arm is tried with all of a part, and with each share of it: each out of reach takes a second."""


@dataclass(frozen=True, slots=True)
class Seat:
    """A place of the part's centre in the robot's base frame, and how much of the part is reached there."""

    origin_mm: Vector
    share: float = 1.0
    """Of the part's size that lies within reach."""


def find_seat(config: CellConfig) -> Seat | None:
    """The place nearest to the cell's own where the robot reaches the part, or as much of it as it reaches anywhere.

    None where it reaches nothing of a tenth of the size. The cell's own is taken where it will do.
    """
    sight = _Sight(config)
    origins = tuple(_places(config))
    quick = not isinstance(config.robot_model(), SerialRobot)
    for share in (1.0, *SHARES):
        possible = [origin for origin in origins if sight.may_reach(origin, share)]
        for origin in possible if quick else possible[: NEAREST[share < 1.0]]:
            if sight.reached(origin, share):
                return Seat(origin, share)
        if share == 1.0 and quick and (just := sight.just_reached(possible)):
            return Seat(just)
    return None


def reached(config: CellConfig) -> bool:
    """Whether the robot reaches the part where the cell has it."""
    return _Sight(config).reached(config.part.origin_mm, 1.0)


def _places(config: CellConfig) -> Iterator[Vector]:
    """The cell's own first, then others, the nearest to it first."""
    first = np.asarray(config.part.origin_mm, dtype=np.float64)
    yield config.part.origin_mm
    robot = config.robot_model()
    if isinstance(robot, MeasuredCompliance):
        x, y, z = (float(value) for value in robot.tip_mm.mean(axis=0).round(1))
        yield x, y, z
        return
    away = float(np.hypot(*first[:2]))
    bearing = first[:2] / away if away else np.array([1.0, 0.0])
    sides = [np.arange(-FAR_MM, FAR_MM + step / 2, step) for step in STEP_MM]
    moves = sorted(product(*sides), key=lambda move: (np.hypot(move[0], move[1]), move))
    for out, along in moves:
        if away + out >= 0:
            x, y = bearing * (away + out)
            yield round(float(x), 1), round(float(y), 1), round(float(first[2] + along), 1)


class _Sight:
    """A cell's part as points, and whether its robot comes to them with the tool leaning as the cell dips."""

    def __init__(self, config: CellConfig) -> None:
        self._optic, self._options = config.optic(), config.compliance_options()
        self._dip_deg = config.process.dip_deg
        self._rotation = config.placement().rotation
        self._robot = config.robot_model()
        outline = config.outline()
        wider = 1 + BEYOND_MM / outline.radius_mm
        corners = outline.corners()
        self._rim = wider * corners[:: max(1, len(corners) // RIM_POINTS)]
        self._outline, self._wider = outline, wider * corners
        self._all = self._lattice(FINE_MM if isinstance(self._robot, HybridRobot) else COARSE_MM)
        self._clear_deg = CLEAR_DEG

    def _lattice(self, step_mm: float) -> FloatArray:
        """(n, 2) mm: points over the part and somewhat beyond its rim, and on that."""
        half_x, half_y = (half + BEYOND_MM for half in self._outline.half_mm)
        x, y = np.meshgrid(np.arange(-half_x, half_x, step_mm), np.arange(-half_y, half_y, step_mm))
        inside = self._outline.contains(x, y, -BEYOND_MM)
        return np.vstack([self._wider, np.column_stack([x[inside], y[inside]])])

    def just_reached(self, origins: Sequence[Vector]) -> Vector | None:
        """The first of these where the hybrid robot reaches all, however near the wrist comes to a singular pose."""
        self._clear_deg = 0.0
        possible = [origin for origin in origins if self.reached(origin, 1.0)][:FEW]
        self._all = self._lattice(FINEST_MM) if possible else self._all
        return next((origin for origin in possible if self.reached(origin, 1.0)), None)

    def may_reach(self, origin_mm: Vector, share: float) -> bool:
        """Whether an arm as long as this one could: its flange above the rim, whatever its joints bear."""
        if not isinstance(self._robot, SerialRobot):
            return True
        try:
            tip, axis = self._poses(Placement(origin_mm, self._rotation), share * self._rim)
        except ComputeError:
            return False
        tool_mm = self._robot.tool_length_mm
        away = np.linalg.norm(tip + tool_mm * axis, axis=1)
        return bool((away < reach_mm(self._robot) - tool_mm).all())

    def reached(self, origin_mm: Vector, share: float) -> bool:
        """Whether the robot comes to so large a share of the part that lies there."""
        if not self.may_reach(origin_mm, share):
            return False
        lies = Placement(origin_mm, self._rotation)
        try:
            return self._comes_to(lies, share * self._rim) and self._comes_to(lies, share * self._all)
        except ComputeError:  # the lean has no direction there, or the optic ends
            return False

    def _comes_to(self, lies: Placement, seen_mm: FloatArray) -> bool:
        tip, axis = self._poses(lies, seen_mm)
        leans = self._dip_deg > 0 and self._options.dip_direction == "inward"
        if leans and np.hypot(tip[:, 0], tip[:, 1]).min() < OFF_AXIS_MM:
            return False
        if isinstance(self._robot, HybridRobot):
            sine = solve_pose(self._robot, geometry_of(self._robot), tip.T, axis.T).sine
            if sine.min() < np.sin(np.radians(self._clear_deg)):
                return False
        return bool(reachable(self._robot, tip, axis).all())

    def _poses(self, lies: Placement, seen_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n, 3) tool tips, mm, and (n, 3) tool axes in the base frame over (n, 2) points of the part."""
        points = on_optic(self._optic, seen_mm)
        axis = tool_axes(points, self._optic, self._dip_deg, self._options, lies)
        return points_to_base(lies, points), axis @ self._rotation.T
