"""Where a part lies best in the cell: the place, turn and posture at which gamma varies least over the part.

A mean gamma acts as a removal rate, which a witness spot or the first pass determines. Its change over the part leaves
an error of low spatial frequency if the plan does not know it. It is often small (docs/explanation/correction.md).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from polishd.model.errors import ComputeError
from polishd.model.outline import Outline
from polishd.model.process import (
    FLAT,
    ComplianceOptions,
    MeasuredCompliance,
    Optic,
    Placement,
    RobotModel,
    SerialRobot,
    ToolProcess,
)
from polishd.model.surface import BoolArray, FloatArray
from polishd.process import frames
from polishd.process.checks import require_number
from polishd.process.metrology.statistics import Removal, remove_terms
from polishd.process.optic_surface import sag_mm, unit_normals
from polishd.process.removal.contact import hertz_depth_mm, volume_rate_nm_mm2_s
from polishd.process.robot.compliance import (
    complex_eigenvalues,
    depth_ratio,
    equivalent_compliance,
    measured_compliance,
    measured_reachable,
    reachable,
    tip_compliance_mm_per_n,
    without_path,
)
from polishd.process.robot.serial import (
    posture_margins,
    serial_inverse_kinematics,
    serial_joint_compliance_mm_per_n,
)

ACROSS = 7
"""Samples across the part. Compliance changes over hundreds of millimetres."""
STEPS = 5
"""Places along each axis in the first round."""
ROUNDS = 3
"""Rounds of search; each after the first halves the distance of the places about the best ones."""
KEPT = 3
"""Best candidates about which the next round searches."""
ALIKE = 4
"""Digits of the error, nm, to which places are alike: of those the one with the least change comes first."""
TURNS_DEG = tuple(np.arange(0.0, 360.0, 45.0).tolist())
"""Turns of the part about its normal, and of the flange about the base's z, in the first round."""
_EIGHT = ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1))
"""Sides and corners of the part's box."""


@dataclass(frozen=True, slots=True)
class PlacementMargins:
    """Distances that a place must keep from what the robot cannot do."""

    around_mm: float = 20.0
    """Reach beyond the part: to its sides, and above it for the retracted tool."""
    joint_deg: float = 5.0
    """Distance of each joint from its limits (serial arm)."""
    regular: float = 0.02
    """Least ratio of the Jacobian's singular values, lengths over the reach (serial arm)."""


@dataclass(frozen=True, slots=True)
class PlacedPart:
    """A place and posture, and gamma over the part there."""

    origin_mm: tuple[float, float, float]
    """``part.origin_mm``."""
    turn_deg: float
    """Turn of the part about its normal, from where it lies in the cell now."""
    flange_turn_deg: float
    """Turn of ``kinematics.flange_x`` about the base's z, from what the cell has (serial arm)."""
    gamma_mean: float
    gamma_range: float
    """Largest less smallest gamma over the part."""
    error_nm: float
    """RMS over the part that a removal without correction leaves of gamma's change, without the alignment terms."""


@dataclass(frozen=True, slots=True)
class PlacementSearch:
    """The present place, and all others that were tried."""

    present: PlacedPart | None
    """None: the cell's own place does not keep the margins."""
    reached: tuple[PlacedPart, ...]
    """All places that keep the margins, by their error."""
    refused: int
    """Places out of reach, or nearer to a limit or singular pose than the margins allow."""
    removal_nm: float

    @property
    def gain_nm(self) -> float | None:
        """What the best place is worth: present error less the best one's; None where either is not known."""
        return None if self.present is None or not self.reached else self.present.error_nm - self.reached[0].error_nm


@dataclass(frozen=True, slots=True)
class PlacementTask:
    """What lies in the cell, and how it is polished."""

    robot: RobotModel
    process: ToolProcess
    placement: Placement
    options: ComplianceOptions
    outline: Outline
    alignment: Removal
    optic: Optic = FLAT
    removal_nm: float = 100.0
    """Mean removal to which errors refer."""
    margins: PlacementMargins = PlacementMargins()


def search_placement(task: PlacementTask, within_mm: float = 200.0) -> PlacementSearch:
    """Search the place, the part's turn and the flange's turn with the least error over the part.

    The part keeps its tilt, and the arm the branch of ``home_deg``. Places lie within ``within_mm`` of the present one
    along each axis of the base. The part's turn counts only if the spindle leans in a direction of the part; only a
    serial arm has a flange turn.

    Raises:
        ComputeError: a length or removal that cannot be.
    """
    require_number("the distance to search within", within_mm, "mm", above=0.0)
    require_number("the mean removal", task.removal_nm, "nm", above=0.0)
    samples = _Samples(task)
    found: dict[_Place, PlacedPart | None] = {_PRESENT: samples.at(_PRESENT)}
    places = _first_round(task, within_mm)
    step_mm, step_deg = 2 * within_mm / (STEPS - 1), TURNS_DEG[1]
    best: list[tuple[_Place, PlacedPart]] = []
    for _ in range(ROUNDS):
        found |= {place: samples.at(place) for place in places if place not in found}
        best = [(place, one) for place, one in found.items() if one is not None]
        best.sort(key=lambda one: (round(one[1].error_nm, ALIKE), _change(one[0])))
        step_mm, step_deg = step_mm / 2, step_deg / 2
        places = [near for place, _ in best[:KEPT] for near in _near(place, step_mm, step_deg, within_mm, task)]
    reached = tuple(one for _, one in best)
    return PlacementSearch(found[_PRESENT], reached, len(found) - len(reached), task.removal_nm)


@dataclass(frozen=True, slots=True)
class _Place:
    shift_mm: tuple[float, float, float]
    turn_deg: float
    flange_deg: float


_PRESENT = _Place((0.0, 0.0, 0.0), 0.0, 0.0)


def _change(place: _Place) -> float:
    turns = sum(min(angle, 360.0 - angle) for angle in (place.turn_deg, place.flange_deg))
    return float(np.linalg.norm(place.shift_mm)) + turns


def _first_round(task: PlacementTask, within_mm: float) -> list[_Place]:
    """Places with the present turns, and the present place with all turns."""
    line = np.linspace(-within_mm, within_mm, STEPS).tolist()
    places = [_Place((x, y, z), 0.0, 0.0) for x, y, z in product(line, line, line[:: STEPS // 2])]
    if _turn_counts(task):
        places += [replace(_PRESENT, turn_deg=turn) for turn in TURNS_DEG]
    if isinstance(task.robot, SerialRobot):
        places += [replace(_PRESENT, flange_deg=turn) for turn in TURNS_DEG]
    return places


def _near(place: _Place, step_mm: float, step_deg: float, within_mm: float, task: PlacementTask) -> Iterator[_Place]:
    """Places beside one, along each axis, and its turns to both sides."""
    for axis, sign in product(range(3), (-1.0, 1.0)):
        shift = list(place.shift_mm)
        shift[axis] = float(np.clip(shift[axis] + sign * step_mm, -within_mm, within_mm))
        yield replace(place, shift_mm=(shift[0], shift[1], shift[2]))
    for sign in (-1.0, 1.0):
        if _turn_counts(task):
            yield replace(place, turn_deg=(place.turn_deg + sign * step_deg) % 360.0)
        if isinstance(task.robot, SerialRobot):
            yield replace(place, flange_deg=(place.flange_deg + sign * step_deg) % 360.0)


def _turn_counts(task: PlacementTask) -> bool:
    return task.options.dip_direction != "inward" and not isinstance(task.robot, MeasuredCompliance)


class _Samples:
    """Samples of a part, laid at one place after another."""

    def __init__(self, task: PlacementTask) -> None:
        self._task = task
        half_x, half_y = task.outline.half_mm
        x, y = np.meshgrid(np.linspace(-half_x, half_x, ACROSS), np.linspace(half_y, -half_y, ACROSS))
        self._mask: BoolArray = task.outline.contains(x, y)
        plane = np.column_stack([x[self._mask], y[self._mask]])
        points = np.column_stack([plane, sag_mm(task.optic, plane)])
        normals = unit_normals(task.optic, plane)
        around = task.margins.around_mm
        top = float(points[:, 2].max())
        rim = np.array([(a * (half_x + around), b * (half_y + around), top) for a, b in _EIGHT])
        self._count = len(points)
        self._reached = np.concatenate([points, points + np.array([0.0, 0.0, around]), rim])
        self._normals = np.concatenate([normals, normals, np.tile([0.0, 0.0, 1.0], (len(rim), 1))])
        self._depth_mm = float(hertz_depth_mm(task.process))

    def at(self, place: _Place) -> PlacedPart | None:
        """Gamma over the part at a place; None where the robot does not reach it with the margins."""
        task, robot, placement = self._task, self._task.robot, _moved(self._task.placement, place)
        if isinstance(robot, SerialRobot):
            robot = _turned(robot, place.flange_deg)
        tip = frames.points_to_base(placement, self._reached)
        normal = frames.directions_to_base(placement, self._normals)
        axis = normal
        if not isinstance(robot, MeasuredCompliance):
            try:
                axis = frames.dipped_axes(without_path(task.options), placement, tip, normal, task.process.dip_deg)
            except ComputeError:  # inward has no direction on the base's z axis
                return None
        compliance = self._compliance(robot, tip, axis, normal)
        if compliance is None:
            return None
        try:
            gamma = depth_ratio(compliance, task.process, self._depth_mm)
        except ComputeError:  # the robot gives way by more than the depth
            return None
        figures = float(gamma.mean()), float(np.ptp(gamma)), self._error_nm(gamma)
        return PlacedPart(placement.origin_mm, place.turn_deg, place.flange_deg, *figures)

    def _compliance(
        self, robot: RobotModel, tip: FloatArray, axis: FloatArray, normal: FloatArray
    ) -> FloatArray | None:
        """(m,) mm/N at the part's own points; None where any pose is out of reach or within the margins."""
        own, options, margins = slice(0, self._count), self._task.options, self._task.margins
        if isinstance(robot, MeasuredCompliance):
            return measured_compliance(robot, tip[own]) if measured_reachable(robot, tip[own]).all() else None
        if isinstance(robot, SerialRobot):
            try:
                joints = serial_inverse_kinematics(robot, tip, axis)
            except ComputeError:
                return None
            joint_deg, regular = posture_margins(robot, joints)
            if joint_deg < margins.joint_deg or regular < margins.regular:
                return None
            matrix = serial_joint_compliance_mm_per_n(robot, joints[own])
        else:
            if not reachable(robot, tip, axis).all():
                return None
            matrix = tip_compliance_mm_per_n(robot, tip[own], axis[own], moment=options.moment)
            if options.moment == "paper" and complex_eigenvalues(matrix).any():
                return None
        return equivalent_compliance(matrix, axis[own], normal[own], options.projection)

    def _error_nm(self, gamma: FloatArray) -> float:
        rate = volume_rate_nm_mm2_s(self._task.process, gamma * self._depth_mm)
        removal = np.full(self._mask.shape, np.nan)
        removal[self._mask] = self._task.removal_nm * rate / rate.mean()
        return float(remove_terms(removal, self._mask, self._task.alignment)[self._mask].std())


def _moved(placement: Placement, place: _Place) -> Placement:
    x, y, z = (float(v) for v in np.add(placement.origin_mm, place.shift_mm))
    turn = frames.rotation_from_rpy_deg(0.0, 0.0, place.turn_deg)
    return Placement((x, y, z), placement.rotation @ turn)


def _turned(robot: SerialRobot, turn_deg: float) -> SerialRobot:
    x, y, z = frames.rotation_from_rpy_deg(0.0, 0.0, turn_deg) @ np.asarray(robot.flange_x)
    return replace(robot, flange_x=(float(x), float(y), float(z)))


def placement_fragment(found: PlacedPart, placement: Placement, robot: RobotModel) -> str:
    """Return the keys of a cell file for a place: ``[part]``, and ``[kinematics]`` where the flange turns.

    Raises:
        ComputeError: the placement's rotation is none.
    """
    turned = placement.rotation @ frames.rotation_from_rpy_deg(0.0, 0.0, found.turn_deg)
    angles = tuple(Rotation.from_matrix(turned).as_euler("XYZ", degrees=True).tolist())
    lines = ["[part]", f"origin_mm = {_numbers(found.origin_mm)}"]
    if found.turn_deg:
        lines.append(f"rotation_rpy_deg = {_numbers(angles)}")
    if found.flange_turn_deg:
        if not isinstance(robot, SerialRobot):
            raise ComputeError("only a serial arm has a flange that turns")
        lines += ["", "[kinematics]", f"flange_x = {_numbers(_turned(robot, found.flange_turn_deg).flange_x)}"]
    return "\n".join(lines)


def _numbers(values: tuple[float, ...]) -> str:
    return "[" + ", ".join(f"{round(value, 6) + 0.0:.6g}" for value in values) + "]"
