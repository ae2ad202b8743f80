"""The behavior of the voice coil, for every protocol. Pure of I/O; the caller passes wall times."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from polishd.config.simulator_faults import FaultSection

RETRACTED, EXTENDING, CONTACT, RETRACTING, FAULT = range(5)
WATCHDOG, OVER_FORCE, DRIVE, ENCODER = 1, 2, 4, 8

TOUCH_UM = 5000.0
"""Position at which the tool's tip is where the program commands it: there it meets a part in its nominal position."""
STROKE_UM = 10000.0
FOLLOWS_UM = 50.0
"""The bonnet keeps contact with a surface that moves away from it by at most this much within a step."""
LIFTED_UM = 200.0
"""The tool counts as lifted at this distance from the contact."""
RISE_N_S = 240.0
FALL_N_S = 1200.0
STEP_S = 0.005
MOST_DRIFT_N = 4.0

Refusal = Literal["", "range", "fault"]


COIL_FAULTS = ("freeze", "drift", "stick", "spike", "press", "lie")
"""States of ``[[fault]]`` that it can have."""


@dataclass(frozen=True, slots=True)
class CoilDynamics:
    """Speeds of motion, wall time, and weight of the tool."""

    land_s: float = 0.125
    """From its rest position to the part."""
    lift_s: float = 0.0625
    """From force off to its rest: for ``stick_share`` of it the tool stays in place, under ``resting_force_n``."""
    stick_share: float = 0.0
    resting_force_n: float = 0.0


@dataclass(slots=True)
class VoiceCoil:
    """Position, force and watchdog of the actuator."""

    rng: np.random.Generator
    report: Callable[..., None]
    """Write to the event log: (event, at_s, **data)."""
    now_s: float
    pace: CoilDynamics = CoilDynamics()
    setpoint_n: float = 0.0
    watchdog_ms: int = 500
    heartbeat: int = 0
    engaged: bool = False
    touch_um: float | None = None
    """Position at which the tool meets the part, from the plant; None: nothing is within its reach."""
    faults: int = 0
    position_um: float = 0.0
    force_n: float = 0.0
    samples: list[tuple[float, float]] = field(default_factory=list)
    """(time, true force) since the points were last taken."""
    stuck: bool = False
    """The force falls to 60 % in contact, whatever the set point is."""
    hung: bool = False
    """The firmware has died: it keeps pressing, gives no answers and watches nothing."""
    drift_n_s: float = 0.0
    """Drift rate of its force sensor, ..."""
    drift_n: float = 0.0
    """... and the drift so far: the force control uses the drifted reading."""
    frozen_n: float | None = None
    """Fixed reading of its force sensor; None: the true force."""
    spike_n: float = 0.0
    """Force beside the regulated one, from one step to the next."""
    pressed_n: float | None = None
    """Force that it exerts in contact, whatever the set point is; None: the set point."""
    factor: float = 1.0
    """Gain of its force sensor, ..."""
    offset_n: float = 0.0
    """... and offset. The force control uses the reading, where it contains any of the force."""
    _clung_s: float = 0.0
    _fed_s: float = 0.0
    _touching: bool = False
    _touched_um: float = TOUCH_UM
    """Position of the last contact with the part."""
    _noise: float = 0.0
    _spiked_n: float = 0.0
    """Share of ``force_n`` that is a spike."""

    def __post_init__(self) -> None:
        """Power up retracted."""
        self._fed_s = self.now_s
        self.samples.append((self.now_s, 0.0))

    @property
    def state(self) -> int:
        """The state number of the protocols."""
        if self.position_um <= 0.0:
            return FAULT if self.faults else RETRACTED
        if not self.engaged:
            return RETRACTING
        return CONTACT if self._touching else EXTENDING

    @property
    def measured_n(self) -> float:
        """The reading of the force sensor."""
        if self.frozen_n is not None:
            return self.frozen_n
        actual = self.force_n * (1.0 + self._noise) if self._touching else 0.0
        return self.factor * actual + self.offset_n + self.drift_n + 0.01 * float(self.rng.standard_normal())

    def suffer(self, fault: FaultSection, on: bool) -> None:
        """Set or clear that state; drift so far stays."""
        if fault.what == "stick":
            self.stuck = on
        elif fault.what == "drift":
            self.drift_n_s = fault.drift_n_s if on else 0.0
        elif fault.what == "spike":
            self.spike_n = fault.force_n if on else 0.0
        elif fault.what == "press":
            self.pressed_n = fault.force_n if on else None
        elif fault.what == "lie":
            self.factor, self.offset_n = (fault.factor, fault.offset_n) if on else (1.0, 0.0)
        else:
            self.frozen_n = self.measured_n if on else None

    def set_force(self, force_n: float) -> Refusal:
        """Take a new set point."""
        if not 0.0 <= force_n <= 50.0:
            return "range"
        if force_n != self.setpoint_n:
            self.report("force_setpoint", self.now_s, force_n=force_n)
        self.setpoint_n = force_n
        return ""

    def engage(self) -> Refusal:
        """Extend, land, regulate."""
        if self.faults:
            return "fault"
        if not self.engaged:
            self.report("engage", self.now_s, setpoint_n=self.setpoint_n)
            self._fed_s = self.now_s
        self.engaged = True
        return ""

    def retract(self) -> Refusal:
        """Force to 0, then lift; clears the watchdog fault."""
        if self.engaged:
            self.report("retract", self.now_s)
        self.engaged = False
        self.faults &= ~WATCHDOG
        return ""

    def set_watchdog(self, milliseconds: int) -> Refusal:
        """Take a new watchdog time."""
        if not 100 <= milliseconds <= 5000:
            return "range"
        self.watchdog_ms = milliseconds
        return ""

    def feed(self, value: int) -> Refusal:
        """Take the controller's heartbeat."""
        self.heartbeat, self._fed_s = value & 0xFFFF, self.now_s
        return ""

    def step(self, now_s: float) -> None:
        """Advance the actuator to the present, in steps short enough for its ramps."""
        while self.now_s < now_s:
            dt = min(STEP_S, now_s - self.now_s)
            self.now_s += dt
            silent = self.engaged and not self.hung
            if self.position_um > 0.0 and silent and self.now_s - self._fed_s > self.watchdog_ms / 1000.0:
                self.report("watchdog", self.now_s, silent_s=round(self.now_s - self._fed_s, 3))
                self.engaged, self.faults = False, self.faults | WATCHDOG
            before = self.force_n
            if self.engaged:
                self._extend(dt)
            else:
                self._withdraw(dt)
            if self.force_n != before:
                self._changed(before)

    def _extend(self, dt: float) -> None:
        touch_um = self.touch_um
        self.position_um += TOUCH_UM / self.pace.land_s * dt
        self.position_um = min(self.position_um, STROKE_UM if touch_um is None else touch_um)
        give_um = FOLLOWS_UM if self._touching else 0.0
        touching = touch_um is not None and self.position_um >= touch_um - give_um
        if touching:
            self._touched_um = self.position_um
        if touching != self._touching:
            self.report("tool_landed" if touching else "contact_lost", self.now_s)
        self._touching = touching
        if not touching:
            self.force_n = self._spiked_n = 0.0
            return
        self._noise += (-self._noise) * dt / 0.05 + 0.01 * (2.0 * dt / 0.05) ** 0.5 * float(self.rng.standard_normal())
        aim = self.setpoint_n
        if self.stuck and aim > 0.0:
            aim *= 0.6
        aim = max(aim - self._drifted(dt) - self.offset_n, 0.0) / (self.factor or 1.0)
        if self.pressed_n is not None:
            aim = self.pressed_n
        regulated_n = self.force_n - self._spiked_n
        regulated_n += min(max(aim - regulated_n, -FALL_N_S * dt), RISE_N_S * dt)
        self._spiked_n = max(self.spike_n, -regulated_n)  # a pull takes the force off, and no more
        self.force_n = regulated_n + self._spiked_n

    def _drifted(self, dt: float) -> float:
        """The drift of its sensor so far."""
        if self.drift_n_s:
            self.drift_n = min(max(self.drift_n + self.drift_n_s * dt, -MOST_DRIFT_N), MOST_DRIFT_N)
        return self.drift_n

    def _withdraw(self, dt: float) -> None:
        self._spiked_n = 0.0  # what is left of it goes with the force
        if self._touching:
            self._touching = self._clings(dt)
            self.force_n = self.force_n if self._touching else 0.0
            return
        if self.position_um <= 0.0:
            return
        lifted_um = self._touched_um - LIFTED_UM
        above = self.position_um > lifted_um
        lift_s = self.pace.lift_s * (1.0 - self.pace.stick_share)
        self.position_um = max(self.position_um - TOUCH_UM / lift_s * dt, 0.0)
        if above and self.position_um <= lifted_um:
            self.report("tool_lifted", self.now_s)
        if self.position_um == 0.0:
            self.report("retracted", self.now_s)

    def _clings(self, dt: float) -> bool:
        """Reduce the force to 0 while the tool still rests on the part for a while."""
        resting_force_n = min(self.pace.resting_force_n, self.force_n)
        if self.force_n > resting_force_n:
            self.force_n = max(self.force_n - FALL_N_S * dt, resting_force_n)
            if self.force_n == resting_force_n > 0.0:
                self.report("force_off", self.now_s, rests_n=resting_force_n)
            return True
        self._clung_s += dt
        clings = self._clung_s < self.pace.lift_s * self.pace.stick_share
        self._clung_s = self._clung_s if clings else 0.0
        return clings

    def _changed(self, before: float) -> None:
        if not self.samples or self.samples[-1][0] < self.now_s - STEP_S:
            self.samples.append((self.now_s - STEP_S, before))
        self.samples.append((self.now_s, self.force_n))
        if self.force_n == 0.0:
            self.report("force_zero", self.now_s, before_n=round(before, 3))
        elif before == 0.0:
            self.report("force_on", self.now_s)
