"""Where the colors of a map end and which colors it has: one rule for the reports and for the page. Without matplotlib.

``polishd/web/static/maps/colormap.js`` has the same colors. A test compares both.
"""

from __future__ import annotations

import numpy as np

from polishd.model.surface import FloatArray

DIVERGING = "RdBu_r"
"""Colors of heights: red high, blue low, white at 0."""
SEQUENTIAL = "cividis"
"""Colors of values without a sign."""
PERCENTILE = 99.5
"""Percentile of the values at which the colors end: a few spikes do not make the rest pale."""
LEAST_NM = 1e-6
"""Smaller heights are rounding errors."""


def height_limit(height_nm: FloatArray, percentile: float = PERCENTILE) -> float:
    """Half-width of the color scale of heights about 0; 1 nm for a flat map."""
    inside = np.abs(height_nm[np.isfinite(height_nm)])
    limit = float(np.percentile(inside, percentile)) if inside.size else 0.0
    return limit if limit > LEAST_NM else 1.0


def value_limits(values: FloatArray, percentile: float = 100.0) -> tuple[float, float]:
    """Least value, and the percentile at which the colors end, of values without a sign. Never the same number."""
    inside = values[np.isfinite(values)]
    low, high = (float(inside.min()), float(np.percentile(inside, percentile))) if inside.size else (0.0, 0.0)
    return low, max(high, low + 1e-9)
