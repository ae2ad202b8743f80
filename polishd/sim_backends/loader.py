"""The simulated part loader."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal
from urllib.parse import quote, unquote

from polishd.config.simulator_devices import LoaderFaults, SimLoaderSection
from polishd.sim_backends.common.registry import SimDevice
from polishd.sim_backends.common.runtime import SimRuntime
from polishd.sim_backends.common.wire import Answer, serve

# The behavior of the loader, for every protocol. Pure of I/O; the caller passes wall times.

IDLE, MOVING, STOPPED, FAULT = range(4)
JAMMED, DROPPED = 1, 2
ANOTHER = "OTHER-7"
"""Id of the part that it brings with the fault of a wrong part."""

Refusal = Literal["", "part", "occupied", "busy", "fault"]


@dataclass(slots=True)
class LoaderArm:
    """One arm, one seat, and a store of parts."""

    report: Callable[..., None]
    """Write to the event log: (event, at_s, **data)."""
    seated: Callable[[str], None]
    """Sends the part now on the seat to the plant; empty: none."""
    now_s: float
    seat: str
    """The part that is truly on the seat."""
    store: Sequence[str] = ()
    """Parts that it accepts; empty: any."""
    load_s: float = 0.5
    unload_s: float = 0.5
    watchdog_s: float = 5.0
    faults: LoaderFaults = field(default_factory=LoaderFaults)
    fault: int = 0
    false_reading: str = ""
    """A false reading of the seat by its reader; else empty."""
    _order: str | None = None
    """The part that it loads; empty: it unloads. None: idle."""
    _left_s: float = 0.0
    _stopped: bool = False
    _request_s: float = 0.0
    _struck: set[str] = field(default_factory=set)

    @property
    def state(self) -> int:
        """The state number of the protocol."""
        if self.fault:
            return FAULT
        return IDLE if self._order is None else STOPPED if self._stopped else MOVING

    @property
    def seen(self) -> str:
        """The part that its reader reports on the seat."""
        return self.false_reading or self.seat

    def load(self, part: str) -> Refusal:
        """Begin or continue to load a part; no motion where it is there."""
        if self.store and part not in self.store:
            return "part"
        if self.seen == part and self._order is None and not self.fault:
            return ""
        return self._begin(part, self.load_s, "occupied" if self.seat else "")

    def unload(self) -> Refusal:
        """Begin to unload the part, or return the one that it carries; no motion for an empty seat."""
        if not self.seat and self._order is None and not self.fault:
            return ""
        return self._begin("", self.unload_s, "")

    def stop(self) -> Refusal:
        """Stand still."""
        if self.state == MOVING:
            self._stopped = True
            self.report("loader_stopped", self.now_s)
        return ""

    def reset(self) -> None:
        """Confirm at the loader that the fault is cleared."""
        self.fault, self._order = 0, None

    def on_request(self) -> None:
        """Take the heartbeat of a request."""
        self._request_s = self.now_s

    def step(self, now_s: float) -> None:
        """Advance to the present."""
        passed, self.now_s = now_s - self.now_s, now_s
        if self.state != MOVING:
            return
        if now_s - self._request_s > self.watchdog_s:
            self.report("watchdog", now_s)
            self.stop()
            return
        self._left_s -= passed
        if self._left_s <= 0.0 and self._order is not None:
            self._arrive(self._order)

    def _begin(self, order: str, seconds: float, refusal: Refusal) -> Refusal:
        if self.fault:
            return "fault"
        if self.state == MOVING:
            return "busy"
        if refusal:
            return refusal
        if order != self._order:
            self._left_s = seconds
        self._order, self._stopped = order, False
        self.report("loader_moves", self.now_s, part=order)
        return ""

    def _arrive(self, order: str) -> None:
        self._order, kind = None, self._mischief(order)
        if kind:
            self.fault = kind
            self.report("loader_fault", self.now_s, fault=kind, part=order)
            return
        brought = ANOTHER if order in {*self.faults.wrong, *self.faults.wrong_part_unnoticed} else order
        self.seat, self.false_reading = brought, order if order in self.faults.wrong_part_unnoticed else ""
        self.seated(self.seat)
        self.report("loader_clear", self.now_s, seat=self.seat)

    def _mischief(self, order: str) -> int:
        kind = DROPPED if order in self.faults.dropped else JAMMED if order in self.faults.jammed else 0
        if order in self._struck:
            return 0
        self._struck |= {order} if kind else set()
        return kind


# The part loader's process (docs/protocols/loader.md).

TICK_S = 0.02
IDENTITY = "polishd,simulated L1,SIM-L1,1.0"
_TEXTS = {
    "part": "no such part",
    "occupied": "a part is on the seat",
    "busy": "it moves",
    "fault": "a fault is set",
    "unknown": "no such request",
}


def answering(arm: LoaderArm, boot_count: int) -> Answer:
    """Return the answer to a request."""

    def answer(request: str) -> str:
        arm.on_request()
        name, _, part = request.partition(",")
        if request == "ID?":
            return f"ID,{IDENTITY},{boot_count}"
        if request == "ST?":
            return f"ST,{arm.state},{arm.fault},{quote(arm.seen, safe='')}"
        if name == "LD" and part:
            refusal: str = arm.load(unquote(part))
        else:
            known = {"UL": arm.unload, "STOP": arm.stop}
            refusal = known[request]() if request in known else "unknown"
        return f"ERR,{refusal},{_TEXTS[refusal]}" if refusal else "OK"

    return answer


async def main(runtime: SimRuntime) -> None:
    """Run the device."""
    config, speed = runtime.start.config.loader or SimLoaderSection(), runtime.start.speed
    arm = LoaderArm(
        report=runtime.link.event,
        seated=lambda part: runtime.link.send_message(part=part),
        now_s=time.monotonic(),
        seat=str(runtime.link.welcome["part"]),
        store=config.parts,
        load_s=config.load_s / speed,
        unload_s=config.unload_s / speed,
        watchdog_s=config.watchdog_s,
        faults=config.faults,
    )
    runtime.on_again.append(lambda: setattr(arm, "faults", (runtime.start.config.loader or config).faults))
    runtime.button(signal.SIGUSR1, arm.reset)
    await serve(runtime, config, arm, answering(arm, runtime.boot_count), TICK_S)


SIM_DEVICES = [
    SimDevice(
        name="loader",
        device="loader",
        section=SimLoaderSection,
        links={"tcp": {"": "numbered lines"}, "serial": {"": "numbered lines"}},
        main=main,
    )
]
