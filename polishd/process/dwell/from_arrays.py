"""Certified dwell times from numpy arrays: a map, samples of a TIF, dwell points (docs/how-to/dwell.md).

The map's axes may run either way and need no particular origin; every array that comes back runs as the map does.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, sparse

from polishd.model.dwell import DwellSolution, OptimalityCertificate
from polishd.model.errors import ComputeError
from polishd.model.surface import BoolArray, FloatArray, Grid
from polishd.process.checks import refuse_where, require_number
from polishd.process.dwell import douglas_rachford, interior_point, newton_cg
from polishd.process.dwell.problem import DwellProblem, check
from polishd.process.dwell.quadratic import choose_piston_nm, regularisation_from_rho
from polishd.process.dwell.residual_curve import (
    CurvePoint,
    ResidualGoal,
    Row,
    Solve,
    solve_once,
    solve_to_goal,
    solve_to_target,
    solve_within_budget,
)
from polishd.process.removal.combined_effect import combine_effects, split_by_tool
from polishd.process.removal.convolution import ConvolutionEffect, sum_of_convolutions
from polishd.process.removal.effect import Effect, SparseEffect

# The effect of dwells at arbitrary points from samples of a TIF, on a map given by its axes.

Indices = NDArray[np.int64]

UNEVEN = 1e-3
"""Largest deviation of a sample from an even axis, over the pitch."""
ON_NODE = 1e-6
MATRIX_ENTRIES = 20_000_000
"""Above it (half a GB with its transpose), points on the map's own samples are a convolution instead of a matrix."""
MOST_ENTRIES = 150_000_000
CHUNK = 2_000_000


@dataclass(frozen=True, slots=True)
class MapAxes:
    """Axes of a map's samples; ``grid`` gives only number and pitch, not the coordinates."""

    x_mm: FloatArray
    """(nx,)"""
    y_mm: FloatArray
    """(ny,)"""
    grid: Grid

    @property
    def first_mm(self) -> FloatArray:
        """(2,) x and y of the first sample."""
        return np.array([self.x_mm[0], self.y_mm[0]])

    @property
    def step_mm(self) -> FloatArray:
        """(2,) from column to column and from row to row, with its sign."""
        return np.array([self.x_mm[-1] - self.x_mm[0], self.y_mm[-1] - self.y_mm[0]]) / (
            self.grid.nx - 1,
            self.grid.ny - 1,
        )

    def box(self, mask: BoolArray) -> tuple[FloatArray, FloatArray]:
        """Least and largest (x, y) of the samples in (ny, nx) ``mask``, mm."""
        x, y = self.x_mm[mask.any(axis=0)], self.y_mm[mask.any(axis=1)]
        return np.array([x.min(), y.min()]), np.array([x.max(), y.max()])


def map_axes(x_mm: FloatArray, y_mm: FloatArray, shape: tuple[int, ...]) -> MapAxes:
    """The axes of a map of this shape, from vectors or from meshgrids.

    Raises:
        ComputeError: they do not fit the map, are uneven, or not of one pitch.
    """
    if len(shape) != 2 or min(shape) < 2:
        raise ComputeError(f"height_nm has the shape {shape}, it must be (ny, nx) with two samples each way at least")
    x = _axis("x_mm", np.asarray(x_mm, dtype=np.float64), shape, 1)
    y = _axis("y_mm", np.asarray(y_mm, dtype=np.float64), shape, 0)
    pitch = abs(x[-1] - x[0]) / (x.size - 1)
    other = abs(y[-1] - y[0]) / (y.size - 1)
    if abs(pitch - other) > UNEVEN * pitch or pitch == 0:
        raise ComputeError(f"the samples are {pitch:.6g} mm apart in x and {other:.6g} mm in y: resample to one pitch")
    return MapAxes(x, y, Grid(shape[0], shape[1], float(pitch)))


def _axis(name: str, value: FloatArray, shape: tuple[int, ...], axis: int) -> FloatArray:
    if value.shape == shape:
        line = value[0] if axis == 1 else value[:, 0]
        if not np.allclose(value, line if axis == 1 else line[:, None], rtol=0, atol=UNEVEN * abs(line[1] - line[0])):
            raise ComputeError(f"{name} is no meshgrid: it must be the same in each {'row' if axis == 1 else 'column'}")
        value = line
    if value.shape != (shape[axis],):
        raise ComputeError(f"{name} is {value.shape}, it must be ({shape[axis]},) or {shape}, as height_nm")
    even = np.linspace(value[0], value[-1], value.size)
    refuse_where(
        ~(np.abs(value - even) <= UNEVEN * np.abs(even[1] - even[0])), value, name, "mm", "it must be finite and even"
    )
    return value


def check_tif(tif_nm_s: FloatArray, pitch_mm: float) -> FloatArray:
    """The samples as float64; ComputeError names the one that is no rate of removal."""
    require_number("tif_pitch_mm", pitch_mm, "mm", above=0)
    tif = np.asarray(tif_nm_s, dtype=np.float64)
    if tif.ndim != 2 or min(tif.shape) < 4:
        raise ComputeError(f"tif_nm_s has the shape {tif.shape}, it must be two-dimensional, 4 x 4 samples at least")
    for trouble, wrong in (("is not finite", ~np.isfinite(tif)), ("is negative", tif < 0)):
        if wrong.any():
            row, column = np.argwhere(wrong)[0]
            raise ComputeError(
                f"tif_nm_s {trouble} at row {row}, column {column}: {tif[row, column]:.6g} nm/s "
                f"({int(wrong.sum())} such samples); it is a rate of removal, clean its rim first"
            )
    if not tif.any():
        raise ComputeError("tif_nm_s is zero everywhere: such a tool removes nothing")
    return tif


def check_points(points_mm: FloatArray) -> FloatArray:
    """The (n, 2) points as float64; ComputeError where they are none, or not finite."""
    points = np.asarray(points_mm, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 2 or len(points) == 0:
        raise ComputeError(
            f"points_mm has the shape {points.shape}, it must be (n, 2), x and y, with one point at least"
        )
    for axis, name in enumerate(("x of points_mm", "y of points_mm")):
        refuse_where(~np.isfinite(points[:, axis]), points[:, axis], name, "mm", "it must be finite")
    return points


def sampled_effect(axes: MapAxes, tif_nm_s: FloatArray, tif_pitch_mm: float, points_mm: FloatArray) -> Effect:
    """The effect of dwells at (n, 2) points: the TIF's cubic spline at each sample of the map, less the point.

    The TIF is taken at the samples, not integrated over their cells: where it bends much within a cell, give the map a
    finer pitch. The spline is cut at 0 below, and is 0 beyond the outermost samples and where all samples about are 0.
    A matrix, unless the points are many samples of the map itself: then a convolution with the same values.

    Raises:
        ComputeError: the matrix would not fit into memory.
    """
    coefficients = ndimage.spline_filter(tif_nm_s, order=3, mode="mirror")
    spline = _Spline(coefficients, (tif_nm_s > 0).astype(np.float64), tif_pitch_mm)
    reach = spline.reach_mm
    place = (points_mm - axes.first_mm) / axes.step_mm
    width = np.floor(2 * reach / axes.grid.pitch_mm + 2 * ON_NODE).astype(int) + 1
    entries = len(points_mm) * int(width.prod())
    if entries > MATRIX_ENTRIES and bool((np.abs(place - np.rint(place)) < ON_NODE).all()):
        return _convolution(axes.grid, np.rint(place).astype(np.int64), spline)
    if entries > MOST_ENTRIES:
        raise ComputeError(
            f"{len(points_mm)} points of {width[1]} x {width[0]} samples each are too many for a matrix: "
            "put them on samples of the map, or resample it to a coarser pitch"
        )
    pitch = axes.grid.pitch_mm
    first = np.ceil(place - reach / pitch - ON_NODE).astype(np.int64)
    size = max(1, CHUNK // int(width.prod()))
    parts = []
    for k in range(0, len(place), size):
        here = slice(k, k + size)
        row, column = (first[here, axis, None] + np.arange(width[axis]) for axis in (1, 0))
        dx, dy = (column - place[here, 0, None]) * pitch, (row - place[here, 1, None]) * pitch
        patch = spline.at(dx[:, None, :], dy[:, :, None])
        parts.append(_columns(axes.grid, row, column, patch))
    return SparseEffect(axes.grid, sparse.csr_array(sparse.hstack(parts, format="csr")))


@dataclass(frozen=True, slots=True)
class _Spline:
    """A TIF between its samples."""

    coefficients: FloatArray
    support: FloatArray
    """1 where a sample is above 0: where none near is, a spline would ring about a TIF that is cut off."""
    pitch_mm: float

    @property
    def reach_mm(self) -> FloatArray:
        """(2,) from the middle to the outermost sample, in x and y."""
        return np.asarray((np.array(self.support.shape[::-1]) - 1) / 2 * self.pitch_mm)

    def at(self, dx_mm: FloatArray, dy_mm: FloatArray) -> FloatArray:
        """nm/s at these distances from the dwell point along rows and columns, broadcast against each other."""
        place = []
        for distance, samples in ((dy_mm, self.support.shape[0]), (dx_mm, self.support.shape[1])):
            at = distance / self.pitch_mm + (samples - 1) / 2
            beyond = (at < -ON_NODE) | (at > samples - 1 + ON_NODE)
            place.append(np.where(beyond, -1.0, np.clip(at, 0, samples - 1)))  # rounding costs no sample on the rim
        where = np.stack(np.broadcast_arrays(*place))
        value = ndimage.map_coordinates(self.coefficients, where, order=3, mode="constant", prefilter=False)
        near = ndimage.map_coordinates(self.support, where, order=1, mode="constant")
        return np.where(near > ON_NODE, np.maximum(value, 0.0), 0.0)


def _columns(grid: Grid, row: Indices, column: Indices, patch: FloatArray) -> sparse.csc_array:
    """The columns of c points: ``patch`` (c, rows, columns) at these rows and columns (c, .) of the grid."""
    inside = ((row >= 0) & (row < grid.ny))[:, :, None] & ((column >= 0) & (column < grid.nx))[:, None, :]
    keep = inside & (patch > 0)
    sample = (row[:, :, None] * grid.nx + column[:, None, :])[keep]
    return sparse.csc_array((patch[keep], (sample, np.nonzero(keep)[0])), shape=(grid.ny * grid.nx, len(patch)))


def _convolution(grid: Grid, node: Indices, spline: _Spline) -> ConvolutionEffect:
    """Return the effect for points on (n, 2) samples, column and row, of the map's lattice."""
    half = np.floor(spline.reach_mm / grid.pitch_mm + ON_NODE).astype(int)
    dx, dy = (np.arange(-n, n + 1) * grid.pitch_mm for n in half)
    kernel = spline.at(dx[None, :], dy[:, None])
    return sum_of_convolutions(grid, (node[:, 1], node[:, 0]), kernel[None], np.ones((len(node), 1)))


RHO = 1e-8
"""Default of rho = regularisation N_r / sigma_max^2: on real maps within 0.3 % of the residual RMS without it."""
MOST_UNREACHED = 0.02


@dataclass(frozen=True, slots=True)
class DwellCase:
    """A map, a tool and where it dwells: all that is given."""

    x_mm: FloatArray
    """(nx,) equidistant columns of the map, or (ny, nx) as by meshgrid; rising or falling."""
    y_mm: FloatArray
    """(ny,) its rows, at the same distance, or (ny, nx)."""
    height_nm: FloatArray
    """(ny, nx) what is to be removed: surface, positive = high; NaN = no data."""
    tif_nm_s: FloatArray
    """(ky, kx) removal rate, not negative, at the centres of cells; the array's middle is the dwell point.

    Rows and columns run as the map's. Between samples a cubic spline, zero beyond the outermost.
    """
    tif_pitch_mm: float
    """Distance of its samples."""
    points_mm: FloatArray | None = None
    """(n, 2) x and y where the tool dwells, anywhere in the map's coordinates; None: a square lattice."""
    step_mm: float = 1.0
    """Index on that lattice, see `dwell_lattice`."""
    mask: BoolArray | None = None
    """(ny, nx) samples that count; None: all that have data."""
    clear: BoolArray | None = None
    """(ny, nx) the clear aperture, in which figures are stated; None: ``mask``."""
    weight: FloatArray | None = None
    """(ny, nx) how much a sample counts; None: all alike."""
    lower_s: float | FloatArray = 0.0
    """Least dwell, one or (n,)."""
    upper_s: float | FloatArray = np.inf
    """Most dwell, one or (n,)."""
    piston_nm: float | None = 0.0
    """Removal wanted everywhere beside ``height_nm``; None: chosen by `choose_piston_nm`."""
    rho: float = RHO
    """Relative regularization: ``regularisation N_r / sigma_max^2``."""


@dataclass(frozen=True, slots=True)
class ArrayDwell:
    """Result of `dwell_from_arrays`."""

    points_mm: FloatArray
    """(n, 2) x and y of the dwell points, in the map's coordinates."""
    problem: DwellProblem
    """The solved problem, with its price of time, regularization and piston."""
    solution: DwellSolution

    @property
    def time_s(self) -> FloatArray:
        """(n,) seconds at each point."""
        return self.solution.time_s

    @property
    def residual_nm(self) -> FloatArray:
        """(ny, nx) predicted surface after the pass, mean removed in ``clear``; NaN outside the mask."""
        return self.solution.residual_nm

    @property
    def certificate(self) -> OptimalityCertificate:
        """Figures and optimality, in float64."""
        return self.solution.certificate


def dwell_from_arrays(
    case: DwellCase,
    *,
    price_nm2_per_s: float = 0.0,
    budget_s: float | None = None,
    target_rms_nm: float | None = None,
    within_s: float = 600.0,
    solve: Solve | None = None,
) -> ArrayDwell:
    """Dwell times that bring a map down to a plane at height 0, or as near as the bounds and the goal allow.

    Args:
        case: what is given.
        price_nm2_per_s: price of a second of total time.
        budget_s: most total time: the best residual within it.
        target_rms_nm: residual RMS in the clear aperture: the least total time that reaches it.
        within_s: CPU seconds for each solve (see TimeLimit).
        solve: another solver than `default_solve`.

    Raises:
        ComputeError: what is wrong, with its value and place: NaN in the mask, nothing in the mask, a TIF that is zero
            or negative, points out of reach, bounds that contradict each other, a budget below the floor's time,
            a target out of reach, two goals at once.
    """
    if (price_nm2_per_s != 0) + (budget_s is not None) + (target_rms_nm is not None) > 1:
        raise ComputeError("price_nm2_per_s, budget_s and target_rms_nm are three ways to the same thing: give one")
    problem, points = array_problem(case)
    problem = replace(problem, price_nm2_per_s=price_nm2_per_s)
    run = partial(default_solve, within_s=within_s) if solve is None else solve
    if budget_s is not None:
        found = solve_within_budget(problem, budget_s, run)
    elif target_rms_nm is not None:
        found = solve_to_target(problem, target_rms_nm, run)
    else:
        check(problem)
        found = solve_once(problem, run)
    return ArrayDwell(points, found.problem, _noted(found.problem, found.solution))


def array_problem(case: DwellCase) -> tuple[DwellProblem, FloatArray]:
    """The problem of a case, for curves and for other solvers, and its dwell points (n, 2) mm.

    Raises:
        ComputeError: as `dwell_from_arrays`.
    """
    height = np.asarray(case.height_nm, dtype=np.float64)
    axes = map_axes(case.x_mm, case.y_mm, height.shape)
    tif = check_tif(case.tif_nm_s, case.tif_pitch_mm)
    mask = _mask("mask", np.isfinite(height) if case.mask is None else case.mask, axes)
    _refuse_missing(height, mask)
    reach = (np.array(tif.shape[::-1]) - 1) / 2 * case.tif_pitch_mm
    given = case.points_mm
    points = dwell_lattice(axes, mask, reach, case.step_mm) if given is None else check_points(given)
    _refuse_outside(points, axes, mask, reach)
    effect = sampled_effect(axes, tif, case.tif_pitch_mm, points)
    lower, upper = _bound("lower_s", case.lower_s, len(points)), _bound("upper_s", case.upper_s, len(points))
    piston = case.piston_nm
    if piston is None:
        piston = choose_piston_nm(height, mask, effect.removal_nm(lower))
    require_number("piston_nm", piston, "nm", above=-np.inf)
    problem = DwellProblem(
        effect,
        height + piston,
        mask,
        mask if case.clear is None else _mask("clear", case.clear, axes),
        lower,
        upper,
        regularisation_from_rho(effect, mask, case.rho),
        weight=case.weight,
    )
    return problem, points


def default_solve(problem: DwellProblem, within_s: float = 600.0) -> DwellSolution:
    """The solver that suits the effect, at its default tolerance.

    Transforms for a sum of convolutions, the interior point for a matrix that it can factorise, newton_cg else.
    """
    if isinstance(problem.effect, ConvolutionEffect):
        return douglas_rachford.solve(problem, within_s)
    try:
        return interior_point.solve(problem, within_s)
    except ComputeError:  # too many points for it; what is malformed is refused again
        return newton_cg.solve(problem, within_s)


def dwell_lattice(axes: MapAxes, mask: BoolArray, reach_mm: FloatArray, step_mm: float) -> FloatArray:
    """(n, 2) x and y mm of a square lattice, centred on the samples that count, that covers them and a TIF's reach.

    Along each axis ``floor((extent + 2 reach) / step) + 1`` points, extent being from sample centre to sample centre.
    Points run along the shorter axis first.
    """
    if not (np.isfinite(step_mm) and step_mm > 0):
        raise ComputeError(f"step_mm is {step_mm}, it must be above 0")
    low, high = axes.box(mask)
    count = np.floor((high - low + 2 * reach_mm) / step_mm + 1e-9).astype(int) + 1
    along = [(low[k] + high[k]) / 2 + (np.arange(count[k]) - (count[k] - 1) / 2) * step_mm for k in (0, 1)]
    x, y = np.meshgrid(*along, indexing="ij" if count[0] >= count[1] else "xy")
    return np.stack([x.ravel(), y.ravel()], axis=1)


def _refuse_missing(height_nm: FloatArray, mask: BoolArray) -> None:
    bad = mask & ~np.isfinite(height_nm)
    if bad.any():
        row, column = np.argwhere(bad)[0]
        raise ComputeError(
            f"height_nm is {height_nm[row, column]} at row {row}, column {column}, which counts "
            f"({int(bad.sum())} such samples): take them out of the mask, or fill them"
        )


def _mask(name: str, mask: BoolArray, axes: MapAxes) -> BoolArray:
    found = np.asarray(mask)
    if found.dtype != np.bool_ or found.shape != axes.grid.shape:
        raise ComputeError(f"{name} is {found.dtype} {found.shape}, it must be bool {axes.grid.shape}")
    if not found.any():
        raise ComputeError(f"{name} is empty: no sample counts")
    return found


def _bound(name: str, value: float | FloatArray, n: int) -> FloatArray:
    found = np.asarray(value, dtype=np.float64)
    if found.shape not in ((), (n,)):
        raise ComputeError(f"{name} is {found.shape}, it must be one number or ({n},)")
    return np.array(np.broadcast_to(found, (n,)))


def _refuse_outside(points: FloatArray, axes: MapAxes, mask: BoolArray, reach_mm: FloatArray) -> None:
    low, high = axes.box(mask)
    slack = 1e-6 * axes.grid.pitch_mm
    outside = ((points < low - reach_mm - slack) | (points > high + reach_mm + slack)).any(axis=1)
    if outside.any():
        first = int(np.argmax(outside))
        raise ComputeError(
            f"point {first} at ({points[first, 0]:.6g}, {points[first, 1]:.6g}) mm lies outside: its TIF cannot reach "
            f"x {low[0]:.6g} to {high[0]:.6g}, y {low[1]:.6g} to {high[1]:.6g} mm ({int(outside.sum())} such points)"
        )


def _noted(problem: DwellProblem, solution: DwellSolution) -> DwellSolution:
    """With what a person should know of the arrays: points without effect, a map that is too low to be reached."""
    notes = list(solution.certificate.notes)
    idle = int(np.count_nonzero(problem.effect.adjoint(problem.solve_mask.astype(np.float64)) <= 0))
    if idle:
        notes.append(f"{idle} points reach no sample that counts; they are left at their lower bound")
    low = (problem.target_nm < problem.effect.removal_nm(problem.lower_s))[problem.solve_mask].mean()
    if low > MOST_UNREACHED:
        notes.append(f"{100 * low:.0f} % of the samples lie below what the least dwell removes: raise piston_nm")
    return replace(solution, certificate=replace(solution.certificate, notes=tuple(notes)))


# Several tools over one part, from arrays: one convex problem for all, and which of them are worth their change.

MOST_TOOLS = 5
"""31 choices among them: more would be solved for hours."""


@dataclass(frozen=True, slots=True)
class ArrayTool:
    """A tool, and where it may dwell: of a `DwellCase` what is its own."""

    name: str
    tif_nm_s: FloatArray
    """(ky, kx) removal rate, as in a `DwellCase`."""
    tif_pitch_mm: float
    points_mm: FloatArray | None = None
    """(n, 2); None: a square lattice of ``step_mm``."""
    step_mm: float = 1.0
    lower_s: float | FloatArray = 0.0
    upper_s: float | FloatArray = np.inf
    change_s: float = 0.0
    """Machine time that it takes to have it on the spindle and the part before it, whatever it then does."""


@dataclass(frozen=True, slots=True)
class ToolDwell:
    """Dwell of one tool."""

    tool: ArrayTool
    points_mm: FloatArray
    """(n, 2) x and y, in the map's coordinates."""
    time_s: FloatArray
    """(n,)."""
    removal_nm: FloatArray
    """(ny, nx)."""


@dataclass(frozen=True, slots=True)
class ToolsDwell:
    """Result of `dwell_of_tools`."""

    passes: tuple[ToolDwell, ...]
    """Dwells of the chosen tools, in the given order."""
    problem: DwellProblem
    """The one that was solved, of their points one after another."""
    certificate: OptimalityCertificate
    """Removal of all tools together."""
    residual_nm: FloatArray
    """(ny, nx) after the last of them, mean removed in the clear aperture; NaN outside the mask."""
    total_s: float
    """Dwell and changes."""
    tried: tuple[Row, ...]
    """Each choice of tools: ``tools``, ``total_s``, ``rms_nm``, ``slope_urad``, ``kkt_residual``; or ``refused``."""


def dwell_of_tools(
    case: DwellCase,
    tools: Sequence[ArrayTool],
    *,
    budget_s: float | None = None,
    target_rms_nm: float | None = None,
    target_slope_urad: float | None = None,
    within_s: float = 600.0,
    solve: Solve | None = None,
) -> ToolsDwell:
    """The dwells of several tools that together bring a map down, and which tools to take for it.

    Without a goal all tools are taken, and the residual is the least. With a target it is the choice of the least
    machine time, with a budget that of the least residual.

    Args:
        case: the map, and what counts of it; its own TIF, points and bounds are not used.
        tools: at most MOST_TOOLS, in the order in which they polish.
        budget_s: most machine time, changes included.
        target_rms_nm: residual RMS in the clear aperture to reach.
        target_slope_urad: RMS of the residual's slope to reach as well, or alone. The dwell is the shortest for its
            residual; of those the one with the least time is taken whose slope is good enough.
        within_s: CPU seconds for each solve.
        solve: another solver than `default_solve`.

    Raises:
        ComputeError: as `dwell_from_arrays`; a goal that no choice of tools reaches, with what each came to.
    """
    goal = ResidualGoal(target_rms_nm, target_slope_urad)
    if budget_s is not None and goal.wanted:
        raise ComputeError("budget_s and a target are two ways to the same thing: give one")
    if not 0 < len(tools) <= MOST_TOOLS:
        raise ComputeError(f"{len(tools)} tools: give one to {MOST_TOOLS}")
    for tool in tools:
        require_number(f"change_s of {tool.name}", tool.change_s, "s", above=-1e-9)
    run = partial(default_solve, within_s=within_s) if solve is None else solve
    alone = [_problem_of(case, tool) for tool in tools]
    free = budget_s is None and not goal.wanted
    rows, best = list[Row](), None
    for chosen in [tuple(range(len(tools)))] if free else _choices(len(tools)):
        names, change_s = [tools[k].name for k in chosen], sum(tools[k].change_s for k in chosen)
        problem = _joined([alone[k][0] for k in chosen], case)
        try:
            found = _found(problem, run, goal, None if budget_s is None else budget_s - change_s)
        except ComputeError as refused:
            rows.append({"tools": names, "refused": str(refused)})
            continue
        rows.append(_row(found, names, change_s))
        score = found.rms_nm if budget_s is not None else found.total_s + change_s
        if best is None or score < best[0]:
            best = score, chosen, found, change_s
    if best is None:
        reasons = "\n".join(f"  {', '.join(row['tools'])}: {row['refused']}" for row in rows)  # type: ignore[arg-type]
        raise ComputeError(f"no choice of tools reaches the target:\n{reasons}")
    _, chosen, found, change_s = best
    own = [(tools[k], *alone[k]) for k in chosen]
    return ToolsDwell(
        passes=tuple(_passes(own, found.solution.time_s)),
        problem=found.problem,
        certificate=found.solution.certificate,
        residual_nm=found.solution.residual_nm,
        total_s=found.total_s + change_s,
        tried=tuple(rows),
    )


def _case_of(case: DwellCase, tool: ArrayTool) -> DwellCase:
    own = ("tif_nm_s", "tif_pitch_mm", "points_mm", "step_mm", "lower_s", "upper_s")
    return replace(case, **{name: getattr(tool, name) for name in own})


def _problem_of(case: DwellCase, tool: ArrayTool) -> tuple[DwellProblem, FloatArray]:
    try:
        return array_problem(_case_of(case, tool))
    except ComputeError as error:
        raise ComputeError(f"{tool.name}: {error}") from error


def _choices(count: int) -> Iterator[tuple[int, ...]]:
    for size in range(1, count + 1):
        yield from combinations(range(count), size)


def _joined(problems: Sequence[DwellProblem], case: DwellCase) -> DwellProblem:
    """One problem of all; the same map for each, so that the piston of the highest floor holds for all."""
    effect = combine_effects([problem.effect for problem in problems])
    first = problems[0]
    highest = max(problems, key=lambda problem: float(problem.target_nm[first.solve_mask].mean()))
    return replace(
        highest,
        effect=effect,
        lower_s=np.concatenate([problem.lower_s for problem in problems]),
        upper_s=np.concatenate([problem.upper_s for problem in problems]),
        regularisation=regularisation_from_rho(effect, first.solve_mask, case.rho),
    )


def _found(problem: DwellProblem, run: Solve, goal: ResidualGoal, budget_s: float | None) -> CurvePoint:
    if goal.wanted:
        return solve_to_goal(problem, goal, run)
    return solve_once(problem, run) if budget_s is None else solve_within_budget(problem, budget_s, run)


def _row(found: CurvePoint, names: list[str], change_s: float) -> Row:
    return {
        "tools": names,
        "total_s": found.total_s + change_s,
        "rms_nm": found.rms_nm,
        "slope_urad": found.slope_urad,
        "kkt_residual": found.solution.certificate.kkt_residual,
        "gap": found.solution.certificate.gap,
    }


def _passes(own: Sequence[tuple[ArrayTool, DwellProblem, FloatArray]], time_s: FloatArray) -> Iterator[ToolDwell]:
    times = split_by_tool(time_s, [len(points) for _, _, points in own])
    for (tool, problem, points), own_s in zip(own, times, strict=True):
        yield ToolDwell(tool, points, own_s, problem.effect.removal_nm(own_s))
