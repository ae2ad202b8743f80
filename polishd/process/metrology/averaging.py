"""Repeated measurements of one surface: their mean, what does not belong to it, and how sure it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from polishd.model.errors import MapError
from polishd.model.surface import BoolArray, FloatArray, SurfaceMap
from polishd.process.metrology.conditioning import SAME_PITCH
from polishd.process.metrology.instrument import same_system
from polishd.process.metrology.statistics import Removal, remove_terms

FEWEST = 3
"""Least number of remaining maps: of two maps that differ, either may be wrong."""
MAP_SIGMAS = 5.0
SAMPLE_SIGMAS = 5.0
SIGMA_PER_MAD = 1.4826
"""Standard deviation over median absolute deviation, of a normal distribution."""
ALIKE = 2.0
"""A map within this many times the usual deviation is never an outlier, however alike the others are."""


@dataclass(frozen=True, slots=True)
class AverageResult:
    """The mean of the repeats that agree, with its uncertainties (one standard deviation of the mean)."""

    height_nm: FloatArray
    """(ny, nx) mean of the samples kept, levelled; NaN outside ``mask``."""
    mask: BoolArray
    """(ny, nx) samples that all maps have."""
    uncertainty_nm: FloatArray
    """(ny, nx) standard error of each sample's mean, from its own scatter; NaN outside ``mask``."""
    rms_nm: float
    """RMS of the mean map, which holds the noise that averaging left."""
    rms_uncertainty_nm: float
    """Its standard error: the mean is repeated without each map in turn (jackknife)."""
    names: tuple[str, ...]
    """Names of all maps, in their order."""
    used: tuple[str, ...]
    rejected: Mapping[str, float]
    """Names of the maps left out, and the RMS in nm by which each deviates from the median map."""
    samples_rejected: int
    """Single samples left out of maps that were used."""


def average_maps(surfaces: Sequence[SurfaceMap], removal: Removal = "tilt", *, mixed: bool = False) -> AverageResult:
    """Mean of repeated maps, registered to each other, without those that deviate.

    A map is left out where its RMS deviation from the median map is more than ``MAP_SIGMAS`` robust standard
    deviations above the usual one; a sample of a map, where it is as far off the median of that sample, by the scatter
    of the sample or of all samples, whichever is larger.

    Args:
        surfaces: the maps; alike in shape and pitch.
        removal: taken off each over the mask before they are compared: alignment differs from one to the next.
        mixed: they may have no pitch, and be of several instruments.

    Raises:
        MapError: one file that is there twice; fewer than ``FEWEST`` maps, before or after the rejection; shapes or
            pitches that differ; no sample that all have; unless ``mixed``, a map without pitch, or of another
            instrument than the first that names one.
    """
    _require_measured_each(surfaces)
    if not mixed:
        _require_one_setup(surfaces)
    common = _common(surfaces)
    heights = np.stack([remove_terms(surface.height_nm, common, removal)[common] for surface in surfaces])
    names = _names(surfaces)
    deviation = np.sqrt(np.mean((heights - np.median(heights, axis=0)) ** 2, axis=1))
    good = ~_outliers(deviation)
    rejected = {name: float(d) for name, d, kept in zip(names, deviation, good, strict=True) if not kept}
    if np.count_nonzero(good) < FEWEST:
        raise MapError(
            f"only {np.count_nonzero(good)} of {len(good)} repeats agree ({', '.join(rejected)} deviate), fewer than "
            f"{FEWEST}: measure again"
        )
    heights = heights[good]
    kept = _samples_kept(heights)
    mean, error = _mean(heights, kept)
    without_one = [_mean(np.delete(heights, i, 0), np.delete(kept, i, 0))[0].std() for i in range(len(heights))]
    return AverageResult(
        height_nm=_spread(mean, common),
        mask=common,
        uncertainty_nm=_spread(error, common),
        rms_nm=float(mean.std()),
        rms_uncertainty_nm=float(np.std(without_one) * np.sqrt(len(heights) - 1)),
        names=names,
        used=tuple(name for name in names if name not in rejected),
        rejected=rejected,
        samples_rejected=int(np.count_nonzero(~kept)),
    )


def _require_one_setup(surfaces: Sequence[SurfaceMap]) -> None:
    names = _names(surfaces)
    bare = [name for name, surface in zip(names, surfaces, strict=True) if surface.pitch_mm is None]
    if bare:
        raise MapError(f"{', '.join(bare)}: without a lateral scale the zoom of the repeats is unknown. Give "
                     "the instrument's --profile, or --mixed")  # fmt: skip
    known = [(name, surface.instrument) for name, surface in zip(names, surfaces, strict=True) if surface.instrument]
    for name, instrument in known[1:]:
        first, usual = known[0]
        if not same_system(instrument, usual):
            raise MapError(
                f"{name} is of the instrument {instrument!r}, {first} of {usual!r}: repeats are of one; leave "
                "it out, or say --mixed"
            )


def _require_measured_each(surfaces: Sequence[SurfaceMap]) -> None:
    """MapError where one measurement is there twice: what is alike by being the same would pass for sure."""
    seen: dict[str, str] = {}
    for name, surface in zip(_names(surfaces), surfaces, strict=True):
        before = seen.setdefault(surface.sha256, name) if surface.sha256 else name
        if before != name:
            raise MapError(f"{name} and {before} hold the same measurement, byte for byte: name each repeat once")


def _size(surface: SurfaceMap) -> str:
    rows, columns = surface.height_nm.shape
    pitch = "no lateral scale" if surface.pitch_mm is None else f"a pitch of {surface.pitch_mm:.7g} mm"
    return f"{rows} x {columns} samples and {pitch}"


def _same_pitch(one: SurfaceMap, other: SurfaceMap) -> bool:
    """Precision of a stored pitch: ``.dat`` rounds it to 7 digits."""
    if one.pitch_mm is None or other.pitch_mm is None:
        return one.pitch_mm is other.pitch_mm
    return abs(one.pitch_mm - other.pitch_mm) <= SAME_PITCH * one.pitch_mm


def _common(surfaces: Sequence[SurfaceMap]) -> BoolArray:
    """(ny, nx) samples that all have."""
    if len(surfaces) < FEWEST:
        raise MapError(f"{len(surfaces)} repeats are too few: at least {FEWEST} tell which of them deviates")
    first, *others = surfaces
    for name, other in zip(_names(surfaces)[1:], others, strict=True):
        if other.height_nm.shape != first.height_nm.shape or not _same_pitch(other, first):
            raise MapError(f"{name} has {_size(other)}, the first repeat {_size(first)}: repeats are of one set-up")
    everywhere: BoolArray = np.logical_and.reduce([surface.valid for surface in surfaces])
    return everywhere


def _names(surfaces: Sequence[SurfaceMap]) -> tuple[str, ...]:
    """The files' names, or else numbers; unlike each other."""
    names = [surface.path.name if surface.path is not None else "repeat" for surface in surfaces]
    return tuple(name if names.count(name) == 1 else f"{name} #{number}" for number, name in enumerate(names, start=1))


def _outliers(deviation_nm: FloatArray) -> BoolArray:
    """(n,) whether each is too far above the median of all."""
    usual = np.median(deviation_nm)
    scatter = SIGMA_PER_MAD * np.median(np.abs(deviation_nm - usual))
    return np.asarray(deviation_nm > np.maximum(usual + MAP_SIGMAS * scatter, ALIKE * usual), dtype=np.bool_)


def _samples_kept(heights: FloatArray) -> BoolArray:
    """(n, m) whether each is near its sample's median; at least half of each sample's always are."""
    off = np.abs(heights - np.median(heights, axis=0))
    # of three values the own scatter is often far too small by chance; the usual one of all samples is not
    scatter = np.maximum(SIGMA_PER_MAD * np.median(off, axis=0), np.median(heights.std(axis=0, ddof=1)))
    return np.asarray(off <= SAMPLE_SIGMAS * scatter, dtype=np.bool_)


def _mean(heights: FloatArray, kept: BoolArray) -> tuple[FloatArray, FloatArray]:
    """(m,) mean of what is kept of each sample, and its standard error; infinite where one value alone is kept."""
    count = kept.sum(axis=0)
    mean = np.where(kept, heights, 0.0).sum(axis=0) / np.maximum(count, 1)
    square = np.where(kept, (heights - mean) ** 2, 0.0).sum(axis=0)
    error = np.sqrt(square / np.maximum(count - 1, 1) / np.maximum(count, 1))
    return mean, np.where(count > 1, error, np.inf)


def _spread(values: FloatArray, mask: BoolArray) -> FloatArray:
    found = np.full(mask.shape, np.nan)
    found[mask] = values
    return found
