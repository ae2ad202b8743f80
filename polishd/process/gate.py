"""The gate after a pass: what was measured must be what was predicted, not its mirror image, nor beside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polishd.model.errors import ComputeError
from polishd.model.surface import BoolArray, FloatArray
from polishd.process.explanation import Explanation, explanations
from polishd.process.orientation import ORIENTATIONS, orientations
from polishd.process.removal_fit import Fit, fit, levelled

MIN_SIGNAL_NM = 1.5
"""RMS of the predicted removal, without piston and tilt, below which nothing can be told."""
MIN_CORRELATION = 0.5
"""Least correlation of an explanation that stops the cell."""
MAX_SHIFT_MM = 0.5
"""Shift that costs as much as a tenth of a pass's gain (physics.md, 6); smaller ones are reported."""
RATES = (0.6, 1.4)
"""Measured to predicted removal that learning the rate takes care of."""
SIGMAS = 3.0
"""Standard errors by which a rate or a shift must be beyond its limit."""
CLEAR_GAIN = 0.1
"""Gain in correlation that makes another explanation the better one, whatever is left unexplained."""
SMALL_GAIN = 0.01
"""The same, where the other explanation also halves what is left unexplained."""
LEFT_OVER = 0.5


@dataclass(frozen=True, slots=True)
class Verdict:
    """What the measured removal says of the predicted one, and whether the cell must stop."""

    stop: str
    """Why the cell must stop and what to do; "" where it may go on."""
    correlation: float
    """Of measured with predicted removal as they are, both without piston and tilt."""
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
    """(ny, nx) without piston and tilt; NaN outside the mask, as in all four."""
    measured_nm: FloatArray
    explained_nm: FloatArray
    """The best explanation: the prediction turned, negated, moved and scaled; NaN also where it has no data."""
    residual_nm: FloatArray
    """Measured less predicted at the fitted rate."""
    best_residual_nm: FloatArray
    """Measured less the best explanation."""


def judge(predicted_nm: FloatArray, measured_nm: FloatArray, mask: BoolArray, pitch_mm: float) -> Verdict:
    """Compare measured with predicted removal, and stop where a flip, turn, negation, shift or factor fits better.

    Args:
        predicted_nm: (ny, nx) removal predicted from what was executed, positive = removed.
        measured_nm: (ny, nx) map before less map after; its piston and tilt are unknown.
        mask: (ny, nx) samples to compare.
        pitch_mm: of the grid.

    Raises:
        ComputeError: shapes that do not fit, or too few samples.
    """
    _check(predicted_nm, measured_nm, mask)
    predicted, measured = levelled(predicted_nm, mask), levelled(measured_nm, mask)
    own = fit(predicted, measured, mask, None, pitch_mm)
    if np.sqrt(np.mean(predicted[mask] ** 2)) < MIN_SIGNAL_NM:
        return _without_signal(own, predicted, measured, mask)
    found = list(explanations(predicted, measured, mask, mask, pitch_mm))
    straight = max((e for e in found if e.as_it_is), key=lambda e: e.correlation)
    rival = max((e for e in found if not e.as_it_is), key=lambda e: e.correlation)
    best = rival if explains_better(rival.correlation, straight.correlation) else straight
    moved = fit(predicted, measured, mask, straight.samples(pitch_mm), pitch_mm)
    final = moved if best is straight else _fit_turned(predicted, measured, mask, best, pitch_mm)
    stop = _reason(best, straight, moved, final)
    undecidable = _undecidable(predicted, mask, pitch_mm, best.correlation, moved)
    notes = () if stop else _notes(moved, undecidable)
    return _verdict(predicted, measured, mask, (own, final), (best, stop, undecidable, notes))


def explains_better(other: float, own: float) -> bool:
    """Whether an explanation of this correlation is clearly better than the one at hand."""
    if other < MIN_CORRELATION:
        return False
    gain, own = other - max(own, 0.0), max(own, 0.0)
    return gain > CLEAR_GAIN or (gain > SMALL_GAIN and 1 - other**2 < LEFT_OVER * (1 - own**2))


def _check(predicted: FloatArray, measured: FloatArray, mask: BoolArray) -> None:
    for name, array in (("predicted", predicted), ("measured", measured)):
        if array.shape != mask.shape:
            raise ComputeError(f"{name} is {array.shape}, the mask {mask.shape}")
        if not np.isfinite(array[mask]).all():
            raise ComputeError(f"{name} is not finite everywhere in the mask")
    if np.count_nonzero(mask) < 100:
        raise ComputeError(f"{np.count_nonzero(mask)} samples are too few to judge a pass by")


def _fit_turned(
    predicted: FloatArray, measured: FloatArray, mask: BoolArray, best: Explanation, pitch_mm: float
) -> Fit:
    turned = best.turn(predicted)
    return fit(turned, measured, mask & best.turn_mask(mask), best.samples(pitch_mm), pitch_mm)


def _reason(best: Explanation, straight: Explanation, moved: Fit, final: Fit) -> str:
    """Why the cell must stop; the clearest reason only."""
    if not best.as_it_is:
        return (
            f"the measured removal looks like the predicted one {best.name} (correlation {best.correlation:.2f}, as "
            f"it is {straight.correlation:.2f}; {final.rate:.2f} times as high): the instrument's profile or the "
            "program's offset and rotation are wrong; prove the profile with `polishd map commission`, then measure"
        )
    x, y = moved.shift_mm
    distance, sigma = _sure(moved)
    if moved.correlation >= MIN_CORRELATION and distance > MAX_SHIFT_MM:
        return (
            f"the removal lies {distance:.2f} +- {sigma:.2f} mm from where it was predicted, at ({x:+.2f}, {y:+.2f}) "
            f"mm, and {MAX_SHIFT_MM:g} mm are allowed: check the part's seat, the program's offset and the map's "
            "registration before going on"
        )
    if not RATES[0] <= moved.rate <= RATES[1] and abs(moved.rate - 1) > SIGMAS * moved.rate_sigma:
        times = f"{moved.rate:.3f} +- {moved.rate_sigma:.3f} times"
        return f"the measured removal is {times} the predicted one{_factor(moved.rate)}"
    return ""


def _sure(moved: Fit) -> tuple[float, float]:
    """Length of the shift in those directions in which the removal shows it, and its standard error; mm."""
    pairs = list(zip(moved.shift_mm, moved.shift_sigma_mm, strict=True))
    sure = [(shift, sigma) for shift, sigma in pairs if abs(shift) > SIGMAS * sigma]
    return float(np.hypot.reduce([s for s, _ in sure] or [0.0])), float(np.hypot.reduce([e for _, e in sure] or [0.0]))


def _factor(rate: float) -> str:
    """What a rate out of bounds looks like, and what to do."""
    if abs(rate) < 0.2:
        return ": hardly anything was removed; was the map taken before the pass, or of another part? Measure again"
    for factor, word in ((0.5, "half"), (2.0, "double")):
        if abs(rate / factor - 1) < 0.2:
            return (
                f", about {word}: surface and wavefront differ by two; prove the profile's factor with `polishd map "
                "commission`, and the removal rate on a witness part"
            )
    return (
        f", and {RATES[0]:g} to {RATES[1]:g} is what learning takes up: check force, speed and slurry before going on"
    )


def _notes(moved: Fit, undecidable: tuple[str, ...]) -> tuple[str, ...]:
    (x, y), (distance, sigma) = moved.shift_mm, _sure(moved)
    notes = []
    if distance > 0:
        notes.append(f"the removal lies ({x:+.2f}, {y:+.2f}) +- {sigma:.2f} mm from where it was predicted")
    if undecidable:
        notes.append("this pass could not show it, had the map been " + ", or ".join(undecidable))
    return tuple(notes)


def _undecidable(
    predicted: FloatArray, mask: BoolArray, pitch_mm: float, quality: float, moved: Fit
) -> tuple[str, ...]:
    """Which mistakes would not have been found: had one been made, the prediction would fit about as well."""
    names = [
        e.name for e in explanations(predicted, predicted, mask, mask, pitch_mm)
        if not e.as_it_is and not explains_better(quality, e.correlation * quality)
    ]  # fmt: skip
    if not SIGMAS * max(moved.shift_sigma_mm) <= MAX_SHIFT_MM:
        names.append("shifted")
    if not SIGMAS * moved.rate_sigma <= RATES[1] - 1:
        names.append("scaled")
    return tuple(names)


def _verdict(
    predicted: FloatArray, measured: FloatArray, mask: BoolArray, fits: tuple[Fit, Fit],
    said: tuple[Explanation, str, tuple[str, ...], tuple[str, ...]],
) -> Verdict:  # fmt: skip
    own, final = fits
    best, stop, undecidable, notes = said
    shown = np.where(mask, measured, np.nan)
    return Verdict(
        stop, own.correlation, final.rate, final.rate_sigma, best, final.shift_mm, final.shift_sigma_mm, undecidable,
        notes, np.where(mask, predicted, np.nan), shown, final.model_nm, shown - own.model_nm, shown - final.model_nm,
    )  # fmt: skip


def _without_signal(own: Fit, predicted: FloatArray, measured: FloatArray, mask: BoolArray) -> Verdict:
    all_of_them = (Explanation(o, sign, 0.0, (0.0, 0.0)) for o in orientations(mask.shape) for sign in (False, True))
    everything = tuple(e.name for e in all_of_them if not e.as_it_is)
    nothing = Fit(float("nan"), float("inf"), (0.0, 0.0), (float("inf"), float("inf")), own.correlation, own.model_nm)
    note = f"the predicted removal varies by less than {MIN_SIGNAL_NM:g} nm RMS: it shows no mistake of the map"
    best = Explanation(ORIENTATIONS[0], False, max(own.correlation, 0.0), (0.0, 0.0))
    said = (best, "", (*everything, "shifted", "scaled"), (note,))
    return _verdict(predicted, measured, mask, (own, nothing), said)
