"""What a profile's device does, whatever it speaks: a force drive, an inverter, a force sensor. Pure of I/O."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

from polishd.config.simulator import FaultSection
from polishd.sim_backends.common.voice_coil import VoiceCoil

Refusal = str
"""Empty, ``range`` or ``fault``."""


class ProfileDeviceModel(Protocol):
    """Physical values by name, in N, mm, rpm and ms; a state in words; orders by name."""

    def values(self) -> Mapping[str, float | str]:
        """What it measures, and who it is."""
        ...

    def state(self) -> str:
        """By the words of profiles."""
        ...

    def watchdog_fault(self) -> bool:
        """Its own watchdog has run out, and nobody has taken that back."""
        ...

    def order(self, name: str, asked: float) -> Refusal:
        """Do what an order of the profile means."""
        ...

    def heard(self) -> None:
        """Somebody has asked, or told, something."""
        ...

    def step(self, now_s: float) -> None:
        """Bring it to the present."""
        ...


@dataclass(slots=True)
class ForceDrive:
    """A voice coil behind another face."""

    coil: VoiceCoil
    identity: Mapping[str, str]
    engages: bool
    """There is an order for it; else any force lands it."""
    beats: bool
    """There is an order that feeds its watchdog; else any request does."""
    STATES = ("retracted", "extending", "contact", "retracting", "fault")

    def values(self) -> Mapping[str, float | str]:
        """See Machine."""
        coil = self.coil
        set_point = coil.setpoint_n if coil.engaged else 0.0
        found: dict[str, float | str] = {**self.identity}
        return found | {"force": coil.measured_n, "set_point": set_point, "position": coil.position_um / 1000.0}

    def state(self) -> str:
        """See Machine."""
        return self.STATES[self.coil.state]

    def watchdog_fault(self) -> bool:
        """See Machine."""
        return bool(self.coil.faults & 1)

    def order(self, name: str, asked: float) -> Refusal:
        """See Machine."""
        coil = self.coil
        if name in {"force", "rest"}:
            lands = not self.engages and asked > 0.0
            return ("fault" if lands and coil.faults else coil.set_force(asked)) or (coil.engage() if lands else "")
        if name == "watchdog":
            return coil.set_watchdog(round(asked))
        if name == "heartbeat":
            return coil.feed(round(asked))
        orders: dict[str, Callable[[], str]] = {"engage": coil.engage, "retract": coil.retract, "clear": coil.retract}
        return orders[name]()

    def heard(self) -> None:
        """See Machine."""
        if not self.beats:
            self.coil.feed(self.coil.heartbeat + 1)

    def step(self, now_s: float) -> None:
        """See Machine."""
        self.coil.step(now_s)


@dataclass(slots=True)
class Inverter:
    """A motor on a ramp, which stops where nobody speaks to it any more, and then says that it has a fault."""

    report: Callable[..., None]
    now_s: float
    max_rpm: float
    ramp_rpm_s: float
    stop_rpm_s: float
    watchdog_s: float
    identity: Mapping[str, str]
    way: int = 1
    """-1: two phases are exchanged, so that the rotor turns the other way round. Without an encoder it cannot tell."""
    rpm: float = 0.0
    target_rpm: float = 0.0
    silent: bool = False
    """Its watchdog has run out."""
    samples: list[tuple[float, float]] = field(default_factory=list)
    """(time, rpm) since they were last taken."""
    _heard_s: float = 0.0
    _said: str = "stopped"

    def suffer(self, _fault: FaultSection, on: bool) -> None:
        """Two phases are exchanged, or put right."""
        self.way = -1 if on else 1
        self.samples.append((self.now_s, self.way * self.rpm))

    def values(self) -> Mapping[str, float | str]:
        """See Machine."""
        found: dict[str, float | str] = {**self.identity}
        return found | {"speed": self.rpm, "commanded": abs(self.target_rpm)}

    def state(self) -> str:
        """See Machine."""
        if self.silent:
            return "fault"
        return "running" if self.rpm or self.target_rpm else "stopped"

    def watchdog_fault(self) -> bool:
        """See Machine."""
        return self.silent

    def order(self, name: str, asked: float) -> Refusal:
        """See Machine."""
        if name in {"forward", "reverse"}:
            if self.silent:
                return "fault"
            if asked > self.max_rpm:
                return "range"
            self.target_rpm = asked if name == "forward" else -asked
        elif name == "stop":
            self.target_rpm = 0.0
        elif name == "clear" and self.rpm == 0.0:
            self.silent = False
        elif name == "watchdog":
            self.watchdog_s = asked / 1000.0
        return ""

    def heard(self) -> None:
        """See Machine."""
        self._heard_s = self.now_s

    def step(self, now_s: float) -> None:
        """See Machine."""
        if self.target_rpm and now_s - self._heard_s > self.watchdog_s:
            self.target_rpm, self.silent = 0.0, True
            self.report("watchdog", now_s)
        faster = abs(self.target_rpm) > abs(self.rpm) and self.rpm * self.target_rpm >= 0.0
        room = (self.ramp_rpm_s if faster else self.stop_rpm_s) * max(now_s - self.now_s, 0.0)
        before = self.rpm
        self.rpm += min(max(self.target_rpm - self.rpm, -room), room)
        if self.rpm != before:
            self.samples += [(self.now_s, self.way * before), (now_s, self.way * self.rpm)]
        self.now_s = max(now_s, self.now_s)
        self._tell(now_s)

    def _tell(self, now_s: float) -> None:
        moving = "ramping" if self.rpm != self.target_rpm else "at_speed" if self.rpm else "stopped"
        if moving != self._said:
            self._said = moving
            self.report(f"spindle_{moving}", now_s, rpm=round(self.rpm, 1))


@dataclass(slots=True)
class Gauge:
    """A force sensor: what presses on it, less what it was told is nothing."""

    pressed_n: Callable[[], float]
    identity: Mapping[str, str]
    zero_n: float = 0.0

    def values(self) -> Mapping[str, float | str]:
        """See Machine."""
        return {**self.identity, "force": self.pressed_n() - self.zero_n}

    def state(self) -> str:
        """See Machine."""
        return "measuring"

    def watchdog_fault(self) -> bool:
        """See Machine."""
        return False

    def order(self, name: str, asked: float) -> Refusal:  # noqa: ARG002 -- nothing is asked of a gauge
        """See Machine."""
        if name == "tare":
            self.zero_n = self.pressed_n()
        return ""

    def heard(self) -> None:
        """See Machine."""

    def step(self, now_s: float) -> None:
        """See Machine."""
