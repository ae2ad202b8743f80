"""The signals of a cell: what its monitors tell, held against the limits before contact and in it.

What no monitor has told for its silence is not known, and what is not known is as bad as what is wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from polishd.model.devices import Signal
from polishd.model.signal_limits import SignalLimits


class Signals:
    """Of one cell; a cell may have none."""

    def __init__(self, limits: Sequence[SignalLimits] = (), silence_s: Mapping[str, float] | None = None) -> None:
        """``silence_s``: of each monitor, for how long nothing of a signal may be told."""
        self.limits = limits
        self._silence_s = silence_s or {}
        self._last: dict[tuple[str, str], Signal] = {}
        self._silent_s: dict[tuple[str, str], float] = {}
        self._bad_s: dict[str, float] = {}
        self._told: set[str] = set()
        """In this contact."""
        self.on_force: Callable[[str, float], None] = lambda _name, _force_n: None
        """Is given each value of a signal that measures the force, as it comes."""

    def hear(self, monitor: str, signal: Signal) -> None:
        """A monitor has told one."""
        self._last[monitor, signal.name] = signal
        self._silent_s[monitor, signal.name] = 0.0
        for limits in self.limits:
            measured = limits.measures_force and (limits.monitor, limits.signal) == (monitor, signal.name)
            if measured and signal.value is not None:
                self.on_force(limits.name, float(signal.value))

    def pass_by(self, seconds: float, *, in_contact: bool) -> list[tuple[SignalLimits, str]]:
        """So much time has passed: those that have been wrong in contact for too long, and how they are; each once."""
        for heard in self._silent_s:
            self._silent_s[heard] += seconds
        if not in_contact:
            self._bad_s, self._told = {}, set()
            return []
        found = []
        for limits in self.limits:
            wrong = self._wrong(limits, in_contact=True)
            bad_s = self._bad_s.get(limits.name, 0.0) + seconds if wrong else 0.0
            self._bad_s[limits.name] = bad_s
            if wrong and bad_s > limits.grace_s and limits.name not in self._told:
                self._told.add(limits.name)
                found.append((limits, f"{wrong} in contact, and was not for more than {limits.grace_s:g} s"))
        return found

    def not_ready(self) -> dict[SignalLimits, str]:
        """Those that are not as they must be before contact, and how they are."""
        return {limits: wrong for limits in self.limits if (wrong := self._wrong(limits, in_contact=False))}

    def untold_on_order(self) -> bool:
        """Whether one is not known that counts when motion is ordered."""
        return any(self.value(limits) is None for limits in self.limits if limits.on_order is not None)

    def wrong_on_order(self) -> list[str]:
        """How those are that are not as they must be when a person orders motion."""
        found = [
            (limits.name, limits.on_order.broken(self.value(limits), limits.unit))
            for limits in self.limits
            if limits.on_order is not None
        ]
        return [f"{name} {broken}" for name, broken in found if broken]

    def facts(self) -> dict[str, dict[str, Any]]:
        """Each with its value, for ``status``: ``wrong`` says how it is not as it must be, before contact or in it."""
        return {
            limits.name: {
                "value": self.value(limits),
                "text": limits.said(self.value(limits)),
                "wrong": self._wrong(limits, in_contact=False) or self._wrong(limits, in_contact=True),
                "leads_to": limits.leads_to,
            }
            for limits in self.limits
        }

    def value(self, limits: SignalLimits) -> float | bool | None:
        """As it was told last; None: it is not known."""
        key = limits.monitor, limits.signal
        if key not in self._last or self._silent_s[key] > self._silence_s.get(limits.monitor, 0.0):
            return None
        return self._last[key].value

    def _wrong(self, limits: SignalLimits, *, in_contact: bool) -> str:
        bounds = limits.in_contact if in_contact else limits.before
        broken = "" if bounds is None else bounds.broken(self.value(limits), limits.unit)
        return f"{limits.name} {broken}" if broken else ""
