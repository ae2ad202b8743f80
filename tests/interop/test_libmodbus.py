"""libmodbus (C): as master at our simulated devices, and as slave before our drivers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from polishd.drivers.transport.address import SerialLine, Tcp
from tests.interop import devices as d
from tests.interop import slaves as s
from tests.interop.peers import Peer, program
from tests.interop.programs.libmodbus import Client
from tests.system.sim_rig import Cell

PEER = Peer("libmodbus", "Modbus RTU and TCP", "master and slave", "Debian", "libmodbus5")
pytestmark = PEER.needed

At = Callable[[Cell, str], d.Master]


class Master:
    """Master of libmodbus that raises Refused."""

    def __init__(self, address: Tcp | SerialLine) -> None:
        if isinstance(address, Tcp):
            self.client = Client(tcp=(address.host, address.port))
        else:
            self.client = Client(path=str(address.path), baud=address.baud)

    def read(self, table: d.Table, address: int, count: int) -> list[int]:
        found = self.client.read(table, address, count)
        if isinstance(found, int):
            raise d.Refused(found)
        return found

    def write(self, table: d.Table, address: int, values: list[int]) -> None:
        if code := self.client.write(table, address, values):
            raise d.Refused(code)


@pytest.fixture
def at() -> Iterator[At]:
    """A master at a device of a cell."""
    made: list[Master] = []

    def make(cell: Cell, name: str) -> Master:
        made.append(Master(d.wire(cell, name)))
        return made[-1]

    yield make
    for one in made:
        one.client.close()


def test_it_works_our_voice_coil_over_tcp(devices: Cell, at: At) -> None:
    d.works_the_voice_coil(at(devices, "actuator"))


def test_it_works_our_voice_coil_on_a_serial_line(serial_coil: Cell, at: At) -> None:
    d.works_the_voice_coil(at(serial_coil, "actuator"))


def test_it_works_our_inverter_on_a_serial_line(devices: Cell, at: At) -> None:
    d.works_the_inverter(at(devices, "spindle"))


def test_it_works_our_plc(devices: Cell, at: At) -> None:
    d.works_the_plc(at(devices, "robot"), devices.state / "programs")


async def test_it_answers_our_drivers_over_tcp() -> None:
    with program("libmodbus.py", "tcp") as peer:
        address, slave = Tcp("127.0.0.1", peer.greeting), s.Behind(peer)
        await s.answers_our_link(slave, address, outside=200)
        await s.is_a_voice_coil_to_us(slave, address)
        await s.is_a_plc_to_us(slave, address)


async def test_it_answers_our_drivers_on_a_serial_line() -> None:
    with s.serial_cable() as (one, other, theirs, ours), program("libmodbus.py", "rtu", theirs) as peer:
        async with s.pumped(one, other):
            address, slave = SerialLine(Path(ours), 19200), s.Behind(peer)
            await s.answers_our_link(slave, address, outside=200)
            await s.is_a_voice_coil_to_us(slave, address)
