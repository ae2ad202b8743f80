"""Refusals of the process layer: the quantity, its value and unit, and the first wrong point of how many."""

from __future__ import annotations

import numpy as np

from polishd.model.errors import ComputeError
from polishd.model.surface import BoolArray, FloatArray


def refuse_where(bad: BoolArray, value: FloatArray, what: str, unit: str, limit: str) -> None:
    """Raise ComputeError for the first point of the (n,) mask ``bad``; ``value`` is (n,) in ``unit``."""
    count = int(np.count_nonzero(bad))
    if count:
        k = int(np.argmax(bad))
        error = ComputeError(
            f"point {k}: {what} is {value[k]:.6g} {unit}, {limit} (so at {count} of {bad.size} points, counted from 0)"
        )
        error.point = k
        raise error


def require_number(what: str, value: float, unit: str, *, above: float, below: float = np.inf) -> None:
    """Raise ComputeError unless ``above < value < below``; NaN never is."""
    if not above < value < below:
        lowest = f"above {above:g} and " if np.isfinite(above) else ""
        wanted = lowest + (f"below {below:g}" if np.isfinite(below) else "finite")
        raise ComputeError(f"{what} is {f'{value:.6g} {unit}'.rstrip()}, it must be {wanted}. Correct it")


def require_vectors(what: str, value: FloatArray, unit: str) -> FloatArray:
    """The (n, 3) array as float64; raise ComputeError where it has another shape or a number that is not finite."""
    array = np.asarray(value, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3:
        raise ComputeError(f"{what} has the shape {array.shape}, it must be (n, 3) in {unit}")
    finite = np.isfinite(array)
    if not finite.all():
        first = np.take_along_axis(array, finite.argmin(axis=1)[:, None], axis=1)[:, 0]
        refuse_where(np.asarray(~finite.all(axis=1)), first, what, unit, "it must be finite")
    return array


def require_unit_vectors(what: str, value: FloatArray) -> FloatArray:
    """The (n, 3) array as float64; raise ComputeError where a length is not 1 within 1e-6."""
    array = require_vectors(what, value, "(unit vector)")
    length = np.sqrt(np.einsum("ni,ni->n", array, array))
    refuse_where(np.abs(length - 1.0) > 1e-6, length, f"the length of {what}", "", "it must be 1")
    return array
