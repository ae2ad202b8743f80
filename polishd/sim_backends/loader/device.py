"""The part loader's process (docs/protocols/loader.md)."""

from __future__ import annotations

import asyncio
import signal
import time
from collections.abc import Iterable
from dataclasses import dataclass
from urllib.parse import quote, unquote

from polishd.config.simulator import Loader
from polishd.sim_backends.actuator.ascii import MAX_LINE, body, line
from polishd.sim_backends.faults.outlet import Outlet
from polishd.sim_backends.loader.arm import Arm
from polishd.sim_backends.runtime import Runtime
from polishd.sim_backends.wire import Feed, Wire

TICK_S = 0.02
IDENTITY = "polishd,simulated L1,SIM-L1,1.0"
_TEXTS = {
    "part": "no such part",
    "occupied": "a part is on the seat",
    "busy": "it moves",
    "fault": "a fault is set",
    "unknown": "no such request",
}


@dataclass(slots=True)
class LoaderSlave:
    """Answers each intact line by one line."""

    arm: Arm
    boot_count: int
    _buffer: bytes = b""

    def feed(self, data: bytes) -> Iterable[bytes]:
        """The answer to each whole request."""
        self._buffer += data
        while b"\n" in self._buffer:
            raw, self._buffer = self._buffer.split(b"\n", 1)
            number, _, request = (body(raw.rstrip(b"\r")) or "").partition(",")
            if number.isdigit() and int(number) <= 65535:
                self.arm.hear()
                yield line(f"{number},{self._answer(request)}")
        self._buffer = self._buffer[-MAX_LINE:]

    def _answer(self, request: str) -> str:
        arm = self.arm
        name, _, part = request.partition(",")
        if request == "ID?":
            return f"ID,{IDENTITY},{self.boot_count}"
        if request == "ST?":
            return f"ST,{arm.state},{arm.fault},{quote(arm.seen, safe='')}"
        if name == "LD" and part:
            refusal: str = arm.load(unquote(part))
        else:
            known = {"UL": arm.unload, "STOP": arm.stop}
            refusal = known[request]() if request in known else "unknown"
        return f"ERR,{refusal},{_TEXTS[refusal]}" if refusal else "OK"


async def main(runtime: Runtime) -> None:
    """The device coroutine."""
    config, speed = runtime.start.config.loader or Loader(), runtime.start.speed
    arm = Arm(
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

    def receiver(outlet: Outlet) -> Feed:
        slave = LoaderSlave(arm, runtime.boot_count)

        def feed(data: bytes) -> None:
            arm.step(time.monotonic())
            for answer in slave.feed(data):
                outlet.send(answer)

        return feed

    wire = Wire(runtime, receiver)
    runtime.on_again.append(lambda: setattr(arm, "faults", (runtime.start.config.loader or config).faults))
    runtime.button(signal.SIGUSR1, arm.reset)
    wire.ready(await wire.open_line(config))
    while True:
        arm.step(time.monotonic())
        await asyncio.sleep(TICK_S)
