"""canopen's own node before our CiA 402 driver, and canopen's own client at our simulated drive."""

from __future__ import annotations

import asyncio
import contextlib
import re
import sys
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from typing import Any

import can
import canopen
import pytest

from polishd.api import SpindleTimes
from polishd.drivers.cia402.drive import CanNodeAddress
from polishd.drivers.cia402.protocol import read_dictionary
from polishd.drivers.cia402.spindle import Cia402Spindle, SpindleScale
from polishd.drivers.transport.address import SocketcandAddress, parse_address
from tests.fakes.canopen_node import LATCH_UP_UNITS
from tests.fakes.cia402 import EDS
from tests.interop.peers import Peer
from tests.system.sim_rig import ROOT, Cell, cell, wait_for
from tests.time_limits import SOON_S

PEER = Peer("canopen", "CANopen", "node and client", "PyPI", "canopen")
pytestmark = PEER.needed

SIM = """
[plant]
aperture_mm = 40.0
[robot]
port = 0
watchdog_s = 30.0
[spindle]
kind = "socketcand"
"""


class Hub(asyncio.Protocol):
    """Client of a socketcand server; all others receive what it sends."""

    clients: set[Hub]

    def __init__(self, clients: set[Hub]) -> None:
        self.clients = clients
        self._text = ""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        transport.write(b"< hi >")

    def connection_lost(self, exc: Exception | None) -> None:
        self.clients.discard(self)

    def data_received(self, data: bytes) -> None:
        self._text += data.decode()
        while match := re.match(r"\s*< (\w+) ?([^>]*)>", self._text):
            self._text = self._text[match.end() :]
            verb, rest = match.groups()
            if verb == "send":
                identifier, _, *octets = rest.split()
                frame = f"< frame {int(identifier, 16):03X} 0.0 {''.join(octet.zfill(2) for octet in octets)} >"
                for other in self.clients - {self}:
                    other._transport.write(frame.encode())
                continue
            self._transport.write(b"< ok >")
            if verb == "rawmode":
                self.clients.add(self)


@pytest.fixture
async def local_node() -> AsyncIterator[SocketcandAddress]:
    """Run canopen's LocalNode in a separate process; the address of its bus."""
    clients: set[Hub] = set()
    server = await asyncio.get_running_loop().create_server(lambda: Hub(clients), "127.0.0.1", 0)
    port = server.sockets[0].getsockname()[1]
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "tests.fakes.canopen_node", str(port), str(EDS), cwd=ROOT,
        stdin=asyncio.subprocess.PIPE, stdout=asyncio.subprocess.PIPE,
    )  # fmt: skip
    assert process.stdout is not None
    async with asyncio.timeout(SOON_S):
        assert await process.stdout.readline() == b"ready\n"
    yield SocketcandAddress("127.0.0.1", port, "can0")
    process.kill()
    await process.wait()
    server.close()
    for client in clients:
        client._transport.abort()


async def test_our_driver_works_canopens_own_node(local_node: SocketcandAddress) -> None:
    place = CanNodeAddress(local_node, 5, 0x45, silence_s=5.0, watchdog_s=5.0)
    scale = SpindleScale(0.1, max_rpm=2000.0)
    spindle = Cia402Spindle(place, read_dictionary(EDS, 5), scale, SpindleTimes(silence_s=5.0))
    await spindle.open()
    identity = await spindle.identify()
    assert (identity.vendor, identity.model, identity.serial) == ("0x0000506f", "0x00000402", "4020")
    await spindle.set_speed(-1500.0)
    samples = [sample async for sample in _first(spindle.samples(), 5)]
    assert {(one.rpm, one.setpoint_rpm, one.fault) for one in samples} == {(-1500.0, -1500.0, 0)}
    await spindle.make_safe()
    assert (await spindle.status()).safe
    await spindle.set_speed(LATCH_UP_UNITS / 10)
    async with asyncio.timeout(SOON_S):
        async for sample in spindle.samples():
            if sample.fault:
                break
    assert (await spindle.status()).detail == "temperature (4210h)"
    await spindle.close()


async def _first(samples: AsyncIterator[Any], count: int) -> AsyncIterator[Any]:
    async for sample in samples:
        yield sample
        count -= 1
        if not count:
            return


@pytest.fixture
def running(tmp_path: Path) -> Iterator[Cell]:
    """The simulated drive."""
    with cell(tmp_path, SIM, "--speed", "20", "--seed", "7") as found:
        yield found


@contextlib.contextmanager
def own_client(endpoint: str) -> Iterator[canopen.RemoteNode]:
    """canopen's client on that bus."""
    address = parse_address(endpoint, ROOT)
    assert isinstance(address, SocketcandAddress)
    network = canopen.Network()

    def connected() -> bool:
        try:
            network.connect(interface="socketcand", host=address.host, port=address.port, channel="can0")
        except can.CanError:  # a frame that comes along with the server's ok is taken for a refusal
            return False
        return True

    wait_for(connected, "the bus")
    canopen.sdo.SdoClient.RESPONSE_TIMEOUT = 5.0
    try:
        yield network.add_node(5, str(EDS))
    finally:
        network.disconnect()


def test_canopens_own_client_works_our_simulated_drive(running: Cell) -> None:
    with own_client(running.endpoints["spindle"]) as node:
        node.sdo[0x1017].raw = 50
        assert node.nmt.wait_for_heartbeat(timeout=SOON_S) == "PRE-OPERATIONAL"
        node.nmt.state = "OPERATIONAL"
        wait_for(lambda: node.nmt.wait_for_heartbeat(timeout=SOON_S) == "OPERATIONAL", "operational")
        with pytest.raises(canopen.SdoAbortedError, match="0x06090030"):
            node.sdo[0x60FF].raw = 100_000
        with pytest.raises(canopen.SdoAbortedError, match="0x06010002"):
            node.sdo.download(0x6041, 0, b"\0\0")
        with pytest.raises(canopen.SdoAbortedError, match="0x06020000"):
            node.sdo.upload(0x5000, 0)
        for index, value in ((0x6083, 10_000), (0x6060, 3), (0x6040, 6), (0x6040, 7), (0x60FF, 5000), (0x6040, 15)):
            node.sdo[index].raw = value
        wait_for(lambda: abs(node.sdo[0x606C].raw - 5000) < 50 and node.sdo[0x6041].raw & 0x400, "500 rpm")
        node.sdo[0x6040].raw = 2
        wait_for(lambda: node.sdo[0x6041].raw & 0x4F == 0x40 and node.sdo[0x606C].raw == 0, "quick stop")
        node.sdo[0x1016][1].raw = 0x7F << 16 | 100
        node.network.send_message(0x77F, b"\x05")
        # of its log: its wait() misses an emergency that comes before it is called
        (emergency,) = wait_for(lambda: [one for one in node.emcy.log if one.code == 0x8130], "the emergency")
        assert emergency.register == 0x11
    wait_for(lambda: running.events("watchdog"), "the watchdog event of the plant")
    said = running.events("spindle_ramping", "spindle_at_speed", "spindle_stopped", "watchdog")
    assert [said[0], said[-1]] == ["spindle_ramping", "watchdog"]
    assert "spindle_at_speed" in said
