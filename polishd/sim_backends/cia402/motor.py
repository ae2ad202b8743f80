"""A spindle motor behind the drive: profile velocity with ramps, and a rotor that follows them a little late."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from polishd.config.simulator import FaultSection
from polishd.sim_backends.cia402 import power as stage
from polishd.sim_backends.cia402.objects import Objects
from polishd.sim_backends.cia402.power import Power

RPM = 0.1
"""Of a unit of velocity."""
COAST_RPM_S = 200.0
LAG_S = 0.02
NOISE_RPM = 0.2
STILL_RPM = 0.5
VELOCITY_MODE = 3
REACHED = 0x400


@dataclass(slots=True)
class Motor:
    """Speed of the rotor."""

    rng: np.random.Generator
    report: Callable[..., None]
    now_s: float
    speed: float = 1.0
    """Process seconds per wall second."""
    rpm: float = 0.0
    way: int = 1
    """-1: two phases are exchanged, so that the rotor turns the other way round. The encoder sees it."""
    jammed: bool = False
    """Held by something: it turns no faster, and no slower."""
    samples: list[tuple[float, float]] = field(default_factory=list)
    """(time, rpm) since they were last taken."""
    _demand: float = 0.0
    _said: str = "spindle_stopped"

    def __post_init__(self) -> None:
        """Stands."""
        self.samples.append((self.now_s, 0.0))

    def suffer(self, _fault: FaultSection, on: bool) -> None:
        """Two phases are exchanged, or put right."""
        self.way = -1 if on else 1
        self.samples.append((self.now_s, self.way * self.rpm))

    def step(self, now_s: float, objects: Objects, power: Power) -> None:
        """See Axis."""
        goal, slope = self._wanted(objects, power)
        elapsed_s, before = max(now_s - self.now_s, 0.0), self.rpm
        room = slope * self.speed * elapsed_s
        self._demand += min(max(goal - self._demand, -room), room)
        if not self.jammed:
            self.rpm += (self._demand - self.rpm) * -math.expm1(-elapsed_s * max(self.speed, 1.0) / LAG_S)
        if self._demand == 0.0 and abs(self.rpm) < STILL_RPM:
            self.rpm = 0.0
            power.stands()
        if self.rpm != before:
            self.samples += [(self.now_s, self.way * before), (now_s, self.way * self.rpm)]
        self.now_s = now_s
        noise = NOISE_RPM * float(self.rng.standard_normal()) if self.rpm else 0.0
        objects[0x606C] = round((self.way * self.rpm + noise) / RPM)
        reached = abs(self.rpm - goal) <= max(0.01 * abs(goal), STILL_RPM)
        objects[0x6041] = objects[0x6041] & ~REACHED | (REACHED if reached else 0)
        self._tell(power, reached)

    def _wanted(self, objects: Objects, power: Power) -> tuple[float, float]:
        """(rpm, rpm/s)."""
        if power.state == stage.ENABLED and objects[0x6061] == VELOCITY_MODE:
            goal = objects[0x60FF] * RPM
            return goal, objects[0x6083 if abs(goal) > abs(self._demand) else 0x6084] * RPM
        if power.live:
            return 0.0, objects[0x6085] * RPM
        return 0.0, COAST_RPM_S

    def _tell(self, power: Power, reached: bool) -> None:
        says = "spindle_ramping"
        if power.state == stage.FAULT:
            says = "spindle_fault"
        elif self.rpm == 0.0 and self._demand == 0.0:
            says = "spindle_stopped"
        elif reached and power.state == stage.ENABLED:
            says = "spindle_at_speed"
        if says != self._said:
            self._said = says
            self.report(says, self.now_s, rpm=round(self.rpm, 1))
