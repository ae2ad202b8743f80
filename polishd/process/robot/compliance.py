"""One interface to the robots that a cell can have."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from polishd.model.errors import ComputeError
from polishd.model.process import (
    FLAT,
    SHIPPED_OPTIONS,
    ComplianceOptions,
    HybridRobot,
    MeasuredCompliance,
    Moment,
    Optic,
    Placement,
    Projection,
    RobotModel,
    SerialRobot,
    ToolProcess,
)
from polishd.model.program import Program
from polishd.model.surface import BoolArray, FloatArray
from polishd.process import frames
from polishd.process.checks import refuse_where, require_number, require_unit_vectors, require_vectors
from polishd.process.removal.contact import hertz_depth_mm
from polishd.process.robot.hybrid import cross, dot, hybrid_reachable, hybrid_tip_compliance_mm_per_n
from polishd.process.robot.serial import serial_reachable, serial_tip_compliance_mm_per_n

# Compliance of a cell from loading tests: a table of positions, linear between them.

FLAT_MM = 1.0
"""A table that is not thicker than this either way is flat, and holds for points as near to it."""

_SAME_MM = 1e-6
_RIM = 1e-9
"""Tolerance of a simplex, relative, for a point to belong to it."""


@dataclass(frozen=True, slots=True)
class _Table:
    """The places in their own dimension."""

    centre_mm: FloatArray
    """(3,)."""
    along: FloatArray
    """(dim, 3) directions in which the table extends."""
    local_mm: FloatArray
    """(m, dim) the places in these directions, sorted along a line."""
    value: FloatArray
    """(m,) compliance, mm/N."""

    def off_mm(self, tip: FloatArray) -> FloatArray:
        """(n,) distance of (n, 3) points from the line, the plane or the space that the table lies in."""
        arm = tip - self.centre_mm
        return np.asarray(np.linalg.norm(arm - arm @ self.along.T @ self.along, axis=1), dtype=np.float64)

    def interpolate(self, tip: FloatArray) -> FloatArray:
        """(n,) compliance, mm/N; NaN outside of the hull."""
        local = (tip - self.centre_mm) @ self.along.T
        if len(self.along) == 1:
            place, ends = self.local_mm[:, 0], self.local_mm[[0, -1], 0]
            inside = (local[:, 0] >= ends[0] - _SAME_MM) & (local[:, 0] <= ends[1] + _SAME_MM)
            return np.where(inside, np.interp(local[:, 0], place, self.value), np.nan)
        mesh = scipy.spatial.Delaunay(self.local_mm)
        simplex = mesh.find_simplex(local, tol=_RIM)
        affine = mesh.transform[simplex]
        weight = np.einsum("nij,nj->ni", affine[:, :-1], local - affine[:, -1])
        weight = np.column_stack([weight, 1.0 - weight.sum(axis=1)])
        value = (weight * self.value[mesh.simplices[simplex]]).sum(axis=1)
        return np.where(simplex >= 0, value, np.nan)


def measured_compliance(table: MeasuredCompliance, tip_mm: FloatArray) -> FloatArray:
    """(n,) equivalent compliance, mm/N, at (n, 3) tool tips, mm, linear between the places of the table.

    Linear on the simplices of the places' Delaunay triangulation, in three dimensions, or in the plane or on the line
    that the places lie in. Raises ComputeError for a table that cannot be one, and for the first point that is more
    than 1 mm off the table's plane or line, or outside of its hull.
    """
    known = _require_table(table)
    tip = require_vectors("tool tip", tip_mm, "mm")
    off, kind = known.off_mm(tip), ("", "line", "plane", "space")[len(known.along)]
    source = f"the table {table.source}".rstrip()
    refuse_where(off > FLAT_MM, off, f"the tool tip's distance from the {kind} of {source}", "mm", "at most 1 mm")
    value = known.interpolate(tip)
    nearest = scipy.spatial.cKDTree(table.tip_mm).query(tip)[0]
    what = "the tool tip's distance from the nearest place measured"
    refuse_where(np.isnan(value), nearest, what, "mm", f"and it is outside of the hull of {source}: not extrapolated")
    return value


def measured_reachable(table: MeasuredCompliance, tip_mm: FloatArray) -> BoolArray:
    """(n,) True where `measured_compliance` would accept the point; arguments as there."""
    known = _require_table(table)
    tip = require_vectors("tool tip", tip_mm, "mm")
    return np.asarray((known.off_mm(tip) <= FLAT_MM) & ~np.isnan(known.interpolate(tip)), dtype=np.bool_)


def _require_table(table: MeasuredCompliance) -> _Table:
    """The table in its own dimension; raise ComputeError where it cannot be one."""
    tip = require_vectors("place measured", table.tip_mm, "mm")
    value = np.asarray(table.compliance_um_per_n, dtype=np.float64)
    if value.shape != (len(tip),):
        raise ComputeError(f"the table has {len(tip)} places and compliances of the shape {value.shape}")
    wrong = ~(np.isfinite(value) & (value > 0))
    refuse_where(wrong, value, "the compliance measured", "um/N", "it must be finite and above 0")
    if len(tip) < 2:
        raise ComputeError(f"the table {table.source} has {len(tip)} places: at least 2 are needed")
    centre = tip.mean(axis=0)
    directions = np.linalg.svd(tip - centre, full_matrices=False)[2]
    extent = np.ptp((tip - centre) @ directions.T, axis=0)
    along = directions[extent > FLAT_MM]
    if not len(along):
        says = f"extends over {extent.max():.3g} mm, it must be above {FLAT_MM:g} mm"
        raise ComputeError(f"the table {table.source} {says}")
    local = (tip - centre) @ along.T
    _refuse_contradictions(local, value)
    order = np.argsort(local[:, 0])
    return _Table(centre, along, local[order], value[order] * 1e-3)


def _refuse_contradictions(place: FloatArray, value: FloatArray) -> None:
    """Raise ComputeError for the first place that was measured before, with another compliance."""
    earlier, later = scipy.spatial.cKDTree(place).query_pairs(_SAME_MM, output_type="ndarray").T
    differ = np.zeros(len(place), dtype=np.bool_)
    differ[later] = np.abs(value[later] - value[earlier]) > 1e-9 * value[later]
    refuse_where(differ, value, "the compliance of a place that was measured before", "um/N", "and differs from then")


def tip_compliance_mm_per_n(
    robot: HybridRobot | SerialRobot,
    tip_mm: FloatArray,
    axis: FloatArray,
    *,
    moment: Moment = "full",
    path: bool = False,
) -> FloatArray:
    """(n, 3, 3) displacement of the tip per force, mm/N, base frame.

    ``moment="full"``: the translational block of eq. 39 at the tip, with the moment of the force about the wrist (which
    eq. 41 drops); symmetric positive definite. ``"paper"`` (hybrid only): eq. 41 as printed, the force acting at the
    wrist centre; not symmetric, and without the wrist joints' share. ``tip_mm`` (n, 3) mm and ``axis`` (n, 3) unit,
    from the tip into the spindle, base frame. Raises ComputeError that names the first pose which cannot be taken;
    with ``path`` the poses follow one another, and a change of the wrist's or the arm's branch is refused too.
    """
    if isinstance(robot, HybridRobot):
        return hybrid_tip_compliance_mm_per_n(robot, tip_mm, axis, moment=moment, path=path)
    if moment == "paper":
        raise ComputeError('moment = "paper" is eq. 41 of the hybrid robot: for a serial arm it must be "full"')
    return serial_tip_compliance_mm_per_n(robot, tip_mm, axis, path=path)


def reachable(robot: RobotModel, tip_mm: FloatArray, axis: FloatArray) -> BoolArray:
    """(n,) True where the robot reaches the pose alone, or where the table of a measured robot covers it.

    Arguments as for `tip_compliance_mm_per_n`; raises ComputeError only for what is not a pose or not a robot.
    """
    if isinstance(robot, HybridRobot):
        return hybrid_reachable(robot, tip_mm, axis)
    if isinstance(robot, SerialRobot):
        return serial_reachable(robot, tip_mm, axis)
    return measured_reachable(robot, tip_mm)


# From the robot's compliance matrix to one number a point, and to what is left of the contact's depth (eq. 42-48).

JUMP = 0.05
"""Relative change between neighbours, beyond that of the compliance matrix itself, that counts as a jump."""
CHUNK = 4096
"""Points worked on at a time: what they need stays in the processor's cache."""
SEPARATE = 1e-3
"""Relative distance of two eigenvalues below which closed forms lose digits and LAPACK is used."""
ROUNDING = 1e-9
"""Relative size up to which an asymmetry, or an imaginary part, is rounding."""
EQUAL = 1e-6
"""Eigenvalues this near (relative) are one: so are points with such a pair given to LAPACK."""


def equivalent_compliance(
    matrix: FloatArray, axis: FloatArray, normal: FloatArray, projection: Projection = "linear"
) -> FloatArray:
    """(n,) linear equivalent compliance in the direction of the surface normal b (paper eq. 42-43), mm/N.

    ``matrix`` (n, 3, 3) mm/N, ``axis`` and ``normal`` (n, 3) unit, all in one frame. X_1 and X_2 are the eigenvectors
    other than the one nearest the tool axis. "linear" sums ``lambda_k |<X_k, b>|`` (eq. 43, with the eigenvectors' sign
    made harmless), "quadratic" sums ``lambda_k <X_k, b>^2``, "normal" is ``b' C b``, what a static loading test along b
    measures. Where lambda_1 and lambda_2 are close "linear" depends on their rotation: see `compliance_jumps`.

    A matrix that is not symmetric (eq. 41 as printed) may have complex eigenvalues: ComputeError names the first such
    point, and says how many there are; `complex_eigenvalues` finds them.
    """
    if projection == "normal":
        return np.asarray(np.einsum("ni,nij,nj->n", normal, matrix, normal), dtype=np.float64)
    if not _is_symmetric(matrix):
        return _projected(*_real_eigen(matrix), axis, normal, projection)
    result = np.empty(len(matrix))
    for first in range(0, len(matrix), CHUNK):
        part = slice(first, first + CHUNK)
        result[part] = _symmetric(matrix[part], axis[part], normal[part], projection)
    return result


def complex_eigenvalues(matrix: FloatArray) -> BoolArray:
    """(n,) True where an (n, 3, 3) matrix has complex eigenvalues, and no equivalent compliance: eq. 41 as printed."""
    values = np.linalg.eigvals(matrix)
    return np.asarray((np.abs(values.imag) > ROUNDING * np.abs(values)).any(axis=1), dtype=np.bool_)


def compliance_jumps(compliance: FloatArray, matrix: FloatArray) -> BoolArray:
    """(n - 1,) True where the equivalent compliance changes by over 5 % more than its matrix does, point to point.

    ``compliance`` (n,) and ``matrix`` (n, 3, 3) in one unit. Such a change comes from the projection, not the robot.
    """
    size = np.linalg.norm(matrix, axis=(1, 2))
    matrix_change = np.linalg.norm(np.diff(matrix, axis=0), axis=(1, 2)) / np.minimum(size[1:], size[:-1])
    change = np.abs(np.diff(compliance)) / np.minimum(compliance[1:], compliance[:-1])
    return np.asarray(change > JUMP + matrix_change, dtype=np.bool_)


def depth_ratio(compliance_mm_per_n: FloatArray, process: ToolProcess, depth_mm: float | FloatArray) -> FloatArray:
    """(n,) gamma = 1 - dz/d (paper eq. 48) with dz = c F / cos(dip) (eq. 44) and d the rigid robot's depth, mm.

    ``depth_mm`` is a number, or (n,) where the part's curvature makes each its own.
    Raises ComputeError where nothing of the depth would be left.
    """
    require_number("the process's dip_deg", process.dip_deg, "deg", above=-90.0, below=90.0)
    offset_mm = compliance_mm_per_n * (process.force_n / np.cos(np.radians(process.dip_deg)))
    gamma = np.asarray(1.0 - offset_mm / depth_mm, dtype=np.float64)
    gone = ~(gamma > 0)
    if gone.any():
        first = int(np.argmax(gone))
        softest, deep = float(compliance_mm_per_n[first]) * 1e3, np.broadcast_to(depth_mm, gone.shape)[first]
        limit = (
            f"the contact is only {deep:.5g} mm deep (equivalent compliance {softest:.4g} um/N at "
            f"{process.force_n:g} N): gamma would not be above 0"
        )
        refuse_where(gone, offset_mm, "the way that the robot gives", "mm", limit)
    return gamma


def _is_symmetric(matrix: FloatArray) -> bool:
    across = [np.abs(matrix[:, i, j] - matrix[:, j, i]).max(initial=0.0) for i, j in ((0, 1), (0, 2), (1, 2))]
    return bool(max(across) <= ROUNDING * np.abs(matrix).max(initial=0.0))


def _symmetric(matrix: FloatArray, axis: FloatArray, normal: FloatArray, projection: Projection) -> FloatArray:
    """Eq. 43 in closed form: LAPACK's batched eigh alone costs as much as all of the robot's model.

    X_3, the eigenvector nearest the tool axis, is found from its eigenvalue; the other two lie in the plane across it,
    where a Jacobi rotation gives them. Where X_3's eigenvalue does not stand apart, LAPACK has the word.
    """
    c = np.ascontiguousarray(matrix.transpose(1, 2, 0))
    a, b = np.ascontiguousarray(axis.T), np.ascontiguousarray(normal.T)
    value, gap = _axial_eigenvalue(c, a)
    x = _null_vector(c, value)
    along = dot(x, b)
    across = b - along * x
    share = np.sqrt(dot(across, across))
    first = across / np.maximum(share, 1e-300)
    second = cross(x, first)
    pushed = _times(c, first)
    m_11, m_12, m_22 = dot(first, pushed), dot(second, pushed), dot(second, _times(c, second))
    mean, half = (m_11 + m_22) / 2, (m_11 - m_22) / 2
    spread = np.hypot(half, m_12)
    big = np.where(spread > 0, (spread + np.abs(half)) / np.maximum(2 * spread, 1e-300), 1.0)
    small = m_12**2 / np.maximum(4 * spread**2 * big, 1e-300)  # 1 - big, without its cancellation
    on_high = np.where(half >= 0, big, small)
    on_low = np.where(half >= 0, small, big)
    if projection == "linear":
        result = share * ((mean + spread) * np.sqrt(on_high) + (mean - spread) * np.sqrt(on_low))
    else:
        result = share**2 * ((mean + spread) * on_high + (mean - spread) * on_low)
    near = gap < SEPARATE
    if near.any():
        result[near] = _projected(*np.linalg.eigh(matrix[near]), axis[near], normal[near], projection)
    return np.asarray(result, dtype=np.float64)


def _axial_eigenvalue(c: FloatArray, a: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n,) eigenvalue of the (3, 3, n) symmetric matrices whose eigenvector is nearest a (3, n), and its relative gap.

    Eigenvalues by the trigonometric form; the squared cosine to each eigenvector is a' P_k a, P_k its projector.
    """
    mean = (c[0, 0] + c[1, 1] + c[2, 2]) / 3
    d_0, d_1, d_2 = c[0, 0] - mean, c[1, 1] - mean, c[2, 2] - mean
    off = c[0, 1] ** 2 + c[0, 2] ** 2 + c[1, 2] ** 2
    size = np.sqrt((d_0**2 + d_1**2 + d_2**2 + 2 * off) / 6)
    det = d_0 * (d_1 * d_2 - c[1, 2] ** 2) - c[0, 1] * (c[0, 1] * d_2 - c[1, 2] * c[0, 2])
    det += c[0, 2] * (c[0, 1] * c[1, 2] - d_1 * c[0, 2])
    angle = np.arccos(np.clip(det / np.maximum(2 * size**3, 1e-300), -1.0, 1.0)) / 3
    high, low = mean + 2 * size * np.cos(angle), mean + 2 * size * np.cos(angle + 2 * np.pi / 3)
    middle = 3 * mean - high - low
    pushed = _times(c, a)
    once, twice = dot(a, pushed), dot(pushed, pushed)
    tiny = np.maximum(np.abs(mean), 1e-300) ** 2 * 1e-30
    value = np.stack([high, middle, low])
    share = np.stack(
        [
            (twice - (q + r) * once + q * r) / np.maximum((p - q) * (p - r) * sign, tiny) * sign
            for p, q, r, sign in ((high, middle, low, 1.0), (middle, high, low, -1.0), (low, high, middle, 1.0))
        ]
    )
    nearest = share.argmax(axis=0)[None, :]
    own = np.take_along_axis(value, nearest, axis=0)[0]
    closest = np.minimum(high - middle, middle - low)
    gap = np.where(nearest[0] == 0, high - middle, np.where(nearest[0] == 2, middle - low, closest))
    gap = np.where(closest > EQUAL * np.abs(high), gap, 0.0)  # of a pair so close the squared cosines are noise
    return own, gap / np.maximum(np.abs(high), 1e-300)


def _null_vector(c: FloatArray, value: FloatArray) -> FloatArray:
    """(3, n) unit eigenvectors of the (3, 3, n) symmetric matrices for a simple eigenvalue (n,): a row cross a row."""
    rows = c.copy()
    for k in range(3):
        rows[k, k] -= value
    crosses = np.stack([cross(rows[0], rows[1]), cross(rows[1], rows[2]), cross(rows[2], rows[0])])
    size = crosses[:, 0] ** 2 + crosses[:, 1] ** 2 + crosses[:, 2] ** 2
    best = size.argmax(axis=0)
    vector = np.take_along_axis(crosses, best[None, None, :], axis=0)[0]
    return np.asarray(vector / np.sqrt(np.maximum(size.max(axis=0), 1e-300)), dtype=np.float64)


def _times(c: FloatArray, p: FloatArray) -> FloatArray:
    return np.stack([dot(c[0], p), dot(c[1], p), dot(c[2], p)])


def _real_eigen(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Eigenvalues (n, 3) and eigenvectors in columns (n, 3, 3) of matrices that need not be symmetric."""
    values, vectors = np.linalg.eig(matrix)
    refuse_where(
        complex_eigenvalues(matrix),
        np.abs(values.imag).max(axis=1, initial=0.0) * 1e3,
        'with moment = "paper" the compliance has complex eigenvalues, the imaginary part',
        "um/N",
        'no equivalent compliance is defined there; use moment = "full"',
    )
    return values.real, vectors.real


def _projected(
    values: FloatArray, vectors: FloatArray, axis: FloatArray, normal: FloatArray, projection: Projection
) -> FloatArray:
    """Eq. 43 from eigenvalues (n, 3) and unit eigenvectors in columns (n, 3, 3)."""
    along_axis = np.abs(np.einsum("nij,ni->nj", vectors, axis))
    across = np.arange(3) != along_axis.argmax(axis=1)[:, None]
    share = np.abs(np.einsum("nij,ni->nj", vectors, normal))
    return np.asarray((across * values * (share if projection == "linear" else share**2)).sum(axis=1))


# The robot's compliance along a program's path, in the direction of the surface normal (paper eq. 34-44).

DIP_TOLERANCE_DEG = 0.5
"""Largest deviation of the program's tool axis from the dip of the process."""


@dataclass(frozen=True, slots=True)
class PathCompliance:
    """Linear equivalent compliance at n timed points, and how sure it is."""

    compliance_mm_per_n: FloatArray
    """(n,) mm/N."""
    jumps: int
    """Neighbours between which the projection jumps and the robot does not (see `compliance_jumps`)."""
    fallbacks: int
    """Points at which the path has no Frenet frame, and the surface normal was taken."""

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user."""
        n = len(self.compliance_mm_per_n)
        found = []
        if self.jumps:
            found.append(
                f"the linear equivalent compliance jumps {self.jumps} times by over 5 % where the robot's does not"
            )
        if self.fallbacks:
            found.append(f"no Frenet frame at {self.fallbacks} of {n} points (straight path): surface normal taken")
        return tuple(found)


def path_compliance(
    program: Program,
    process: ToolProcess,
    robot: RobotModel,
    placement: Placement,
    *,
    options: ComplianceOptions = SHIPPED_OPTIONS,
    optic: Optic = FLAT,
) -> PathCompliance:
    """Linear equivalent compliance at the timed points of a program in the part's frame.

    The pose is the block's middle with the axis at its end. Raises ComputeError for a point that is out of reach or
    whose axis is not dipped as the process says.
    """
    start = require_vectors("start of block", program.start_mm, "mm")
    end = require_vectors("end of block", program.end_mm, "mm")
    if not len(start) == len(end) == len(program.axis):
        raise ComputeError(f"the program has {len(start)} starts, {len(end)} ends and {len(program.axis)} axes")
    middle = (start + end) / 2
    return compliance_at(middle, program.axis, process, robot, placement, options=options, optic=optic)


def require_dip(program: Program, process: ToolProcess, placement: Placement, optic: Optic) -> None:
    """Raise ComputeError for the first timed point whose axis is not dipped as the process says."""
    middle = (program.start_mm + program.end_mm) / 2
    surface = frames.surface_normals(placement, middle, optic)
    _require_dipped(process, frames.directions_to_base(placement, program.axis), surface)


def _require_dipped(process: ToolProcess, base_axis: FloatArray, surface: FloatArray) -> None:
    dip = frames.dips_deg(base_axis, surface)
    off = ~(np.abs(dip - process.dip_deg) <= DIP_TOLERANCE_DEG)
    refuse_where(off, dip, "the program's tool axis is dipped: the dip", "deg", f"the process says {process.dip_deg:g}")


def compliance_at(
    point_mm: FloatArray,
    axis: FloatArray,
    process: ToolProcess,
    robot: RobotModel,
    placement: Placement,
    *,
    options: ComplianceOptions = SHIPPED_OPTIONS,
    optic: Optic = FLAT,
) -> PathCompliance:
    """Compliance at points along a path: (n, 3) tool tips, mm, and (n, 3) unit tool axes, both in the part's frame."""
    tip = frames.points_to_base(placement, point_mm)
    base_axis = frames.directions_to_base(placement, require_unit_vectors("tool axis", axis))
    surface = frames.surface_normals(placement, point_mm, optic)
    _require_dipped(process, base_axis, surface)
    if isinstance(robot, MeasuredCompliance):
        return PathCompliance(measured_compliance(robot, tip), 0, 0)
    normal, fallbacks = _normals(options, placement, process.dip_deg, tip=tip, axis=base_axis, surface=surface)
    matrix = tip_compliance_mm_per_n(robot, tip, base_axis, moment=options.moment, path=True)
    compliance = equivalent_compliance(matrix, base_axis, normal, options.projection)
    return PathCompliance(compliance, int(compliance_jumps(compliance, matrix).sum()), fallbacks)


def _normals(
    options: ComplianceOptions,
    placement: Placement,
    dip_deg: float,
    *,
    tip: FloatArray,
    axis: FloatArray,
    surface: FloatArray,
) -> tuple[FloatArray, int]:
    """(n, 3) unit normals b that the options ask for, base frame, and at how many points it fell back."""
    if options.frame == "surface":
        return surface, 0
    if options.frame == "frenet":
        binormal, defined = frames.frenet_binormals(tip)
        facing = np.where(np.einsum("ni,ni->n", binormal, surface) < 0, -1.0, 1.0)
        return np.where(defined[:, None], binormal * facing[:, None], surface), int((~defined).sum())
    lean = frames.lean_directions(options, placement, tip, surface)
    return frames.normals_from_axes(axis, lean, dip_deg), 0


# The equivalent compliance over the workspace (paper fig. 10): to compare positions in the cell.

AROUND_MM = 300.0
"""Half the side of the cube about the part that replaces the workspace of a robot which states none."""


@dataclass(frozen=True, slots=True)
class ComplianceField:
    """Equivalent compliance and gamma on horizontal planes through the workspace, NaN where there is none."""

    x_mm: FloatArray
    """(nx,) base frame, ascending."""
    y_mm: FloatArray
    """(ny,) base frame, ascending."""
    z_mm: FloatArray
    """(nz,) base frame, one a plane."""
    compliance_um_per_n: FloatArray
    """(nz, ny, nx)."""
    gamma: FloatArray
    """(nz, ny, nx); not above 0 where the robot gives way by more than the contact's depth."""
    places: int
    """Samples within the workspace."""
    out_of_reach: int
    """Points that the robot cannot reach: out of stroke or limits, or singular."""
    undefined: int
    """Points that it reaches where eq. 41 as printed has complex eigenvalues."""


def compliance_field(
    robot: RobotModel,
    process: ToolProcess,
    placement: Placement,
    options: ComplianceOptions,
    *,
    planes: int = 5,
    across: int = 67,
) -> ComplianceField:
    """Sample the workspace at ``across`` x ``across`` places on each of ``planes``, for a flat part held like this one.

    The tool is dipped as the options ask for; along or across the path means along or across the part's x, for want of
    a path. The workspace is that of the hybrid robot's limits, a cube about the part for a serial arm, and the box of
    the measured places for a table.
    """
    x, y, z = _axes(robot, placement, planes, across)
    tip = np.stack(np.meshgrid(z, y, x, indexing="ij"), axis=-1)[..., ::-1].reshape(-1, 3)
    inside = _inside(robot, tip)
    value, undefined = np.full(len(tip), np.nan), 0
    if isinstance(robot, MeasuredCompliance):
        can = measured_reachable(robot, tip)
        value[can] = measured_compliance(robot, tip[can])
    else:
        can = inside & _has_lean(options, tip)
        normal = np.repeat(frames.surface_normals(placement, np.zeros((1, 3))), len(tip), axis=0)
        axis = np.zeros_like(tip)
        axis[can] = frames.dipped_axes(without_path(options), placement, tip[can], normal[can], process.dip_deg)
        can[can] = reachable(robot, tip[can], axis[can])
        matrix = tip_compliance_mm_per_n(robot, tip[can], axis[can], moment=options.moment)
        complex_ones = complex_eigenvalues(matrix) if options.moment == "paper" else np.zeros(len(matrix), np.bool_)
        undefined, at = int(complex_ones.sum()), np.flatnonzero(can)[~complex_ones]
        value[at] = equivalent_compliance(matrix[~complex_ones], axis[at], normal[at], options.projection)
    gamma = 1 - value * process.force_n / np.cos(np.radians(process.dip_deg)) / hertz_depth_mm(process)
    shape = (len(z), len(y), len(x))
    places = int(inside.sum())
    return ComplianceField(
        x, y, z, value.reshape(shape) * 1e3, gamma.reshape(shape), places, places - int(can.sum()), undefined
    )


def _axes(
    robot: RobotModel, placement: Placement, planes: int, across: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    if isinstance(robot, HybridRobot):
        reach = robot.workspace_radius_mm
        low, high = (robot.joint_height_mm - height for height in robot.workspace_height_mm[::-1])
        return np.linspace(-reach, reach, across), np.linspace(-reach, reach, across), np.linspace(low, high, planes)
    if isinstance(robot, MeasuredCompliance):
        lows, highs = robot.tip_mm.min(axis=0), robot.tip_mm.max(axis=0)
    else:
        centre = np.asarray(placement.origin_mm)
        lows, highs = centre - AROUND_MM, centre + AROUND_MM
    x, y, z = (np.linspace(a, b, n) for a, b, n in zip(lows, highs, (across, across, planes), strict=True))
    return x, y, np.unique(z)


def _inside(robot: RobotModel, tip_mm: FloatArray) -> np.ndarray:
    """(n,) True within the workspace: the hybrid robot's is a cylinder."""
    if isinstance(robot, HybridRobot):
        return np.asarray(np.hypot(tip_mm[:, 0], tip_mm[:, 1]) <= robot.workspace_radius_mm)
    return np.ones(len(tip_mm), dtype=np.bool_)


def _has_lean(options: ComplianceOptions, tip_mm: FloatArray) -> np.ndarray:
    """(n,) False on the base's z axis, where inward has no direction."""
    return np.asarray((options.dip_direction != "inward") | (np.hypot(tip_mm[:, 0], tip_mm[:, 1]) > 1e-6))


def without_path(options: ComplianceOptions) -> ComplianceOptions:
    """Return the options where there is no path: along and across it mean along and across the part's x."""
    azimuth = {"along": 0.0, "across": 90.0}.get(options.dip_direction)
    return options if azimuth is None else ComplianceOptions(dip_direction="fixed", dip_azimuth_deg=azimuth)
