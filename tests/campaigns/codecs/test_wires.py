"""The same talks on pseudo-terminals and TCP, in real time: no value is another's, no descriptor or task is left."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from polishd.drivers.transport.address import SerialLine, Tcp
from tests.campaigns.codecs import hses, lines, modbus, robots
from tests.campaigns.codecs.faulty_peer import NEVER_ON_WIRES, FaultyPeer, Talk, ask_until
from tests.fakes.wires import PtyWire, TcpWire
from tests.time_limits import SOON_S

SILENCE_S = 0.1
"""Much of what is broken is answered by nothing more. A busy computer loses some good ones, too."""
SERIAL: list[Any] = [
    lines.ForceSensor, lines.Monitor, lines.Loader, lines.VoiceCoil, lines.ForceGauge, modbus.ProfiledRtu,
]  # fmt: skip
NETWORK: list[Any] = [
    lines.OwnLines, lines.LinuxCnc, modbus.ProfiledTcp, modbus.Controller, robots.RobotLink, robots.Rtde,
    robots.Dashboard, robots.FanucRmi, robots.KukaProxy,
]  # fmt: skip


def descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


async def talked(talk: Talk, peer: FaultyPeer, bad: int) -> None:
    """Until so many malformed replies came; no task is left of it."""
    tasks = len(asyncio.all_tasks())
    outcomes = await ask_until(talk, peer, bad)
    assert outcomes["value"] > 0
    assert len(asyncio.all_tasks()) == tasks


async def on_serial_line(make: Any, where: Path, bad: int) -> None:
    talk = make(address=SerialLine(where, 115200), silence_s=SILENCE_S)
    peer = FaultyPeer(talk, 16, NEVER_ON_WIRES)
    wire = PtyWire(peer, where)
    try:
        opened = descriptors()
        await talked(talk, peer, bad)
        assert descriptors() == opened
    finally:
        await wire.close()


async def on_tcp(make: Any, bad: int) -> None:
    opened = descriptors()
    peer = FaultyPeer(make(silence_s=SILENCE_S), 16, NEVER_ON_WIRES)
    wire = await TcpWire(peer).start()
    peer.talk = make(address=Tcp("127.0.0.1", wire.port), silence_s=SILENCE_S)
    peer.talk.say = peer.treat
    try:
        await talked(peer.talk, peer, bad)
    finally:
        await wire.close()
    await until(lambda: descriptors() <= opened)  # the far ends hear of it in their own turn


class Datagrams(asyncio.DatagramProtocol):
    """The device's UDP port."""

    def __init__(self, peer: FaultyPeer) -> None:
        self._peer = peer

    def connection_made(self, transport: Any) -> None:
        self._transport = transport

    def datagram_received(self, data: bytes, addr: Any) -> None:
        self._peer.write = lambda reply: self._transport.sendto(reply, addr)
        self._peer.on_bytes(data)


async def on_udp(make: Any, bad: int) -> None:
    opened, peer = descriptors(), FaultyPeer(make(silence_s=SILENCE_S), 16, NEVER_ON_WIRES)
    loop = asyncio.get_running_loop()
    port, _ = await loop.create_datagram_endpoint(lambda: Datagrams(peer), local_addr=("127.0.0.1", 0))
    peer.talk = make(address=Tcp("127.0.0.1", port.get_extra_info("sockname")[1]), silence_s=SILENCE_S)
    try:
        await talked(peer.talk, peer, bad)
    finally:
        port.close()
    await until(lambda: descriptors() <= opened)


async def until(holds: Callable[[], bool]) -> None:
    async with asyncio.timeout(SOON_S):
        while not holds():  # noqa: ASYNC110 -- the kernel has no event for it
            await asyncio.sleep(0.01)


@pytest.mark.full
@pytest.mark.parametrize("make", SERIAL, ids=lambda one: one.name)
async def test_broken_replies_on_a_serial_line(tmp_path: Path, make: Any) -> None:
    await on_serial_line(make, tmp_path / "line", 60)


@pytest.mark.full
@pytest.mark.parametrize("make", NETWORK, ids=lambda one: one.name)
async def test_broken_replies_on_tcp(make: Any) -> None:
    await on_tcp(make, 60)


@pytest.mark.full
async def test_broken_replies_on_udp() -> None:
    await on_udp(hses.Controller, 60)


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("make", SERIAL, ids=lambda one: one.name)
async def test_two_thousand_broken_replies_on_a_serial_line(tmp_path: Path, make: Any) -> None:
    await on_serial_line(make, tmp_path / "line", 2_000)


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("make", NETWORK, ids=lambda one: one.name)
async def test_two_thousand_broken_replies_on_tcp(make: Any) -> None:
    await on_tcp(make, 2_000)
