"""Residual against time: a path of solved problems, and the rules that choose one point of it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from polishd.model.dwell import DwellSolution, Start
from polishd.model.errors import ComputeError
from polishd.process.dwell.problem import DwellProblem, check
from polishd.process.dwell.quadratic import quadratic
from polishd.process.metrology.statistics import slope

Solve = Callable[[DwellProblem], DwellSolution]
"""A solver with its deadline and tolerance bound; ``problem.warm`` is the last solution of the path."""
Row = dict[str, float | int | str | list[str] | None]

# Of the price at which polishing stops altogether: two a decade, and last no price at all.
PRICES = (*np.logspace(-1, -8, 15).tolist(), 0.0)


CERTIFIED = ("objective", "kkt_residual", "at_lower", "at_upper", "solver", "iterations", "seconds", "stopped")
"""As in the certificate."""


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
        """Return figures, certificate and request as JSON values; units in the keys."""
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
class ResidualCurve:
    """Solved problems in the order of solution, each with its certificate."""

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


def price_curve(problem: DwellProblem, solve: Solve, prices_nm2_per_s: Sequence[float] | None = None) -> ResidualCurve:
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
        points.append(solve_once(step, solve, points[-1].solution if points else problem.warm))
    if not points:
        raise ComputeError("a curve needs at least one point")
    return ResidualCurve(tuple(points))


def highest_price(problem: DwellProblem) -> float:
    """nm^2/s: the price of time from which on every point stays at its lower bound."""
    downhill = -quadratic(replace(problem, price_nm2_per_s=0.0)).gradient(problem.lower_s)
    return max(float(downhill.max()), 0.0)


def solve_once(problem: DwellProblem, solve: Solve, warm: Start | None = None) -> CurvePoint:
    """Solve once, from ``warm`` (default: the problem's own)."""
    return CurvePoint(replace(problem, warm=None), solve(problem if warm is None else replace(problem, warm=warm)))


# A dwell for a time budget or for a target residual, and what the dwell floor costs.

BUDGET_TOLERANCE = 1e-3
TARGET_TOLERANCE = 1e-2
MAX_SOLVES = 60
# Of the highest price: below it the price is lost in rounding beside the gradient.
LEAST_PRICE = 1e-13


def solve_within_budget(
    problem: DwellProblem, budget_s: float, solve: Solve, tolerance: float = BUDGET_TOLERANCE
) -> CurvePoint:
    """The best residual with ``sum(t) <= budget_s``: the price of time at which the budget is just used up.

    Args:
        problem: the problem. The search starts no lower than its price.
        budget_s: total time, s.
        solve: the solver; each solve starts from the last.
        tolerance: how much of the budget may stay unused, as a fraction of it, where it binds.

    Returns:
        The problem with its price, and the solution. Never over budget; a note says whether the budget binds.

    Raises:
        ComputeError: the problem is malformed, or the lower bounds alone take more than the budget.
    """
    check(problem)
    least = float(problem.lower_s.sum())
    if not least <= budget_s:
        raise ComputeError(f"the budget is {budget_s:.6g} s, but the dwell floor alone takes {least:.6g} s")
    cheap = solve_once(problem, solve)
    if cheap.total_s <= budget_s:
        return _noted(cheap, f"the budget of {budget_s:.6g} s does not bind")
    aim = (1 - tolerance / 2) * budget_s
    found = _search(
        cheap,
        solve,
        lambda point: aim - point.total_s,
        accept=lambda point: (1 - tolerance) * budget_s <= point.total_s <= budget_s,
        feasible=lambda point: point.total_s <= budget_s,
    )
    binds = f"the budget of {budget_s:.6g} s binds at {found.problem.price_nm2_per_s:.6g} nm^2/s"
    better = possible_gain_nm(found, budget_s)
    return _noted(found, binds if better is None else f"{binds}: no dwell within it leaves {better:.2g} nm less")


def possible_gain_nm(found: CurvePoint, budget_s: float) -> float | None:
    """By how much less any dwell that takes no more than ``budget_s`` can leave at most, nm of the objective's root.

    The price is the budget's multiplier: whatever keeps to the budget costs no less than the priced least, less the
    price of all of it. Without the price the objective is the residual's and the regularisation's. None: nothing is
    proved.
    """
    certificate, price = found.solution.certificate, found.problem.price_nm2_per_s
    if certificate.gap is None:
        return None
    left = max(certificate.objective - price * found.total_s, 0.0)
    gap = certificate.gap * certificate.objective + price * max(budget_s - found.total_s, 0.0)
    return float(left**0.5 - max(left - gap, 0.0) ** 0.5)


@dataclass(frozen=True, slots=True)
class ResidualGoal:
    """A residual to reach in the clear aperture: its RMS, the RMS of its slope, or both."""

    rms_nm: float | None = None
    slope_urad: float | None = None

    @property
    def wanted(self) -> bool:
        """There is one."""
        return self.rms_nm is not None or self.slope_urad is not None

    def share(self, point: CurvePoint) -> float:
        """Return the residual over its limit, the worse of both: 1 just reaches the goal."""
        shares = []
        if self.rms_nm is not None:
            shares.append(point.rms_nm / self.rms_nm)
        if self.slope_urad is not None:
            shares.append(point.slope_urad / self.slope_urad)
        return max(shares)

    def __str__(self) -> str:
        asked = [] if self.rms_nm is None else [f"{self.rms_nm:.6g} nm RMS"]
        return " with ".join([*asked, *([] if self.slope_urad is None else [f"a slope of {self.slope_urad:.6g} urad"])])


def solve_to_target(
    problem: DwellProblem, rms_nm: float, solve: Solve, tolerance: float = TARGET_TOLERANCE
) -> CurvePoint:
    """The least total time whose residual RMS in the clear aperture is at most ``rms_nm``; see `solve_to_goal`."""
    return solve_to_goal(problem, ResidualGoal(rms_nm), solve, tolerance)


def solve_to_goal(
    problem: DwellProblem, goal: ResidualGoal, solve: Solve, tolerance: float = TARGET_TOLERANCE
) -> CurvePoint:
    """The least total time whose residual reaches the goal.

    The highest price of time at which the goal is met, to ``tolerance`` of it. A slope is no part
    of the objective: of the dwells that are shortest for their residual the shortest is found whose slope is met.

    Raises:
        ComputeError: the problem is malformed, or even without a price of time the residual stays above the goal.
    """
    check(problem)
    cheap = solve_once(problem, solve)
    if not cheap.rms_nm > 0 or not goal.share(cheap) <= 1:
        least = f"{cheap.rms_nm:.6g} nm" + ("" if goal.slope_urad is None else f" and {cheap.slope_urad:.6g} urad")
        raise ComputeError(f"{goal} is out of reach: the least is {least} in {cheap.total_s:.6g} s")
    aim = 1 - tolerance / 2
    return _search(
        cheap,
        solve,
        lambda point: math.log(goal.share(point) / aim),
        accept=lambda point: 1 - tolerance <= goal.share(point) <= 1,
        feasible=lambda point: goal.share(point) <= 1,
    )


@dataclass(frozen=True, slots=True)
class FloorCost:
    """A problem with its dwell floor, without it, and with it and as much more to remove as the floor itself takes."""

    bounded: CurvePoint
    free: CurvePoint
    raised: CurvePoint

    def row(self) -> Row:
        """Return JSON values; a cost is the floor's increase of the free dwell's figure (0.02 is 2 %)."""
        bounded, free, raised = self.bounded, self.free, self.raised
        return {
            "floor_s": float(bounded.problem.lower_s.sum()),
            "at_floor": bounded.solution.certificate.at_lower,
            "free_rms_nm": free.rms_nm,
            "free_total_s": free.total_s,
            "rms_nm": bounded.rms_nm,
            "total_s": bounded.total_s,
            "rms_cost": bounded.rms_nm / free.rms_nm - 1,
            "time_cost_s": bounded.total_s - free.total_s,
            "raised_by_nm": raised.solution.certificate.piston_nm - bounded.solution.certificate.piston_nm,
            "raised_rms_nm": raised.rms_nm,
            "raised_total_s": raised.total_s,
            "raised_rms_cost": raised.rms_nm / free.rms_nm - 1,
            "raised_time_cost_s": raised.total_s - free.total_s,
        }


def floor_cost(problem: DwellProblem, solve: Solve) -> FloorCost:
    """What ``lower_s`` as a bound costs against ``t >= 0``, and what it costs where time may be spent on it.

    At the same target the floor digs where nothing is to be removed, which no solver mends. With the target raised by
    the most that the floor removes anywhere, that is wanted, and the residual comes back for the time it takes.

    Raises:
        ComputeError: the problem is malformed, or the solver fails.
    """
    check(problem)
    bounded = solve_once(problem, solve)
    free = solve_once(replace(problem, lower_s=0 * problem.lower_s), solve, bounded.solution)
    dug = float(problem.effect.removal_nm(problem.lower_s)[problem.solve_mask].max())
    raised = solve_once(replace(problem, target_nm=problem.target_nm + dug), solve, bounded.solution)
    return FloorCost(bounded, free, raised)


def _search(
    cheap: CurvePoint,
    solve: Solve,
    miss: Callable[[CurvePoint], float],
    *,
    accept: Callable[[CurvePoint], bool],
    feasible: Callable[[CurvePoint], bool],
) -> CurvePoint:
    """The price at which ``miss``, which rises with it and is negative for ``cheap``, is about 0.

    False position on the logarithm of the price, after Illinois: a residual far above its neighbour's is halved.
    Ends with the accepted point, or the feasible one of the least miss.
    """
    if accept(cheap):
        return cheap
    top = highest_price(cheap.problem)
    low, high = np.log(max(cheap.problem.price_nm2_per_s, LEAST_PRICE * top)), np.log(top)
    dear = solve_once(replace(cheap.problem, price_nm2_per_s=float(np.exp(high))), solve)
    seen, last = [cheap, dear], cheap
    at_low, at_high, side = miss(cheap), miss(dear), 0
    for _ in range(MAX_SOLVES):
        if accept(seen[-1]) or not (at_low < 0 < at_high and high - low > 1e-12):
            break
        share = -at_low / (at_high - at_low)
        where = low + min(max(share, 0.02), 0.98) * (high - low)
        last = solve_once(replace(cheap.problem, price_nm2_per_s=float(np.exp(where))), solve, last.solution)
        seen.append(last)
        here = miss(last)
        if here < 0:
            low, at_low, at_high = where, here, at_high / (2 if side < 0 else 1)
        else:
            high, at_high, at_low = where, here, at_low / (2 if side > 0 else 1)
        side = -1 if here < 0 else 1
    accepted = [point for point in seen if accept(point)]
    return min(accepted or filter(feasible, seen), key=lambda point: abs(miss(point)))


def _noted(point: CurvePoint, note: str) -> CurvePoint:
    certificate = point.solution.certificate
    noted = replace(certificate, notes=(*certificate.notes, note))
    return CurvePoint(point.problem, replace(point.solution, certificate=noted))
