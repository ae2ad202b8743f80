"""A dwell for a tool that polishes while it moves, without a matrix, to an objective within GAP of the least.

Beside L-BFGS-B with the same products: both get the effect. Beside a matrix: bench_moving_matrix.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np

from benchmarks.bench_dwell import FEED_MM_S, Goal, lbfgsb, path, require
from benchmarks.bench_effect import Case
from benchmarks.dwell_cases import UNREACHED, surface
from benchmarks.harness import Progress, Row, Runner, race
from polishd.model.dwell import DwellSolution
from polishd.model.surface import Grid
from polishd.process.dwell import alternating_directions
from polishd.process.dwell.problem import DwellProblem
from polishd.process.dwell.quadratic import choose_piston_nm, quadratic, regularisation_from_rho
from polishd.process.removal.effect import Effect
from polishd.process.removal.spread_effect import SpreadEffect, spread_effect
from polishd.process.toolpath.apertures import circle
from polishd.process.toolpath.paths import raster

GAP = 1e-6
CASES = (Case(300.0, 1.0, 1.0, 10.0, 1e-3), Case(200.0, 0.5, 0.93, 10.0, 1e-3))
LEAST_NM = 10.0
"""Removed by the fastest motion: a figure that can be corrected."""
CAP_S = 900.0


def rows(progress: Progress) -> Iterator[Row]:
    """A cell takes a matrix for smaller spots: bench_dwell."""
    for case in CASES:
        progress(f"moving: preparing phi {case.diameter_mm:g} mm, spot {case.radius_mm:g} mm")
        part = Part(case)
        yield solved(part, progress)


def reached(best: DwellSolution) -> Goal:
    return Goal(best.certificate.objective * (1 + GAP))


class Part:
    """A disc, a raster on it, and the data that the race needs before it."""

    def __init__(self, case: Case) -> None:
        self.case = case
        side = int((case.diameter_mm + 2 * case.radius_mm) / case.pitch_mm) + 1
        self.grid = Grid(side, side, case.pitch_mm)
        self.program = path(raster(circle(case.diameter_mm), case.step_mm, case.step_mm))
        self.gamma = np.asarray(0.875 + 0.035 * np.sin(self.program.end_mm[:, 0] / 30))
        self.problem = self.of(self.without())
        self.goal = reached(alternating_directions.solve(self.problem, 3600.0, 0.0, GAP / 100))  # a proved gap

    @property
    def name(self) -> str:
        case = self.case
        return f"phi {case.diameter_mm:g} mm, {self.program.n} blocks, spot {case.radius_mm:g} mm, gap {GAP:g}"

    def without(self) -> SpreadEffect:
        spot, one = self.case.spot, np.ones(self.program.n)
        return spread_effect(self.grid, spot, self.program, self.gamma, one, tolerance=self.case.tolerance)

    def of(self, effect: Effect) -> DwellProblem:
        """Return the same figure for any of its effects, long enough that few bounds are active."""
        solve, clear = (self.grid.radius_mm() <= self.case.diameter_mm / 2 - edge for edge in (0.0, 3.0))
        height, lower = surface(self.grid, solve, 1), self.program.length_mm / FEED_MM_S
        lower *= LEAST_NM / float(np.median(effect.removal_nm(lower)[solve]))
        target = height + choose_piston_nm(height, solve, effect.removal_nm(lower), UNREACHED)
        p = regularisation_from_rho(effect, solve, 1e-4)
        return DwellProblem(effect, target, solve, clear, lower, np.full(lower.size, np.inf), p)


def solved(part: Part, progress: Progress) -> Row:
    """CPU seconds from the lower bound, the effect given."""
    peers: dict[str, Runner] = {"scipy L-BFGS-B (m = 10), same products": partial(by_lbfgsb, part)}
    return race(f"dwell of a moving tool, {part.name}", partial(ours, part), peers, progress=progress, peer_cap_s=CAP_S)


def ours(part: Part) -> None:
    of(part.problem, part.goal)


def of(problem: DwellProblem, goal: Goal) -> None:
    require(quadratic(problem), alternating_directions.solve(problem, 3600.0, 0.0, GAP).time_s, problem, goal)


def by_lbfgsb(part: Part) -> None:
    lbfgsb(part.problem, quadratic(part.problem), part.goal)
