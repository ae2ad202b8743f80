"""Fiducials in the map itself: dark marks reflect nothing, so they are small compact holes in the data."""

from __future__ import annotations

import numpy as np
import scipy

from polishd.model.surface import FloatArray
from polishd.process.registration.record import Point

SMALLEST_PX = 5
"""Pixels below which a hole is a drop-out."""
LARGEST_MM = 6.0
"""Diameter above which a hole is no mark."""
MOST_ELONGATED = 2.0
"""Longest to shortest axis of a hole that may be a mark; scratches are longer."""
LEAST_FULL = 0.7
"""Least share of its own ellipse that a hole fills: dirt has arms."""
CROSS = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], dtype=np.bool_)


def find(height_nm: FloatArray, pitch_mm: float) -> tuple[Point, ...]:
    """(row, column) px of the centroid of each hole that may be a mark, largest first; open to the outside is none.

    The missing pixels of a mark d pixels wide place its centre within about 0.15 / sqrt(d) pixels, RMS.

    Args:
        height_nm: (ny, nx), NaN = no data.
        pitch_mm: of the map.
    """
    missing = ~np.isfinite(height_nm)
    core = scipy.ndimage.binary_opening(
        missing, CROSS
    )  # without drop-outs; then with the marks' own outermost pixels again
    missing &= scipy.ndimage.binary_dilation(core, CROSS)
    labels, count = scipy.ndimage.label(missing)
    if not count:
        return ()
    area = np.bincount(labels.ravel(), minlength=count + 1)
    edge = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
    fits = (area >= SMALLEST_PX) & (area <= np.pi / 4 * (LARGEST_MM / pitch_mm) ** 2)
    fits[np.append(edge, 0)] = False
    boxes = scipy.ndimage.find_objects(labels)
    order = sorted(np.flatnonzero(fits), key=lambda label: -area[label])
    found = []
    for label in order:
        box = boxes[label - 1]
        row, column = np.nonzero(labels[box] == label)
        if _compact(row, column):
            found.append((float(row.mean() + box[0].start), float(column.mean() + box[1].start)))
    return tuple(found)


def _compact(row: np.ndarray, column: np.ndarray) -> bool:
    """Whether a hole is about an ellipse, of moments that its pixels have, and not too long."""
    moments = np.cov(np.stack([row, column]), bias=True) + np.eye(2) / 12  # a pixel is a square of its own
    short, long = np.sqrt(np.linalg.eigvalsh(moments))
    return bool(long <= MOST_ELONGATED * short and row.size >= LEAST_FULL * 4 * np.pi * short * long)
