"""A Modbus slave of others for our drivers; the test fills and reads its tables, in the same way for all slaves."""

from __future__ import annotations

import asyncio
import os
import tty
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path
from typing import Protocol

import pytest

from polishd.api import DeviceRefused
from polishd.config.controller_profile import load_controller_profile
from polishd.drivers.plc_robot.modbus import Modbus
from polishd.drivers.profile_device.links import ModbusWire
from polishd.drivers.transport.address import SerialLine, Tcp
from polishd.drivers.transport.modbus_link import ModbusLink
from tests.fakes.devices_by_profile import shipped
from tests.interop.devices import Table
from tests.interop.peers import Program

SILENCE_S = 10.0
PLC = load_controller_profile("plc-modbus", Path())


class Slave(Protocol):
    """Slave whose tables the test accesses directly."""

    def put(self, table: Table, address: int, values: list[int]) -> None:
        """Fill."""
        ...

    def got(self, table: Table, address: int, count: int) -> list[int]:
        """What stands there."""
        ...


class Behind:
    """A Slave that is a process of ``programs/``."""

    def __init__(self, program: Program) -> None:
        self._program = program

    def put(self, table: Table, address: int, values: list[int]) -> None:
        self._program.ask(set=[table, address, values])

    def got(self, table: Table, address: int, count: int) -> list[int]:
        return list(map(int, self._program.ask(get=[table, address, count])))


async def answers_our_link(slave: Slave, address: Tcp | SerialLine, outside: int) -> None:
    """All eight functions; ``outside`` is an address that it has not."""
    link = ModbusLink(address, 1, SILENCE_S, 0.0, {})
    await link.connect()
    try:
        for table, values in (("coil", [1, 0, 1]), ("discrete", [0, 1, 1]), ("input", [65535, 0, 258])):
            slave.put(table, 17, values)  # type: ignore[arg-type]
            assert await link.read(table, 17, 3) == values  # type: ignore[arg-type]
        long = [(257 * k) & 0xFFFF for k in range(120)]
        slave.put("holding", 3, long)
        assert await link.read("holding", 3, 120) == long
        await link.write("holding", 1, [40_000], many=False)
        await link.write("holding", 3, [1, 2, 65_535], many=True)
        await link.write("coil", 4, [1], many=False)
        await link.write("coil", 5, [1, 0, 1, 1, 0, 0, 0, 0, 1], many=True)
        assert slave.got("holding", 1, 5)[::2] == [40_000, 1, 65_535]
        assert slave.got("coil", 4, 10) == [1, 1, 0, 1, 1, 0, 0, 0, 0, 1]
        with pytest.raises(DeviceRefused, match="exception 2, address not known"):
            await link.read("holding", outside, 1)
        with pytest.raises(DeviceRefused, match="exception 2, address not known"):
            await link.write("holding", outside, [1], many=False)
        assert await link.read("holding", 1, 1) == [40_000], "the link is as good as before"
    finally:
        await link.disconnect()


async def is_a_voice_coil_to_us(slave: Slave, address: Tcp | SerialLine) -> None:
    """With what its registers say of one, by the shipped profile."""
    words = [ord(a) << 8 | ord(b) for a, b in zip("OTHERS\0\0"[::2], "OTHERS\0\0"[1::2], strict=True)]
    slave.put("input", 0, [2, 0xFFFB, 1200, 5000, 0, 0])
    slave.put("input", 100, words)
    wire = ModbusWire(shipped("voice_coil_modbus"), address, SILENCE_S)
    await wire.connect()
    try:
        values = await wire.read(["state", "force", "set_point", "position", "vendor"])
        assert {name: values[name] for name in ("force", "set_point", "position", "vendor")} == {
            "force": -0.05, "set_point": 12.0, "position": 5.0, "vendor": "OTHERS",
        }  # fmt: skip
        await wire.order("force", 12.34)
        await wire.order("engage")
        await wire.order("watchdog", 500.0)
        await wire.order("heartbeat")
        assert slave.got("holding", 0, 4) == [1, 1234, 500, 1]
    finally:
        await wire.disconnect()


async def is_a_plc_to_us(slave: Slave, address: Tcp) -> None:
    """Require that the driver works with the slave as a PLC, with the shipped profile plc-modbus."""
    slave.put("input", 0, [3, 1, 4464, 0, 9, 77, 0xC029, 0x4000, 0, 0, *[0] * 8, 100])
    slave.put("discrete", 0, [1, 0])
    link = Modbus(address, PLC.variables, SILENCE_S)
    try:
        await link.open()
        values = (await link.read()).values
        seen = {name: values[name] for name in ("line", "state", "clock", "feed_hold", "in_motion", "feed_override")}
        assert seen == {
            "line": 70_000, "state": 3, "clock": -12.625, "feed_hold": True, "in_motion": False, "feed_override": 100,
        }  # fmt: skip
        await link.write({"hold": False, "start": True, "heartbeat": 41})
        assert slave.got("coil", 0, 4) == [1, 0, 0, 0]
        assert slave.got("holding", 0, 1) == [41]
    finally:
        await link.close()


@contextmanager
def serial_cable() -> Iterator[tuple[int, int, str, str]]:
    """Two pseudo-terminals: their far ends, and the paths of the near ones."""
    ends = [os.openpty() for _ in range(2)]
    for _, near in ends:
        tty.setraw(near)
    try:
        yield ends[0][0], ends[1][0], os.ttyname(ends[0][1]), os.ttyname(ends[1][1])
    finally:
        for far, near in ends:
            os.close(far)
            os.close(near)


@asynccontextmanager
async def pumped(one: int, other: int) -> AsyncIterator[None]:
    """What comes out of one goes into the other."""
    loop = asyncio.get_running_loop()
    for source, sink in ((one, other), (other, one)):
        loop.add_reader(source, lambda source=source, sink=sink: os.write(sink, os.read(source, 4096)))  # type: ignore[misc]
    try:
        yield
    finally:
        loop.remove_reader(one)
        loop.remove_reader(other)
