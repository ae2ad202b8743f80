"""pyModbusTCP: as master at our simulated devices, and its server before our drivers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest

from polishd.drivers.transport.address import Tcp
from tests.interop import devices as d
from tests.interop import slaves as s
from tests.interop.peers import Peer
from tests.system.sim_rig import Cell

PEER = Peer("pyModbusTCP", "Modbus TCP", "master and slave", "PyPI", "pyModbusTCP")
pytestmark = PEER.needed

SECONDS = 10.0
NAMES = {"coil": "coils", "discrete": "discrete_inputs", "holding": "holding_registers", "input": "input_registers"}


class Master:
    """Master made of pyModbusTCP's client."""

    def __init__(self, address: Tcp) -> None:
        from pyModbusTCP.client import ModbusClient

        self.client: Any = ModbusClient(host=address.host, port=address.port, unit_id=1, timeout=SECONDS)

    def read(self, table: d.Table, address: int, count: int) -> list[int]:
        return [int(value) for value in self._told(getattr(self.client, f"read_{NAMES[table]}")(address, count))]

    def write(self, table: d.Table, address: int, values: list[int]) -> None:
        name = "coil" if table == "coil" else "register"
        if len(values) == 1:
            self._told(getattr(self.client, f"write_single_{name}")(address, values[0]))
        else:
            self._told(getattr(self.client, f"write_multiple_{name}s")(address, values))

    def _told(self, found: Any) -> Any:
        if not found:
            assert self.client.last_except, self.client.last_error_as_txt
            raise d.Refused(self.client.last_except)
        return found


class Bank:
    """Tables of pyModbusTCP's server."""

    def __init__(self) -> None:
        from pyModbusTCP.server import DataBank

        self.bank: Any = DataBank(coils_size=200, d_inputs_size=200, h_regs_size=200, i_regs_size=200)

    def put(self, table: d.Table, address: int, values: list[int]) -> None:
        assert getattr(self.bank, f"set_{NAMES[table]}")(address, values)

    def got(self, table: d.Table, address: int, count: int) -> list[int]:
        return [int(value) for value in getattr(self.bank, f"get_{NAMES[table]}")(address, count)]


@pytest.fixture
def at() -> Iterator[Callable[[Cell, str], Master]]:
    """A master at a device of a cell."""
    made: list[Master] = []

    def make(cell: Cell, name: str) -> Master:
        address = d.wire(cell, name)
        assert isinstance(address, Tcp)
        made.append(Master(address))
        return made[-1]

    yield make
    for one in made:
        one.client.close()


def test_it_works_our_voice_coil(devices: Cell, at: Callable[[Cell, str], Master]) -> None:
    d.works_the_voice_coil(at(devices, "actuator"))


def test_it_works_our_plc(devices: Cell, at: Callable[[Cell, str], Master]) -> None:
    d.works_the_plc(at(devices, "robot"), devices.state / "programs")


async def test_it_answers_our_drivers() -> None:
    from pyModbusTCP.server import ModbusServer

    bank = Bank()
    server = ModbusServer("127.0.0.1", d.free_port(), no_block=True, data_bank=bank.bank)
    server.start()
    try:
        address = Tcp("127.0.0.1", server.port)
        await s.answers_our_link(bank, address, outside=200)
        await s.is_a_voice_coil_to_us(bank, address)
        await s.is_a_plc_to_us(bank, address)
    finally:
        server.stop()
