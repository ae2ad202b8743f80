"""What two maps differ by: a removal that is scaled and moved, and low orders that none explains.

Temperature and set-up bend a part between two maps: power and astigmatism. Three points of a mount print through as a
trefoil (J. E. Nelson, J. Lubliner, T. S. Mast, "Telescope mirror supports: plate deflections on point supports",
Proc. SPIE 332, 212, 1982). Left out of a fit they read as rate and shift: 4 nm of power as up to 1 mm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from polishd.model.estimates import CauseName, Diagnosis, Estimate
from polishd.model.surface import BoolArray, FloatArray, Grid
from polishd.model.text import with_error
from polishd.process.identification.removal_check import MAX_SHIFT_MM, MIN_CORRELATION, RemovalCheckResult
from polishd.process.identification.removal_fit import FEWEST, regress_signals, remove_plane
from polishd.process.metrology.statistics import Removal
from polishd.process.metrology.zernike import order, values

NOLL = (4, 5, 6, 9, 10)
"""Power, astigmatism at 45 and 0 degrees, trefoil as sine and cosine: their indices, after Noll."""
CHANCE = (7, 8, 11, 12, 13, 14, 15)
"""Their neighbours, which neither temperature nor mount makes: what these come to, is chance's and the tool's."""


@dataclass(frozen=True, slots=True)
class ResidualFit:
    """Each with its standard error. Sizes are RMS over the circle of the mask.

    Of low orders it is the scatter over the map's tiles or, where that is more, what the fit leaves of their
    neighbours, RMS: of what is as long as the part tiles know nothing.
    """

    rate: Estimate | None
    """Measured over predicted removal; None between two maps with no pass between."""
    shift_mm: Estimate
    """Length of the way by which the removal lies off its prediction."""
    power_nm: Estimate
    """Positive: the rim lost more than the removal explains; negative: it stands higher in the map after."""
    astigmatism_nm: Estimate
    trefoil_nm: Estimate


def fit_residual(
    changed_nm: FloatArray,
    mask: BoolArray,
    pitch_mm: float,
    predicted_nm: FloatArray | None = None,
    *,
    removal: Removal = "tilt",
) -> ResidualFit | None:
    """All of them in one least-squares fit, beside piston and tilt; None where the samples are too few.

    Args:
        changed_nm: (ny, nx) map before less map after, positive = removed.
        mask: (ny, nx) samples to compare.
        pitch_mm: of the grid.
        predicted_nm: (ny, nx) removal predicted of the pass between, positive = removed; None: there was none.
        removal: what nobody knows of a change: with "power" none is told of it, and 0 stands for it.
    """
    if np.count_nonzero(mask) < FEWEST:
        return None
    fitted = [] if predicted_nm is None else [predicted_nm, *_slopes(predicted_nm, pitch_mm)]
    modes, first = _modes(mask), len(fitted)
    if removal == "power":
        modes[0] = np.zeros(mask.shape)
    signals = [remove_plane(signal, mask, removal) for signal in (*fitted, *modes[: len(NOLL)])]
    measured = remove_plane(changed_nm, mask, removal)
    found = regress_signals(signals, measured, mask, lambda factors: factors, with_drift=False)
    size, left = found.factors, measured[mask] - found.terms @ found.factors
    error = np.concatenate(
        [found.scatter[:first], np.maximum(found.scatter[first:], _chance_nm(left, modes[len(NOLL) :], mask))]
    )
    power, astigmatism, trefoil = (slice(first + a, first + b) for a, b in ((0, 1), (1, 3), (3, 5)))
    rate = float(size[0]) if fitted else 1.0
    moved = (size[1:3] / (rate or 1.0), error[1:3] / (rate or 1.0)) if fitted else (np.zeros(2), np.zeros(2))
    return ResidualFit(
        rate=Estimate(rate, float(error[0])) if fitted else None,
        shift_mm=_length(*moved),
        power_nm=Estimate(float(size[power][0]), float(error[power][0])),
        astigmatism_nm=_length(size[astigmatism], error[astigmatism]),
        trefoil_nm=_length(size[trefoil], error[trefoil]),
    )


def _chance_nm(left_nm: FloatArray, neighbours: Sequence[FloatArray], mask: BoolArray) -> float:
    """RMS of the neighbours in what the fit leaves: as terms of it they would take the rate's place on a small part."""
    terms = np.column_stack([neighbour[mask] for neighbour in neighbours])
    return float(np.sqrt(np.mean(np.linalg.lstsq(terms, left_nm, rcond=None)[0] ** 2)))


def _length(vector: FloatArray, errors: FloatArray) -> Estimate:
    """With the larger of the components' errors."""
    return Estimate(float(np.linalg.norm(vector)), float(np.abs(errors).max()))


def _slopes(height_nm: FloatArray, pitch_mm: float) -> list[FloatArray]:
    """What a removal that is moved by 1 mm along x, along y has more: y goes up, rows go down."""
    down, right = (np.asarray(np.gradient(height_nm, pitch_mm, axis=axis), dtype=np.float64) for axis in (0, 1))
    return [-right, down]


def _modes(mask: BoolArray) -> list[FloatArray]:
    """(ny, nx) each: of RMS 1 over the circle that the mask fills, zero outside it."""
    grid = Grid(mask.shape[0], mask.shape[1], 1.0)
    rows, columns = np.nonzero(mask)
    x, y = grid.x_mm[columns], grid.y_mm[rows]
    x, y = x - (x.max() + x.min()) / 2, y - (y.max() + y.min()) / 2
    circle = float(np.hypot(x, y).max())
    indices = (*NOLL, *CHANCE)
    pairs = order("noll", max(indices))
    made = []
    for term in values([pairs[index - 1] for index in indices], "rms", x / circle, y / circle):
        mode = np.zeros(mask.shape)
        mode[mask] = term
        made.append(mode)
    return made


# Which of a loop's assumptions failed, by name: from the gate's verdict and what a pass leaves unexplained.

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


def limiting_change(found: Sequence[Diagnosis], wanted_nm: float) -> tuple[Diagnosis, ...]:
    """What changes so much from map to map that a part which may be off by ``wanted_nm`` cannot be judged by one."""
    return tuple(one for one in found if one.size > HARM * wanted_nm)


def largest_of_each_cause(found: Sequence[Diagnosis]) -> tuple[Diagnosis, ...]:
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
    return largest_of_each_cause([one for one in found if one.size > one.limit])


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
