"""The robot controller's process: the link's TCP side, the clock, and reports to the plant."""

from __future__ import annotations

import asyncio
import signal
import time
from typing import Any

import numpy as np

from polishd.model.robot import HybridRobot
from polishd.model.surface import BoolArray
from polishd.process.robot import reachable
from polishd.sim_backends import truth
from polishd.sim_backends.bus import ROW
from polishd.sim_backends.faults import Outlet
from polishd.sim_backends.placement import Frames
from polishd.sim_backends.robot import frames
from polishd.sim_backends.robot.clients import Client
from polishd.sim_backends.robot.controller import Controller
from polishd.sim_backends.robot.motion import Motion
from polishd.sim_backends.robot.path import Limits
from polishd.sim_backends.robot.rnc import Block
from polishd.sim_backends.runtime import Runtime
from polishd.sim_backends.wire import Feed, Wire

TICK_S = 0.01
STATUS_S = 0.05
NOMINAL = HybridRobot()


class RobotServer:
    """Everything that the process holds."""

    def __init__(self, runtime: Runtime) -> None:
        start, robot = runtime.start, runtime.start.config.robot
        hidden = truth.draw(start.config.truth, start.seed)
        limits = Limits(
            accel_mm_s2=hidden.accel_mm_s2,
            overhead_s=hidden.overhead_s,
            corner_deg=robot.corner_deg,
            rapid_mm_s=robot.rapid_mm_s,
            max_feed_mm_s=robot.max_feed_mm_s,
            speed=start.speed,
        )
        x, y, z, a, c = runtime.link.welcome.get("pose") or robot.home
        identity = {
            "vendor": "polishd",
            "model": "simulated 3UPS-UP",
            "serial": "SIM-R1",
            "firmware": "1.0",
            "boot_id": runtime.boot_id,
        }
        self.runtime = runtime
        self._frames = Frames(start.config.plant)
        self.controller = Controller(robot, Motion(limits, (x, y, z, a, c)), identity, self.reach, self.event)

    async def run(self) -> None:
        """Tick for ever."""
        next_status = time.monotonic()
        while True:
            now = time.monotonic()
            self.controller.tick(now)
            self.report_motion()
            if now >= next_status:
                next_status = max(next_status + STATUS_S, now)
                self.controller.send_status()
            await asyncio.sleep(TICK_S)

    def connected(self, outlet: Outlet) -> Feed:
        """What takes the bytes of a client: it acts on each whole frame. Nothing moves because somebody connects."""
        client, splitter, broken = Client(outlet.send, outlet.backlog), frames.Splitter(), 0
        outlet.on_closed = lambda: self.controller.on_closed(client)

        def feed(data: bytes) -> None:
            nonlocal broken
            for kind, payload in splitter.feed(data):
                self.controller.on_frame(client, kind, payload, time.monotonic())
            if splitter.broken > broken:
                broken = splitter.broken
                self.controller.on_broken(client)
            self.report_motion()

        return feed

    def reach(self, blocks: list[Block]) -> BoolArray:
        """Which blocks end within the strokes of the limbs."""
        poses = np.array([block.end for block in blocks]).reshape(-1, 5)
        return reachable(NOMINAL, *self._frames.in_base(*self._frames.in_part(poses)))

    def event(self, name: str, at_s: float | None = None, **data: Any) -> None:
        """Tell the witness, after the motion that came before."""
        self.report_motion()
        self.runtime.link.event(name, at_s, **data)

    def report_motion(self) -> None:
        """Send what moved since the last time, and vouch for it."""
        motion = self.controller.motion
        now = time.monotonic()
        motion.advance(now)
        rows = np.concatenate(motion.rows) if motion.rows else np.zeros((0, len(ROW)))
        motion.rows.clear()
        mark = now
        if motion.state == "running" and len(rows):
            mark = float(rows[-1, 2])
        self.runtime.link.rows(rows, mark, motion.pose)


async def main(runtime: Runtime) -> None:
    """The device coroutine."""
    server = RobotServer(runtime)
    config = runtime.start.config.robot
    wire = Wire(runtime, config.faults, server.connected)
    address = await wire.open_tcp(config.port)
    runtime.button(signal.SIGUSR1, lambda: server.controller.press("emergency stop", time.monotonic()))
    runtime.button(signal.SIGUSR2, lambda: server.controller.press("pause at the pendant", time.monotonic()))
    wire.ready(f"tcp://{address}")
    await server.run()
