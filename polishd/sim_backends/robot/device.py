"""The process of the robot controller: the link's TCP side, the clock, and reports to the plant."""

from __future__ import annotations

import asyncio
import signal
import time

from polishd.config.simulator import MOTION, SimRobotSection
from polishd.sim_backends.common import framing
from polishd.sim_backends.common.registry import SimDevice
from polishd.sim_backends.common.runtime import SimRuntime
from polishd.sim_backends.common.wire import FaultyLink, Feed, SimWire
from polishd.sim_backends.robot.controller import Client, SimRobotController
from polishd.sim_backends.robot.motion import SimRobotBody

TICK_S = 0.01
STATUS_S = 0.05


class RobotServer:
    """All state of the process."""

    def __init__(self, runtime: SimRuntime) -> None:
        identity = {
            "vendor": "polishd",
            "model": "simulated 3UPS-UP",
            "serial": "SIM-R1",
            "firmware": "1.0",
            "boot_id": runtime.boot_id,
        }
        machine = SimRobotBody(runtime)
        self._machine = machine
        robot = runtime.start.config.robot
        self.controller = SimRobotController(robot, machine.motion, identity, machine.reach, machine.event)

    async def run(self) -> None:
        """Tick until cancelled."""
        next_status = time.monotonic()
        while True:
            now = time.monotonic()
            self._machine.set_pace(now)
            self.controller.tick(now)
            self._machine.report()
            if now >= next_status:
                next_status = max(next_status + STATUS_S, now)
                self.controller.send_status()
            await asyncio.sleep(TICK_S)

    def connected(self, outlet: FaultyLink) -> Feed:
        """Return the receiver of a client's bytes: it acts on each whole frame. A connection alone moves nothing."""
        client, splitter, broken = Client(outlet.send, outlet.backlog), framing.Splitter(), 0
        outlet.on_closed = lambda: self.controller.on_closed(client)

        def feed(data: bytes) -> None:
            nonlocal broken
            for kind, payload in splitter.feed(data):
                self.controller.on_frame(client, kind, payload, time.monotonic())
            if splitter.broken > broken:
                broken = splitter.broken
                self.controller.on_broken(client)
            self._machine.report()

        return feed


async def main(runtime: SimRuntime) -> None:
    """Run the device."""
    server = RobotServer(runtime)
    config = runtime.start.config.robot
    wire = SimWire(runtime, server.connected)
    address = await wire.open_tcp(config.port)
    runtime.button(signal.SIGUSR1, lambda: server.controller.press("emergency stop", time.monotonic()))
    runtime.button(signal.SIGUSR2, lambda: server.controller.press("pause at the pendant", time.monotonic()))
    wire.ready(f"tcp://{address}")
    await server.run()


SIM_DEVICES = [
    SimDevice(
        name="robot_link",
        device="robot",
        section=SimRobotSection,
        links={"link": {"": "robot_link"}},
        main=main,
        faults=MOTION,
    )
]
