"""A voice coil behind the drive: profile torque presses it out against its spring, without current the spring lifts."""

from __future__ import annotations

from dataclasses import dataclass

from polishd.sim_backends.actuator.coil import VoiceCoil
from polishd.sim_backends.cia402 import power as stage
from polishd.sim_backends.cia402.objects import Objects
from polishd.sim_backends.cia402.power import Power

N_PER_PERMILLE = 0.05
BALANCE_N = 2.0
"""What the spring lifts with."""
MOST_N = 50.0
TORQUE_MODE = 4


@dataclass(slots=True)
class DrivenCoil:
    """The coil's mechanics, moved by current instead of by commands."""

    coil: VoiceCoil

    def step(self, now_s: float, objects: Objects, power: Power) -> None:
        """See Axis."""
        coil = self.coil
        coil.feed(0)  # its own watchdog is the drive's business here
        pressed_n = self._pressed_n(objects, power)
        if pressed_n > 0.0 or (pressed_n == 0.0 and coil.engaged):
            coil.set_force(min(pressed_n, MOST_N))
            coil.engage()
        else:
            coil.retract()
        coil.step(now_s)
        if power.state in {stage.QUICK_STOP, stage.REACTION}:
            power.stands()
        objects[0x6064] = round(coil.position_um)
        objects[0x6077] = self._torque(objects, power)

    def _pressed_n(self, objects: Objects, power: Power) -> float:
        """On the part; negative: it is lifted. Also in profile position, which here leads to its rest only."""
        if power.state == stage.ENABLED and objects[0x6061] == TORQUE_MODE:
            return round(objects[0x6071] * N_PER_PERMILLE - BALANCE_N, 9)
        return -BALANCE_N

    def _torque(self, objects: Objects, power: Power) -> int:
        if power.state != stage.ENABLED:
            return 0
        on_part = self.coil.engaged and self.coil.force_n > 0.0
        return round((self.coil.measured_n + BALANCE_N) / N_PER_PERMILLE) if on_part else objects[0x6071]
