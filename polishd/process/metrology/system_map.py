"""What poses told of an instrument, kept beside its map: how sure each term is, and what nobody has seen."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from polishd.model.errors import MapError
from polishd.model.surface import BoolArray, FloatArray, SurfaceMap
from polishd.process.metrology import zernike
from polishd.process.metrology.absolute_test import AbsoluteSolution
from polishd.process.metrology.conditioning import SAME_PITCH
from polishd.process.metrology.zernike import values

DIGITS = 9
"""Of the covariance, as it is kept: fewer would leave it no covariance."""
Term = tuple[int, int]


@dataclass(frozen=True, slots=True)
class AbsoluteTestResult:
    """All that the bound of a figure needs to know of the instrument's map."""

    degree: int
    """Radial order of the terms."""
    terms: tuple[Term, ...]
    """(n, m) of the instrument's terms above tilt: RMS norm, angles from x towards y."""
    covariance: FloatArray
    """(j, j) nm^2 of them, as far as they were told."""
    unknown: Mapping[Term, float]
    """Of terms that are not told, which share is not: 0 to 1."""
    rest_nm: float
    """RMS of the waves above the terms that the poses leave in the part."""
    circle_px: tuple[float, float, float]
    """(row, column, radius) of the terms' unit circle in the map's frame."""

    @classmethod
    def of(cls, found: AbsoluteSolution) -> Self:
        """Of maps that were told apart."""
        design = found.design
        share = {(one.n, one.m): one.share for one in design.unknown}
        return cls(design.degree, design.terms, found.solution.covariance, share, found.hidden_rest_nm, found.circle_px)

    def with_reference(self, term: Term, sigma_nm: float) -> AbsoluteTestResult:
        """The same where a reference has told a term that no pose tells: known to ``sigma_nm``, one standard deviation.

        Raises:
            BadMap: the poses told it already, or there is no such term.
        """
        if term not in self.unknown:
            raise MapError(f"the term (n, m) = {term} is none that the poses left unknown: leave the reference out")
        at = self.terms.index(term)
        covariance = self.covariance.copy()
        covariance[at, :] = covariance[:, at] = 0.0
        covariance[at, at] = sigma_nm**2
        unknown = {one: share for one, share in self.unknown.items() if one != term}
        return replace(self, covariance=covariance, unknown=unknown)

    def shape(self, term: Term, mask: BoolArray) -> FloatArray:
        """(ny, nx) of a term of size 1 inside ``mask`` of the map's frame, NaN outside: RMS 1 over the circle."""
        height = np.full(mask.shape, np.nan)
        height[mask] = values((term,), "rms", *zernike.unit_coordinates(mask, self.circle_px))[0]
        return height

    def facts(self) -> dict[str, Any]:
        """Values of JSON: of the covariance the lower triangle, row by row."""
        lower = self.covariance[np.tril_indices(len(self.terms))]
        return {
            "degree": self.degree,
            "terms": [list(term) for term in self.terms],
            "covariance": [float(f"{value:.{DIGITS}g}") for value in lower],
            "unknown": [[*term, share] for term, share in self.unknown.items()],
            "rest_nm": self.rest_nm,
            "circle_px": list(self.circle_px),
        }

    @classmethod
    def load(cls, facts: Mapping[str, Any]) -> Self:
        """From them again; ValueError, TypeError or KeyError where they are none."""
        terms = tuple((int(n), int(m)) for n, m in facts["terms"])
        covariance = np.zeros((len(terms), len(terms)))
        covariance[np.tril_indices(len(terms))] = facts["covariance"]
        row, column, radius = map(float, facts["circle_px"])
        return cls(
            int(facts["degree"]),
            terms,
            covariance + np.tril(covariance, -1).T,
            {(int(n), int(m)): float(share) for n, m, share in facts["unknown"]},
            float(facts["rest_nm"]),
            (row, column, radius),
        )


@dataclass(frozen=True, slots=True)
class SystemMap:
    """An instrument's own error, which is taken off each of its maps."""

    surface: SurfaceMap
    """As the instrument's profile turns and scales its maps: of one frame with them."""
    told: AbsoluteTestResult

    def off(self, surface: SurfaceMap) -> SurfaceMap:
        """The map less the instrument's error, sample by sample; no data where that has none.

        Args:
            surface: as the profile turns and scales it.

        Raises:
            BadMap: it is of another frame: other samples, or another pitch.
        """
        own, other = self.surface.height_nm.shape, surface.height_nm.shape
        pitch, wanted = surface.pitch_mm, self.surface.grid.pitch_mm
        if other != own or pitch is None or abs(pitch - wanted) > SAME_PITCH * wanted:
            name = surface.path.name if surface.path is not None else "the map"
            given = "no pitch" if pitch is None else f"{pitch:.6g} mm"
            raise MapError(
                f"{name} has {other[0]} x {other[1]} samples of {given}, the instrument's system map "
                f"{own[0]} x {own[1]} of {wanted:.6g} mm: measure with the zoom and crop of its calibration, or "
                "calibrate it with these"
            )
        return surface.with_height(surface.height_nm - self.surface.height_nm)
