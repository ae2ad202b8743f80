"""What a reading of a controller's variables means, by its profile. Sans-IO."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from polishd.api import ProtocolError
from polishd.config.controller_profile import ClockVariable, Flag, StateVariable, Value, VariablesTable
from polishd.drivers.handover.variables import VariableSnapshot

MEANINGS = ("idle", "ready", "running", "paused", "held", "done", "ended", "fault")
LEAST_OVERRIDE = 0.01
"""Share of the programmed feed below which nothing moves any more."""


@dataclass(frozen=True, slots=True)
class ControllerReport:
    """What the controller was doing when it was looked at."""

    time_s: float
    """On its own clock, or on what stands for it."""
    states: frozenset[str]
    """What its state may mean: a value may stand for several."""
    line: int
    """As the profile's ``line`` counts."""
    line_began_s: float | None = None
    """When the block at that line began, where the controller tells, on the same clock."""
    state_began_s: float | None = None
    """When it came to its state, likewise."""
    moving: bool | None = None
    feed_held: bool = False
    override: float = 1.0
    """Share of the programmed feed."""
    alarm: str = ""
    beat: Value | None = None
    session: str = ""
    loaded: str | None = None

    @property
    def running(self) -> bool:
        """It executes its program."""
        return "running" in self.states

    @property
    def stands(self) -> bool:
        """Nothing moves, by all that it says."""
        return not self.running and not self.moving

    @property
    def stopped_by(self) -> str:
        """What somebody at the controller does that stands in the way of motion; empty where nothing does."""
        if self.feed_held:
            return "the feed is held at the controller"
        if self.override < LEAST_OVERRIDE:
            return f"the feed override stands at {100 * self.override:.5g} %"
        return ""


def report_of(table: VariablesTable, reading: VariableSnapshot) -> ControllerReport:
    """Understand a reading. ProtocolError where a value cannot be what the profile says."""
    values = reading.values
    line = values["line"]
    if isinstance(line, bool | str | float):
        raise ProtocolError(f"variable line: {line!r} is no line number: look at the controller's profile")
    override = values.get("feed_override")
    time_s = _time_of(table.clock, values.get("clock"))
    return ControllerReport(
        time_s=reading.time_s if time_s is None else time_s,
        states=_states(table.state, values["state"]),
        line=max(line, 0),  # some count what is no line at all below 0
        line_began_s=_line_began(table, reading),
        state_began_s=_time_of(table.state_began, values.get("state_began")),
        moving=_flag(table.in_motion, values.get("in_motion")),
        feed_held=bool(_flag(table.feed_hold, values.get("feed_hold"))),
        override=1.0 if table.feed_override is None else _number(override) / table.feed_override.full,
        alarm=_alarm(values),
        beat=values.get("controller_heartbeat"),
        session=str(values.get("session", "")),
        loaded=str(values["loaded"]) if "loaded" in values else None,
    )


def _states(state: StateVariable, value: Value) -> frozenset[str]:
    named = frozenset(name for name in MEANINGS if any(value == one for one in getattr(state, name)))
    return named or frozenset({"fault"})


def _time_of(clock: ClockVariable | None, value: Value | None) -> float | None:
    return None if clock is None else _number(value) * clock.unit_s


def _line_began(table: VariablesTable, reading: VariableSnapshot) -> float | None:
    if table.line_began is not None:
        return _time_of(table.line_began, reading.values["line_began"])
    if table.line.stamped and table.clock is None:
        return reading.changed_s.get("line")
    return None


def _flag(flag: Flag | None, value: Value | None) -> bool | None:
    return None if flag is None else value == flag.on


def _alarm(values: Mapping[str, Value]) -> str:
    alarm, text = values.get("alarm", 0), str(values.get("alarm_text", ""))
    if not alarm:
        return ""
    return f"alarm {alarm}{': ' if text else ''}{text}"


def _number(value: Value | None) -> float:
    if value is None or isinstance(value, str):
        raise ProtocolError(f"{value!r} is no number: look at the types in the controller's profile")
    return float(value)
