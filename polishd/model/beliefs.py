"""What is believed of a process, each number with its standard error, and what a pass adds to it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from polishd.model.surface import BoolArray, FloatArray


@dataclass(frozen=True, slots=True)
class Belief:
    """A number that is learned."""

    value: float
    sigma: float | None = None
    """Its standard error; None: nothing has been measured of it."""
    unit: str = "1"


@dataclass(frozen=True, slots=True)
class Beliefs:
    """What a removal model believes of the process, carried over the cycles of a job and kept with its passes.

    A model that learns more than the rate has a subclass with fields of its own: whatever JSON can hold.
    """

    rate: Belief = Belief(1.0)
    """Removal rate, relative to the model's own."""


UNTAUGHT = Beliefs()


@dataclass(frozen=True, slots=True)
class Evidence:
    """What a pass removed, for a removal model to learn from: the gate has found nothing wrong with it."""

    beliefs: Beliefs
    """With which ``predicted_nm`` was predicted."""
    executed_s: FloatArray
    """(n,) s: time that each timed point really had."""
    predicted_nm: FloatArray
    """(ny, nx) nm, positive = removed, without what nobody knows of it (piston, tilt); NaN outside the mask."""
    measured_nm: FloatArray
    """(ny, nx) nm: map before less map after, levelled alike."""
    mask: BoolArray
    """(ny, nx) the clear aperture."""
    pitch_mm: float
    tells_rate: bool
    """Whether a wrong rate would have been seen: else nothing may be learned of it."""
    rates: tuple[float, float]
    """Least and largest rate, relative to the model's own, that ``limits.max_rate_change`` allows."""


@dataclass(frozen=True, slots=True)
class Lesson:
    """What a pass taught a removal model."""

    beliefs: Beliefs
    found: Mapping[str, Any] = field(default_factory=dict)
    """How it was found, JSON-ready: stands in ``learned.json``."""
    notes: tuple[str, ...] = ()
    """For people: what was found and not taken."""
