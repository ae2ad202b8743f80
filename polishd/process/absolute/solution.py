"""Part and instrument by generalised least squares over their Zernike terms, in what the poses tell of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy

from polishd.model.surface import FloatArray
from polishd.process.absolute.design import Design
from polishd.process.absolute.poses import LEVEL, PartPose, moved

LEAST_SHARE = 0.1
"""Noise, in that of a fit with exact poses, below which it is not sought: the poses' errors explain all."""


@dataclass(frozen=True, slots=True)
class PlaceError:
    """How well poses are known, one standard deviation each, independent from map to map."""

    angle_deg: float = 0.0
    shift_mm: float = 0.0
    """In x and in y."""


@dataclass(frozen=True, slots=True)
class TermSolution:
    """Terms of both, and how sure they are. What is hidden is the part's: the instrument's share of it is 0."""

    part_nm: FloatArray
    """(j,) of the design's terms, RMS norm."""
    instrument_nm: FloatArray
    """(j,)"""
    covariance: FloatArray
    """(j, j) of the instrument's terms, nm^2, without what is hidden."""
    left_nm: FloatArray
    """(maps, j) seen less what part and instrument explain."""
    chi2: float
    """Of ``left_nm`` in the covariance of what was seen; its expectation is the design's freedom."""


def solve(design: Design, seen_nm: FloatArray, covariance: FloatArray) -> TermSolution:
    """Least squares over what the poses tell.

    Args:
        design: the poses.
        seen_nm: (maps, j) terms of each map.
        covariance: (maps, j, j) of each map's terms, nm^2; maps are independent.
    """
    size = len(design.terms)
    known = _complement(design.null)
    root = np.linalg.cholesky(covariance)
    whole = np.concatenate([design.moves, np.broadcast_to(np.eye(size), design.moves.shape)], axis=2) @ known
    rows = np.linalg.solve(root, whole).reshape(-1, known.shape[1])
    right = np.linalg.solve(root, seen_nm[:, :, None]).reshape(-1)
    q, r = np.linalg.qr(rows)
    value = np.linalg.solve(r, q.T @ right)
    spread = known @ np.linalg.inv(r)
    gauge = _gauge(design)
    both, spread = gauge @ (known @ value), gauge @ spread
    part, instrument = both[:size], both[size:]
    left = seen_nm - (design.moves @ part + instrument)
    return TermSolution(
        part_nm=part,
        instrument_nm=instrument,
        covariance=spread[size:] @ spread[size:].T,
        left_nm=left,
        chi2=float(((right - rows @ value) ** 2).sum()),
    )


def solve_noise(
    design: Design, seen_nm: FloatArray, per_noise: FloatArray, place: PlaceError, noise_nm: float | None
) -> tuple[TermSolution, float]:
    """The solution, and the noise of a sample: the one that is given, or that at which the misfit is as expected.

    Errors of the poses act through the part, as a first solution without them has it.

    Args:
        design: the poses; where the noise is not given, of a freedom above 0.
        seen_nm: (maps, j) terms of each map.
        per_noise: (maps, j, j) their covariance for noise of 1 nm a sample.
        place: how well the poses are known.
        noise_nm: of a sample; None: to be found.
    """
    exact = solve(design, seen_nm, per_noise)
    found = np.sqrt(exact.chi2 / design.freedom) if noise_nm is None else noise_nm
    least = float(np.finfo(float).eps * np.abs(seen_nm).max(initial=1.0))
    found = max(float(found), least)
    own = misplaced(design, exact.part_nm, place)
    if not own.any():
        return _scaled(exact, found), found

    def excess(noise: float) -> float:
        return solve(design, seen_nm, noise**2 * per_noise + own).chi2 - design.freedom

    if noise_nm is None and excess(LEAST_SHARE * found) <= 0:
        found *= LEAST_SHARE
    elif noise_nm is None:
        found = float(scipy.optimize.brentq(excess, LEAST_SHARE * found, found, rtol=1e-3))
    return solve(design, seen_nm, found**2 * per_noise + own), found


def misplaced(design: Design, part_nm: FloatArray, place: PlaceError) -> FloatArray:
    """(maps, j, j) covariance that errors of the poses give to the terms that are seen, nm^2."""
    whole = np.concatenate([np.zeros(LEVEL), part_nm])

    def seen(pose: PartPose) -> FloatArray:
        return np.asarray((moved(design.degree, pose, design.radius_mm) @ whole)[LEVEL:])

    found = []
    for pose in design.poses:
        ways = (
            replace(pose, angle_deg=pose.angle_deg + place.angle_deg),
            replace(pose, x_mm=pose.x_mm + place.shift_mm),
            replace(pose, y_mm=pose.y_mm + place.shift_mm),
        )
        change = np.stack([seen(way) - seen(pose) for way in ways])
        found.append(change.T @ change)
    return np.stack(found)


def _complement(null: FloatArray) -> FloatArray:
    """(2 j, p) orthonormal: all that is not in the null space."""
    whole, _ = np.linalg.qr(null, mode="complete")
    return np.asarray(whole[:, null.shape[1] :])


def _gauge(design: Design) -> FloatArray:
    """(2 j, 2 j) moves along the null space until the instrument has nothing of what is hidden: the part takes it."""
    size = len(design.terms)
    own = design.null[size:]
    away = np.linalg.pinv(own) @ design.hidden @ design.hidden.T
    found = np.eye(2 * size)
    found[:, size:] -= design.null @ away
    return found


def _scaled(found: TermSolution, noise_nm: float) -> TermSolution:
    """The same for noise that is not 1 nm a sample."""
    return replace(found, covariance=found.covariance * noise_nm**2, chi2=found.chi2 / noise_nm**2)
