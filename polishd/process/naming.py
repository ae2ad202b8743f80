"""Which of a loop's assumptions failed, by name: from the gate's verdict and what a pass leaves unexplained.

The classes are `polishd.model.cause.CAUSES`. How large each must be, and how often each is named rightly:
docs/naming.md.
"""

from __future__ import annotations

from collections.abc import Sequence

from polishd.model.beliefs import Estimate
from polishd.model.cause import CauseName, Diagnosis
from polishd.model.text import with_error
from polishd.process.gate import MAX_SHIFT_MM, MIN_CORRELATION, RemovalCheckResult
from polishd.process.leftover import ResidualFit

SIGMAS = 4.0
"""Standard errors by which a size must be other than none: a cell makes thousands of passes."""
LOW_SIGMAS = 8.0
"""The same of low orders, whose error is that of seven neighbours: as rare as four of an error that is known."""
KNOWN_RATE = 0.04
"""Standard error of a rate that a witness spot or an earlier part has told: 16 % off is none of a good cell's."""
LEAST_MM = 0.15
"""Of a shift: what robots that are not calibrated, and pictures that are a little distorted, have without a cause."""
SHARE = 0.01
"""Of the removal: a good tool's rate changes by so much over a part, which reads as low orders."""
LEAST_NM = 0.1
"""Of low orders between two maps with no pass between: less is no harm to a part that is wanted to a nanometre."""
MAPS = 12
"""Most that are taken until two in a row agree, ..."""
WAIT_S = 120.0
"""... and so far apart, where the cell does not say (`between.settle`): 24 minutes in all."""
HARM = 0.5
"""Of what a part may be off, RMS: what changes by less from map to map is told, and holds nobody up."""


def diagnose_removal(verdict: RemovalCheckResult, most_shift_mm: float = MAX_SHIFT_MM) -> Diagnosis:
    """What stopped the cell, in the order of `gate.judge`'s own reasons, as it was allowed a shift."""
    if not verdict.best.as_it_is:
        what = f"the removal looks like the predicted one {verdict.best.name}"
        return Diagnosis("map", verdict.best.correlation, 0.0, MIN_CORRELATION, "1", what)
    distance = Estimate((verdict.shift_mm[0] ** 2 + verdict.shift_mm[1] ** 2) ** 0.5, max(verdict.shift_sigma_mm))
    if distance.value > most_shift_mm:
        return _named("shift", distance, most_shift_mm, "mm", "the removal lies {} off its place")
    return _rate(Estimate(verdict.rate, verdict.rate_sigma))


def diagnose_pass(
    verdict: RemovalCheckResult,
    left: ResidualFit | None,
    removed_nm: float,
    again: Sequence[Diagnosis] | None = None,
    most_shift_mm: float = MAX_SHIFT_MM,
) -> tuple[Diagnosis, ...]:
    """All that a pass names, suspicions first where there are any.

    Args:
        verdict: the gate's.
        left: what the pass left (`leftover`); None: its samples are too few.
        removed_nm: RMS of the predicted removal, mean included.
        again: what the maps since the pass have named among themselves (`of_change`); None: there is one map only.
        most_shift_mm: that the gate allowed.
    """
    stopped = (diagnose_removal(verdict, most_shift_mm),) if verdict.stop else ()
    if left is None or any(one.cause == "map" for one in stopped):
        return stopped
    bent = _bent(left, SHARE * removed_nm)
    if bent and again is None:
        return tuple(_suspected(one) for one in bent)  # first: low orders read as a shift and a rate, too
    if stopped:
        return (*stopped, *(again or ()))  # its low orders are of the same cause
    moves = {one.cause for one in again or ()}  # what changes with no pass between is no pass's
    told = (*(again or ()), *(_of_process(one) for one in bent if one.cause not in moves))
    if not verdict.tells_rate:
        return told
    found = [_named("shift", left.shift_mm, LEAST_MM, "mm", "the removal lies {} off its place")]
    if left.rate is not None and left.shift_mm.value <= MAX_SHIFT_MM:  # beside a larger one, first order tells none
        found.append(_rate(left.rate))
    return (*(one for one in found if one.size > one.limit), *told)


def diagnose_change(left: ResidualFit | None) -> tuple[Diagnosis, ...]:
    """What two maps with no pass between name: what is set up anew, or has cooled, is no removal."""
    return () if left is None else _bent(left, LEAST_NM)


def is_settling(found: Sequence[Diagnosis], before: Sequence[Diagnosis]) -> bool:
    """Whether another map is worth waiting for: what cools changes less from map to map, a mount or set-up does not.

    Args:
        found: by the last map and the one before it.
        before: by that and the one before; empty where there is none.
    """
    last_nm = max((one.size for one in before), default=float("inf"))
    return bool(found) and all(one.cause == "settling" and one.size < last_nm for one in found)


def harmful(found: Sequence[Diagnosis], wanted_nm: float) -> tuple[Diagnosis, ...]:
    """What changes so much from map to map that a part which may be off by ``wanted_nm`` cannot be judged by one."""
    return tuple(one for one in found if one.size > HARM * wanted_nm)


def persistent(found: Sequence[Diagnosis]) -> tuple[Diagnosis, ...]:
    """Of what many maps named, each cause once, where it was largest."""
    causes = dict.fromkeys(one.cause for one in found)
    return tuple(max((one for one in found if one.cause == cause), key=lambda one: one.size) for cause in causes)


def _bent(left: ResidualFit, least_nm: float) -> tuple[Diagnosis, ...]:
    """Low orders that are beyond their limits."""
    found = (
        _named("settling", left.power_nm, least_nm, "nm", "power changed by {}", sigmas=LOW_SIGMAS),
        _named("settling", left.astigmatism_nm, least_nm, "nm", "astigmatism changed by {}", sigmas=LOW_SIGMAS),
        _named("mount", left.trefoil_nm, least_nm, "nm", "a trefoil changed by {}", sigmas=LOW_SIGMAS),
    )
    return persistent([one for one in found if one.size > one.limit])


def _named(
    cause: CauseName, found: Estimate, least: float, unit: str, what: str, *, sigmas: float = SIGMAS
) -> Diagnosis:
    sigma = float("inf") if found.sigma is None else found.sigma
    size, limit = abs(found.value), max(sigmas * sigma, least)
    return Diagnosis(cause, size, sigma, limit, unit, what.format(f"{size:.3g} +- {sigma:.2g} {unit}"))


def _rate(rate: Estimate) -> Diagnosis:
    sigma = float("inf") if rate.sigma is None else rate.sigma
    what = f"the measured removal is {with_error(rate.value, sigma)} times the predicted one"
    return Diagnosis("rate", abs(rate.value - 1), sigma, SIGMAS * (sigma**2 + KNOWN_RATE**2) ** 0.5, "1", what)


def _suspected(one: Diagnosis) -> Diagnosis:
    return Diagnosis(one.cause, one.size, one.sigma, one.limit, one.unit, one.what, again=True)


def _of_process(one: Diagnosis) -> Diagnosis:
    """What maps since do not change any more."""
    return Diagnosis("field", one.size, one.sigma, one.limit, one.unit, f"{one.what} in the pass, and stays")
