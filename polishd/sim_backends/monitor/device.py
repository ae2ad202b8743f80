"""The monitor's process (docs/protocols/monitor.md)."""

from __future__ import annotations

import signal
import time

from polishd.config.simulator import SEVEN, SimMonitorSection
from polishd.model.surface import FloatArray
from polishd.sim_backends.bus import Message
from polishd.sim_backends.monitor.inputs import Inputs
from polishd.sim_backends.numbered import Answer, serve
from polishd.sim_backends.runtime import SimRuntime
from polishd.sim_backends.truth import stream

TICK_S = 0.02
IDENTITY = "polishd,simulated M1,SIM-M1,1.0"


def answering(inputs: Inputs, boot_count: int) -> Answer:
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


async def main(runtime: SimRuntime) -> None:
    """The device coroutine."""
    config = runtime.start.config.monitor or SimMonitorSection()
    rng = stream(runtime.start.seed, "monitor")
    inputs = Inputs({**SEVEN, **config.signals}, rng, runtime.link.event, time.monotonic())

    def on_message(message: Message | FloatArray) -> None:
        if isinstance(message, dict) and "acting_n" in message:
            inputs.step(time.monotonic())
            inputs.touching = message["acting_n"] > 0.0

    runtime.link.on_message = on_message
    runtime.button(signal.SIGUSR1, inputs.press)
    await serve(runtime, config, inputs, answering(inputs, runtime.boot_count), TICK_S)
