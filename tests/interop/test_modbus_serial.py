"""modbus-serial (JavaScript): as master at our simulated devices, and its ServerTCP before our drivers."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from polishd.drivers.transport.address import Tcp
from tests.interop import devices as d
from tests.interop import slaves as s
from tests.interop.peers import Peer, Program, program
from tests.system.sim_rig import Cell

PEER = Peer("modbus-serial", "Modbus RTU and TCP", "master and slave", "npm", "modbus-serial")
pytestmark = PEER.needed


class Master:
    """Client of modbus-serial in a separate process."""

    def __init__(self, peer: Program) -> None:
        self._peer = peer

    def read(self, table: d.Table, address: int, count: int) -> list[int]:
        return list(self._asked(read=[table, address, count]))

    def write(self, table: d.Table, address: int, values: list[int]) -> None:
        self._asked(write=[table, address, values])

    def _asked(self, **question: object) -> list[int]:
        found = self._peer.ask(**question)
        if isinstance(found, dict):
            raise d.Refused(found["refused"])
        return found or []


@contextmanager
def master_at(cell: Cell, name: str) -> Iterator[Master]:
    address = d.wire(cell, name)
    where = ("tcp", address.host, address.port) if isinstance(address, Tcp) else ("rtu", address.path, address.baud)
    with program("modbus_serial.js", "master", *where) as peer:
        yield Master(peer)


def test_it_works_our_voice_coil_over_tcp(devices: Cell) -> None:
    with master_at(devices, "actuator") as master:
        d.works_the_voice_coil(master)


def test_it_works_our_voice_coil_on_a_serial_line(serial_coil: Cell) -> None:
    with master_at(serial_coil, "actuator") as master:
        d.works_the_voice_coil(master)


def test_it_works_our_inverter_on_a_serial_line(devices: Cell) -> None:
    with master_at(devices, "spindle") as master:
        d.works_the_inverter(master)


def test_it_works_our_plc(devices: Cell) -> None:
    with master_at(devices, "robot") as master:
        d.works_the_plc(master, devices.state / "programs")


async def test_it_answers_our_drivers_over_tcp() -> None:
    with program("modbus_serial.js", "slave") as peer:
        address, slave = Tcp("127.0.0.1", peer.greeting), s.Behind(peer)
        await s.answers_our_link(slave, address, outside=200)
        await s.is_a_voice_coil_to_us(slave, address)
        await s.is_a_plc_to_us(slave, address)
