"""The line distance that a spot whose radius is not known exactly leaves least ripple with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from polishd.model.surface import FloatArray
from polishd.process.checks import require_number
from polishd.process.removal.path_lines import LEAST_LINES, travel_ways
from polishd.process.removal.removal_patch import widened
from polishd.process.removal.ripple import RADIUS_ERROR, ActingSpots, Ripple
from polishd.process.removal.ripple_forecast import HARMONICS
from polishd.process.removal.tif import Spot
from polishd.process.removal.transfer_function import modulus_along

MORE_PATH = 1.15
"""Path that a quieter line distance may cost, over that of the largest one."""
CANDIDATES = 301


@dataclass(frozen=True, slots=True)
class ContactAt:
    """A contact, and the lines that it follows."""

    depth_ratio: float
    """Gamma."""
    azimuth_rad: float
    """Where the spindle leans, counterclockwise from the part's x."""
    across_rad: float = np.pi / 2
    """Direction across the lines, counterclockwise from the part's x."""


@dataclass(frozen=True, slots=True)
class QuietPitch:
    """A line distance, and the ripple that it leaves, RMS over the mean removal."""

    pitch_mm: float
    share: float
    """With the spot as modelled."""
    share_high: float
    """With a spot whose radius is off, the worse of both signs."""
    radius_error: float = RADIUS_ERROR

    @property
    def words(self) -> str:
        """Return the distance and its ripple as text."""
        high = f"{100 * self.share_high:.1f} % with a radius that is off by {100 * self.radius_error:g} %"
        return f"lines {self.pitch_mm:.3g} mm apart, ripple {100 * self.share:.1f} % of the mean removal, {high}"


def ripple_shares(
    spot: Spot, contact: ContactAt, pitch_mm: FloatArray, radius_error: float = RADIUS_ERROR
) -> tuple[FloatArray, FloatArray]:
    """RMS ripple of straight lines of even removal, over its mean, for (m,) line distances.

    Each harmonic has twice the share that the spot's spectrum has at its frequency, zero to peak.

    Args:
        spot: the spot.
        contact: how it acts, and where the lines run.
        pitch_mm: (m,) distances.
        radius_error: share of the radius that the spot may be off by.

    Returns:
        (m,) as modelled, and (m,) the largest for a spot as modelled, narrower and wider.
    """
    ratio = np.array([contact.depth_ratio])
    fine = widened(spot, 1.0)
    patch = fine.patch(ratio, np.array([contact.azimuth_rad]))[0]
    side = 2 * float(fine.half_width_mm(ratio)[0]) / len(patch)
    order = np.arange(1, HARMONICS + 1)[:, None]
    factors = (1.0, 1.0 - radius_error, 1.0 + radius_error)
    found = []
    for factor in factors:
        frequency = (factor * order / pitch_mm).ravel()
        share = modulus_along(patch, side, frequency, contact.across_rad).reshape(HARMONICS, -1) / patch.sum()
        found.append(np.sqrt(2 * np.sum(share**2, axis=0)))
    return found[0], np.max(found, axis=0)


def quiet_pitch(
    spot: Spot,
    contacts: Sequence[ContactAt],
    at_most_mm: float,
    *,
    radius_error: float = RADIUS_ERROR,
    more_path: float = MORE_PATH,
) -> QuietPitch:
    """Find the line distance up to ``at_most_mm`` with the least ripple of a spot whose radius may be off.

    Its path is at most ``more_path`` times as long as that with the largest distance. Several contacts count in the
    mean square: lines of a spiral run in all directions.
    """
    require_number("the largest line distance", at_most_mm, "mm", above=0.0)
    pitch = np.linspace(at_most_mm / more_path, at_most_mm, CANDIDATES)
    each = [ripple_shares(spot, contact, pitch, radius_error) for contact in contacts]
    share, high = (np.sqrt(np.mean(np.square(of), axis=0)) for of in zip(*each, strict=True))
    best = int(np.argmin(high))
    return QuietPitch(float(pitch[best]), float(share[best]), float(high[best]), radius_error)


LEAST_PITCH = 0.3
"""Smallest line distance that is looked at for less ripple, as a share of the present one."""


def quieter_pitch_mm(acting: ActingSpots, ripple: Ripple, share: float) -> float | None:
    """Find the largest line distance whose ripple, 95 % value, is at most a share of a forecast one.

    It counts with the spot at the middle gamma, across the lines of most blocks. None: there is none down to
    LEAST_PITCH, or the forecast has no line distance.
    """
    now = next((one for one in ripple.lines if (one.direction, one.cause) == ("across", "path")), None)
    if now is None or acting.blocks.n < LEAST_LINES:
        return None
    blocks = acting.blocks
    travel = travel_ways(blocks)
    double = np.arctan2(travel[:, 1], travel[:, 0]) * 2  # lines to and fro have one direction
    along = float(np.angle(np.exp(1j * double).sum())) / 2
    azimuth = float(np.angle(np.exp(1j * blocks.azimuth_rad).sum()))
    contact = ContactAt(float(np.median(blocks.depth_ratio)), azimuth, along + np.pi / 2)
    pitch = np.linspace(LEAST_PITCH, 1.0, CANDIDATES) * now.period_mm
    _, high = ripple_shares(acting.spot, contact, pitch, ripple.errors.radius)
    quiet = np.flatnonzero(high <= share * high[-1])
    return float(pitch[quiet[-1]]) if quiet.size else None
