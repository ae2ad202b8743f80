"""The part loader's process (docs/protocols/loader.md)."""

from __future__ import annotations

import signal
import time
from urllib.parse import quote, unquote

from polishd.config.simulator import SimLoaderSection
from polishd.sim_backends.loader.arm import LoaderArm
from polishd.sim_backends.numbered import Answer, serve
from polishd.sim_backends.runtime import SimRuntime

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
