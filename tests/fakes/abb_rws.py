"""Fake ABB controller on a socket of this process: the simulator's controller and services without a plant."""

from __future__ import annotations

import asyncio
import time
from importlib.resources import files
from pathlib import Path

from polishd.config.simulator_devices import SimRobotSection
from polishd.drivers.abb_rws.driver import tls_context
from polishd.drivers.abb_rws.services import Account, Version
from polishd.drivers.transport.address import Tcp
from polishd.sim_backends.abb_rws import device
from polishd.sim_backends.abb_rws.controller import WATCH_TASK, AbbController
from polishd.sim_backends.abb_rws.device import LoginCheck, RwsPeer, TlsLayer
from polishd.sim_backends.abb_rws.service import RwsService
from polishd.sim_backends.robot.motion import SimMotion
from polishd.sim_backends.robot.trajectory import Limits
from tests.fakes.wires import Filter, unchanged

LOOPBACK = "127.0.0.1"
TICK_S = 0.002
WATCH = files("polishd.config").joinpath("controller_programs/polishd_watch.mod").read_bytes()


def rapid_move(number: int) -> bytes:
    """Return block n of a program: 1 mm in 30 ms, and a wait in some blocks."""
    if number % 10 == 7:
        return b"WaitTime 0.02;"
    zone = b"fine" if number % 10 == 6 else b"z1"
    target = b"[[%d,0,60],[0,1,0,0],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]]" % (number % 100)
    return b"MoveL %b,v100\\T:=0.03,%b,tool0\\WObj:=wobj0;" % (target, zone)


class FakeAbb:
    """Fake controller. A task advances its time from ``start`` to ``close``."""

    def __init__(self, folder: Path, version: Version = "1.0", *, speed: float = 1.0, has_watch: bool = True) -> None:
        limits = Limits(1000.0, 0.001, 30.0, 100.0, 100.0, speed)
        motion = SimMotion(limits, (0.0, 0.0, 60.0, 0.0, 0.0))
        self.events: list[str] = []
        self.controller = AbbController(SimRobotSection(), motion, self._event, time.monotonic(), 1)
        self.service = RwsService(self.controller, version, folder, "boot")
        self.version: Version = version
        self.filter: Filter = unchanged
        """Filter for the bytes that the controller sends."""
        self.silent = False
        self._login = LoginCheck(version)
        self._tls = device.tls_context(folder) if version == "2.0" else None
        self._writers: list[asyncio.StreamWriter] = []
        self._tasks: set[asyncio.Task[None]] = set()
        self._server: asyncio.Server | None = None
        if has_watch:
            for _ in self.controller.loading(WATCH_TASK, WATCH, replace=False):
                pass

    def _event(self, name: str, at_s: float | None = None, **_data: object) -> None:
        self.events.append(name)

    @property
    def account(self) -> Account:
        """Address and login of the controller."""
        assert self._server is not None
        port = self._server.sockets[0].getsockname()[1]
        tls = tls_context("", Path()) if self.version == "2.0" else None
        return Account(Tcp(LOOPBACK, port), self.version, "Default User", "robotics", tls)

    @property
    def stands(self) -> bool:
        """Return whether nothing moves and no program would move."""
        return not self.controller.is_active

    async def start(self) -> FakeAbb:
        """Listen on loopback and start the clock."""
        self._server = await asyncio.start_server(self._connected, LOOPBACK, 0)
        self._go(self._pass_time())
        return self

    async def close(self) -> None:
        """Close all connections and stop the clock."""
        self.cut()
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def cut(self) -> None:
        """Cut all connections, and refuse new ones."""
        if self._server is not None:
            self._server.close()
        for writer in self._writers:
            writer.transport.abort()

    def advance(self) -> None:
        """Advance the controller to the present."""
        self.controller.tick(time.monotonic())
        self.service.publish()

    def _go(self, work: object) -> None:
        assert asyncio.iscoroutine(work)
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _pass_time(self) -> None:
        while True:
            self.advance()
            await asyncio.sleep(TICK_S)

    def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._writers.append(writer)
        self._go(self._serve(reader, writer))

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        def send(data: bytes) -> None:
            if not self.silent and not writer.is_closing():
                for part in self.filter(data):
                    writer.write(part)

        tls = None if self._tls is None else TlsLayer(self._tls, send)
        peer = RwsPeer(self.service, self._login, send if tls is None else tls.write, self.advance)
        try:
            while data := await reader.read(1 << 16):
                plain = data if tls is None else tls.feed(data)
                if plain and not await peer.receive(plain):
                    break
        except ConnectionError:  # the client closed the connection amid an answer
            pass
        finally:
            peer.closed()
            writer.close()
