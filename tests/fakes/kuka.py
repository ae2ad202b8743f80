"""Fake KUKA controller on one socket of this process: the simulator's machine without a plant."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from polishd.config.simulator_devices import SimRobotSection
from polishd.drivers.kuka_kvp.driver import KukaRobot
from polishd.drivers.transport.address import Tcp
from polishd.drivers.transport.file_delivery import Folder
from polishd.model.devices import RobotTimes
from polishd.model.errors import ProgramError
from polishd.sim_backends.kuka_kvp.controller import KukaController, kuka_path
from polishd.sim_backends.kuka_kvp.device import INSTALLED, MODULES, KvpClient, read_module
from polishd.sim_backends.kuka_kvp.krl import read_krl
from tests.fakes.wires import Filter, unchanged

LOOPBACK = "127.0.0.1"
TICK_S = 0.002
TIMES = RobotTimes(silence_s=1.0, lifts=False)


class FakeKuka:
    """Fake controller. A task advances its time from ``start`` to ``close``."""

    def __init__(self, folder: Path, *, has_c3: bool = True, speed: float = 1.0) -> None:
        path = kuka_path((0.0, 0.0, 60.0, 0.0, 0.0), 0.002)
        self.machine = KukaController(SimRobotSection(), path, 0.004, 2000.0, speed, time.monotonic())
        self.machine.complain = lambda line, text: self.complaints.append((line, text))
        self.machine.boot(*(read_krl((MODULES / name).read_text()) for name in INSTALLED))
        self.complaints: list[tuple[int, str]] = []
        self.folder = folder
        self.has_c3 = has_c3
        self.filter: Filter = unchanged
        """Filter for the bytes that the controller sends."""
        self.silent = False
        self.port = 0
        self.clients: list[_Client] = []
        self._server: asyncio.Server | None = None
        self._task: asyncio.Task[None] | None = None

    @property
    def stands(self) -> bool:
        """Return whether nothing moves and no program would move."""
        return not self.machine.active

    async def start(self) -> FakeKuka:
        """Listen on loopback and start the clock."""
        self._server = await asyncio.get_running_loop().create_server(lambda: _Client(self), LOOPBACK, 0)
        self.port = self._server.sockets[0].getsockname()[1]
        self._task = asyncio.create_task(self._pass_time())
        return self

    async def close(self) -> None:
        """Close all connections and stop the clock."""
        self.cut()
        if self._task is not None:
            self._task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._task
        await asyncio.sleep(0)

    def cut(self) -> None:
        """Cut the wire permanently."""
        if self._server is not None:
            self._server.close()
        self.drop()

    def drop(self) -> None:
        """Cut all connections; new ones are accepted."""
        for client in list(self.clients):
            client.transport.abort()

    def advance(self) -> None:
        """Advance the machine to the present, before a request acts."""
        for _ in self.machine.due(time.monotonic()):
            self.machine.frame()

    def select(self, name: str, answer: Callable[[int], None]) -> None:
        """Load the module at once."""
        module = name.rpartition("/")[2]
        try:
            reading: Iterator[None] = self.machine.selecting(module, *read_module(self.folder, module))
            for _ in reading:
                pass
        except (OSError, ProgramError) as error:
            self.complaints.append((0, str(error)))
            answer(0)
            return
        answer(1)

    async def _pass_time(self) -> None:
        while True:
            self.advance()
            await asyncio.sleep(TICK_S)


class _Client(asyncio.Protocol):
    def __init__(self, fake: FakeKuka) -> None:
        self._fake = fake

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self.transport = transport
        self._fake.clients.append(self)
        self._serves = KvpClient(self._fake.machine, self._send, self._fake.select, self._fake.has_c3)

    def data_received(self, data: bytes) -> None:
        self._fake.advance()
        self._serves.feed(data)

    def connection_lost(self, exc: Exception | None) -> None:
        self._fake.clients.remove(self)

    def _send(self, data: bytes) -> None:
        if not self._fake.silent and not self.transport.is_closing():
            for part in self._fake.filter(data):
                self.transport.write(part)


def kuka_robot(fake: FakeKuka, times: RobotTimes = TIMES) -> KukaRobot:
    """Return the driver of that controller."""
    return KukaRobot(Tcp(LOOPBACK, fake.port), Folder(fake.folder), "/R1/PROGRAM/", times, poll_s=0.005, load_s=5.0)


def krl(number: int) -> bytes:
    """Return a short move along X of some tens of ms."""
    return b"LIN {X %.1f,Y 0,Z 60,A 0,B 0,C 180}" % (number * 0.4)
