"""Part loaders."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from pathlib import Path

from polishd.api import PartLoader
from polishd.drivers.loader_line import LoaderLine
from polishd.drivers.transport.address import SerialLine, Tcp
from polishd.model.devices import LoaderTimes
from polishd.testing.suites.loader import LoaderRig
from tests.conformance.rigs.wired import on_wire
from tests.fakes.loader import FakeLoader
from tests.fakes.wires import PtyWire, TcpWire, dribbled
from tests.selection import kind

PATIENT_LOADER = LoaderTimes(silence_s=1.0)
"""A busy machine is silent for longer than most wires would be."""


@asynccontextmanager
async def loader_serial(folder: Path) -> AsyncIterator[LoaderRig]:
    """loader_line on a serial line."""
    fake = FakeLoader()
    wire = PtyWire(fake, folder / "loader")
    async with _loader(fake, wire, LoaderLine(SerialLine(wire.path), PATIENT_LOADER)) as rig:
        yield rig


@asynccontextmanager
async def loader_tcp_dribbled(_: Path) -> AsyncIterator[LoaderRig]:
    """loader_line over TCP, byte by byte, with garbage before each answer."""
    fake = FakeLoader()
    fake.filter = lambda data: [b"\xff*noise$", *dribbled(data)]
    wire = await TcpWire(fake).start()
    async with _loader(fake, wire, LoaderLine(Tcp("127.0.0.1", wire.port), PATIENT_LOADER)) as rig:
        yield rig


def _loader(fake: FakeLoader, wire: PtyWire | TcpWire, device: PartLoader) -> AbstractAsyncContextManager[LoaderRig]:
    return on_wire(wire, device, lambda: fake.state != 1)


LOADERS = kind(loader_serial, loader_tcp_dribbled)
