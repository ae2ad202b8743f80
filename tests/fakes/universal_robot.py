"""Fake Universal Robots controller on three sockets of this process: the simulator's machine without a plant."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from polishd.config.simulator_devices import SimRobotSection
from polishd.drivers.transport.address import Tcp
from polishd.drivers.universal_robots.driver import Addresses
from polishd.sim_backends.universal_robots import device
from polishd.sim_backends.universal_robots.arm import UrArm
from polishd.sim_backends.universal_robots.controller import UrController
from polishd.sim_backends.universal_robots.device import Dashboard, InputOwnership, RtdeClient
from tests.fakes.wires import Filter, unchanged

LOOPBACK = "127.0.0.1"
TICK_S = 0.002
Feed = Callable[[bytes], None]


class FakeController:
    """Fake controller. A task advances its time from ``start`` to ``close``."""

    def __init__(self, *, speed: float = 1.0, overhead_s: float = 0.002, cycle_s: float = 0.008) -> None:
        arm = UrArm.at((0.0, 0.0, 60.0, 0.0, 0.0))
        self.machine = UrController(SimRobotSection(), arm, cycle_s, overhead_s, speed, time.monotonic())
        self.machine.complain = self._complain
        self.filter: Filter = unchanged
        """Filter for the RTDE bytes that the controller sends."""
        self.silent = False
        self.held = InputOwnership()
        self.clients: list[RtdeClient] = []
        self.scripts: list[str] = []
        self.wires = [_Wire(self, self._rtde), _Wire(self, self._dashboard), _Wire(self, self._primary)]
        self._waiting: list[tuple[Callable[[], bool], Callable[[], None]]] = []
        self._task: asyncio.Task[None] | None = None

    @property
    def addresses(self) -> Addresses:
        """Addresses of the controller."""
        return Addresses(*(Tcp(LOOPBACK, wire.port) for wire in self.wires))

    @property
    def stands(self) -> bool:
        """Return whether nothing moves and no program would move."""
        return not self.machine.active

    async def start(self) -> FakeController:
        """Listen on loopback and start the clock."""
        for wire in self.wires:
            await wire.listen()
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
        """Cut the wires permanently."""
        for wire in self.wires:
            wire.cut()

    def drop(self) -> None:
        """Cut all connections; new ones are accepted."""
        for wire in self.wires:
            wire.drop()

    def advance(self) -> None:
        """Advance the machine to the present, before a request acts."""
        for _ in self.machine.due(time.monotonic()):
            before_s = self.machine.time_s
            self.machine.frame()
            for client in self.clients:
                client.tick(before_s)

    async def _pass_time(self) -> None:
        while True:
            self.advance()
            due, self._waiting = self._waiting, []
            for condition, then in due:
                if condition():
                    then()
                else:
                    self._waiting.append((condition, then))
            await asyncio.sleep(TICK_S)

    def _rtde(self, client: _Client) -> Feed:
        serves = RtdeClient(self.machine, self.held, lambda data: client.send(self.filter(data)))
        self.clients.append(serves)

        def closed() -> None:
            serves.closed()
            self.clients.remove(serves)

        client.on_closed = closed
        return serves.feed

    def _dashboard(self, client: _Client) -> Feed:
        client.send([device.GREETING])

        def later(when: Callable[[], bool], then: Callable[[], None]) -> None:
            self._waiting.append((when, then))

        return Dashboard(self.machine, lambda data: client.send([data]), later).feed

    def _primary(self, _client: _Client) -> Feed:
        return device.ScriptIntake(self._load).feed

    def _load(self, text: str) -> None:
        self.scripts.append(text)
        self.machine.load(text)

    def _complain(self, line: int, text: str) -> None:
        for client in self.wires[2].clients:
            client.send([device.complaint(line, text)])


@dataclass
class _Wire:
    controller: FakeController
    serve: Callable[[_Client], Feed]
    port: int = 0
    clients: list[_Client] = field(default_factory=list)
    _server: asyncio.Server | None = None

    async def listen(self) -> None:
        self._server = await asyncio.get_running_loop().create_server(lambda: _Client(self), LOOPBACK, 0)
        self.port = self._server.sockets[0].getsockname()[1]

    def drop(self) -> None:
        for client in list(self.clients):
            client.transport.abort()

    def cut(self) -> None:
        if self._server is not None:
            self._server.close()
        self.drop()


class _Client(asyncio.Protocol):
    def __init__(self, wire: _Wire) -> None:
        self._wire = wire
        self.on_closed: Callable[[], None] = lambda: None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self.transport = transport
        self._wire.clients.append(self)
        self._feed = self._wire.serve(self)

    def data_received(self, data: bytes) -> None:
        self._wire.controller.advance()
        self._feed(data)

    def connection_lost(self, exc: Exception | None) -> None:
        self._wire.clients.remove(self)
        self.on_closed()

    def send(self, parts: Iterable[bytes]) -> None:
        """Send the parts unless the controller is muted or cut."""
        if not self._wire.controller.silent and not self.transport.is_closing():
            for part in parts:
                self.transport.write(part)


def urscript(number: int) -> bytes:
    """Return a short move along X of 24 ms."""
    return b"movel(p[%.4f, 0, 0.06, 0, 3.14159, 0], a=5, v=0.1)" % (number * 4e-4)
