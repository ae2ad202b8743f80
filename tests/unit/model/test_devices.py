"""What a signal must be, in numbers and in words."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from polishd.model.devices import SignalLimits, SignalRange

FLOW = SignalLimits(
    "slurry_flow", "monitor.plc", "AI3", "l/min", SignalRange(min=1.0), 30.0, SignalRange(0.8, 4.0), 2.0, "lift"
)


@pytest.mark.parametrize(
    ("bounds", "value", "broken"),
    [
        (SignalRange(min=1.0), 1.0, ""),
        (SignalRange(min=1.0), 0.99, "is 0.99 l/min, must be at least 1 l/min"),
        (SignalRange(max=30.0), 30.5, "is 30.5 l/min, must be at most 30 l/min"),
        (SignalRange(0.8, 4.0), 5.0, "is 5 l/min, must be at least 0.8 l/min and at most 4 l/min"),
        (SignalRange(0.8, 4.0), 4.0, ""),
        (SignalRange(min=1.0), math.nan, "is nan l/min, must be at least 1 l/min"),
        (SignalRange(min=1.0), math.inf, ""),
        (SignalRange(min=1.0), None, "is not known, must be at least 1 l/min"),
        (SignalRange(min=0.0), True, "is on, must be at least 0 l/min"),
        (SignalRange(state=True), True, ""),
        (SignalRange(state=True), False, "is off, must be on"),
        (SignalRange(state=False), True, "is on, must be off"),
        (SignalRange(state=False), None, "is not known, must be off"),
        (SignalRange(state=True), 1.0, "is 1 l/min, must be on"),
    ],
)
def test_a_value_against_its_bounds(bounds: SignalRange, value: float | bool | None, broken: str) -> None:
    assert bounds.broken(value, "l/min") == broken


def test_limits_say_what_they_are() -> None:
    assert str(FLOW) == (
        "slurry_flow of monitor.plc: before contact at least 1 l/min (waited for 30 s), in contact at least 0.8 l/min "
        "and at most 4 l/min (else lift after 2 s)"
    )
    assert str(replace(FLOW, before=None)).startswith("slurry_flow of monitor.plc: in contact at least 0.8")
    assert str(replace(FLOW, in_contact=None)).endswith("at least 1 l/min (waited for 30 s)")
