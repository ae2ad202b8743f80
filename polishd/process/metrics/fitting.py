"""Least squares over very many samples: QR in blocks, so that the whole design matrix is never in memory."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from polishd.model.surface import BoolArray, FloatArray

BLOCK = 8192
"""Samples at a time: a block of 37 terms stays in the cache."""

Basis = Callable[[FloatArray, FloatArray], FloatArray]
"""From the coordinates of m samples, x and y, to (k, m): each of k functions there."""


def triangle(basis: Basis, x: FloatArray, y: FloatArray, values: FloatArray) -> FloatArray:
    """The R of the QR decomposition of ``[basis, values]``, as it comes from blocks stacked under one another.

    Args:
        basis: the functions to be fitted.
        x: (m,) coordinates.
        y: (m,) coordinates.
        values: (m,) what they are fitted to.

    Returns:
        (k + 1, k + 1) upper triangle, zero rows below if there are fewer samples: the first k columns are the basis's
        own R, the last one is the values in the orthogonal basis; its end is the norm of what the fit leaves.
    """
    found = np.zeros((0, 0))
    for start in range(0, len(values), BLOCK):
        part = slice(start, start + BLOCK)
        block = np.vstack([basis(x[part], y[part]), values[None, part]]).T
        found = _r(np.vstack([found, block]) if found.size else block)
    size = found.shape[1]
    return np.vstack([found, np.zeros((size - len(found), size))])


def _r(matrix: FloatArray) -> FloatArray:
    factor: FloatArray = np.linalg.qr(matrix, mode="r")  # type: ignore[assignment]  # numpy's stubs miss this mode
    return factor


def points(mask: BoolArray, x: ArrayLike, y: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """(m,) coordinates of the mask's samples in the order of ``height[mask]``, from those of columns and rows."""
    row, column = np.nonzero(mask)
    return np.asarray(x, dtype=np.float64)[column], np.asarray(y, dtype=np.float64)[row]
