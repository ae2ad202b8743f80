"""Units that a device profile may write, and what they are in polishd's own."""

from __future__ import annotations

FORCE = {"N": 1.0, "mN": 1e-3, "kN": 1e3, "kgf": 9.80665, "gf": 9.80665e-3, "lbf": 4.4482216, "ozf": 0.27801385}
LENGTH = {"mm": 1.0, "um": 1e-3, "m": 1e3, "in": 25.4}
SPEED = {"rpm": 1.0, "1/s": 60.0}
FREQUENCY = {"Hz": 60.0}
"""Of the current in the motor: rpm are 60 times as many for one pair of poles."""
TIME = {"ms": 1.0, "s": 1e3}
PLAIN = {"1": 1.0}
FACTORS = FORCE | LENGTH | SPEED | FREQUENCY | TIME | PLAIN
KINDS = {"force": FORCE, "length": LENGTH, "speed": SPEED | FREQUENCY, "time": TIME}
"""By what is measured: the units that fit, each with its worth in N, mm, rpm or ms."""


def factor(unit: str, pole_pairs: int) -> float:
    """Worth of one of that unit in N, mm, rpm or ms."""
    return FACTORS[unit] / (pole_pairs if unit in FREQUENCY else 1)
