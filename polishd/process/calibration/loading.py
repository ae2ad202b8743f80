"""Static loading tests: the tool is pushed along a direction, and gives way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polishd.model.errors import ComputeError
from polishd.model.surface import FloatArray
from polishd.process.robot.refusal import refuse_where, require_unit_vectors, require_vectors


@dataclass(frozen=True, slots=True)
class LoadingTests:
    """n tests, one a row; base frame."""

    tip_mm: FloatArray
    """(n, 3) tool tips."""
    axis: FloatArray
    """(n, 3) unit tool axes, from the tip into the spindle."""
    direction: FloatArray
    """(n, 3) unit, along which the tip was loaded and its way measured: the surface normal, or any other."""
    compliance_um_per_n: FloatArray
    """(n,) way per force."""

    def __len__(self) -> int:
        return len(self.tip_mm)


@dataclass(frozen=True, slots=True)
class PercentErrors:
    """Absolute percentage errors, of the measured value, as the paper quotes them (fig. 10)."""

    tests: int
    mean_percent: float
    max_percent: float


def require_tests(tests: LoadingTests, what: str) -> LoadingTests:
    """The tests as float64 arrays; ComputeError names the first that is none (``point`` is the row, from 0)."""
    tip = require_vectors(f"tool tip of {what}", tests.tip_mm, "mm")
    axis = require_unit_vectors(f"tool axis of {what}", tests.axis)
    direction = require_unit_vectors(f"direction of {what}", tests.direction)
    measured = np.asarray(tests.compliance_um_per_n, dtype=np.float64)
    if not len(tip) == len(axis) == len(direction) or measured.shape != (len(tip),):
        raise ComputeError(
            f"{what}: {len(tip)} tool tips, {len(axis)} axes, {len(direction)} directions and compliances of the shape "
            f"{measured.shape} do not go together"
        )
    wrong = ~(np.isfinite(measured) & (measured > 0))
    refuse_where(wrong, measured, f"the compliance of {what}", "um/N", "it must be finite and above 0")
    return LoadingTests(tip, axis, direction, measured)


def percent_errors(relative: FloatArray) -> PercentErrors:
    """From what the model is off by, relative to each measured value, (n,), n above 0."""
    error = 100 * np.abs(relative)
    return PercentErrors(len(error), float(error.mean()), float(error.max()))
