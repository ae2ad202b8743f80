"""How good a part truly is: bounds of its figures, from a measured map and all that is known of its errors."""

from __future__ import annotations

from polishd.process.trust.bound import (
    ErrorContribution,
    FigureBound,
    RemeasureAdvice,
    RmsBound,
    demands,
    true_figure_bound,
    true_rms_bound,
)
from polishd.process.trust.errors import MapErrors, MapNoise, errors_from_system_map

__all__ = [
    "FigureBound",
    "ErrorContribution",
    "RemeasureAdvice",
    "MapErrors",
    "MapNoise",
    "RmsBound",
    "demands",
    "errors_from_system_map",
    "true_figure_bound",
    "true_rms_bound",
]
