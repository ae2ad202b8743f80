"""Limits of correction by the spot: its transfer function, its cut-off, and the surface at shorter periods."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polishd.model.errors import ComputeError
from polishd.model.surface import BoolArray, FloatArray
from polishd.process.checks import require_number
from polishd.process.metrology.spectra import split_bands
from polishd.process.removal.tif import Spot

SHARE = 0.05
"""A period at which the spot has less than this share of its mean cannot be made: 1 nm of it costs a dwell of 20 nm."""
NULL = 0.05
"""A minimum of the modulus below this is a null: where the directions' nulls lie apart, their mean is not 0."""
LOBE = 0.01
"""And the modulus rises by this much beyond it."""
DIRECTIONS = 36
"""Directions over half a turn that the modulus is averaged over."""
FREQUENCIES = 400
"""Samples of the transfer function, evenly from 0 to the frequency at which the patch's own squares end it."""
SQUARES_A_PERIOD = 4.0
"""Shortest period looked at, in squares of the patch."""


@dataclass(frozen=True, slots=True)
class SpotTransferFunction:
    """Transfer function of a spot at rest: how much a dwell that varies with a frequency still removes of it."""

    frequency_per_mm: FloatArray
    """(k,) ascending from 0."""
    modulus: FloatArray
    """(k,) modulus of the spectrum, mean over all directions, relative to that at 0."""
    share: float
    cutoff_period_mm: float
    """The longest period at which the modulus is down to ``share``, or null."""
    null_period_mm: float | None
    """The longest period that is a null: 1.398 a for a Hertz contact of radius a; None: there is none."""


@dataclass(frozen=True, slots=True)
class CorrectablePeriods:
    """A surface, split at the spot's cut-off."""

    transfer: SpotTransferFunction
    rms_nm: float
    """RMS of the surface inside the mask, mean removed."""
    within_reach_rms_nm: float
    """RMS of the periods above the cut-off."""
    beyond_reach_rms_nm: float
    """RMS of the periods below it, which no dwell with this spot removes."""
    resolved: bool
    """The map resolves periods below the cut-off; where it does not, they are unknown."""


def spot_transfer_function(
    spot: Spot, depth_ratio: float = 1.0, azimuth_rad: float = 0.0, share: float = SHARE
) -> SpotTransferFunction:
    """Transfer function of a spot at one depth ratio; moving it along a block takes more away.

    The patch's squares are summed for each frequency, and what averaging over squares takes away is given back.
    Raises ComputeError for a share outside 0 to 1, a spot that removes nothing, or one too sharp for its patch.
    """
    require_number("the share at the cut-off", share, "", above=0.0, below=1.0)
    require_number("the depth ratio gamma", depth_ratio, "", above=0.0)
    ratio = np.array([depth_ratio])
    patch = spot.patch(ratio, np.array([azimuth_rad]))[0]
    total = float(patch.sum())
    if not total > 0:
        raise ComputeError("the spot removes nothing: it has no transfer function")
    side = 2 * float(spot.half_width_mm(ratio)[0]) / len(patch)
    frequency = np.linspace(0.0, 1 / (SQUARES_A_PERIOD * side), FREQUENCIES)
    modulus = (
        np.mean(
            [
                modulus_along(patch, side, frequency, angle)
                for angle in np.asarray((np.arange(DIRECTIONS) + 0.5) * np.pi / DIRECTIONS, dtype=np.float64)
            ],
            axis=0,
        )
        / total
    )
    null = _null_period_mm(frequency, modulus)
    cutoff = null if null is not None and modulus.min() > share else _cutoff_period_mm(frequency, modulus, share)
    return SpotTransferFunction(frequency, modulus, share, max(cutoff, null or 0.0), null)


def correctable_surface(
    height_nm: FloatArray, mask: BoolArray, pitch_mm: float, of: SpotTransferFunction
) -> CorrectablePeriods:
    """What of a surface the spot can correct, by `split_bands` at its cut-off.

    Args:
        height_nm: (ny, nx), finite inside ``mask``; best on the map's own pixels.
        mask: (ny, nx) the clear aperture.
        pitch_mm: distance of samples.
        of: the spot's transfer function.

    Raises:
        MapError: the mask is empty, or the surface not finite inside it.
    """
    above, below = split_bands(height_nm, mask, pitch_mm, (of.cutoff_period_mm,))
    return CorrectablePeriods(
        transfer=of,
        rms_nm=float(height_nm[mask].std()),
        within_reach_rms_nm=float(above[mask].std()),
        beyond_reach_rms_nm=float(below[mask].std()),
        resolved=of.cutoff_period_mm > 2 * pitch_mm,
    )


def modulus_along(patch: FloatArray, side: float, frequency: FloatArray, angle: float) -> FloatArray:
    """(k,) modulus of a patch's spectrum along one direction.

    Args:
        patch: (m, m) volume rate of each square.
        side: width of a square, mm.
        frequency: (k,) 1/mm.
        angle: direction, rad counterclockwise from the part's x.
    """
    x, y = frequency * np.cos(angle) * side, frequency * np.sin(angle) * side
    spectrum = (_waves(x, len(patch)) @ patch.T * _waves(-y, len(patch))).sum(axis=1)
    return np.asarray(np.abs(spectrum) / np.abs(np.sinc(x) * np.sinc(y)), dtype=np.float64)


def _waves(frequency: FloatArray, squares: int) -> NDArray[np.complex128]:
    """(k, squares) waves of (k,) frequencies, in periods a square, about the middle of the squares.

    By powers of one square's phase: sines and cosines of all would take three times as long.
    """
    wave = np.empty((len(frequency), squares), dtype=np.complex128)
    wave[:, 0] = np.exp(-1j * np.pi * (squares - 1) * frequency)
    wave[:, 1:] = np.exp(2j * np.pi * frequency)[:, None]
    return np.asarray(np.cumprod(wave, axis=1), dtype=np.complex128)


def _cutoff_period_mm(frequency: FloatArray, modulus: FloatArray, share: float) -> float:
    low = modulus <= share
    if not low.any():
        shown = f"{modulus[-1]:.2g} of its mean at a period of {1 / frequency[-1]:.3g} mm"
        raise ComputeError(f"the spot has {shown}: its patch is too coarse, or the share at the cut-off too small")
    first = int(low.argmax())
    between = (modulus[first - 1] - share) / (modulus[first - 1] - modulus[first])
    return float(1 / (frequency[first - 1] + between * (frequency[first] - frequency[first - 1])))


def _null_period_mm(frequency: FloatArray, modulus: FloatArray) -> float | None:
    """Period of the first minimum that is a null; round a null the modulus squared is a parabola."""
    square = modulus**2
    left, middle, right = square[:-2], square[1:-1], square[2:]
    lobe = np.maximum.accumulate(modulus[::-1])[::-1][1:-1]
    low = (modulus[1:-1] < NULL) & (lobe > modulus[1:-1] + LOBE)
    nulls = np.flatnonzero((middle < left) & (middle < right) & low)
    if nulls.size == 0:
        return None
    k = nulls[0]
    shift = (left[k] - right[k]) / (2 * (left[k] - 2 * middle[k] + right[k]))
    return float(1 / (frequency[k + 1] + shift * (frequency[1] - frequency[0])))
