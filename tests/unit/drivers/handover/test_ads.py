"""Variables over ADS: pyads against the simulated PLC's own server, on a loopback address of its own."""

from __future__ import annotations

import asyncio
import os
import socket
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from polishd.api import LinkError, ProtocolError
from polishd.config.controller_profile import load_controller_profile
from polishd.drivers.handover.ads import Ads
from polishd.sim_backends.handover.ads import AMS_PORT, TCP_PORT, AdsServer
from tests.fakes.handover import FakePlc

PROFILE = load_controller_profile("twincat-ads", Path())
HOST = f"127.{40 + os.getpid() % 80}.{os.getpid() // 80 % 250}.1"
NETID = f"{HOST}.1.1"


class Peer(asyncio.Protocol):
    """A connection to the server, which can be muted."""

    def __init__(self, fake: FakePlc, open_: list[asyncio.Transport]) -> None:
        self._fake, self._open = fake, open_

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self._transport = transport
        self._open.append(transport)
        self._feed = AdsServer(self._fake.plc).connected(self)

    def send(self, frame: bytes) -> None:
        if not self._fake.silent:
            self._transport.write(frame)

    def data_received(self, data: bytes) -> None:
        self._feed(data)


@asynccontextmanager
async def serving(fake: FakePlc) -> AsyncIterator[list[asyncio.Transport]]:
    """The server for the time of the block."""
    connections: list[asyncio.Transport] = []
    loop = asyncio.get_running_loop()
    server = await loop.create_server(lambda: Peer(fake, connections), HOST, TCP_PORT, family=socket.AF_INET)
    try:
        yield connections
    finally:
        server.close()
        for one in connections:
            one.abort()


def link(silence_s: float = 5.0, **changed: str) -> Ads:
    table = PROFILE.variables
    if changed:
        (name, address), *_ = changed.items()
        point = getattr(table, name).model_copy(update={"address": address})
        table = table.model_copy(update={name: point})
    return Ads(HOST, NETID, AMS_PORT, table, silence_s)


async def test_all_that_is_watched_comes_in_one_reading(tmp_path: Path) -> None:
    fake = FakePlc(tmp_path)
    async with serving(fake):
        ads = link()
        await ads.open()
        fake.plc.shown |= {"line": 70_000, "state": 3, "in_motion": True, "clock": 12.5, "alarm_text": "Düse"}
        values = (await ads.read()).values
        assert {name: values[name] for name in ("line", "state", "in_motion", "clock", "session", "alarm_text")} == {
            "line": 70_000,
            "state": 3,
            "in_motion": True,
            "clock": 12.5,
            "session": "boot-1",
            "alarm_text": "Düse",
        }
        identity = await ads.identify()
        assert (identity.model, identity.serial) == ("polishd sim PLC", NETID)
        await ads.close()


async def test_orders_are_written_together(tmp_path: Path) -> None:
    fake = FakePlc(tmp_path)
    async with serving(fake):
        ads = link()
        await ads.open()
        await ads.write({"hold": False, "start": True, "program": "a.nc", "heartbeat": 7})
        found = {name: fake.plc.inputs[name] for name in ("hold", "start", "program", "heartbeat")}
        assert found == {"hold": False, "start": True, "program": "a.nc", "heartbeat": 7}
        await ads.close()


async def test_a_symbol_that_is_not_there_is_named(tmp_path: Path) -> None:
    async with serving(FakePlc(tmp_path)):
        with pytest.raises(ProtocolError, match="addresses in the profile"):
            await link(line="GVL_polishd.lines").open()


async def test_nobody_there_and_nobody_answering_are_lost_links(tmp_path: Path) -> None:
    with pytest.raises(LinkError):
        await link().open()
    fake = FakePlc(tmp_path)
    async with serving(fake):
        ads = link(silence_s=0.3)
        await ads.open()
        fake.silent = True
        with pytest.raises(LinkError):
            await ads.read()
        await ads.close()
        with pytest.raises(LinkError, match="is not open"):
            await ads.read()
