"""How good a part truly is: bounds of its figures, from a measured map and all that is known of its errors."""

from __future__ import annotations

from polishd.process.trust.bound import (
    Bound,
    Contribution,
    Demand,
    RmsBound,
    demands,
    true_figure_bound,
    true_rms_bound,
)
from polishd.process.trust.errors import Errors, Noise, of_told

__all__ = [
    "Bound",
    "Contribution",
    "Demand",
    "Errors",
    "Noise",
    "RmsBound",
    "demands",
    "of_told",
    "true_figure_bound",
    "true_rms_bound",
]
