"""Our simulated Modbus devices, and the requests that a master of others sends to each: the same for all masters."""

from __future__ import annotations

import socket
import struct
from pathlib import Path
from typing import Literal, Protocol

from polishd.config.device_profile_checks import DEVICE_PROFILE_DIR
from polishd.drivers.transport.address import SerialLine, Tcp, parse_address
from tests.system.sim_rig import Cell, wait_for

Table = Literal["coil", "discrete", "holding", "input"]
PRESSING = """
[plant]
aperture_mm = 40.0
speed = 20.0
"""
TCP = f"""
[robot]
kind = "modbus"
port = 0
watchdog_s = 60.0
home = [0.0, 0.0, 0.0, 15.0, 0.0]
[actuator]
kind = "modbus_tcp"
[spindle]
kind = "profile"
profile = "{DEVICE_PROFILE_DIR}/automationdirect_gs2.toml"
watchdog_s = 60.0
"""
RTU = f"""
[robot]
port = 0
watchdog_s = 60.0
home = [0.0, 0.0, 0.0, 15.0, 0.0]
[actuator]
kind = "modbus_rtu"
[spindle]
kind = "profile_tcp"
profile = "{DEVICE_PROFILE_DIR}/hitachi_wj200.toml"
watchdog_s = 60.0
"""
RANGE, ADDRESS = 3, 2
"""Exception codes."""
STATE, FORCE, SET_POINT, POSITION, FAULT, BEAT = range(6)
RETRACTED, CONTACT = 0, 2
IDLE, READY, RUNNING, DONE = 0, 1, 2, 5
START, HOLD, RESET, LOAD = range(4)
SLOW = ["G21 G90", "G1 X10 F2", "G1 X20", "M2"]
QUICK = ["G21 G90", "G1 X10 F1200", "G1 X20", "M2"]


class Refused(Exception):
    """The device answered with an exception."""

    def __init__(self, code: int) -> None:
        super().__init__(f"exception {code}")
        self.code = code


class Master(Protocol):
    """A master of others at one device. Refused where the device answers so."""

    def read(self, table: Table, address: int, count: int) -> list[int]:
        """Words, or bits as 0 and 1."""
        ...

    def write(self, table: Table, address: int, values: list[int]) -> None:
        """A single value with the function for one, several with the function for several."""
        ...


def wire(cell: Cell, name: str) -> Tcp | SerialLine:
    """Return the address of a device of the cell."""
    found = parse_address(cell.endpoints[name], Path())
    assert isinstance(found, Tcp | SerialLine)
    return found


def free_port() -> int:
    """Return a free port on loopback, for a server that does not report its port."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def refusal(master: Master, table: Table, address: int, values: list[int] | None = None) -> int:
    """The code that a read of one, or this write, is refused with; 0 where it is not."""
    try:
        if values is None:
            master.read(table, address, 1)
        else:
            master.write(table, address, values)
    except Refused as refused:
        return refused.code
    return 0


def text(words: list[int]) -> str:
    """Return the text that the registers hold."""
    return struct.pack(f">{len(words)}H", *words).rstrip(b"\0").decode()


def works_the_voice_coil(master: Master) -> None:
    """Who it is, what it refuses, pressed with 12 N, lifted (docs/protocols/voice_coil_modbus.md)."""
    words = master.read("input", 100, 30)
    assert (text(words[:8]), text(words[8:16])) == ("polishd", "simulated VC50")
    assert words[28] << 16 | words[29] == 1
    master.write("holding", 0, [0])
    wait_for(lambda: master.read("input", STATE, 1) == [RETRACTED], "retracted")
    assert refusal(master, "holding", 1, [5001]) == RANGE
    assert refusal(master, "holding", 9, [1]) == ADDRESS
    assert refusal(master, "input", 60) == ADDRESS
    master.write("holding", 1, [1200, 5000])
    assert master.read("holding", 0, 3) == [0, 1200, 5000]
    master.write("holding", 3, [7])
    master.write("holding", 0, [1])

    def pressed() -> bool:
        master.write("holding", 3, [41])
        state, force, set_point, _, fault, beat = master.read("input", 0, 6)
        return (state, set_point, fault, beat) == (CONTACT, 1200, 0, 41) and abs(force - 1200) < 120

    wait_for(pressed, "12 N")
    master.write("holding", 0, [0])
    wait_for(lambda: master.read("input", 0, 4)[::3] == [RETRACTED, 0], "retracted")


def works_the_inverter(master: Master) -> None:
    """Turned either way and stopped, as its manual has it (the registers of a GS2)."""
    for reverse, status in ((0, 0x03), (1, 0x1B)):
        master.write("holding", 0x091A, [300, 1, reverse])

        def at_speed(status: int = status) -> bool:
            return master.read("holding", 0x2100, 4) == [0, status, 300, 300]

        wait_for(at_speed, "30 Hz")
        master.write("holding", 0x091B, [0])
        wait_for(lambda: master.read("holding", 0x2103, 1) == [0], "standstill")
    assert refusal(master, "holding", 0x3000) == ADDRESS


def works_the_plc(master: Master, programs: Path) -> None:
    """A program is loaded, held and reset, another seen to its end: bits and registers of the profile plc-modbus."""
    _load(master, programs, SLOW)
    master.write("coil", START, [1])
    wait_for(lambda: master.read("discrete", 1, 1) == [1], "in motion")
    state, high, low = master.read("input", 0, 3)
    assert (state, high) == (RUNNING, 0)
    assert 1 <= low <= len(SLOW)
    master.write("coil", HOLD, [1])
    wait_for(lambda: master.read("discrete", 0, 2) == [0, 0], "held")
    assert master.read("coil", 0, 4) == [1, 1, 0, 0]
    master.write("coil", START, [0])
    master.write("coil", HOLD, [0])
    _load(master, programs, QUICK)
    master.write("holding", 0, [9])
    master.write("coil", START, [1])
    wait_for(lambda: master.read("input", 0, 1) == [DONE], "done")
    master.write("coil", START, [0])
    (clock,) = struct.unpack(">d", struct.pack(">4H", *master.read("input", 6, 4)))
    assert clock > 0.0
    assert refusal(master, "input", 60) == ADDRESS
    assert refusal(master, "coil", 4, [1]) == ADDRESS


def _load(master: Master, programs: Path, lines: list[str]) -> None:
    (programs / "polishd.nc").write_text("\n".join(lines) + "\n")
    master.write("coil", START, [0, 0, 0, 0])
    _seen(master)
    for order, state in ((RESET, IDLE), (LOAD, READY)):
        master.write("coil", order, [1])
        wait_for(lambda state=state: master.read("input", 0, 1) == [state], f"state {state}")
        master.write("coil", order, [0])
        _seen(master)


def _seen(master: Master) -> None:
    """It has: it has reported since."""
    before = master.read("input", 4, 1)
    wait_for(lambda: master.read("input", 4, 1) != before, "a report")
