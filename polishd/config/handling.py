"""What a cell's file says of a part's seat, and of what happens between passes."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import BeforeValidator, Field, model_validator

from polishd.config.values import ConfigSection, Pair, Positive, Seconds, Text, Texts, as_tuple


class TouchOffSection(ConfigSection):
    """Height and seat of the part, proved before contact: left out, nobody proves them."""

    force_n: Annotated[float, Field(gt=0, le=0.8)] = 0.8
    """Force with which the tool rests on each place, its spindle at rest; a quarter more is let pass, 1 N at most."""
    force_max_n: Annotated[float, Field(gt=1, le=10)] = 2.0
    """Largest force that any device may read in a touch-off: one reading above it, or a rise that would pass it before
    the next one, leaves contact at once."""
    position_mm: Positive | None = None
    """Position of the actuator, in contact with that force, where the tool's tip is where the program says; left out:
    half of `actuator.stroke_mm`."""
    most_off_mm: Positive = 0.3
    """Farthest that any point of the part may sit from where `part` says. The tool is driven no deeper than that."""
    places_mm: Annotated[tuple[Pair, Pair, Pair] | None, BeforeValidator(as_tuple)] = None
    """Three places (x, y) on the part or its ring, outside the clear aperture; left out: on the middle of the rim that
    `part.edge_mm` leaves out."""
    each_pass: bool = False
    """Whether the part leaves its seat to be measured: then it is proved before each pass, else before the first one
    after a start, a hold or an interruption."""


class StepSection(ConfigSection):
    """A step that a person or a command does, tool up and robot at rest."""

    person: Text | None = None
    """What a person is asked to do: the cell is held until `polishd resume`."""
    command: Texts = ()
    """Program and arguments, run in the folder of the cell's file; done when it ends with 0."""
    within_s: Seconds = 600.0
    """Longest that the command may take; it is killed then."""

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        if (self.person is None) == (not self.command):
            raise ValueError('person: say who does it: person = "wipe the part", or command = ["./wash.sh"]')
        return self


class SettleSection(ConfigSection):
    """Maps are taken until two in a row agree within the instrument's noise; the last one counts."""

    wait_s: Annotated[float, Field(ge=0, le=86400)] = 60.0
    """Between two maps."""
    maps: Annotated[int, Field(ge=2, le=1000)] = 10
    """Most maps of one measurement; where none agrees with the one before, the cell is held. [1]"""


class BetweenSection(ConfigSection):
    """What happens between passes: each table that is there."""

    clean: StepSection | None = None
    """Before the part is measured."""
    settle: SettleSection | None = None
    """While it is measured, the first time too."""
    condition: StepSection | None = None
    """Of the pad, before the next pass."""
    change: StepSection | None = None
    """Of the tool, where there are [tools]; its name is in `POLISHD_TOOL`. Left out: a person mounts it."""
