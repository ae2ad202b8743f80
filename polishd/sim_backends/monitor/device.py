"""The monitor's process (docs/protocols/monitor.md)."""

from __future__ import annotations

import asyncio
import signal
import time
from collections.abc import Callable

from polishd.config.simulator import SEVEN, Monitor
from polishd.model.surface import FloatArray
from polishd.sim_backends.bus import Message
from polishd.sim_backends.faults.outlet import Outlet
from polishd.sim_backends.monitor.inputs import Inputs
from polishd.sim_backends.numbered import NumberedSlave
from polishd.sim_backends.runtime import Runtime
from polishd.sim_backends.truth import stream
from polishd.sim_backends.wire import Feed, Wire

TICK_S = 0.02
IDENTITY = "polishd,simulated M1,SIM-M1,1.0"


def answering(inputs: Inputs, boot_count: int) -> Callable[[str], str]:
    """What it answers to a request."""

    def answer(request: str) -> str:
        kind, _, what = request.partition(",")
        if request == "ID?":
            return f"ID,{IDENTITY},{boot_count}"
        if kind == "LS?" and what.isdigit():
            names = list(inputs.signals)
            return f"LS,{what},{names[int(what)]}" if int(what) < len(names) else f"LS,{what}"
        if kind == "V?" and what in inputs.signals:
            return f"V,{what},{inputs.told(what)}"
        return f"ERR,unknown,no such {'signal' if kind == 'V?' else 'request'}"

    return answer


async def main(runtime: Runtime) -> None:
    """The device coroutine."""
    config = runtime.start.config.monitor or Monitor()
    rng = stream(runtime.start.seed, "monitor")
    inputs = Inputs({**SEVEN, **config.signals}, rng, runtime.link.event, time.monotonic())

    def on_message(message: Message | FloatArray) -> None:
        if isinstance(message, dict) and "acting_n" in message:
            inputs.step(time.monotonic())
            inputs.touching = message["acting_n"] > 0.0

    def receiver(outlet: Outlet) -> Feed:
        slave = NumberedSlave(answering(inputs, runtime.boot_count))

        def feed(data: bytes) -> None:
            inputs.step(time.monotonic())
            for answer in slave.feed(data):
                outlet.send(answer)

        return feed

    runtime.link.on_message = on_message
    runtime.button(signal.SIGUSR1, inputs.press)
    wire = Wire(runtime, receiver)
    wire.ready(await wire.open_line(config))
    while True:
        inputs.step(time.monotonic())
        await asyncio.sleep(TICK_S)
