"""``[signals.NAME]``: what a signal of the cell must be before contact and in it, and what it leads to."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from polishd.config.values import ConfigSection, Name, Text
from polishd.model.signal_limits import LeadsTo, SignalLimits, SignalRange


class BoundsSection(ConfigSection):
    """What a signal must be: a state, or a range."""

    min: float | None = None
    """Least that it may be. [in `unit`]"""
    max: float | None = None
    """Most that it may be. [in `unit`]"""
    state: bool | None = None
    """What a signal that is on or off must be."""

    @model_validator(mode="after")
    def _says_something(self) -> Self:
        if self.state is None and self.min is None and self.max is None:
            raise ValueError("says nothing; write min, max, or state")
        if self.state is not None and (self.min, self.max) != (None, None):
            raise ValueError("state: goes without min and max; a signal is a state or a number")
        if self.min is not None and self.max is not None and self.min > self.max:
            raise ValueError("min: must be at most max")
        return self

    @property
    def bounds(self) -> SignalRange:
        """As they are judged."""
        return SignalRange(self.min, self.max, self.state)


class BeforeSection(BoundsSection):
    """What it must be before contact: the cell waits for that, and is then held."""

    wait_s: Annotated[float, Field(ge=0, le=3600)] = 30.0
    """How long it is waited for."""


class InContactSection(BoundsSection):
    """What it must be in contact."""

    grace_s: Annotated[float, Field(ge=0, le=600)] = 0.5
    """How long it may be otherwise, or not known."""


class SignalSection(ConfigSection):
    """A signal of the cell that is watched: slurry flow, a pressure, a guard (docs/monitors.md)."""

    monitor: Name | None = None
    """Which of several monitors tells it: `plc` of `[monitor.plc]`."""
    signal: Text | None = None
    """How the monitor calls it; left out: as its section is named."""
    unit: str = ""
    """Of its values, for messages."""
    measures: Literal["force"] | None = None
    """It measures the force on the part, in N: one value above `process.force_max_n` (in a touch-off
    `touch_off.force_max_n`) leaves contact at once, whatever else is asked of it."""
    before: BeforeSection | None = None
    in_contact: InContactSection | None = None
    on_order: BoundsSection | None = None
    """What it must be when a person orders motion, wherever from: the key at the cell that says it is clear. Else
    `resume` and `approve` are refused."""
    leads_to: LeadsTo = "hold"
    """What follows in contact: people are told and it goes on; contact is left, and the cell is held; or its daemon
    ends as after any safety stop; or motion stops at once, whatever the part costs."""

    @model_validator(mode="after")
    def _is_watched(self) -> Self:
        if self.measures == "force" and self.unit not in {"", "N"}:
            raise ValueError(f'unit: is {self.unit!r}, and a signal that measures the force has "N"')
        if (self.before, self.in_contact, self.on_order, self.measures) == (None, None, None, None):
            raise ValueError("nothing is asked of it; write before = {...}, in_contact = {...}, or both")
        if self.in_contact is None and "leads_to" in self.model_fields_set:
            raise ValueError("leads_to: goes with in_contact; what is not so before contact holds the cell")
        return self

    def limits(self, name: str) -> SignalLimits:
        """As the daemon watches it."""
        before, in_contact = self.before, self.in_contact
        return SignalLimits(
            name=name,
            monitor="monitor" if self.monitor is None else f"monitor.{self.monitor}",
            signal=self.signal or name,
            unit=self.unit,
            before=before.bounds if before else None,
            wait_s=before.wait_s if before else 0.0,
            in_contact=in_contact.bounds if in_contact else None,
            grace_s=in_contact.grace_s if in_contact else 0.0,
            leads_to=self.leads_to,
            on_order=self.on_order.bounds if self.on_order else None,
            measures_force=self.measures == "force",
        )
