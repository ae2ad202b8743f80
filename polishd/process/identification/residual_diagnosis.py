"""Fit of the difference of two maps: a removal that is scaled and shifted, and unexplained low orders.

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
"""Neighboring terms, which neither temperature nor mount causes: their size measures noise and tool."""


@dataclass(frozen=True, slots=True)
class ResidualFit:
    """Fitted terms with standard errors. Sizes are RMS over the circle of the mask.

    The error of a low order is the larger of its scatter over the map's tiles and the RMS of its neighboring terms in
    the residual: tiles do not show the error of a term that is as long as the part.
    """

    rate: Estimate | None
    """Measured over predicted removal; None between two maps with no pass between."""
    shift_mm: Estimate
    """Length of the shift of the removal from its prediction."""
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
    """Fit all terms together with piston and tilt by least squares; None where the samples are too few.

    Args:
        changed_nm: (ny, nx) map before less map after, positive = removed.
        mask: (ny, nx) samples to compare.
        pitch_mm: of the grid.
        predicted_nm: (ny, nx) removal predicted of the pass between, positive = removed; None: there was none.
        removal: unknown terms of a change; with "power" the result's power is 0.
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
    """RMS of the neighboring terms in the residual; fitted, they would be confounded with the rate on a small part."""
    terms = np.column_stack([neighbour[mask] for neighbour in neighbours])
    return float(np.sqrt(np.mean(np.linalg.lstsq(terms, left_nm, rcond=None)[0] ** 2)))


def _length(vector: FloatArray, errors: FloatArray) -> Estimate:
    """Return the length of a vector, with the larger of the components' errors."""
    return Estimate(float(np.linalg.norm(vector)), float(np.abs(errors).max()))


def _slopes(height_nm: FloatArray, pitch_mm: float) -> list[FloatArray]:
    """Return the change of a removal that is shifted by 1 mm along x, along y; y goes up, rows go down."""
    down, right = (np.asarray(np.gradient(height_nm, pitch_mm, axis=axis), dtype=np.float64) for axis in (0, 1))
    return [-right, down]


def _modes(mask: BoolArray) -> list[FloatArray]:
    """Return terms (ny, nx) of RMS 1 over the circle that the mask fills, zero outside it."""
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


# Diagnosis by cause, from the removal check and the residual of a pass.

SIGMAS = 4.0
"""Standard errors by which a size must differ from 0: a cell makes thousands of passes."""
LOW_SIGMAS = 8.0
"""Standard errors for low orders, whose error comes from seven neighbors: as rare as four of a known error."""
KNOWN_RATE = 0.04
"""Standard error of a rate from a witness spot or an earlier part: a good cell is not off by 16 %."""
LEAST_MM = 0.15
"""Least shift to report: uncalibrated robots and slightly distorted images show less without a cause."""
SHARE = 0.01
"""Share of the removal by which a good tool's rate varies over a part, which appears as low orders."""
LEAST_NM = 0.1
"""Least low order to report between two maps without a pass: less does not matter to a 1 nm tolerance."""
MAPS = 12
"""Most maps to measure until two in a row agree, ..."""
WAIT_S = 120.0
"""... and their interval, as defaults of `part_handling.settle`: 24 minutes in all."""
HARM = 0.5
"""Share of the part's tolerance, RMS: a smaller change from map to map is reported and does not delay the job."""


def diagnose_removal(verdict: RemovalCheckResult, most_shift_mm: float = MAX_SHIFT_MM) -> Diagnosis:
    """Return the cause of a stop, in the order of the reasons of `check_removal`."""
    if not verdict.best.as_it_is:
        what = f"the removal looks like the predicted one {verdict.best.name}"
        return Diagnosis("map", verdict.best.correlation, 0.0, MIN_CORRELATION, "1", what)
    distance = Estimate((verdict.shift_mm[0] ** 2 + verdict.shift_mm[1] ** 2) ** 0.5, max(verdict.shift_sigma_mm))
    if distance.value > most_shift_mm:
        return _named("shift", distance, most_shift_mm, "mm", "the removal is shifted by {}")
    return _rate(Estimate(verdict.rate, verdict.rate_sigma))


def diagnose_pass(
    verdict: RemovalCheckResult,
    left: ResidualFit | None,
    removed_nm: float,
    again: Sequence[Diagnosis] | None = None,
    most_shift_mm: float = MAX_SHIFT_MM,
) -> tuple[Diagnosis, ...]:
    """Return the diagnoses of a pass, suspected ones first.

    Args:
        verdict: of the removal check.
        left: fit of the residual (`fit_residual`); None: too few samples.
        removed_nm: RMS of the predicted removal, mean included.
        again: diagnoses of the maps since the pass (`diagnose_change`); None: there is only one map.
        most_shift_mm: limit of the removal check.
    """
    stopped = (diagnose_removal(verdict, most_shift_mm),) if verdict.stop else ()
    if left is None or any(one.cause == "map" for one in stopped):
        return stopped
    bent = _bent(left, SHARE * removed_nm)
    if bent and again is None:
        return tuple(
            Diagnosis(one.cause, one.size, one.sigma, one.limit, one.unit, one.what, again=True) for one in bent
        )  # first: low orders appear as shift and rate, too
    if stopped:
        return (*stopped, *(again or ()))  # its low orders have the same cause
    moves = {one.cause for one in again or ()}  # a change without a pass is not caused by a pass
    low_orders = (*(again or ()), *(_of_process(one) for one in bent if one.cause not in moves))
    if not verdict.tells_rate:
        return low_orders
    found = [_named("shift", left.shift_mm, LEAST_MM, "mm", "the removal is shifted by {}")]
    if (
        left.rate is not None and left.shift_mm.value <= MAX_SHIFT_MM
    ):  # the first-order fit is invalid beside a larger shift
        found.append(_rate(left.rate))
    return (*(one for one in found if one.size > one.limit), *low_orders)


def diagnose_change(left: ResidualFit | None) -> tuple[Diagnosis, ...]:
    """Return the diagnoses of two maps without a pass between them: set-up or temperature changed, not removal."""
    return () if left is None else _bent(left, LEAST_NM)


def is_settling(found: Sequence[Diagnosis], before: Sequence[Diagnosis]) -> bool:
    """Return whether another map is worth waiting for: a cooling part changes less from map to map, a mount does not.

    Args:
        found: by the last map and the one before it.
        before: by that and the one before; empty where there is none.
    """
    last_nm = max((one.size for one in before), default=float("inf"))
    return bool(found) and all(one.cause == "settling" and one.size < last_nm for one in found)


def limiting_change(found: Sequence[Diagnosis], wanted_nm: float) -> tuple[Diagnosis, ...]:
    """Return the changes from map to map that are too large to accept a part of tolerance ``wanted_nm`` by one map."""
    return tuple(one for one in found if one.size > HARM * wanted_nm)


def largest_of_each_cause(found: Sequence[Diagnosis]) -> tuple[Diagnosis, ...]:
    """Return the largest diagnosis of each cause."""
    causes = dict.fromkeys(one.cause for one in found)
    return tuple(max((one for one in found if one.cause == cause), key=lambda one: one.size) for cause in causes)


def _bent(left: ResidualFit, least_nm: float) -> tuple[Diagnosis, ...]:
    """Return the low orders beyond their limits."""
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


def _of_process(one: Diagnosis) -> Diagnosis:
    """Return a change by the pass that later maps confirm."""
    return Diagnosis("field", one.size, one.sigma, one.limit, one.unit, f"{one.what} in the pass, and stays")
