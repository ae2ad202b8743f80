"""The process of the FANUC controller: its two ports, its clock, its operator's buttons, and reports to the plant."""

from __future__ import annotations

import asyncio
import signal
import time
from typing import cast

from polishd.config.simulator_faults import MOTION, PANEL
from polishd.sim_backends.common.registry import SimDevice
from polishd.sim_backends.common.runtime import SimRuntime
from polishd.sim_backends.common.wire import FaultyLink, Feed, SimWire
from polishd.sim_backends.fanuc_rmi.controller import LONGEST, FanucController, line_of
from polishd.sim_backends.fanuc_rmi.section import SimFanucRmiSection
from polishd.sim_backends.robot.motion import SimRobotBody

TICK_S = 0.004


class FanucServer:
    """All state of the process."""

    def __init__(self, runtime: SimRuntime, config: SimFanucRmiSection) -> None:
        self._machine = SimRobotBody(runtime)
        motion, reach = self._machine.motion, self._machine.reach
        self.controller = FanucController(config, motion, reach, self._machine.event)

    async def run(self) -> None:
        """Tick until cancelled."""
        while True:
            self._tick()
            await asyncio.sleep(TICK_S)

    def press(self, button: str) -> None:
        """Press a button at the controller."""
        self.controller.press(button, time.monotonic())
        self._machine.report()

    def connecting(self, outlet: FaultyLink) -> Feed:
        """Return the receiver of a client of the first port."""
        rest = b""

        def feed(data: bytes) -> None:
            nonlocal rest
            *lines, rest = (rest + data).split(b"\n")
            rest = rest[-LONGEST:]
            for line in lines:
                outlet.send(line_of(self.controller.on_connect_line(line)))

        return feed

    def session(self, outlet: FaultyLink) -> Feed:
        """Return the receiver of a client of the session; a second client gets no answer."""
        rest, has_session = b"", self.controller.begin(outlet.send)

        def closed() -> None:
            if has_session:
                self.controller.end(time.monotonic())

        def feed(data: bytes) -> None:
            nonlocal rest
            *lines, rest = (rest + data).split(b"\n")
            rest = rest[-LONGEST:]
            for line in lines:
                if has_session and line.strip():
                    self.controller.on_line(line, time.monotonic())
            self._tick()

        outlet.on_closed = closed
        return feed

    def _tick(self) -> None:
        now = time.monotonic()
        self._machine.set_pace(now, self.controller.slider, is_slowed=not self.controller.motion.waits)
        self.controller.tick(now)
        self._machine.report()


async def main(runtime: SimRuntime) -> None:
    """Run the device."""
    config = cast("SimFanucRmiSection", runtime.start.config.robot)
    server = FanucServer(runtime, config)
    wires = {"connect": server.connecting, "session": server.session}
    first, session = (SimWire(runtime, receive, link) for link, receive in wires.items())
    address = await first.open_tcp(config.port)
    port = int(address.rpartition(":")[2])
    session_address = await session.open_tcp(config.session_port or port + 1)
    server.controller.session_port = int(session_address.rpartition(":")[2])
    runtime.button(signal.SIGUSR1, lambda: server.press("emergency stop"), "estop")
    runtime.button(signal.SIGUSR2, lambda: server.press("pause"))
    runtime.button(signal.SIGALRM, lambda: server.press("teach pendant"), "manual")
    first.ready(f"tcp://{address}")
    runtime.button(signal.SIGURG, session.cut)
    await server.run()


SIM_DEVICES = [
    SimDevice(
        name="fanuc_rmi",
        device="robot",
        section=SimFanucRmiSection,
        links={"fanuc_rmi": {"connect": "lines", "session": "lines"}},
        main=main,
        faults=(*MOTION, *PANEL),
    )
]
