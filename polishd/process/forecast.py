"""What a planned pass is expected to leave, as a distribution, before it is made; and how far off passes have been.

``after = left - error of the rate * removal - what no rate explains``. The next map's noise is in the place of the last
one's, which no spot follows; on its own samples it is more than on the process grid. So is the ripple between a path's
tracks, which no dwell takes off again, and to which each pass along the same tracks adds. The rate's error is normal;
what no rate explains (a rate that changes over the part or the time, a spot of another shape or place) is a smooth
field, as large beside all that is removed as the passes before have shown, or `UNEXPLAINED` where there were none; and
so large only within a factor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polishd.model.surface import BoolArray, FloatArray
from polishd.process.removal_fit import MIN_SIGNAL_NM, levelled

LEVEL = 0.9
UNEXPLAINED = 0.009
"""Of the removal, RMS, before a pass has shown it: so that most first passes in each of this package's scenarios
come as expected, those with a ripple that no touch tells among them (docs/scenarios.md)."""
WITHIN = 0.6
"""Standard deviation of the natural logarithm of how large it is in the next pass."""
MODES = 12
"""Independent parts of the field that no rate explains: a part is so many of its correlation lengths."""
SURE_NOISE = 3.0
"""A removal that varies by less than so many times its noise shows nothing of what no rate explains."""
SAMPLES = 4000


@dataclass(frozen=True, slots=True)
class Forecast:
    """RMS that the next map is expected to show on its own samples, in the clear aperture, aligned as it is."""

    low_nm: float
    median_nm: float
    high_nm: float
    level: float
    """Chance that it comes between the two."""
    better: float
    """Chance that it is less than what was measured before the pass."""

    @property
    def words(self) -> str:
        """For people."""
        return f"{self.low_nm:.2f} to {self.high_nm:.2f} nm ({100 * self.level:.0f} %)"


def forecast(
    now_nm: FloatArray,
    removal_nm: FloatArray,
    *,
    removed_nm: float,
    rate_sigma: float,
    unexplained: float,
    noise_nm: float = 0.0,
    finer_nm: float = 0.0,
    ripple: float = 0.0,
) -> Forecast:
    """Of a pass.

    Args:
        now_nm: (n,) surface in the clear aperture as measured, aligned.
        removal_nm: (n,) what the pass is expected to remove there, aligned likewise.
        removed_nm: RMS of the removal, all of it.
        rate_sigma: standard error of the removal rate, relative.
        unexplained: RMS of what no rate explains, relative to that.
        noise_nm: RMS of the next map's noise beyond what ``now_nm`` has of it, in quadrature.
        finer_nm: RMS of what the map shows beyond ``now_nm`` and its noise: it stays.
        ripple: what a pass adds to that, relative to ``removed_nm``, known as well as ``unexplained`` is.
    """
    rng = np.random.default_rng(0)  # the same question has the same answer
    left, removal = now_nm - removal_nm, removal_nm - removal_nm.mean()
    left = left - left.mean()
    own, across, square = (float(np.mean(a * b)) for a, b in ((left, left), (left, removal), (removal, removal)))
    off = rate_sigma * rng.standard_normal(SAMPLES)
    by_rate = np.maximum(own - 2 * off * across + off**2 * square, 0.0)
    size = unexplained * removed_nm * np.exp(WITHIN * rng.standard_normal(SAMPLES))
    field = size**2 * rng.chisquare(MODES, SAMPLES) / MODES
    mixed = 2 * np.sqrt(by_rate * field / MODES) * rng.standard_normal(SAMPLES)
    after = np.sqrt(np.maximum(by_rate + field + mixed, 0.0))
    alike = rng.uniform(size=SAMPLES)  # of the same tracks all of it, of others it is beside what is there
    finer = finer_nm + ripple * removed_nm * alike * np.exp(WITHIN * rng.standard_normal(SAMPLES))
    seen = np.hypot(np.hypot(after, noise_nm), finer)
    low, median, high = np.quantile(seen, [(1 - LEVEL) / 2, 0.5, (1 + LEVEL) / 2])
    better = float(np.mean(np.hypot(after, finer) < np.hypot(now_nm.std(), finer_nm)))
    return Forecast(float(low), float(median), float(high), LEVEL, better)


def unexplained(predicted_nm: FloatArray, measured_nm: FloatArray, mask: BoolArray, noise_nm: float) -> float | None:
    """What no rate explains of a pass, relative to all that it removed; None where the pass is too weak to tell.

    Args:
        predicted_nm: (ny, nx) removal by the model, of what was executed, all of it.
        measured_nm: (ny, nx) map before less map after.
        mask: (ny, nx) the clear aperture.
        noise_nm: RMS of one map's noise on these samples.
    """
    predicted, measured = (levelled(np.where(mask, v, 0.0), mask)[mask] for v in (predicted_nm, measured_nm))
    size = float(np.sqrt(np.mean(predicted**2)))
    change_nm = 2**0.5 * noise_nm
    if size < max(MIN_SIGNAL_NM, SURE_NOISE * change_nm):
        return None
    rate = float(predicted @ measured / (predicted @ predicted))
    rest = float(np.mean((measured - rate * predicted) ** 2))
    return float(np.sqrt(max(rest - change_nm**2, 0.0) / np.mean(predicted_nm[mask] ** 2)))


def pooled(known: float, shown: float | None) -> float:
    """What is expected of the next pass: the last one counts as much as all before it."""
    return known if shown is None else float(np.sqrt((known**2 + shown**2) / 2))
