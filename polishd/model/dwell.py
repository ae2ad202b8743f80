"""Dwell solutions and the certificate without which none is used."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from numpy.typing import NDArray

from polishd.model.surface import FloatArray

Choice = Literal["least", "knee", "target", "budget", "as_programmed"]
AS_PROGRAMMED: Choice = "as_programmed"
"""The least residual; where 1 % more time buys less than 1 % of it; the least time for a target; the best in a time."""


@dataclass(frozen=True, slots=True)
class OptimalityCertificate:
    """Figures of a dwell solution, computed from the solution in float64."""

    solver: str
    objective: float
    kkt_residual: float
    """Largest component of the projected gradient, relative to the largest gradient at the lower bound."""
    bound_violation_s: float
    predicted_rms_nm: float
    """RMS (mean removed) of the predicted residual in the clear aperture."""
    predicted_pv_nm: float
    dwell_total_s: float
    piston_nm: float
    """Requested mean removal in the clear aperture."""
    at_lower: int
    at_upper: int
    iterations: int
    seconds: float
    """CPU seconds of the solver."""
    stopped: str
    """Why the solver stopped: ``converged``, ``deadline``, ``iterations``; what was used may follow."""
    cross_check: str | None = None
    """Name of an independent solver that solved it too, or None."""
    cross_check_gap: float | None = None
    """(our objective - its objective) / its objective; at most a small positive number."""
    notes: tuple[str, ...] = ()
    gap: float | None = None
    """Proved: no dwell within the bounds has an objective that is lower by more than this share; None: nothing is."""
    gap_nm: float | None = None
    """Gap of the objective's root: the RMS of the solved area, where price and regularization are small."""
    predicted_band_rms_nm: float | None = None
    """RMS of the periods above the problem's ``band_period_mm`` in the clear aperture; None: not requested."""
    cutoff_period_mm: float | None = None
    """Shorter periods no dwell with this spot removes; None: not known, or finer than the process grid shows."""
    floor_nm: float | None = None
    """Mean removal in the clear aperture of the shortest times that the machine can make; None: not known."""


@dataclass(frozen=True, slots=True)
class WarmStart:
    """A start that was kept with a run."""

    time_s: FloatArray
    state: Mapping[str, NDArray[Any]]


@dataclass(frozen=True, slots=True)
class DwellSolution:
    """Dwell per timed point with its certificate and the residual that it predicts."""

    time_s: FloatArray
    """(n,) seconds at each timed point."""
    removal_nm: FloatArray
    """(ny, nx) predicted removal on the process grid."""
    residual_nm: FloatArray
    """(ny, nx) predicted surface after the pass, NaN outside the mask."""
    certificate: OptimalityCertificate
    lower_s: FloatArray = field(repr=False)
    upper_s: FloatArray = field(repr=False)
    state: Mapping[str, NDArray[Any]] = field(default_factory=dict, repr=False)
    """State from which its solver can continue, by name; kept with the run."""


Start = WarmStart | DwellSolution
"""Start of a solver: the kept state of a run, or a solution of a similar problem."""
