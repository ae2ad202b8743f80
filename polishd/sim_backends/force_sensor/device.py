"""The force sensor's process (docs/protocols/force_sensor.md)."""

from __future__ import annotations

import time

from polishd.config.simulator import SimForceSensorSection
from polishd.model.surface import FloatArray
from polishd.sim_backends.bus import Message
from polishd.sim_backends.force_sensor.cell import LoadCell
from polishd.sim_backends.numbered import Answer, serve
from polishd.sim_backends.runtime import SimRuntime
from polishd.sim_backends.truth import stream

TICK_S = 0.01
IDENTITY = "polishd,simulated F1,SIM-F1,1.0"
_TEXTS = {"busy": "it tares", "fault": "a fault is set", "unknown": "no such request"}


def answering(cell: LoadCell, boot_count: int) -> Answer:
    """What it answers to a request."""

    def answer(request: str) -> str:
        if request == "ID?":
            return f"ID,{IDENTITY},{boot_count}"
        if request == "F?":
            force_n = 0.0 if cell.state == 1 else cell.reading_n - cell.zero_n
            return f"F,{cell.state},{cell.count},{force_n:+.3f},{cell.fault}"
        refusal = cell.tare() if request == "TARE" else "unknown"
        return f"ERR,{refusal},{_TEXTS[refusal]}" if refusal else "OK"

    return answer


async def main(runtime: SimRuntime) -> None:
    """The device coroutine."""
    config = runtime.start.config.force_sensor or SimForceSensorSection()
    rng = stream(runtime.start.seed, "force_sensor")
    cell = LoadCell(config, rng, runtime.link.event, time.monotonic())

    def on_message(message: Message | FloatArray) -> None:
        if isinstance(message, dict) and "acting_n" in message:
            cell.feel(time.monotonic(), float(message["acting_n"]))

    runtime.link.on_message = on_message
    runtime.script.suffer = cell.suffer
    await serve(runtime, config, cell, answering(cell, runtime.boot_count), TICK_S)
