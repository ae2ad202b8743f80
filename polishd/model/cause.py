"""What may be wrong with a loop, in classes: what its evidence cannot tell apart bears one name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

CauseName = Literal["map", "shift", "rate", "settling", "mount", "field"]


@dataclass(frozen=True, slots=True)
class DiagnosisClass:
    """A class of causes."""

    members: str
    """What it may be: no evidence of a pass tells these apart."""
    todo: str
    """What is done about it, and what a person can do."""


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
        "a worn tool, the slurry, process.preston, a compliance that is off all over, a force or speed that nobody "
        "reads, or the factor of the map's heights",
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
        'noted: process.learns = "machine" learns a rate that changes over the part',
    ),
}
"""In the order in which the loop looks for them: of a map that lies wrongly no size is believed."""


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
    """In words."""
    again: bool = False
    """Suspected only: another map, with no pass between, tells."""

    @property
    def words(self) -> str:
        """With what cannot be told from it, and what is done."""
        cause = CAUSES[self.cause]
        return f"{self.what}: {cause.members}, which cannot be told apart; {cause.todo}"
