"""mbpoll, a command line master, at our simulated devices."""

from __future__ import annotations

import re
import subprocess
from dataclasses import dataclass

from polishd.drivers.transport.address import SerialLine, Tcp
from tests.interop import devices as d
from tests.interop.peers import Peer
from tests.system.sim_rig import Cell

PEER = Peer("mbpoll", "Modbus RTU and TCP", "master", "Debian", "mbpoll")
pytestmark = PEER.needed

TABLES = {"coil": "0", "discrete": "1", "input": "3", "holding": "4"}
SAID = {"Illegal data address": 2, "Illegal data value": 3, "Slave device or server failure": 4}


@dataclass(frozen=True, slots=True)
class Mbpoll:
    """A run of it for each request."""

    address: Tcp | SerialLine

    def read(self, table: d.Table, address: int, count: int) -> list[int]:
        output = self._run(table, address, "-c", str(count))
        return [int(value) & 0xFFFF for value in re.findall(r"^\[\d+\]:\s+(\d+)", output, re.MULTILINE)]

    def write(self, table: d.Table, address: int, values: list[int]) -> None:
        self._run(table, address, values=list(map(str, values)))

    def _run(self, table: d.Table, address: int, *options: str, values: list[str] | None = None) -> str:
        place = self.address
        if isinstance(place, Tcp):
            where = ["-m", "tcp", "-p", str(place.port), place.host]
        else:
            where = ["-m", "rtu", "-b", str(place.baud), "-P", "none", str(place.path)]
        wanted = ["-0", "-1", "-a", "1", "-o", "10", "-r", str(address), "-t", TABLES[table], *options]
        command = ["mbpoll", *wanted, *where, *(values or [])]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        output = done.stdout + done.stderr
        for words, code in SAID.items():
            if words in output:
                raise d.Refused(code)
        assert done.returncode == 0, output
        return output


def test_it_works_our_voice_coil_over_tcp(devices: Cell) -> None:
    d.works_the_voice_coil(Mbpoll(d.wire(devices, "actuator")))


def test_it_works_our_voice_coil_on_a_serial_line(serial_coil: Cell) -> None:
    d.works_the_voice_coil(Mbpoll(d.wire(serial_coil, "actuator")))


def test_it_works_our_inverter_on_a_serial_line(devices: Cell) -> None:
    d.works_the_inverter(Mbpoll(d.wire(devices, "spindle")))


def test_it_works_our_plc(devices: Cell) -> None:
    d.works_the_plc(Mbpoll(d.wire(devices, "robot")), devices.state / "programs")
