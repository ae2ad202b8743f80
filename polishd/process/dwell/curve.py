"""Residual against time: a path of solved problems, and the rules that choose one point of it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from polishd.model.dwell import DwellSolution, Start
from polishd.model.errors import ComputeError
from polishd.process.dwell.problem import DwellProblem
from polishd.process.dwell.quadratic import quadratic
from polishd.process.dwell.validation import check
from polishd.process.metrics.slopes import slope

Solve = Callable[[DwellProblem], DwellSolution]
"""A solver with its deadline and tolerance bound; ``problem.warm`` is the last solution of the path."""
Row = dict[str, float | int | str | list[str] | None]

# Of the price at which polishing stops altogether: two a decade, and last no price at all.
PRICES = (*np.logspace(-1, -8, 15).tolist(), 0.0)


CERTIFIED = ("objective", "kkt_residual", "at_lower", "at_upper", "solver", "iterations", "seconds", "stopped")
"""Of the certificate, as it is."""


@dataclass(frozen=True, slots=True)
class CurvePoint:
    """A problem and its solution: the certificate is to be read against this problem's price and regularisation."""

    problem: DwellProblem
    solution: DwellSolution = field(repr=False)

    @property
    def total_s(self) -> float:
        """Total time."""
        return self.solution.certificate.dwell_total_s

    @property
    def rms_nm(self) -> float:
        """RMS (mean removed) of the predicted residual in the clear aperture."""
        return self.solution.certificate.predicted_rms_nm

    @property
    def slope_urad(self) -> float:
        """RMS of the slope of the same over two samples, urad."""
        residual, clear = self.solution.residual_nm, self.problem.metric_mask
        return slope(np.where(clear, residual, 0.0), clear, self.problem.effect.grid.pitch_mm).rms_urad

    def row(self) -> Row:
        """What JSON can hold of it: figures, certificate, and what was asked for; units in the keys."""
        c = self.solution.certificate
        return {
            "total_s": c.dwell_total_s,
            "rms_nm": c.predicted_rms_nm,
            "pv_nm": c.predicted_pv_nm,
            "band_rms_nm": c.predicted_band_rms_nm,
            "price_nm2_per_s": self.problem.price_nm2_per_s,
            "regularisation": self.problem.regularisation,
            "piston_nm": c.piston_nm,
            **{name: getattr(c, name) for name in CERTIFIED},
            "notes": list(c.notes),
        }


@dataclass(frozen=True, slots=True)
class Curve:
    """A path of solved problems, in the order they were solved, each certified by itself."""

    points: tuple[CurvePoint, ...]

    def rows(self) -> list[Row]:
        """One JSON-able object a point."""
        return [point.row() for point in self.points]

    def at_target(self, rms_nm: float) -> CurvePoint:
        """The shortest total time whose residual RMS is at or below ``rms_nm``.

        Raises:
            ComputeError: no point is that good; names the best.
        """
        good = [point for point in self.points if point.rms_nm <= rms_nm]
        if not good:
            best = min(self.points, key=lambda point: point.rms_nm)
            raise ComputeError(
                f"no point of the curve reaches {rms_nm:.6g} nm RMS: the best is {best.rms_nm:.6g} nm "
                f"in {best.total_s:.6g} s"
            )
        return min(good, key=lambda point: point.total_s)

    def within(self, budget_s: float) -> CurvePoint:
        """The least residual RMS whose total time is at most ``budget_s``.

        Raises:
            ComputeError: no point is that quick; names the quickest.
        """
        quick = [point for point in self.points if point.total_s <= budget_s]
        if not quick:
            least = min(point.total_s for point in self.points)
            raise ComputeError(f"no point of the curve takes at most {budget_s:.6g} s: the quickest takes {least:.6g}")
        return min(quick, key=lambda point: point.rms_nm)

    def knee(self) -> CurvePoint:
        """Where more time stops to pay: beyond it, 1 % more time buys less than 1 % of the residual.

        Walks back from the longest total time as long as ``residual RMS * total time`` falls. Unlike the largest
        curvature, or the largest distance from a chord, that does not depend on where the curve ends, nor on its being
        convex on logarithmic axes, which those of real maps are not.
        """
        back = sorted(self.points, key=lambda point: -point.total_s)
        knee = back[0]
        for point in back[1:]:
            if point.rms_nm * point.total_s > knee.rms_nm * knee.total_s:
                break
            knee = point
        return knee


def price_curve(problem: DwellProblem, solve: Solve, prices_nm2_per_s: Sequence[float] | None = None) -> Curve:
    """Walk the price of time down: the Pareto front itself.

    Where ``min residual + regularisation |t|^2 + price sum(t)`` is solved, no dwell of the same regularisation takes
    less time for the same residual: the price is the multiplier of a time budget. So this is the curve to choose on;
    the regularisation only conditions.

    Args:
        problem: the problem; its own price does not count.
        solve: the solver.
        prices_nm2_per_s: the prices, falling (each point starts from the last). Default: from a tenth of the price at
            which nothing is worth polishing down by two a decade to 1e-8 of it, and last 0.

    Raises:
        ComputeError: the problem or a price is impossible, or the solver fails.
    """
    check(problem)
    prices = highest_price(problem) * np.array(PRICES) if prices_nm2_per_s is None else prices_nm2_per_s
    points: list[CurvePoint] = []
    for price in prices:
        step = replace(problem, price_nm2_per_s=float(price))
        check(step)
        points.append(solved(step, solve, points[-1].solution if points else problem.warm))
    if not points:
        raise ComputeError("a curve needs at least one point")
    return Curve(tuple(points))


def highest_price(problem: DwellProblem) -> float:
    """nm^2/s: the price of time from which on every point stays at its lower bound."""
    downhill = -quadratic(replace(problem, price_nm2_per_s=0.0)).gradient(problem.lower_s)
    return max(float(downhill.max()), 0.0)


def solved(problem: DwellProblem, solve: Solve, warm: Start | None = None) -> CurvePoint:
    """Solve once, from ``warm`` (default: the problem's own)."""
    return CurvePoint(replace(problem, warm=None), solve(problem if warm is None else replace(problem, warm=warm)))
