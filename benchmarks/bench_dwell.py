"""Dwell solve of a demo-size part, to a relative objective gap of 1e-6: ours, and scipy's L-BFGS-B."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy import optimize

from benchmarks.harness import Progress, Row, race
from polishd.model.process import ToolProcess
from polishd.model.program import Program
from polishd.model.surface import FloatArray, Grid
from polishd.process.dwell import newton_cg
from polishd.process.dwell.problem import DwellProblem
from polishd.process.dwell.quadratic import QuadraticObjective, choose_piston_nm, quadratic, regularisation_from_rho
from polishd.process.removal.dynamic_tif import effect_matrix
from polishd.process.removal.effect import SparseEffect
from polishd.process.removal.tif import HertzSpot
from polishd.process.toolpath.apertures import circle
from polishd.process.toolpath.paths import raster

GAP = 1e-6
RADII_MM = (50.0, 150.0)
FEED_MM_S = 50.0


def rows(progress: Progress) -> Iterator[Row]:
    """Two sizes; both solvers start at the lower bound with the same products and stop at the same objective."""
    for radius_mm in RADII_MM:
        progress(f"dwell: preparing phi {2 * radius_mm:g} mm")
        problem = part(radius_mm)
        f = quadratic(problem)
        reference = newton_cg.solve(problem, 600.0, 1e-10).certificate
        if not reference.kkt_residual <= 1e-9:
            raise RuntimeError(f"the reference has a KKT residual of {reference.kkt_residual:g}")
        goal = Goal(reference.objective * (1 + GAP))
        name = f"dwell solve, phi {2 * radius_mm:g} mm, {problem.effect.n} points, gap {GAP:g}"
        yield race(
            name,
            partial(ours, problem, f, goal),
            {"scipy L-BFGS-B (m = 10)": partial(lbfgsb, problem, f, goal)},
            progress=progress,
        )


@dataclass(frozen=True)
class Goal:
    """The objective to reach."""

    objective: float


def ours(problem: DwellProblem, f: QuadraticObjective, goal: Goal) -> None:
    zero = np.zeros(problem.effect.n)
    value, slope = f.value(zero), f.gradient(zero)

    def stop(t: FloatArray, gradient: FloatArray) -> str | None:
        reached = float(t @ (gradient + slope)) / 2 + value  # of a quadratic
        return "reached" if reached <= goal.objective else None

    t, _, _ = newton_cg.minimise(f, (problem.lower_s, problem.upper_s), problem.lower_s, stop)
    require(f, t, problem, goal)


def lbfgsb(problem: DwellProblem, f: QuadraticObjective, goal: Goal) -> None:
    m = f.target.size

    def both(t: FloatArray) -> tuple[float, FloatArray]:
        miss = f.forward(t) - f.target
        value = float(miss @ miss) / m + f.regularisation * float(t @ t)
        return value, 2 / m * f.backward(miss) + 2 * f.regularisation * t

    def stop(intermediate_result: optimize.OptimizeResult) -> None:
        if intermediate_result.fun <= goal.objective:
            raise StopIteration

    found = optimize.minimize(
        both,
        problem.lower_s,
        jac=True,
        method="L-BFGS-B",
        bounds=optimize.Bounds(problem.lower_s, problem.upper_s),
        callback=stop,
        options={"maxcor": 10, "maxiter": 100_000, "maxfun": 100_000, "ftol": 0.0, "gtol": 0.0},
    )
    require(f, found.x, problem, goal)


def require(f: QuadraticObjective, t: FloatArray, problem: DwellProblem, goal: Goal) -> None:
    """Fail the race for a solver that stopped early or left its bounds."""
    if f.value(t) > goal.objective * (1 + 1e-9) or (t < problem.lower_s).any() or (t > problem.upper_s).any():
        raise RuntimeError(f"reached {f.value(t):g} of {goal.objective:g}")


def part(radius_mm: float) -> DwellProblem:
    """A disc at 1 mm, 18.5 nm RMS, the paper's process with a compliance that varies, a raster at 50 mm/s at most."""
    points = raster(circle(2 * radius_mm), 1.0, 1.0)
    program = path(points)
    n = int(2 * radius_mm + 10)
    grid = Grid(n, n, 1.0)
    process = ToolProcess()
    gamma = 0.875 + 0.035 * np.sin(points[1:, 0] / 30)
    matrix = effect_matrix(grid, HertzSpot(process), program, gamma, np.ones(program.n))
    effect, solve = SparseEffect(grid, matrix), grid.radius_mm() <= radius_mm
    height = surface(grid, solve)
    lower = program.length_mm / FEED_MM_S
    target = height + choose_piston_nm(height, solve, effect.removal_nm(lower))
    clear = grid.radius_mm() <= radius_mm - 3
    p = regularisation_from_rho(effect, solve, 1e-4)
    return DwellProblem(effect, target, solve, clear, lower, program.length_mm / 0.5, p)


def path(points_mm: FloatArray) -> Program:
    n = len(points_mm) - 1
    axis = np.tile([np.sin(np.radians(15)), 0.0, np.cos(np.radians(15))], (n, 1))
    lines = np.arange(n)
    start, end = points_mm[:-1], points_mm[1:]
    return Program(b"", "", "bench", "rs274", "feed", lines + 1, lines, start, end, axis, np.ones(n), n, 3000.0)


def surface(grid: Grid, inside: np.ndarray) -> FloatArray:
    """(ny, nx) nm: a figure that falls towards 7 mm, and 0.3 nm of noise."""
    rng = np.random.default_rng(1)
    f = np.hypot(np.fft.fftfreq(grid.ny)[:, None], np.fft.rfftfreq(grid.nx)[None, :])
    size = np.where((f > 0) & (f < 1 / 7), 1 / (1 + (40 * f) ** 2), 0.0)
    height = np.fft.irfft2(size * np.exp(2j * np.pi * rng.random(f.shape)), grid.shape)
    height = (height - height[inside].mean()) * 18.5 / height[inside].std()
    return np.asarray(height + 0.3 * rng.standard_normal(grid.shape), dtype=np.float64)
