"""The behavior of a profile's device, for every protocol: a force drive, an inverter, a force sensor. Pure of I/O."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

from polishd.config.simulator import FaultSection
from polishd.sim_backends.common.voice_coil import VoiceCoil

Refusal = str
"""Empty, ``range`` or ``fault``."""


class ProfileDeviceModel(Protocol):
    """Physical values by name, in N, mm, rpm and ms; a state by its name; commands by name."""

    def values(self) -> Mapping[str, float | str]:
        """Measured values and identity."""
        ...

    def state(self) -> str:
        """Return the state by its name in profiles."""
        ...

    def watchdog_fault(self) -> bool:
        """True if its own watchdog has run out and the fault is not reset."""
        ...

    def order(self, name: str, value: float) -> Refusal:
        """Execute a command of the profile."""
        ...

    def on_request(self) -> None:
        """Take the heartbeat of a request."""
        ...

    def step(self, now_s: float) -> None:
        """Advance to the present."""
        ...


@dataclass(slots=True)
class ForceDrive:
    """A voice coil behind a profile."""

    coil: VoiceCoil
    identity: Mapping[str, str]
    engages: bool
    """There is a command that lands it; else any force does."""
    beats: bool
    """There is a command that feeds its watchdog; else any request does."""
    STATES = ("retracted", "extending", "contact", "retracting", "fault")

    def values(self) -> Mapping[str, float | str]:
        """See ProfileDeviceModel."""
        coil = self.coil
        set_point = coil.setpoint_n if coil.engaged else 0.0
        found: dict[str, float | str] = {**self.identity}
        return found | {"force": coil.measured_n, "set_point": set_point, "position": coil.position_um / 1000.0}

    def state(self) -> str:
        """See ProfileDeviceModel."""
        return self.STATES[self.coil.state]

    def watchdog_fault(self) -> bool:
        """See ProfileDeviceModel."""
        return bool(self.coil.faults & 1)

    def order(self, name: str, value: float) -> Refusal:
        """See ProfileDeviceModel."""
        coil = self.coil
        if name in {"force", "rest"}:
            lands = not self.engages and value > 0.0
            return ("fault" if lands and coil.faults else coil.set_force(value)) or (coil.engage() if lands else "")
        if name == "watchdog":
            return coil.set_watchdog(round(value))
        if name == "heartbeat":
            return coil.feed(round(value))
        orders: dict[str, Callable[[], str]] = {"engage": coil.engage, "retract": coil.retract, "clear": coil.retract}
        return orders[name]()

    def on_request(self) -> None:
        """See ProfileDeviceModel."""
        if not self.beats:
            self.coil.feed(self.coil.heartbeat + 1)

    def step(self, now_s: float) -> None:
        """See ProfileDeviceModel."""
        self.coil.step(now_s)


@dataclass(slots=True)
class Inverter:
    """A motor on a ramp. It stops when requests cease, and then reports a fault."""

    report: Callable[..., None]
    now_s: float
    max_rpm: float
    ramp_rpm_s: float
    stop_rpm_s: float
    watchdog_s: float
    identity: Mapping[str, str]
    way: int = 1
    """-1: two phases are exchanged, and the rotor turns the other way round. It has no encoder to detect that."""
    rpm: float = 0.0
    target_rpm: float = 0.0
    silent: bool = False
    """Its watchdog has run out."""
    samples: list[tuple[float, float]] = field(default_factory=list)
    """(time, rpm) since the samples were last taken."""
    _request_s: float = 0.0
    _reported: str = "stopped"

    def suffer(self, _fault: FaultSection, on: bool) -> None:
        """Exchange two phases, or restore them."""
        self.way = -1 if on else 1
        self.samples.append((self.now_s, self.way * self.rpm))

    def values(self) -> Mapping[str, float | str]:
        """See ProfileDeviceModel."""
        found: dict[str, float | str] = {**self.identity}
        return found | {"speed": self.rpm, "commanded": abs(self.target_rpm)}

    def state(self) -> str:
        """See ProfileDeviceModel."""
        if self.silent:
            return "fault"
        return "running" if self.rpm or self.target_rpm else "stopped"

    def watchdog_fault(self) -> bool:
        """See ProfileDeviceModel."""
        return self.silent

    def order(self, name: str, value: float) -> Refusal:
        """See ProfileDeviceModel."""
        if name in {"forward", "reverse"}:
            if self.silent:
                return "fault"
            if value > self.max_rpm:
                return "range"
            self.target_rpm = value if name == "forward" else -value
        elif name == "stop":
            self.target_rpm = 0.0
        elif name == "clear" and self.rpm == 0.0:
            self.silent = False
        elif name == "watchdog":
            self.watchdog_s = value / 1000.0
        return ""

    def on_request(self) -> None:
        """See ProfileDeviceModel."""
        self._request_s = self.now_s

    def step(self, now_s: float) -> None:
        """See ProfileDeviceModel."""
        if self.target_rpm and now_s - self._request_s > self.watchdog_s:
            self.target_rpm, self.silent = 0.0, True
            self.report("watchdog", now_s)
        faster = abs(self.target_rpm) > abs(self.rpm) and self.rpm * self.target_rpm >= 0.0
        room = (self.ramp_rpm_s if faster else self.stop_rpm_s) * max(now_s - self.now_s, 0.0)
        before = self.rpm
        self.rpm += min(max(self.target_rpm - self.rpm, -room), room)
        if self.rpm != before:
            self.samples += [(self.now_s, self.way * before), (now_s, self.way * self.rpm)]
        self.now_s = max(now_s, self.now_s)
        self._report_motion(now_s)

    def _report_motion(self, now_s: float) -> None:
        moving = "ramping" if self.rpm != self.target_rpm else "at_speed" if self.rpm else "stopped"
        if moving != self._reported:
            self._reported = moving
            self.report(f"spindle_{moving}", now_s, rpm=round(self.rpm, 1))


@dataclass(slots=True)
class Gauge:
    """A force sensor: the force on it, less its tare."""

    pressed_n: Callable[[], float]
    identity: Mapping[str, str]
    zero_n: float = 0.0

    def values(self) -> Mapping[str, float | str]:
        """See ProfileDeviceModel."""
        return {**self.identity, "force": self.pressed_n() - self.zero_n}

    def state(self) -> str:
        """See ProfileDeviceModel."""
        return "measuring"

    def watchdog_fault(self) -> bool:
        """See ProfileDeviceModel."""
        return False

    def order(self, name: str, value: float) -> Refusal:  # noqa: ARG002 -- a gauge has no set point
        """See ProfileDeviceModel."""
        if name == "tare":
            self.zero_n = self.pressed_n()
        return ""

    def on_request(self) -> None:
        """See ProfileDeviceModel."""

    def step(self, now_s: float) -> None:
        """See ProfileDeviceModel."""
