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
from polishd.sim_backends.faults import Mischief, Outlet
from polishd.sim_backends.placement import Frames
from polishd.sim_backends.robot import frames
from polishd.sim_backends.robot.clients import Client
from polishd.sim_backends.robot.controller import Controller
from polishd.sim_backends.robot.motion import Limits, Motion
from polishd.sim_backends.robot.rnc import Block
from polishd.sim_backends.runtime import LOOPBACK, Runtime

TICK_S = 0.01
STATUS_S = 0.05
MAX_UNSENT = 8 << 20
NOMINAL = HybridRobot()


class Connection(asyncio.Protocol):
    """One client's bytes."""

    def __init__(self, server: RobotServer) -> None:
        self._server = server
        self._splitter = frames.Splitter()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Somebody connected; nothing moves for that."""
        if isinstance(transport, asyncio.Transport):
            self.transport = transport
        outlet = Outlet(self._write, self._server.mischief)
        self.client = Client(outlet.send, self._backlog)
        self._worker = None if outlet.mischief.idle else self._server.runtime.group.create_task(outlet.run())
        self._server.connections.add(self)

    def data_received(self, data: bytes) -> None:
        """Act on each whole frame."""
        for kind, payload in self._splitter.feed(data):
            self._server.controller.on_frame(self.client, kind, payload, time.monotonic())
        if self._splitter.broken > self.client.broken:
            self.client.broken = self._splitter.broken
            self._server.controller.on_broken(self.client)
        self._server.report_motion()

    def connection_lost(self, _exc: Exception | None) -> None:
        """The controller goes on without."""
        self._server.connections.discard(self)
        self._server.controller.on_closed(self.client)
        if self._worker is not None:
            self._worker.cancel()

    def _backlog(self) -> int:
        return self.transport.get_write_buffer_size()

    def _write(self, data: bytes) -> None:
        if self._backlog() > MAX_UNSENT:
            self.transport.abort()
        elif not self.transport.is_closing():
            self.transport.write(data)


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
        self.mischief = Mischief(robot.faults, truth.stream(start.seed, "robot"))
        self.connections: set[Connection] = set()
        self._frames = Frames(start.config.plant)
        self.controller = Controller(robot, Motion(limits, (x, y, z, a, c)), identity, self.reach, self.event)

    async def run(self) -> None:
        """Tick for ever."""
        faults = self.runtime.start.config.robot.faults
        next_status = next_cut = time.monotonic()
        while True:
            now = time.monotonic()
            self.controller.tick(now)
            self.report_motion()
            if now >= next_status:
                next_status = max(next_status + STATUS_S, now)
                self.controller.send_status()
            if faults.disconnect_every_s and now - next_cut >= faults.disconnect_every_s:
                next_cut = now
                for connection in list(self.connections):
                    connection.transport.abort()
            await asyncio.sleep(TICK_S)

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
    port = await runtime.serve(lambda: Connection(server), runtime.start.config.robot.port)
    runtime.button(signal.SIGUSR1, lambda: server.controller.press("emergency stop", time.monotonic()))
    runtime.button(signal.SIGUSR2, lambda: server.controller.press("pause at the pendant", time.monotonic()))
    runtime.ready(f"tcp://{LOOPBACK}:{port}")
    runtime.group.create_task(runtime.reboot_later(runtime.start.config.robot.faults.reboot_after_s))
    await server.run()
