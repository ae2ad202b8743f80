"""Estimates of a process with their standard errors, and the evidence that a pass adds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

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
    """Estimates of the process by a removal model, carried over the cycles of a job and kept with its passes.

    A model that estimates more than the rate has a subclass with further fields of JSON values.
    """

    rate: Estimate = Estimate(1.0)
    """Removal rate, relative to the model's own."""


UNTAUGHT = Estimates()


@dataclass(frozen=True, slots=True)
class MachineEstimates(Estimates):
    """Estimated parameters of a machine (docs/explanation/identification.md); 0 is the configured value."""

    applied: Mapping[str, float] = field(default_factory=dict)
    """Parameters that plans use besides the rate; a missing one counts as 0."""
    mean: Mapping[str, float] = field(default_factory=dict)
    """All of them, applied or not; empty before the first pass."""
    covariance: tuple[tuple[float, ...], ...] = ()
    """Covariance of these parameters, in their order."""
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
    """Measured removal of a pass that the removal check accepted, for a removal model to estimate from."""

    beliefs: Estimates
    """With which ``predicted_nm`` was predicted."""
    executed_s: FloatArray
    """(n,) s: time that each timed point really had."""
    predicted_nm: FloatArray
    """(ny, nx) nm, positive = removed, without the unknown terms (piston, tilt); NaN outside the mask."""
    measured_nm: FloatArray
    """(ny, nx) nm: map before less map after, levelled alike."""
    mask: BoolArray
    """(ny, nx) the clear aperture."""
    pitch_mm: float
    tells_rate: bool
    """The pass shows a wrong rate; otherwise the rate must not be estimated from it."""
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
    """The pass measures the machine; without a result the cell stops for the operator."""


@dataclass(frozen=True, slots=True)
class EstimateUpdate:
    """Update of the estimates by a pass."""

    beliefs: Estimates
    found: Mapping[str, Any] = field(default_factory=dict)
    """Figures of the update, JSON-ready, for ``learned.json``."""
    notes: tuple[str, ...] = ()
    """For people: what was found and not taken."""
    stop: str = ""
    """Why a person must look before the next pass, and what to do; "" where the job may go on."""


# What passes show of their process, and what is found in it: a stall, a drift, a worn tool, another spot.

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
    """RMS of the residual at periods that the spot corrects."""
    contact_s: float
    rate: Estimate | None
    """Removal rate, relative to the model's own."""
    fade: Estimate | None
    """Change of the rate from the pass's begin to its end, of its mean."""
    width: Estimate | None
    """Relative excess of the spot's width over the model's."""
    expected_nm: tuple[float, float] | None = None
    """Between which ``seen_nm`` was expected, with a chance of nine in ten; None: nothing was."""
    seen_nm: float | None = None
    """RMS of the map itself, on its own samples: with its noise, and the ripple that a grid beside them smears."""


@dataclass(frozen=True, slots=True)
class PassSeries:
    """Passes by one process, over jobs, since the tool was last looked at."""

    process: str
    """Identity of the process; passes by another process are excluded."""
    passes: int = 0
    contact_h: float = 0.0
    reference: Estimate | None = None
    """Mean rate of the first of them that showed it."""
    rated: int = 0
    """Number of passes that showed it."""
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
    min_improvement: float = 0.3


@dataclass(frozen=True, slots=True)
class Finding:
    """Finding from a pass and those before it."""

    kind: Kind
    what: str
    """With its numbers, and what to do."""
    stops: Stops
    """Scope of the stop: this job, or all jobs of the cell until the operator has checked the tool."""


# What may be wrong with a loop, in classes: what its evidence cannot tell apart bears one name.

CauseName = Literal["map", "shift", "rate", "settling", "mount", "field"]


@dataclass(frozen=True, slots=True)
class DiagnosisClass:
    """A class of causes."""

    members: str
    """The possible causes, which the evidence of a pass cannot separate."""
    todo: str
    """Action of the daemon, and actions for the operator."""


CAUSES: dict[CauseName, DiagnosisClass] = {
    "map": DiagnosisClass(
        "the map lies on the part otherwise than the instrument's profile says, or the program otherwise than "
        "program.rotation_deg",
        "held: prove the profile with polishd map commission",
    ),
    "shift": DiagnosisClass(
        "the part off its seat, the program's offset, the map's registration, or a spot off its place whose spindle "
        "leans one way",
        "held beyond half a millimetre; less is noted",
    ),
    "rate": DiagnosisClass(
        "a worn tool, the slurry, process.preston, a compliance that is wrong everywhere, an unmonitored "
        "force or speed, or the factor of the map's heights",
        "held beyond what learning takes up; less is learned, and the next plan counts with it",
    ),
    "settling": DiagnosisClass(
        "a part that is warm still, or a set-up that bends it by other power or astigmatism",
        "measured again until it stays, and learned from the last map; held where the tolerance does not bear what "
        "still changes",
    ),
    "mount": DiagnosisClass(
        "three points of the mount that print through otherwise with each set-up",
        "held where the tolerance does not bear it: look at the mount's three points, and at how the part is clamped",
    ),
    "field": DiagnosisClass(
        "a removal rate that changes over the part, or a set-up that changed before the last pass and stays",
        'noted: process.estimates = "machine" learns a rate that changes over the part',
    ),
}
"""In the order of the checks: no size is meaningful in a misplaced map."""


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """A cause that a loop names."""

    cause: CauseName
    size: float
    sigma: float
    """Its standard error."""
    limit: float
    """The least size at which these maps would have named it."""
    unit: str
    what: str
    """Description."""
    again: bool = False
    """Suspected only: another map without a pass between decides."""

    @property
    def words(self) -> str:
        """Return the finding with its possible causes and the action."""
        cause = CAUSES[self.cause]
        return f"{self.what}: {cause.members}, which cannot be separated; {cause.todo}"
