"""Run the simulated PLC without a plant in the loop of the test: behind OPC UA, ADS or HSES, or called directly."""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
import time
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, cast

import numpy as np

from polishd.api import DeviceIdentity, LinkError
from polishd.config.controller_profile import ControllerProfile, Value, load_controller_profile
from polishd.config.simulator_devices import SimRobotSection
from polishd.drivers.plc_robot.ads import Ads
from polishd.drivers.plc_robot.driver import PlcRobot
from polishd.drivers.plc_robot.opcua import OpcUa
from polishd.drivers.plc_robot.variables import VariableSnapshot, of_kind, watched
from polishd.drivers.transport.file_delivery import Folder
from polishd.sim_backends.plc_robot.controller import Plc
from polishd.sim_backends.plc_robot.device import AMS_PORT, TCP_PORT, AdsServer
from polishd.sim_backends.plc_robot.hses import HsesServer
from polishd.sim_backends.robot.motion import SimMotion
from polishd.sim_backends.robot.trajectory import Limits

HOST = f"127.{40 + os.getpid() % 80}.{os.getpid() // 80 % 250}.1"
"""Address of this test process: ADS has a fixed port, so that each process needs another address."""
NETID = f"{HOST}.1.1"
CYCLE_S = 0.002
SPEED = 100.0
"""Speed of the PLC's clock: 100 mm of the suites' programs last a second."""
PROFILE = load_controller_profile("plc-opcua", Path())


class FakePlc:
    """PLC with a cycle, whose wire can be cut or muted."""

    def __init__(self, folder: Path, *, speed: float = SPEED, **robot: float) -> None:
        self.folder = folder
        self.events: list[str] = []
        limits = Limits(1000.0, 0.002, 30.0, 100.0, 100.0, speed)
        config = SimRobotSection(x_mm=(-1e4, 1e4), **{"report_ms": 10.0, "watchdog_s": 8.0, **robot})
        self.plc = Plc(config, SimMotion(limits, (0.0, 0.0, 60.0, 0.0, 0.0)), folder, _anywhere, self._report, "boot-1")
        self.plc.tick(time.monotonic())
        self.silent = self.dead = False
        self.override = 100.0
        self.written: list[Mapping[str, Value]] = []

    @property
    def stands(self) -> bool:
        """Return whether the robot stands still, whatever the PLC reports."""
        return self.plc.motion.state != "running"

    def cut(self) -> None:
        """Cut the wire permanently."""
        self.dead = True

    async def cycle(self) -> None:
        """Run the cycle until cancelled."""
        while True:
            self.plc.tick(time.monotonic())
            await asyncio.sleep(CYCLE_S)

    def _report(self, event: str, *_: object, **__: object) -> None:
        self.events.append(event)


class Direct:
    """Variables port that accesses the PLC directly."""

    def __init__(self, fake: FakePlc, profile: ControllerProfile = PROFILE) -> None:
        self._fake = fake
        self._watched = watched(profile.variables)
        self._silence_s = profile.silence_s
        self._open = False

    async def open(self) -> None:
        await self._wire()
        self._open = True

    async def close(self) -> None:
        self._open = False

    async def identify(self) -> DeviceIdentity:
        await self._answers()
        return DeviceIdentity("test", "PLC", "1", "1")

    async def read(self) -> VariableSnapshot:
        await self._answers()
        shown = {**self._fake.plc.shown, "feed_override": self._fake.override}
        values = {name: of_kind(point.type, shown[name], name) for name, point in self._watched.items()}
        return VariableSnapshot(time.monotonic(), values)

    async def write(self, values: Mapping[str, Value]) -> None:
        await self._answers()
        self._fake.written.append(dict(values))
        self._fake.plc.inputs.update(values)

    async def _answers(self) -> None:
        if not self._open:
            raise LinkError("test PLC: is not open")
        await self._wire()

    async def _wire(self) -> None:
        if self._fake.silent:
            await asyncio.sleep(self._silence_s)
        if self._fake.dead or self._fake.silent:
            raise LinkError("test PLC: answers no more")
        await asyncio.sleep(0.0)


class Relay:
    """TCP relay to the OPC UA server that can be cut permanently and muted."""

    def __init__(self, fake: FakePlc, target: int) -> None:
        self._fake, self._target = fake, target
        self._ends: set[asyncio.StreamWriter] = set()
        self._ways: set[asyncio.Task[None]] = set()
        self.server: asyncio.Server | None = None

    def cut(self) -> None:
        self._fake.cut()
        if self.server is not None:
            self.server.close()
        for end in self._ends:
            end.transport.abort()

    async def connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        far_reader, far_writer = await asyncio.open_connection("127.0.0.1", self._target)
        self._ends |= {writer, far_writer}
        ways = {
            asyncio.ensure_future(self._pump(reader, far_writer, lambda: False)),
            asyncio.ensure_future(self._pump(far_reader, writer, lambda: self._fake.silent)),
        }
        self._ways |= ways
        await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        for end in (writer, far_writer):
            end.transport.abort()

    async def _pump(
        self, source: asyncio.StreamReader, sink: asyncio.StreamWriter, swallows: Callable[[], bool]
    ) -> None:
        with contextlib.suppress(ConnectionError):
            while data := await source.read(1 << 16):
                if not swallows():
                    sink.write(data)

    async def end(self) -> None:
        for end in self._ends:
            end.transport.abort()
        for way in self._ways:
            way.cancel()
        await asyncio.gather(*self._ways, return_exceptions=True)


class ServedPeer(asyncio.Protocol):
    """Connection to the server that can be muted."""

    def __init__(self, fake: FakePlc, server: Callable[[Plc], Any], open_: list[asyncio.Transport]) -> None:
        self._fake, self._server, self._open = fake, server, open_

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        if self._fake.dead:
            transport.abort()
        self._open.append(transport)
        self._feed = self._server(self._fake.plc).connected(self)  # it only sends

    def send(self, frame: bytes) -> None:
        if not self._fake.silent:
            self._transport.write(frame)

    def data_received(self, data: bytes) -> None:
        self._feed(data)


@asynccontextmanager
async def serving(
    fake: FakePlc, what: Callable[[Plc], Any], host: str = "127.0.0.1", port: int = 0
) -> AsyncIterator[tuple[int, list[asyncio.Transport]]]:
    """Run the server for the duration of the block; its port and its connections."""
    connections: list[asyncio.Transport] = []
    loop = asyncio.get_running_loop()
    server = await loop.create_server(lambda: ServedPeer(fake, what, connections), host, port, family=socket.AF_INET)
    try:
        yield server.sockets[0].getsockname()[1], connections
    finally:
        server.close()
        for one in connections:
            one.abort()


class ServedDatagrams(asyncio.DatagramProtocol):
    """UDP port of the controller, whose answers a test can drop, repeat or change."""

    def __init__(self, server: HsesServer) -> None:
        self.server = server
        self.asked: list[bytes] = []
        """Datagrams that were received."""
        self.out: Callable[[bytes], list[bytes]] = lambda answer: [answer]
        """Return the datagrams to send instead of an answer."""
        self.into: Callable[[bytes], list[bytes]] = lambda request: [request]
        """Return the datagrams to process instead of a request."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast("asyncio.DatagramTransport", transport)  # asyncio's own is no subclass

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        self.asked.append(data)
        for request in self.into(data):
            for answer in self.out(self.server.answer(request)):
                self._transport.sendto(answer, addr)


@asynccontextmanager
async def datagrams(fake: FakePlc) -> AsyncIterator[tuple[int, ServedDatagrams]]:
    """Run HSES for the duration of the block; its port and server."""
    loop = asyncio.get_running_loop()
    fake.plc.goes_on = False
    transport, served = await loop.create_datagram_endpoint(
        lambda: ServedDatagrams(HsesServer(fake.plc)), local_addr=("127.0.0.1", 0)
    )
    try:
        yield transport.get_extra_info("sockname")[1], served
    finally:
        transport.close()


@asynccontextmanager
async def cycling(fake: FakePlc) -> AsyncIterator[FakePlc]:
    """Run the PLC for the duration of the block."""
    task = asyncio.create_task(fake.cycle())
    try:
        yield fake
    finally:
        task.cancel()
        await asyncio.wait({task})


@asynccontextmanager
async def direct(fake: FakePlc, profile: ControllerProfile = PROFILE) -> AsyncIterator[PlcRobot]:
    """Run the PLC; the driver accesses it directly and is closed."""
    async with cycling(fake):
        device = PlcRobot("test PLC", profile, lambda: Direct(fake, profile), Folder(fake.folder))
        try:
            yield device
        finally:
            await device.close()


@asynccontextmanager
async def over_opcua(fake: FakePlc, profile: ControllerProfile = PROFILE) -> AsyncIterator[tuple[PlcRobot, Relay]]:
    """Run the PLC behind an OPC UA server; the driver is closed."""
    from polishd.sim_backends.plc_robot.device import served

    async with cycling(fake), served(fake.plc) as port:
        relay = Relay(fake, port)
        relay.server = await asyncio.start_server(relay.connected, "127.0.0.1", 0)
        url = f"opc.tcp://127.0.0.1:{relay.server.sockets[0].getsockname()[1]}"
        make = lambda: OpcUa(url, profile.variables, profile.silence_s)  # noqa: E731
        device = PlcRobot("test PLC", profile, make, Folder(fake.folder))
        try:
            yield device, relay
        finally:
            await device.close()
            relay.server.close()
            await relay.end()


@asynccontextmanager
async def over_ads(fake: FakePlc) -> AsyncIterator[tuple[PlcRobot, Callable[[], None]]]:
    """Run the PLC behind ADS; the driver, which is closed, and a function that cuts the wire permanently."""
    profile = load_controller_profile("plc-ads", Path())

    async with cycling(fake), serving(fake, AdsServer, HOST, TCP_PORT) as (_, connections):

        def cut() -> None:
            fake.cut()
            for one in connections:
                one.abort()

        make = lambda: Ads(HOST, NETID, AMS_PORT, profile.variables, profile.silence_s)  # noqa: E731
        device = PlcRobot("test PLC", profile, make, Folder(fake.folder))
        try:
            yield device, cut
        finally:
            await device.close()


def _anywhere(blocks: list[object]) -> np.ndarray:
    return np.ones(len(blocks), dtype=bool)
