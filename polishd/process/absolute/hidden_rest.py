"""How much of an instrument's shorter waves poses leave unknown: those above the order of the Zernike terms.

N equal turns leave what is round and what has their folds there too, a share of about 1/N of any print. It is found by
trial: an instrument of noise alone, measured at these poses without a part, and what `split` does not find of it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.ndimage

from polishd.model.surface import BoolArray
from polishd.process.absolute.poses import PartPose
from polishd.process.absolute.rest import split
from polishd.process.metrics import zernike

RADIUS_PX = 30
"""Of the trial's aperture."""
WAVE_PX = 1.5
"""Over which its noise is made smooth, for turning it costs short waves by themselves."""
TRIALS = 3
"""Of some 300 waves each: the share is known to a tenth of itself."""


def hidden_share(poses: Sequence[PartPose], degree: int, radius_mm: float) -> float:
    """Mean share, 0 to 1, of the square of the instrument's waves above an order that stays in the part.

    Args:
        poses: of the part in each map.
        degree: radial order of the terms that are told otherwise.
        radius_mm: of the aperture.
    """
    along = np.arange(-RADIUS_PX, RADIUS_PX + 1)
    mask = np.hypot(along[:, None], along[None, :]) <= RADIUS_PX
    pitch_mm, axis = radius_mm / RADIUS_PX, (float(RADIUS_PX), float(RADIUS_PX))
    count = (degree + 1) * (degree + 2) // 2
    rng = np.random.default_rng(0)
    whole, hidden = 0.0, 0.0
    for _ in range(TRIALS):
        noise = np.where(mask, scipy.ndimage.gaussian_filter(rng.normal(size=mask.shape), WAVE_PX), np.nan)
        print_nm = noise - zernike.surface(zernike.fit(noise, mask, count, "ansi", circle_px=(*axis, RADIUS_PX)), mask)
        seen = [np.where(_on_part(pose, mask, pitch_mm), print_nm, np.nan) for pose in poses]
        found = split(seen, poses, axis, pitch_mm).instrument_nm
        there = np.isfinite(found)
        whole += float((print_nm[there] ** 2).sum())
        hidden += float(((print_nm - found)[there] ** 2).sum())
    return min(hidden / whole, 1.0) if whole else 1.0


def _on_part(pose: PartPose, mask: BoolArray, pitch_mm: float) -> BoolArray:
    """(ny, nx) samples of the map where the part is."""
    along = (np.arange(len(mask), dtype=np.float64) - RADIUS_PX) * pitch_mm
    x_mm, down_mm = np.meshgrid(along, along)
    x, y = pose.on_part(x_mm, -down_mm)
    return np.asarray(np.hypot(x, y) <= RADIUS_PX * pitch_mm)
