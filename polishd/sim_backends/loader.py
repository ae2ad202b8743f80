"""The simulated part loader."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal
from urllib.parse import quote, unquote

from polishd.config.simulator import LoaderFaults, SimLoaderSection
from polishd.sim_backends.common.numbered_lines import Answer, serve
from polishd.sim_backends.common.registry import SimDevice
from polishd.sim_backends.common.runtime import SimRuntime

# The loader's behaviour, whatever it is asked in. Pure of I/O; wall times are handed in.

IDLE, MOVING, STOPPED, FAULT = range(4)
JAMMED, DROPPED = 1, 2
ANOTHER = "OTHER-7"
"""What it brings where it is told to bring the wrong part."""

Refusal = Literal["", "part", "occupied", "busy", "fault"]


@dataclass(slots=True)
class LoaderArm:
    """One arm, one seat, and a store of parts."""

    report: Callable[..., None]
    """Tells the witness: (event, at_s, **data)."""
    seated: Callable[[str], None]
    """Tells the plant which part is on the seat now; empty: none."""
    now_s: float
    seat: str
    """What truly is on the seat."""
    store: Sequence[str] = ()
    """What it can be asked for; empty: anything."""
    load_s: float = 0.5
    unload_s: float = 0.5
    watchdog_s: float = 5.0
    faults: LoaderFaults = field(default_factory=LoaderFaults)
    fault: int = 0
    says: str = ""
    """What its reader says of the seat, where that is not so; else empty."""
    _order: str | None = None
    """The part that it puts on; empty: it takes one off. None: nothing is to be done."""
    _left_s: float = 0.0
    _stopped: bool = False
    _heard_s: float = 0.0
    _struck: set[str] = field(default_factory=set)

    @property
    def state(self) -> int:
        """The state number of the protocol."""
        if self.fault:
            return FAULT
        return IDLE if self._order is None else STOPPED if self._stopped else MOVING

    @property
    def seen(self) -> str:
        """What its reader sees on the seat."""
        return self.says or self.seat

    def load(self, part: str) -> Refusal:
        """Begin to put a part on, or go on with that; nothing is to be done where it is there."""
        if self.store and part not in self.store:
            return "part"
        if self.seen == part and self._order is None and not self.fault:
            return ""
        return self._begin(part, self.load_s, "occupied" if self.seat else "")

    def unload(self) -> Refusal:
        """Begin to take the part off, or what it carries back; an empty seat is done already."""
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
        """Somebody has put things right and pressed the button."""
        self.fault, self._order = 0, None

    def hear(self) -> None:
        """A request came."""
        self._heard_s = self.now_s

    def step(self, now_s: float) -> None:
        """Bring it to the present."""
        passed, self.now_s = now_s - self.now_s, now_s
        if self.state != MOVING:
            return
        if now_s - self._heard_s > self.watchdog_s:
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
        self.seat, self.says = brought, order if order in self.faults.wrong_part_unnoticed else ""
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
    """What it answers to a request."""

    def answer(request: str) -> str:
        arm.hear()
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
    """The device coroutine."""
    config, speed = runtime.start.config.loader or SimLoaderSection(), runtime.start.speed
    arm = LoaderArm(
        report=runtime.link.event,
        seated=lambda part: runtime.link.ask(part=part),
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
