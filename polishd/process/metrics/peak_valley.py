"""PVr: a peak-to-valley figure that one bad pixel does not set."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polishd.model.surface import BoolArray, FloatArray
from polishd.process.metrics import zernike
from polishd.process.metrics.zernike_terms import Ordering


@dataclass(frozen=True, slots=True)
class Pvr:
    """``pvr_nm = fit_pv_nm + 3 * residual_rms_nm``; without the number of terms it says nothing."""

    pvr_nm: float
    fit_pv_nm: float
    """PV of the fitted surface over the mask, piston and nothing else left out."""
    residual_rms_nm: float
    terms: int
    ordering: Ordering


def pvr(height_nm: FloatArray, mask: BoolArray, terms: int = 36) -> Pvr:
    """PV of a Zernike fit plus three times the RMS of what it leaves (C. J. Evans, Opt. Eng. 48(4), 043605, 2009).

    Args:
        height_nm: (ny, nx), finite inside ``mask``; take off tilt or power before where they are alignment.
        mask: (ny, nx) samples that count; the unit circle is ``zernike.enclosing(mask)``.
        terms: Zernike terms in fringe order, piston counted. Some programs take 37.

    Raises:
        BadMap: as ``zernike.fit``.
    """
    fitted = zernike.fit(height_nm, mask, terms, "fringe")
    pv = float(np.ptp(zernike.surface(fitted, mask)[mask]))
    return Pvr(pv + 3 * fitted.residual_rms_nm, pv, fitted.residual_rms_nm, terms, fitted.ordering)
