"""Dwell times for numpy arrays: a map, samples of a TIF and dwell points in, a certified dwell out. See docs/dwell.md.

The map's axes may run either way and need no particular origin; every array that comes back runs as the map does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from polishd.model.dwell import DwellSolution, OptimalityCertificate
from polishd.model.errors import ComputeError
from polishd.model.surface import BoolArray, FloatArray
from polishd.process.convolution import ConvolutionEffect
from polishd.process.dwell import douglas_rachford, interior_point, newton_cg
from polishd.process.dwell.budget import to_target, within_budget
from polishd.process.dwell.curve import Solve, solved
from polishd.process.dwell.problem import DwellProblem
from polishd.process.dwell.sampled_tif import MapAxes, check_points, check_tif, map_axes, sampled_effect
from polishd.process.dwell.setup import choose_piston_nm, regularisation_from_rho
from polishd.process.dwell.validation import check
from polishd.process.robot.refusal import require_number

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
    """Of that lattice, see `dwell_lattice`."""
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
    """Of the regularisation: ``regularisation N_r / sigma_max^2``."""


@dataclass(frozen=True, slots=True)
class ArrayDwell:
    """What `dwell_from_arrays` gives."""

    points_mm: FloatArray
    """(n, 2) x and y of the dwell points, in the map's coordinates."""
    problem: DwellProblem
    """What was solved, with its price of time, regularisation and piston."""
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
        found = within_budget(problem, budget_s, run)
    elif target_rms_nm is not None:
        found = to_target(problem, target_rms_nm, run)
    else:
        check(problem)
        found = solved(problem, run)
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
