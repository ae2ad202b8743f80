"""The simulated force sensor: a load cell that measures the true force, and its amplifier."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from polishd.config.simulator_devices import SimForceSensorSection
from polishd.config.simulator_faults import FaultSection
from polishd.model.surface import FloatArray
from polishd.sim_backends.common.hidden_truth import stream
from polishd.sim_backends.common.registry import SimDevice
from polishd.sim_backends.common.runtime import Message, SimRuntime
from polishd.sim_backends.common.wire import Answer, serve

# The load cell and its amplifier. Pure of I/O; the caller passes wall times.

MEASURING, TARING, FAULT = range(3)
OVER_RANGE = 1
RATE_HZ = 100.0
TARE_S = 0.2
"""Duration of the mean that gives a zero."""


@dataclass(slots=True)
class LoadCell:
    """Follow the true force with a lag, an offset, noise and the errors of its faults."""

    config: SimForceSensorSection
    rng: np.random.Generator
    report: Callable[..., None]
    """Write to the event log: (event, at_s, **data)."""
    now_s: float
    true_n: float = 0.0
    """The present force, from the plant."""
    count: int = 0
    """Conversions, modulo 65536."""
    reading_n: float = 0.0
    """Value of the last conversion, before its zero is subtracted."""
    zero_n: float = 0.0
    fault: int = 0
    _felt: deque[tuple[float, float]] = field(default_factory=deque)
    _converted_s: float = 0.0
    _drift_n_s: float = 0.0
    _drift_n: float = 0.0
    _frozen: bool = False
    """It repeats one force as new conversions."""
    _halted: bool = False
    """It stops converting and continues to answer."""
    _most_n: float = 0.0
    """It saturates at this force without a report; 0: it covers its whole range."""
    _spike_n: float = 0.0
    """Offset of its reading."""
    _factor: float = 1.0
    """Gain of its reading, ..."""
    _offset_n: float = 0.0
    """... and offset."""
    _tare: list[float] | None = None

    def suffer(self, fault: FaultSection, on: bool) -> None:
        """Set or clear that state; drift so far stays."""
        if fault.what == "drift":
            self._drift_n_s = fault.drift_n_s if on else 0.0
        elif fault.what == "freeze":
            self._frozen = on
        elif fault.what == "halt":
            self._halted = on
        elif fault.what == "spike":
            self._spike_n = fault.force_n if on else 0.0
        elif fault.what == "lie":
            self._factor, self._offset_n = (fault.factor, fault.offset_n) if on else (1.0, 0.0)
        else:
            self._most_n = fault.limit_n if on else 0.0

    @property
    def state(self) -> int:
        """The state number of the protocol."""
        return FAULT if self.fault else MEASURING if self._tare is None else TARING

    def feel(self, at_s: float, true_n: float) -> None:
        """Take another force from then on."""
        self.step(at_s)
        self.true_n = true_n
        self._felt.append((at_s + self.config.latency_s, true_n))

    def tare(self) -> str:
        """Begin to tare; return the refusal, or empty."""
        if self.state != MEASURING:
            return "busy" if self.state == TARING else "fault"
        self._tare = []
        return ""

    def step(self, now_s: float) -> None:
        """Advance to the present: one conversion for each period of its rate."""
        passed = now_s - self.now_s
        self.now_s = now_s
        self._drift_n += self._drift_n_s * passed
        if now_s - self._converted_s >= 1.0 / RATE_HZ and not self._halted:
            self._convert(now_s)

    def _convert(self, now_s: float) -> None:
        self._converted_s, self.count = now_s, (self.count + 1) & 0xFFFF
        while len(self._felt) > 1 and self._felt[1][0] <= now_s:
            self._felt.popleft()
        felt_n = self._felt[0][1] if self._felt and self._felt[0][0] <= now_s else 0.0
        if not self._frozen:
            noise_n = self.config.noise_n * float(self.rng.standard_normal())
            false_n = self._offset_n + self._spike_n + self._drift_n
            self.reading_n = self.config.offset_n + self._factor * felt_n + false_n + noise_n
        limit_n = self._most_n or self.config.range_n
        self.fault = OVER_RANGE if abs(self.reading_n) > self.config.range_n else 0
        self.reading_n = min(max(self.reading_n, -limit_n), limit_n)
        if self._tare is not None:
            self._tare.append(self.reading_n)
            if len(self._tare) >= TARE_S * RATE_HZ / 2:
                self.zero_n, self._tare = sum(self._tare) / len(self._tare), None
                self.report("sensor_tared", now_s, zero_n=round(self.zero_n, 3))


# The force sensor's process (docs/protocols/force_sensor.md).

TICK_S = 0.01
IDENTITY = "polishd,simulated F1,SIM-F1,1.0"
_TEXTS = {"busy": "it tares", "fault": "a fault is set", "unknown": "no such request"}


def answering(cell: LoadCell, boot_count: int) -> Answer:
    """Return the answer to a request."""

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
    """Run the device."""
    config = runtime.start.config.force_sensor or SimForceSensorSection()
    rng = stream(runtime.start.seed, "force_sensor")
    cell = LoadCell(config, rng, runtime.link.event, time.monotonic())

    def on_message(message: Message | FloatArray) -> None:
        if isinstance(message, dict) and "acting_n" in message:
            cell.feel(time.monotonic(), float(message["acting_n"]))

    runtime.link.on_message = on_message
    runtime.script.suffer = cell.suffer
    await serve(runtime, config, cell, answering(cell, runtime.boot_count), TICK_S)


SIM_DEVICES = [
    SimDevice(
        name="force_sensor",
        device="force_sensor",
        section=SimForceSensorSection,
        links={"tcp": {"": "numbered lines"}, "serial": {"": "numbered lines"}},
        main=main,
        faults=("freeze", "drift", "saturate", "halt", "spike", "lie"),
    )
]
