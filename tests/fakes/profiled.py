"""Run the simulated device of a profile at the far end of a wire."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path

from polishd.sim_backends.common.device_profile import SimDeviceProfile
from polishd.sim_backends.profile_device.device import Gauge, Inverter, ProfileDeviceModel, by_profile
from tests.fakes.actuator import Coil
from tests.fakes.wires import Peer

IDENTITY = {"vendor": "Fake", "model": "F-1", "serial": "42", "firmware": "1.2", "boot": "3"}


class ProfiledPeer(Peer):
    """Peer that answers according to the profile; a request advances its machine."""

    def __init__(
        self, profile: Path, make: Callable[[SimDeviceProfile], ProfileDeviceModel], *, tcp: bool = False, unit: int = 1
    ) -> None:
        super().__init__()
        self.sheet = SimDeviceProfile.read(profile)
        self.machine = make(self.sheet)
        self.requests: list[bytes] = []
        self._slave = by_profile(self.sheet, self.machine, unit, tcp=tcp)

    def on_bytes(self, data: bytes) -> None:
        self.requests.append(data)
        self.step()
        for _, answer in self._slave.feed(data, time.monotonic()):
            self.send(answer)

    def step(self) -> None:
        """Advance the machine to the present."""
        self.machine.step(time.monotonic())


class IdealDrive:
    """Force drive that has the requested force at once, without scatter."""

    STATES = ("retracted", "extending", "contact", "retracting", "fault")

    def __init__(self, sheet: SimDeviceProfile) -> None:
        self.coil = Coil()
        self._engages = "engage" in sheet.raw["commands"]
        self._beats = "heartbeat" in sheet.raw["commands"]

    def values(self) -> Mapping[str, float | str]:
        coil = self.coil
        measured = {"force": coil.force_n, "set_point": coil.setpoint_n, "position": coil.position_um / 1000.0}
        return {**IDENTITY, **measured}

    def state(self) -> str:
        return self.STATES[self.coil.state]

    def watchdog_fault(self) -> bool:
        self.coil.update()
        return bool(self.coil.fault & 1)

    def order(self, name: str, asked: float) -> str:
        coil = self.coil
        if name in {"force", "rest"}:
            if not 0.0 <= asked <= 50.0:
                return "range"
            coil.setpoint_n = asked
            return "fault" if asked and not self._engages and not coil.engage() else ""
        if name == "engage":
            return "" if coil.engage() else "fault"
        if name == "watchdog":
            coil.watchdog_ms = round(asked)
        elif name == "heartbeat":
            coil.feed()
        else:
            coil.retract()
        return ""

    def on_request(self) -> None:
        if not self._beats:
            self.coil.feed()

    def step(self, now_s: float) -> None:
        self.coil.update()


def inverter(sheet: SimDeviceProfile) -> Inverter:
    """Return a quick inverter."""
    return Inverter(
        lambda *_a, **_k: None,
        time.monotonic(),
        max_rpm=sheet.raw["spindle"]["max_rpm"],
        ramp_rpm_s=6000.0,
        stop_rpm_s=12_000.0,
        watchdog_s=1.0,
        identity=IDENTITY,
    )


def gauge(pressed_n: Callable[[], float]) -> Callable[[SimDeviceProfile], Gauge]:
    """Return a factory of gauges that read this force."""
    return lambda _sheet: Gauge(pressed_n, IDENTITY)
