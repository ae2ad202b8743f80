"""What is believed of a process, each number with its standard error, and what a pass adds to it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from polishd.model.surface import BoolArray, FloatArray, Grid


@dataclass(frozen=True, slots=True)
class Estimate:
    """A number that is learned."""

    value: float
    sigma: float | None = None
    """Its standard error; None: nothing has been measured of it."""
    unit: str = "1"


@dataclass(frozen=True, slots=True)
class Estimates:
    """What a removal model believes of the process, carried over the cycles of a job and kept with its passes.

    A model that learns more than the rate has a subclass with fields of its own: whatever JSON can hold.
    """

    rate: Estimate = Estimate(1.0)
    """Removal rate, relative to the model's own."""


UNTAUGHT = Estimates()


@dataclass(frozen=True, slots=True)
class MachineEstimates(Estimates):
    """What identification believes of a machine, by its parameters (docs/identification.md), 0 as it is configured."""

    applied: Mapping[str, float] = field(default_factory=dict)
    """Those that plans count with, besides the rate; where none is, a plan is as if nothing were known of it."""
    mean: Mapping[str, float] = field(default_factory=dict)
    """All of them, applied or not; empty before the first pass."""
    covariance: tuple[tuple[float, ...], ...] = ()
    """Of those, in their order."""
    odds: Mapping[str, float] = field(default_factory=dict)
    """Natural logarithm, by choice (`Knowledge.odds`)."""
    pass_h: float = 0.0
    """Hours of contact of the last pass: what a plan takes the next one's to be, where the tool wears."""


@dataclass(frozen=True, slots=True)
class MapPixels:
    """A map's own samples: a point p of the part is seen at ``R(rotation) p + shift`` from the middle of the map."""

    grid: Grid
    rotation_deg: float = 0.0
    """Counter-clockwise."""
    shift_mm: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class PassEvidence:
    """What a pass removed, for a removal model to learn from: the gate has found nothing wrong with it."""

    beliefs: Estimates
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
    acted_s: FloatArray | None = None
    """(n,) s at the process's own force and speed that remove what the force and speed of the pass did; None: as
    executed."""
    noise_nm: float | None = None
    """Standard deviation of a sample of ``measured_nm`` by the instrument's repeatability; None: not known."""
    pixels: MapPixels | None = None
    """Of both maps: a sample of ``measured_nm`` is the mean of those that lie in its cell, by area. None: not known, or
    not the same of both."""
    most_miss_mm: float = 0.5
    """So far off where it should the spot may have acted: what is further stops for a person."""
    must_tell: bool = False
    """The pass was made to teach: where it does not, that stops for a person, too."""


@dataclass(frozen=True, slots=True)
class EstimateUpdate:
    """What a pass taught a removal model."""

    beliefs: Estimates
    found: Mapping[str, Any] = field(default_factory=dict)
    """How it was found, JSON-ready: stands in ``learned.json``."""
    notes: tuple[str, ...] = ()
    """For people: what was found and not taken."""
    stop: str = ""
    """Why a person must look before the next pass, and what to do; "" where the job may go on."""
