"""minimalmodbus, a master of serial lines, at our simulated devices."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from tests.interop import devices as d
from tests.interop.peers import Peer
from tests.system.sim_rig import Cell

PEER = Peer("minimalmodbus", "Modbus RTU", "master", "PyPI", "minimalmodbus")
pytestmark = PEER.needed

SECONDS = 2.0
"""For an answer. It waits so long for the rest of an exception, too: it expects as many bytes as of a good answer."""


class Master:
    """Master made of minimalmodbus's Instrument."""

    def __init__(self, cell: Cell, name: str) -> None:
        import minimalmodbus

        address = d.wire(cell, name)
        assert isinstance(address, d.SerialLine)
        self.instrument: Any = minimalmodbus.Instrument(str(address.path), 1)
        self.instrument.serial.baudrate = address.baud
        self.instrument.serial.timeout = SECONDS

    def read(self, table: d.Table, address: int, count: int) -> list[int]:
        with self._refused():
            return list(self.instrument.read_registers(address, count, functioncode=4 if table == "input" else 3))

    def write(self, table: d.Table, address: int, values: list[int]) -> None:
        with self._refused():
            if len(values) == 1:
                self.instrument.write_register(address, values[0], functioncode=6)
            else:
                self.instrument.write_registers(address, values)

    @contextmanager
    def _refused(self) -> Iterator[None]:
        """Raise Refused with the exception code: the library distinguishes 2 and 3 by their text only."""
        import minimalmodbus

        try:
            yield
        except minimalmodbus.IllegalRequestError as error:
            codes = {"data address": d.ADDRESS, "data value": d.RANGE}
            raise d.Refused(next(code for words, code in codes.items() if words in str(error))) from error


@pytest.fixture
def at() -> Iterator[Callable[[Cell, str], Master]]:
    """A master at a device of a cell."""
    made: list[Master] = []

    def make(cell: Cell, name: str) -> Master:
        made.append(Master(cell, name))
        return made[-1]

    yield make
    for one in made:
        one.instrument.serial.close()


def test_it_works_our_voice_coil(serial_coil: Cell, at: Callable[[Cell, str], Master]) -> None:
    d.works_the_voice_coil(at(serial_coil, "actuator"))


def test_it_works_our_inverter(devices: Cell, at: Callable[[Cell, str], Master]) -> None:
    d.works_the_inverter(at(devices, "spindle"))
