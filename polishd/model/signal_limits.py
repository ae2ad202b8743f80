"""What a signal of the cell must be, and what it leads to where it is not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

LeadsTo = Literal["notify", "hold", "lift", "estop"]


@dataclass(frozen=True, slots=True)
class Bounds:
    """A state, or a range; None: no bound."""

    min: float | None = None
    max: float | None = None
    state: bool | None = None

    def broken(self, value: float | bool | None, unit: str = "") -> str:
        """What is wrong with that value, in words; empty where it is as it must be. None: it is not known."""
        if self.state is not None:
            told = "not known" if value is None else _state(value) if isinstance(value, bool) else f"{value:g}"
            return "" if value is self.state else f"is {told}, must be {_state(self.state)}"
        if value is None or isinstance(value, bool):
            return f"is {'not known' if value is None else _state(value)}, must be {self._range(unit)}"
        low, high = self.min, self.max
        fits = value == value and (low is None or value >= low) and (high is None or value <= high)  # noqa: PLR0124 - NaN
        return "" if fits else f"is {_number(value, unit)}, must be {self._range(unit)}"

    def _range(self, unit: str) -> str:
        low = "" if self.min is None else f"at least {_number(self.min, unit)}"
        high = "" if self.max is None else f"at most {_number(self.max, unit)}"
        return " and ".join(filter(None, [low, high]))


def _state(value: bool) -> str:
    return "on" if value else "off"


def _number(value: float, unit: str) -> str:
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
    before: Bounds | None
    """What it must be before contact."""
    wait_s: float
    """So long that is waited for."""
    in_contact: Bounds | None
    grace_s: float
    """So long it may be outside in contact."""
    leads_to: LeadsTo
