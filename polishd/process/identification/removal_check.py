"""Removal check after a pass: the measured removal must be the predicted one, not mirrored, moved or scaled."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from polishd.model.errors import ComputeError
from polishd.model.surface import BoolArray, FloatArray
from polishd.model.text import with_error
from polishd.process.frames import ORIENTATIONS, orientations
from polishd.process.identification.removal_fit import (
    MIN_SIGNAL_NM,
    Fit,
    compare_predictions,
    fit,
    remove_plane,
    shift_samples,
    unknown_fit,
)
from polishd.process.metrology.commissioning import Explanation, explanations
from polishd.process.metrology.statistics import Removal

MIN_CORRELATION = 0.5
"""Least correlation of an explanation that stops the cell."""
MAX_SHIFT_MM = 0.5
"""Shift that costs a tenth of a pass's gain (physics.md, 6); smaller shifts are only reported."""
RATES = (0.6, 1.4)
"""Measured over predicted removal that the estimate of the rate can follow."""
SCALED = 0.1
"""Largest error of the rate at which a factor of 1/2 or 2 is outside of ``RATES``."""
SCALED_WORD = "scaled"
"""Name of the rate among the undecidable mistakes."""
SIGMAS = 3.0
"""Standard errors by which a shift must exceed its limit."""
RATE_SIGMAS = 2.0
"""Standard errors by which a rate must exceed its limits, which are far from the rates of a good cell."""
SURE = 3.5
"""Standard errors for a turn, flip, negation or shift by samples, which is the best of many tried."""
CLEAR_GAIN = 0.1
"""Gain in correlation that alone makes another explanation the better one."""
SMALL_GAIN = 0.01
"""Sufficient gain where the other explanation also halves the unexplained variance."""
LEFT_OVER = 0.5
STILL = Explanation(ORIENTATIONS[0], False, 0.0, (0.0, 0.0))
"""The prediction without turn, negation or shift."""


@dataclass(frozen=True, slots=True)
class RemovalCheckResult:
    """Comparison of the measured with the predicted removal, and whether the cell must stop."""

    stop: str
    """Reason to stop and what to do; "" where the cell may go on."""
    correlation: float
    """Correlation of measured and predicted removal, both without piston and tilt."""
    rate: float
    """Measured over predicted removal, of the best explanation; NaN without a signal."""
    rate_sigma: float
    best: Explanation
    shift_mm: tuple[float, float]
    """(x, y) by which the removal lies off the best explanation."""
    shift_sigma_mm: tuple[float, float]
    undecidable: tuple[str, ...]
    """Mistakes that this removal could not show: it is too weak, or too symmetric."""
    notes: tuple[str, ...]
    predicted_nm: FloatArray
    """(ny, nx) leveled, also used to estimate the rate. NaN outside the mask, as in all five."""
    measured_nm: FloatArray
    explained_nm: FloatArray
    """The best explanation: the prediction turned, negated, moved and scaled; NaN also where it has no data."""
    residual_nm: FloatArray
    """Measured less predicted."""
    best_residual_nm: FloatArray
    """Measured less the best explanation."""

    @property
    def tells_rate(self) -> bool:
        """Return whether this pass shows a wrong rate, so that it can estimate the rate."""
        return SCALED_WORD not in self.undecidable


def check_removal(
    predicted_nm: FloatArray, measured_nm: FloatArray, mask: BoolArray, pitch_mm: float,
    rates: tuple[float, float] = RATES, *, removal: Removal = "tilt", most_shift_mm: float = MAX_SHIFT_MM,
) -> RemovalCheckResult:  # fmt: skip
    """Compare measured with predicted removal, and stop where a flip, turn, negation, shift or factor fits better.

    Args:
        predicted_nm: (ny, nx) removal predicted from what was executed, positive = removed.
        measured_nm: (ny, nx) map before less map after; its piston and tilt are unknown.
        mask: (ny, nx) samples to compare.
        pitch_mm: of the grid.
        rates: measured over predicted removal that the estimate may follow; never beyond ``RATES``.
        removal: unknown terms of a removal, subtracted from both: "tilt", or "power" where power is alignment.
        most_shift_mm: a larger shift stops; a pass that measures the spot's offset may allow more.

    Raises:
        ComputeError: shapes that do not fit, or too few samples.
    """
    _check(predicted_nm, measured_nm, mask)
    levels = remove_plane(predicted_nm, mask, removal), remove_plane(measured_nm, mask, removal)
    seen = _Pass(*levels, mask, pitch_mm, rates, most_shift_mm)
    own = fit(seen.predicted_nm, seen.measured_nm, mask, None, pitch_mm)
    if np.sqrt(np.mean(seen.predicted_nm[mask] ** 2)) < MIN_SIGNAL_NM:
        return _without_signal(own, seen)
    found = [(e, seen.fit(e)) for e in explanations(seen.predicted_nm, seen.measured_nm, mask, mask, pitch_mm)]
    straight, moved = max((pair for pair in found if pair[0].as_it_is), key=_correlation)
    rival, turned = max((pair for pair in found if not pair[0].as_it_is), key=_correlation)
    better = _better(seen, straight, turned, moved) and seen.surely(rival, straight)
    if not seen.surely(straight, STILL):
        straight, moved = STILL, _without_unsure_shift(seen.fit(STILL), own)
    best, final = (rival, turned) if better else (straight, moved)
    best = replace(best, correlation=max(final.correlation, 0.0))
    stop = _reason(seen, best, moved, final)
    undecidable = () if better else _undecidable(seen, moved)
    notes = () if stop else _notes(seen, moved, undecidable)
    return _verdict(seen, own, final, best=best, stop=stop, undecidable=undecidable, notes=notes)


@dataclass(frozen=True, slots=True)
class _Pass:
    """Predicted and measured removal, both leveled, on one mask."""

    predicted_nm: FloatArray
    measured_nm: FloatArray
    mask: BoolArray
    pitch_mm: float
    rates: tuple[float, float]
    most_shift_mm: float

    @property
    def limits(self) -> tuple[float, float]:
        """Return the limits of the rate, never so wide that 1/2 or 2 lies within."""
        return max(RATES[0], self.rates[0]), min(RATES[1], self.rates[1])

    def beyond(self, moved: Fit) -> float:
        """Return by how much a rate is beyond its limits; not positive within them."""
        low, high = self.limits
        return max(low - moved.rate, moved.rate - moved.rate_excess - high)

    def fit(self, one: Explanation) -> Fit:
        """Fit rate and shift of the prediction under an explanation."""
        turned, mask = one.turn(self.predicted_nm), self.mask & one.turn_mask(self.mask)
        return fit(turned, self.measured_nm, mask, one.samples(self.pitch_mm), self.pitch_mm)

    def surely(self, other: Explanation, own: Explanation) -> bool:
        """Return whether one explanation is better than the other by more than noise makes the best of many."""
        gap, sigma = self.compare(other, own)
        return gap > SURE * sigma

    def compare(self, other: Explanation, own: Explanation) -> tuple[float, float]:
        """Return the advantage of one explanation over the other and its standard error: `compare_predictions`."""
        (own_nm, own_mask), (other_nm, other_mask) = self._placed(own), self._placed(other)
        return compare_predictions(other_nm, own_nm, self.measured_nm, self.mask & own_mask & other_mask)

    def _placed(self, one: Explanation) -> tuple[FloatArray, BoolArray]:
        down, right = one.samples(self.pitch_mm)
        height, mask = (shift_samples(v, down, right) for v in (one.turn(self.predicted_nm), one.turn_mask(self.mask)))
        return height, mask


def _correlation(pair: tuple[Explanation, Fit]) -> float:
    return pair[1].correlation


def explains_better(other: float, own: float) -> bool:
    """Return whether an explanation of the correlation ``other`` is clearly better than one of ``own``."""
    if other < MIN_CORRELATION:
        return False
    gain, own = other - max(own, 0.0), max(own, 0.0)
    return gain > CLEAR_GAIN or (gain > SMALL_GAIN and 1 - other**2 < LEFT_OVER * (1 - own**2))


def _better(seen: _Pass, straight: Explanation, turned: Fit, moved: Fit) -> bool:
    """Return whether a turn or flip is the better explanation; where the cell stops for a shift, a small gain suffices.

    A figure that is nearly its own mirror image fits mirrored as it is and 5 mm aside, to a correlation of 0.995.
    """
    if explains_better(turned.correlation, moved.correlation):
        return True
    less = 1 - turned.correlation**2 < LEFT_OVER * (1 - max(moved.correlation, 0.0) ** 2)
    return less and _sure(moved)[0] > MAX_SHIFT_MM and bool(_reason(seen, straight, moved, moved))


def _check(predicted: FloatArray, measured: FloatArray, mask: BoolArray) -> None:
    for name, array in (("predicted", predicted), ("measured", measured)):
        if array.shape != mask.shape:
            raise ComputeError(f"{name} is {array.shape}, the mask {mask.shape}")
        if not np.isfinite(array[mask]).all():
            raise ComputeError(f"{name} is not finite everywhere in the mask")
    if np.count_nonzero(mask) < 100:
        raise ComputeError(f"{np.count_nonzero(mask)} samples are too few to check a pass: at least 100 are needed")


def _reason(seen: _Pass, best: Explanation, moved: Fit, final: Fit) -> str:
    """Return the clearest reason to stop; "" without one."""
    if not best.as_it_is:
        return (
            f"the measured removal looks like the predicted one {best.name} (correlation {best.correlation:.2f}, as "
            f"it is {moved.correlation:.2f}; {final.rate:.2f} times as high): the instrument's profile or the "
            "program's offset and rotation are wrong. Prove the profile with `polishd map commission` and measure again"
        )
    x, y = moved.shift_mm
    distance, sigma = _sure(moved)
    if moved.correlation >= MIN_CORRELATION and distance - seen.most_shift_mm > SIGMAS * sigma:
        return (
            f"the removal lies {with_error(distance, sigma)} mm from where it was predicted, at ({x:+.2f}, {y:+.2f}) "
            f"mm; {seen.most_shift_mm:g} mm are allowed. Check the part's seat, the program's offset and the map's "
            "registration"
        )
    if seen.beyond(moved) > RATE_SIGMAS * moved.rate_sigma:
        return f"the measured removal is {_times(moved)} the predicted one{_factor(moved.rate, seen.limits)}"
    return ""


def _times(moved: Fit) -> str:
    return f"{with_error(moved.rate, moved.rate_sigma)} times"


def _without_unsure_shift(moved: Fit, own: Fit) -> Fit:
    """Return the rate of the fit without a shift where no shift is certain: on a small part the two are confounded."""
    if _sure(moved)[0] > 0:
        return moved
    return replace(moved, rate=own.rate, rate_sigma=own.rate_sigma, rate_excess=own.rate_excess)


def _sure(moved: Fit) -> tuple[float, float]:
    """Return length and standard error, mm, of the shift in the directions that the removal shows."""
    pairs = list(zip(moved.shift_mm, moved.shift_sigma_mm, strict=True))
    sure = [(shift, sigma) for shift, sigma in pairs if abs(shift) > SIGMAS * sigma]
    distance = float(np.hypot.reduce([s for s, _ in sure] or [0.0]))
    return distance, float(np.hypot.reduce([s * e / distance for s, e in sure] or [0.0]))


def _factor(rate: float, limits: tuple[float, float]) -> str:
    """Describe a rate out of bounds, and what to do."""
    if abs(rate) < 0.2:
        return ": hardly anything was removed. Check that the map is of this part and after the pass, and measure again"
    for factor, word in ((0.5, "half"), (2.0, "double")):
        if abs(rate / factor - 1) < 0.2:
            return (
                f", about {word}: surface and wavefront differ by a factor of two. Prove the profile's factor with "
                "`polishd map commission`, and the removal rate on a witness part"
            )
    return (
        f"; {limits[0]:.3g} to {limits[1]:.3g} are allowed (limits.max_rate_change). Check force, speed, slurry and "
        "process.preston"
    )


def _notes(seen: _Pass, moved: Fit, undecidable: tuple[str, ...]) -> tuple[str, ...]:
    (x, y), (distance, sigma) = moved.shift_mm, _sure(moved)
    notes = []
    if distance > 0:
        notes.append(f"the removal lies ({x:+.2f}, {y:+.2f}) +- {sigma:.2g} mm from where it was predicted")
    low, high = seen.limits
    if not low <= moved.rate <= high:
        notes.append(f"the measured removal is {_times(moved)} the predicted one; the map's noise is too large to "
                     f"prove that it is beyond {low:.3g} to {high:.3g}")  # fmt: skip
    if undecidable:
        notes.append("this pass cannot show whether the map is " + ", or ".join(undecidable))
    return tuple(notes)


def _undecidable(seen: _Pass, moved: Fit) -> tuple[str, ...]:
    """Return the mistakes that this pass cannot show: they fit as well, or the errors are too large."""
    is_seen = moved.rate > SURE * moved.rate_sigma  # else no mistake can be seen

    def shows(e: Explanation) -> bool:
        likely = explains_better(moved.correlation, e.correlation * moved.correlation)
        return is_seen and likely and SURE * seen.compare(e, STILL)[1] < RATES[0]

    all_of_them = explanations(seen.predicted_nm, seen.predicted_nm, seen.mask, seen.mask, seen.pitch_mm)
    names = [e.name for e in all_of_them if not (e.as_it_is or shows(e))]
    if not SIGMAS * max(moved.shift_sigma_mm) <= seen.most_shift_mm:
        names.append("shifted")
    if not max(RATE_SIGMAS * moved.rate_sigma, moved.rate_excess) <= SCALED:
        names.append(SCALED_WORD)
    return tuple(names)


def _verdict(
    seen: _Pass, own: Fit, final: Fit, *, best: Explanation, stop: str, undecidable: tuple[str, ...],
    notes: tuple[str, ...],
) -> RemovalCheckResult:  # fmt: skip
    predicted, measured = (np.where(seen.mask, v, np.nan) for v in (seen.predicted_nm, seen.measured_nm))
    return RemovalCheckResult(
        stop, own.correlation, final.rate, final.rate_sigma, best, final.shift_mm, final.shift_sigma_mm, undecidable,
        notes, predicted, measured, final.model_nm, measured - predicted, measured - final.model_nm,
    )  # fmt: skip


def _without_signal(own: Fit, seen: _Pass) -> RemovalCheckResult:
    everywhere = orientations(seen.mask.shape)
    all_of_them = (Explanation(o, sign, 0.0, (0.0, 0.0)) for o in everywhere for sign in (False, True))
    everything = tuple(e.name for e in all_of_them if not e.as_it_is)
    note = f"the predicted removal varies by less than {MIN_SIGNAL_NM:g} nm RMS: it shows no mistake of the map"
    best = Explanation(ORIENTATIONS[0], False, max(own.correlation, 0.0), (0.0, 0.0))
    nothing = unknown_fit(own.correlation, own.model_nm)
    undecidable = (*everything, "shifted", SCALED_WORD)
    return _verdict(seen, own, nothing, best=best, stop="", undecidable=undecidable, notes=(note,))
