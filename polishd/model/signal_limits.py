"""What a signal of the cell must be, and what it leads to where it is not."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

LeadsTo = Literal["notify", "hold", "lift", "estop"]


@dataclass(frozen=True, slots=True)
class SignalRange:
    """A state, or a range; None: no bound."""

    min: float | None = None
    max: float | None = None
    state: bool | None = None

    def broken(self, value: float | bool | None, unit: str = "") -> str:
        """What is wrong with that value, in words; empty where it is as it must be. None: it is not known."""
        return "" if self._holds(value) else f"is {in_words(value, unit)}, must be {self.words(unit)}"

    def words(self, unit: str = "") -> str:
        """What a value must be."""
        if self.state is not None:
            return in_words(self.state)
        low = "" if self.min is None else f"at least {in_words(self.min, unit)}"
        high = "" if self.max is None else f"at most {in_words(self.max, unit)}"
        return " and ".join(filter(None, [low, high]))

    def _holds(self, value: float | bool | None) -> bool:
        if value is None or isinstance(value, bool) or self.state is not None:
            return value is not None and value is self.state
        return (-math.inf if self.min is None else self.min) <= value <= (math.inf if self.max is None else self.max)


def in_words(value: float | bool | None, unit: str = "") -> str:
    """A number with its unit, a state, or that it is not known."""
    if value is None or isinstance(value, bool):
        return {None: "not known", True: "on", False: "off"}[value]
    return f"{value:g} {unit}".rstrip()


@dataclass(frozen=True, slots=True)
class SignalLimits:
    """A signal that is watched, and its limits."""

    name: str
    """Of its section, `[signals.NAME]`."""
    monitor: str
    """The device that tells it."""
    signal: str
    """As that calls it."""
    unit: str
    before: SignalRange | None
    """What it must be before contact."""
    wait_s: float
    """So long that is waited for."""
    in_contact: SignalRange | None
    grace_s: float
    """So long it may be outside in contact."""
    leads_to: LeadsTo
    on_order: SignalRange | None = None
    """What it must be when a person orders motion."""
    measures_force: bool = False
    """It reads the force on the part, N."""

    def said(self, value: float | bool | None) -> str:
        """A value in words."""
        return in_words(value, self.unit)

    def __str__(self) -> str:
        """With its limits and what they lead to."""
        said = ["force on the part"] if self.measures_force else []
        if self.before is not None:
            said.append(f"before contact {self.before.words(self.unit)} (waited for {self.wait_s:g} s)")
        if self.in_contact is not None:
            said.append(
                f"in contact {self.in_contact.words(self.unit)} (else {self.leads_to} after {self.grace_s:g} s)"
            )
        if self.on_order is not None:
            said.append(f"when motion is ordered {self.on_order.words(self.unit)}")
        return f"{self.name} of {self.monitor}: {', '.join(said)}"
