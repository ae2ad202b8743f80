"""What passes show of their process, and what is found in it: a stall, a drift, a worn tool, another spot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from polishd.model.beliefs import Estimate

Kind = Literal["stall", "drift", "wear", "spot"]
Stops = Literal["job", "cell"]


@dataclass(frozen=True, slots=True)
class PassIndicators:
    """What a pass showed. RMS is of the process grid, as the plan's prediction is: map noise and ripple are not in it.

    What a pass was too weak, or too even, to show is None.
    """

    before_nm: float
    predicted_nm: float | None
    """RMS that its plan expected after it."""
    after_nm: float
    within_reach_nm: float | None
    """Of what is left, the RMS of periods that the spot corrects."""
    contact_s: float
    rate: Estimate | None
    """Removal rate, relative to the model's own."""
    fade: Estimate | None
    """Change of the rate from the pass's begin to its end, of its mean."""
    width: Estimate | None
    """By how much the spot is wider than the model's, relative."""
    expected_nm: tuple[float, float] | None = None
    """Between which ``seen_nm`` was expected, with a chance of nine in ten; None: nothing was."""
    seen_nm: float | None = None
    """RMS of the map itself, on its own samples: with its noise, and the ripple that a grid beside them smears."""


@dataclass(frozen=True, slots=True)
class PassSeries:
    """Passes by one process, over jobs, since the tool was last looked at."""

    process: str
    """What identifies the process: passes by another are no part of it."""
    passes: int = 0
    contact_h: float = 0.0
    reference: Estimate | None = None
    """Mean rate of the first of them that showed it."""
    rated: int = 0
    """How many showed it."""
    faded: float = 0.0
    """Sum of the fades of those that showed one, ..."""
    faded_variance: float = 0.0
    faded_h: float = 0.0
    """... and their hours in contact."""


@dataclass(frozen=True, slots=True)
class FindingLimits:
    """Beyond these, and surely so, something is found."""

    max_rate_drift: float = 0.25
    max_spot_change: float = 0.3
    least_gain: float = 0.3


@dataclass(frozen=True, slots=True)
class Finding:
    """What was found in a pass and those before it."""

    kind: Kind
    what: str
    """With its numbers, and what to do."""
    stops: Stops
    """What should not go on: this job only, or all jobs of the cell until a person has looked at the tool."""
