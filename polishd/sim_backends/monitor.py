"""The simulated monitor: a box of inputs, and scripted changes of their values."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from polishd.config.simulator_devices import SEVEN, SimMonitorSection, SimSignal
from polishd.model.surface import FloatArray
from polishd.sim_backends.common.hidden_truth import stream
from polishd.sim_backends.common.registry import SimDevice
from polishd.sim_backends.common.runtime import Message, SimRuntime
from polishd.sim_backends.common.wire import Answer, serve

# The behavior of the inputs. Pure of I/O; the caller passes wall times.


@dataclass(slots=True)
class Inputs:
    """Each input keeps its value until the script changes it."""

    signals: Mapping[str, SimSignal]
    rng: np.random.Generator
    report: Callable[..., None]
    """Write to the event log: (event, at_s, **data)."""
    now_s: float
    touching: bool = False
    """The tool presses on the part."""
    _contact_s: float = 0.0
    _changed_s: dict[str, float] = field(default_factory=dict)
    """Time of the change of each input."""

    def press(self) -> None:
        """Start all changes now."""
        for name, simulated in self.signals.items():
            if simulated.changes_to is not None and name not in self._changed_s:
                self._change(name)

    def step(self, now_s: float) -> None:
        """Advance the inputs to the present."""
        self._contact_s += now_s - self.now_s if self.touching else 0.0
        self.now_s = now_s
        for name, simulated in self.signals.items():
            if 0.0 < simulated.after_s < self._contact_s and name not in self._changed_s:
                self._change(name)

    def reading(self, name: str) -> str:
        """Return a number, ``ON`` or ``OFF``, or ``?`` where the transducer is broken."""
        signal = self.signals[name]
        changed_s = self._changed_s.get(name)
        lasts = changed_s is not None and (signal.duration_s == 0.0 or self.now_s - changed_s < signal.duration_s)
        value = signal.changes_to if lasts else signal.value
        if value is None or value == "?":
            return "?"
        if isinstance(value, bool):
            return "ON" if value else "OFF"
        return f"{float(value) + signal.noise * float(self.rng.standard_normal()):.4f}"

    def _change(self, name: str) -> None:
        self._changed_s[name] = self.now_s
        self.report("signal_changes", self.now_s, signal=name, to=self.signals[name].changes_to)


# The monitor's process (docs/protocols/monitor.md).

TICK_S = 0.02
IDENTITY = "polishd,simulated M1,SIM-M1,1.0"


def answering(inputs: Inputs, boot_count: int) -> Answer:
    """Return the answer to a request."""

    def answer(request: str) -> str:
        kind, _, what = request.partition(",")
        if request == "ID?":
            return f"ID,{IDENTITY},{boot_count}"
        if kind == "LS?" and what.isdigit():
            names = list(inputs.signals)
            return f"LS,{what},{names[int(what)]}" if int(what) < len(names) else f"LS,{what}"
        if kind == "V?" and what in inputs.signals:
            return f"V,{what},{inputs.reading(what)}"
        return f"ERR,unknown,no such {'signal' if kind == 'V?' else 'request'}"

    return answer


async def main(runtime: SimRuntime) -> None:
    """Run the device."""
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


SIM_DEVICES = [
    SimDevice(
        name="monitor",
        device="monitor",
        section=SimMonitorSection,
        links={"tcp": {"": "numbered lines"}, "serial": {"": "numbered lines"}},
        main=main,
    )
]
