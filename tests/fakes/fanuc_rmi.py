"""Fake FANUC controller with RMI in the loop of the test: the simulated one without a plant, on two ports."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from polishd.sim_backends.fanuc_rmi.controller import FanucController, line_of
from polishd.sim_backends.fanuc_rmi.section import SimFanucRmiSection
from polishd.sim_backends.robot.motion import SimMotion
from polishd.sim_backends.robot.trajectory import Limits
from tests.fakes.wires import Filter, unchanged

TICK_S = 0.002
HOME = (0.0, 0.0, 50.0, 0.0, 0.0)


def controller(report: Callable[..., None] = lambda *_a, **_k: None, **limits: Any) -> FanucController:
    """Return a controller at rest with all positions in reach."""
    kept = {"accel_mm_s2": 1000.0, "overhead_s": 0.0, "corner_deg": 30.0, "rapid_mm_s": 100.0, "max_feed_mm_s": 100.0}
    motion = SimMotion(Limits(**{**kept, **limits}, speed=1.0), HOME)
    reach = lambda blocks: np.ones(len(blocks), dtype=np.bool_)  # noqa: E731
    return FanucController(SimFanucRmiSection(kind="fanuc_rmi"), motion, reach, report)


class FakeFanuc:
    """Controller with its servers and its clock."""

    def __init__(self) -> None:
        self.controller = controller()
        self.silent = False
        self.filter: Filter = unchanged
        self.port = 0
        self.lines: list[bytes] = []
        """All lines of the session that the controller received."""
        self.most_held = 0
        """Highest number of outstanding instructions."""
        self._servers: list[asyncio.Server] = []
        self._writers = set[asyncio.StreamWriter]()
        self._is_cut = False
        self._task: asyncio.Task[None] | None = None

    async def start(self) -> FakeFanuc:
        """Listen on loopback."""
        for serve in (self._connecting, self._session):
            self._servers.append(await asyncio.start_server(serve, "127.0.0.1", 0))
        self.port, self.controller.session_port = (int(server.sockets[0].getsockname()[1]) for server in self._servers)
        self._task = asyncio.create_task(self._run())
        return self

    async def close(self) -> None:
        """Close the servers and stop the clock."""
        self.cut()
        if self._task is not None:
            self._task.cancel()
            await asyncio.wait({self._task})

    def cut(self) -> None:
        """Cut all links permanently."""
        self._is_cut = True
        for server in self._servers:
            server.close()
        for writer in list(self._writers):
            writer.transport.abort()

    @property
    def stands(self) -> bool:
        """Return whether no instruction moves or waits."""
        return self.controller.motion.state != "running"

    @property
    def held(self) -> int:
        """Return the number of outstanding instructions."""
        return len(self.controller._held)

    def drop_session(self) -> None:
        """Cut the link of the session once."""
        for writer in list(self._writers):
            writer.transport.abort()

    async def _run(self) -> None:
        while True:
            self.controller.tick(time.monotonic())
            await asyncio.sleep(TICK_S)

    def _send(self, writer: asyncio.StreamWriter, data: bytes) -> None:
        if not self.silent:
            parts: Iterable[bytes] = self.filter(data)
            for part in parts:
                writer.write(part)

    async def _connecting(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with self._kept(writer):
            while line := await reader.readline():
                self._send(writer, line_of(self.controller.on_connect_line(line)))

    async def _session(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if not self.controller.begin(lambda data: self._send(writer, data)):
            writer.close()
            return
        try:
            with self._kept(writer):
                while line := await reader.readline():
                    self.lines.append(line)
                    self.controller.on_line(line, time.monotonic())
                    self.most_held = max(self.most_held, self.held)
        finally:
            self.controller.end(time.monotonic())

    @contextlib.contextmanager
    def _kept(self, writer: asyncio.StreamWriter) -> Any:
        self._writers.add(writer)
        try:
            with contextlib.suppress(ConnectionError):
                yield
        finally:
            self._writers.discard(writer)
            writer.close()
