"""A surface carried on beyond its data, so that the dwell near the rim is not driven by what lies outside.

`nearest` repeats the rim's sample, `c1` is the thin plate that goes on with the rim's height and slope, and
`gerchberg_papoulis` the surface that has no periods shorter than the spot can make (Papoulis 1975; Marks 1981).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy

from polishd.model.errors import ComputeError
from polishd.model.surface import BoolArray, FloatArray
from polishd.process.checks import require_number
from polishd.process.metrology.spectra import FIT_DEGREE, frequencies, taper_rim
from polishd.process.metrology.statistics import polynomial

Extension = Literal["nearest", "c1", "gerchberg_papoulis"]

ROUNDS = 200
"""Most projections of `gerchberg_papoulis`."""
TOLERANCE = 1e-3
"""The iteration stops where its misfit on the data falls by less than this share in STALL rounds, or below it."""
STALL = 10
SLACK = 1e-5
"""Weight of slope beside bending in `c1`: settles what the data leave open (a lone sample), and nothing else."""


@dataclass(frozen=True, slots=True)
class ExtendedSurface:
    """A surface and its extension."""

    height_nm: FloatArray
    """(ny, nx) the data untouched, the extension around them and in their holes, NaN beyond the reach."""
    mask: BoolArray
    """(ny, nx) where there is a height: data and extension."""
    rounds: int = 0
    """Projections that `gerchberg_papoulis` took."""
    misfit: float = 0.0
    """RMS of data less band-limited surface, over the RMS of the data (low-order fit off): what is out of its band."""


def extend_surface(
    height_nm: FloatArray,
    mask: BoolArray,
    pitch_mm: float,
    reach_mm: float,
    method: Extension,
    *,
    cutoff_period_mm: float | None = None,
) -> ExtendedSurface:
    """Extend a surface by ``reach_mm`` beyond its data; holes are filled in the same way.

    Args:
        height_nm: (ny, nx), finite inside ``mask``; what it holds elsewhere is ignored.
        mask: (ny, nx) the data.
        pitch_mm: distance of samples.
        reach_mm: how far from the nearest datum: the spot's radius is enough. The array is not enlarged.
        method: ``nearest``: value of the nearest datum. ``c1``: least bending, value and slope go on; exact on planes.
            ``gerchberg_papoulis``: no periods below ``cutoff_period_mm``; a polynomial of degree 2 is taken off before.
        cutoff_period_mm: shortest period of the spot (`correctable_surface`), for ``gerchberg_papoulis``.

    Raises:
        ComputeError: an empty mask, data that are not finite, a reach below a sample, or a cut-off that is missing or
            below the Nyquist period.
    """
    _check(height_nm, mask, pitch_mm, reach_mm)
    distance, nearest = scipy.ndimage.distance_transform_edt(~mask, return_indices=True)
    reached = distance <= reach_mm / pitch_mm
    match method:
        case "nearest":
            full, rounds, misfit = height_nm[tuple(nearest)], 0, 0.0
        case "c1":
            full, rounds, misfit = _thin_plate(height_nm, mask, reached), 0, 0.0
        case "gerchberg_papoulis":
            full, rounds, misfit = _band_limited(height_nm, mask, reached, _cutoff(cutoff_period_mm, pitch_mm))
        case _:
            raise ComputeError(f"no extension {method!r}; use nearest, c1 or gerchberg_papoulis")
    height = np.where(mask, height_nm, np.where(reached, full, np.nan))
    return ExtendedSurface(height, reached, rounds, misfit)


def _check(height_nm: FloatArray, mask: BoolArray, pitch_mm: float, reach_mm: float) -> None:
    if height_nm.ndim != 2 or height_nm.shape != mask.shape:
        raise ComputeError(f"the surface is {height_nm.shape}, its mask {mask.shape}")
    require_number("the map's pitch", pitch_mm, "mm", above=0.0)
    require_number("the reach of the extension", reach_mm, "mm", above=pitch_mm * (1 - 1e-9))
    if not mask.any():
        raise ComputeError("the mask is empty: there is no surface to extend")
    missing = int(np.count_nonzero(~np.isfinite(height_nm[mask])))
    if missing:
        raise ComputeError(f"{missing} samples inside the mask have no data: fill them, or take them out of the mask")


def _cutoff(cutoff_period_mm: float | None, pitch_mm: float) -> float:
    """The cut-off in samples."""
    if cutoff_period_mm is None:
        raise ComputeError("gerchberg_papoulis wants the spot's cut-off period: give cutoff_period_mm")
    require_number("the spot's cut-off period", cutoff_period_mm, "mm", above=2 * pitch_mm)
    return cutoff_period_mm / pitch_mm


def _thin_plate(height_nm: FloatArray, mask: BoolArray, reached: BoolArray) -> FloatArray:
    """The heights that bend least, ``sum u_xx^2 + 2 u_xy^2 + u_yy^2``, with the data held and the outer rim free.

    Differences that touch no unknown say nothing, so that two samples of data round about carry height and slope.
    """
    unknown = reached & ~mask
    if not unknown.any():
        return height_nm
    bending = _differences(reached, unknown)
    index = np.flatnonzero(unknown)
    held = bending @ np.where(mask, height_nm, 0.0).ravel()
    free = scipy.sparse.csc_array(bending[:, index])
    normal = scipy.sparse.csc_array(free.T @ free)
    full = np.where(mask, height_nm, 0.0).ravel()
    full[index] = scipy.sparse.linalg.splu(normal, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True}).solve(
        -(free.T @ held)
    )
    return np.asarray(full.reshape(mask.shape), dtype=np.float64)


def _differences(within: BoolArray, touched: BoolArray) -> scipy.sparse.csr_array:
    """(k, ny * nx) differences of samples that all lie ``within`` and of which one at least is ``touched``."""
    n = np.arange(within.size).reshape(within.shape)
    second, twist, slope = (1.0, -2.0, 1.0), tuple(2**0.5 * sign for sign in (1, -1, -1, 1)), (-SLACK, SLACK)
    stencils = (
        ((n[:, :-2], n[:, 1:-1], n[:, 2:]), second),
        ((n[:-2], n[1:-1], n[2:]), second),
        ((n[:-1, :-1], n[:-1, 1:], n[1:, :-1], n[1:, 1:]), twist),
        ((n[:, :-1], n[:, 1:]), slope),
        ((n[:-1], n[1:]), slope),
    )
    rows = []
    for places, weights in stencils:
        samples = np.stack([place.ravel() for place in places])
        samples = samples[:, within.ravel()[samples].all(axis=0) & touched.ravel()[samples].any(axis=0)]
        row = np.tile(np.arange(samples.shape[1]), len(weights))
        entries = (np.repeat(weights, samples.shape[1]), (row, samples.ravel()))
        rows.append(scipy.sparse.coo_array(entries, shape=(samples.shape[1], within.size)))
    return scipy.sparse.csr_array(scipy.sparse.vstack(rows, format="csr"))


def _band_limited(
    height_nm: FloatArray, mask: BoolArray, reached: BoolArray, cutoff: float
) -> tuple[FloatArray, int, float]:
    """Gerchberg's iteration ``u <- B (data + (1 - M) u)``, accelerated: heights, rounds, misfit.

    M cuts to the data, B to the band. It is Landweber's for ``B M B u = B M data``, which conjugate gradients solve
    with the same two projections a round, from the thin plate tapered to zero. Few rounds on purpose: what the data
    say least about (far off, near the cut-off) comes last, and as noise.
    """
    mean = float(height_nm[mask].mean())
    known = np.where(mask, height_nm - mean, 0.0)
    fit = mean + polynomial(known, mask, FIT_DEGREE)
    rest = np.where(mask, height_nm - fit, 0.0)
    scale = float(np.sqrt(np.mean(rest[mask] ** 2)))
    if scale <= 1e-12 * float(np.abs(height_nm[mask]).max()):
        return fit, 0, 0.0
    margin = int(np.ceil(cutoff))
    start, inside, window = taper_rim(_thin_plate(rest, mask, reached), reached, margin)
    data = np.zeros(start.shape)
    inside[window], data[window] = mask, rest
    band = frequencies(start.shape, 1.0) <= 1 / cutoff
    u = _project(start, band)
    u, rounds, misfit = _conjugate_gradients(u, data, inside, band)
    return fit + u[window], rounds, misfit / scale


def _conjugate_gradients(
    u: FloatArray, data: FloatArray, inside: BoolArray, band: BoolArray
) -> tuple[FloatArray, int, float]:
    """Least squares of a band-limited ``u`` on the data: the surface, rounds and misfit (RMS)."""
    left = np.where(inside, data - u, 0.0)
    gradient = _project(left, band)
    direction, square = gradient, _square(gradient)
    count, goal = int(np.count_nonzero(inside)), TOLERANCE * _square(data) ** 0.5
    misfits = [_square(left) ** 0.5]
    while len(misfits) <= ROUNDS and misfits[-1] > goal and square > 0:
        seen = np.where(inside, direction, 0.0)
        step = square / _square(seen)
        u = u + step * direction
        left = left - step * seen
        misfits.append(_square(left) ** 0.5)
        if len(misfits) > STALL and misfits[-1] > (1 - TOLERANCE) * misfits[-1 - STALL]:
            break
        gradient = _project(left, band)
        last, square = square, _square(gradient)
        direction = gradient + square / last * direction
    return u, len(misfits) - 1, misfits[-1] / count**0.5


def _square(u: FloatArray) -> float:
    return float(np.sum(u * u))  # no BLAS: its threads cost more than they gain here


def _project(u: FloatArray, band: BoolArray) -> FloatArray:
    return np.asarray(scipy.fft.irfft2(scipy.fft.rfft2(u) * band, u.shape), dtype=np.float64)
