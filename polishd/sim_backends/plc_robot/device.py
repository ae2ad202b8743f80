"""The process of the PLC: its variables over ADS, Modbus TCP, OPC UA and HSES, its cycle, and reports to the plant.

Over ADS: AMS/TCP frames, symbols by name, and sums of reads and writes.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import signal
import struct
import time
import zlib
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from datetime import UTC
from functools import partial
from pathlib import Path

from asyncua import Server, ua
from asyncua.server.address_space import NodeData

from polishd.config.simulator_devices import SimRobotSection
from polishd.config.simulator_faults import MOTION
from polishd.sim_backends.common.registry import SimDevice
from polishd.sim_backends.common.runtime import LOOPBACK, SimRuntime
from polishd.sim_backends.common.wire import FaultyLink, Feed, SimTcpConnection, SimWire
from polishd.sim_backends.plc_robot.controller import Plc, Value
from polishd.sim_backends.plc_robot.hses import HsesServer, open_udp
from polishd.sim_backends.robot.motion import SimRobotBody

TCP_PORT = 48898
AMS_PORT = 851
PREFIX = "GVL_polishd."
NAME = b"polishd sim PLC"
_TCP = struct.Struct("<HI")
_AMS = struct.Struct("<6sH6sHHHIII")
_SYMBOL = struct.Struct("<IIIIIIHHH")
DEVICE_INFO, READ, WRITE, STATE, READ_WRITE = 1, 2, 3, 4, 9
INFO_BY_NAME, SUM_READ, SUM_WRITE, DATA = 0xF009, 0xF080, 0xF081, 0x4040
OK, NO_SERVICE, NO_GROUP, BAD_SIZE, NO_SYMBOL = 0, 0x701, 0x702, 0x705, 0x710
RESPONSE = 0x0005
STRING_BYTES = 256
ADS_TYPES: dict[str, tuple[str, int, str]] = {
    "bool": ("BOOL", 33, "?"),
    "uint16": ("UINT", 18, "<H"),
    "uint32": ("UDINT", 19, "<I"),
    "double": ("LREAL", 5, "<d"),
    "string": (f"STRING({STRING_BYTES - 1})", 30, ""),
}
"""Name in the PLC, number of the type, and packing."""
KINDS = {
    "start": "bool", "hold": "bool", "reset": "bool", "load": "bool", "program": "string", "heartbeat": "uint32",
    "state": "uint16", "line": "uint32", "line_began": "double", "state_began": "double", "clock": "double",
    "loaded": "string", "feed_override": "double", "feed_hold": "bool", "in_motion": "bool", "alarm": "uint32",
    "alarm_text": "string", "controller_heartbeat": "uint32", "session": "string",
}  # fmt: skip
_NAMES = list(KINDS)


@dataclass(slots=True)
class AdsServer:
    """Answer on any number of connections."""

    plc: Plc

    def connected(self, outlet: FaultyLink) -> Feed:
        """Return the receiver of a client's bytes."""
        rest = b""

        def feed(data: bytes) -> None:
            nonlocal rest
            rest += data
            while len(rest) >= _TCP.size:
                _, length = _TCP.unpack_from(rest)
                if len(rest) < _TCP.size + length:
                    return
                frame, rest = rest[_TCP.size : _TCP.size + length], rest[_TCP.size + length :]
                if len(frame) >= _AMS.size:
                    outlet.send(self._answer(frame))

        return feed

    def _answer(self, frame: bytes) -> bytes:
        target, target_port, source, source_port, command, _, _, _, invoke = _AMS.unpack_from(frame)
        body = self._command(command, frame[_AMS.size :])
        head = _AMS.pack(source, source_port, target, target_port, command, RESPONSE, len(body), 0, invoke)
        return _TCP.pack(0, len(head) + len(body)) + head + body

    def _command(self, command: int, data: bytes) -> bytes:
        if command == DEVICE_INFO:
            return struct.pack("<IBBH16s", OK, 3, 1, 4024, NAME)
        if command == STATE:
            return struct.pack("<IHH", OK, 5, 0)
        if command == READ and len(data) == 12:
            return _with_length(*self._read(*struct.unpack("<III", data)))
        if command == WRITE and len(data) >= 12:
            group, offset, _ = struct.unpack_from("<III", data)
            return struct.pack("<I", self._write(group, offset, data[12:]))
        if command == READ_WRITE and len(data) >= 16:
            group, offset, _, _ = struct.unpack_from("<IIII", data)
            return _with_length(*self._read_write(group, offset, data[16:]))
        return struct.pack("<I", NO_SERVICE)

    def _read_write(self, group: int, offset: int, data: bytes) -> tuple[int, bytes]:
        if group == INFO_BY_NAME:
            return self._symbol(data.rstrip(b"\0").decode("utf-8", "replace"))
        if group == SUM_READ:
            requests = list(struct.iter_unpack("<III", data[: 12 * offset]))
            found = [self._read(*one) for one in requests]
            errors = struct.pack(f"<{len(found)}I", *(error for error, _ in found))
            sized = (value.ljust(size, b"\0") for (_, value), (_, _, size) in zip(found, requests, strict=True))
            return OK, errors + b"".join(sized)
        if group == SUM_WRITE:
            requests = list(struct.iter_unpack("<III", data[: 12 * offset]))
            at, results = 12 * offset, b""
            for one_group, one_offset, size in requests:
                results += struct.pack("<I", self._write(one_group, one_offset, data[at : at + size]))
                at += size
            return OK, results
        return NO_GROUP, b""

    def _symbol(self, symbol: str) -> tuple[int, bytes]:
        name = symbol.removeprefix(PREFIX)
        if not symbol.startswith(PREFIX) or name not in KINDS:
            return NO_SYMBOL, b""
        plc_type, number, _ = ADS_TYPES[KINDS[name]]
        texts = b"".join(text.encode() + b"\0" for text in (symbol, plc_type, ""))
        at = _NAMES.index(name) * STRING_BYTES
        lengths = (len(symbol), len(plc_type), 0)
        return OK, _SYMBOL.pack(_SYMBOL.size + len(texts), DATA, at, _size(name), number, 0, *lengths) + texts

    def _read(self, group: int, offset: int, size: int) -> tuple[int, bytes]:
        name = _at(group, offset)
        if not name:
            return NO_GROUP, b""
        if size != _size(name):
            return BAD_SIZE, b""
        value = self.plc.inputs[name] if name in self.plc.inputs else self.plc.shown[name]
        return OK, _packed(name, value)

    def _write(self, group: int, offset: int, data: bytes) -> int:
        name = _at(group, offset)
        if name not in self.plc.inputs:
            return NO_GROUP
        if len(data) != _size(name):
            return BAD_SIZE
        self.plc.inputs[name] = _unpacked(name, data)
        return OK


def _at(group: int, offset: int) -> str:
    number, within = divmod(offset, STRING_BYTES)
    return _NAMES[number] if group == DATA and not within and number < len(_NAMES) else ""


def _size(name: str) -> int:
    form = ADS_TYPES[KINDS[name]][2]
    return struct.calcsize(form) if form else STRING_BYTES


def _packed(name: str, value: Value) -> bytes:
    form = ADS_TYPES[KINDS[name]][2]
    if not form:
        return str(value).encode()[: STRING_BYTES - 1].ljust(STRING_BYTES, b"\0")
    return struct.pack(form, value)


def _unpacked(name: str, data: bytes) -> Value:
    form = ADS_TYPES[KINDS[name]][2]
    if not form:
        return data.partition(b"\0")[0].decode("utf-8", "replace")
    value: Value = struct.unpack(form, data)[0]
    return value


def _with_length(error: int, data: bytes) -> bytes:
    return struct.pack("<II", error, len(data)) + data


# The PLC's variables over Modbus TCP: bits and registers, one request at a time.

_HEAD = struct.Struct(">HHHB")
COILS = ("start", "hold", "reset", "load")
DISCRETES = ("feed_hold", "in_motion")
ILLEGAL_FUNCTION, ILLEGAL_ADDRESS, ILLEGAL_VALUE = 1, 2, 3
FILE = "polishd.nc"
"""File that it loads: a register holds no name."""


@dataclass(slots=True)
class ModbusServer:
    """Answer on any number of connections."""

    plc: Plc

    def connected(self, outlet: FaultyLink) -> Feed:
        """Return the receiver of a client's bytes."""
        self.plc.inputs["program"] = FILE
        rest = b""

        def feed(data: bytes) -> None:
            nonlocal rest
            rest += data
            while len(rest) >= _HEAD.size:
                number, _, length, unit = _HEAD.unpack_from(rest)
                if length < 2 or len(rest) < 6 + length:
                    return
                pdu, rest = rest[_HEAD.size : 6 + length], rest[6 + length :]
                answer = self.answer(pdu)
                outlet.send(_HEAD.pack(number, 0, 1 + len(answer), unit) + answer)

        return feed

    def answer(self, pdu: bytes) -> bytes:
        """Return the answer to a request PDU."""
        function = pdu[0]
        if function not in {1, 2, 3, 4, 5, 6, 15, 16}:
            return bytes([function | 0x80, ILLEGAL_FUNCTION])
        if len(pdu) < 5 or (function > 6 and (len(pdu) < 6 or len(pdu) != 6 + pdu[5])):
            return bytes([function | 0x80, ILLEGAL_VALUE])
        address, number = struct.unpack_from(">HH", pdu, 1)
        if function == 5 and number not in {0, 0xFF00}:
            return bytes([function | 0x80, ILLEGAL_VALUE])
        read = {1: self._bits, 2: self._bits, 3: self._holding, 4: self._registers}.get(function)
        if read is not None:
            found = read(function, address, number)
            return bytes([function | 0x80, ILLEGAL_ADDRESS]) if found is None else bytes([function, len(found)]) + found
        if function in {5, 15}:
            many = [bool(pdu[6 + at // 8] >> at % 8 & 1) for at in range(min(number, 8 * (len(pdu) - 6)))]
            taken = self._coils(address, many if function == 15 else [number == 0xFF00])
        else:
            taken = self._heartbeat(address, pdu[6:] if function == 16 else pdu[3:])
        return pdu[:5] if taken else bytes([function | 0x80, ILLEGAL_ADDRESS])

    def _bits(self, function: int, address: int, count: int) -> bytes | None:
        names = COILS if function == 1 else DISCRETES
        values = self.plc.inputs if function == 1 else self.plc.shown
        if not count or address + count > len(names):
            return None
        return bytes([sum(bool(values[name]) << k for k, name in enumerate(names[address : address + count]))])

    def _registers(self, _function: int, address: int, count: int) -> bytes | None:
        shown = self.plc.shown
        table = struct.pack(
            ">HIHHHdddH",
            shown["state"],
            shown["line"],
            shown["alarm"],
            int(shown["controller_heartbeat"]) & 0xFFFF,
            zlib.crc32(str(shown["session"]).encode()) & 0xFFFF,
            shown["clock"],
            shown["line_began"],
            shown["state_began"],
            round(float(shown["feed_override"])),
        )
        found = table[2 * address : 2 * (address + count)]
        return found if count and len(found) == 2 * count else None

    def _holding(self, _function: int, address: int, count: int) -> bytes | None:
        beat = struct.pack(">H", int(self.plc.inputs["heartbeat"]) & 0xFFFF)
        return beat if (address, count) == (0, 1) else None

    def _coils(self, address: int, values: list[bool]) -> bool:
        names = COILS[address : address + len(values)]
        if not values or len(names) != len(values):
            return False
        self.plc.inputs.update(zip(names, values, strict=True))
        return True

    def _heartbeat(self, address: int, data: bytes) -> bool:
        if address or len(data) != 2:
            return False
        (self.plc.inputs["heartbeat"],) = struct.unpack(">H", data)
        return True


# The PLC's variables over OPC UA: asyncua's server, one node a variable.

NAMESPACE = "urn:polishd:handover"
OPCUA_TYPES = {
    "start": ua.VariantType.Boolean,
    "hold": ua.VariantType.Boolean,
    "reset": ua.VariantType.Boolean,
    "load": ua.VariantType.Boolean,
    "program": ua.VariantType.String,
    "heartbeat": ua.VariantType.UInt32,
    "state": ua.VariantType.UInt16,
    "line": ua.VariantType.UInt32,
    "line_began": ua.VariantType.Double,
    "state_began": ua.VariantType.Double,
    "clock": ua.VariantType.Double,
    "loaded": ua.VariantType.String,
    "feed_override": ua.VariantType.Double,
    "feed_hold": ua.VariantType.Boolean,
    "in_motion": ua.VariantType.Boolean,
    "alarm": ua.VariantType.UInt32,
    "alarm_text": ua.VariantType.String,
    "controller_heartbeat": ua.VariantType.UInt32,
    "session": ua.VariantType.String,
}


@asynccontextmanager
async def served(plc: Plc) -> AsyncIterator[int]:
    """Run the server for the duration of the block; yield its port on loopback."""
    logging.getLogger("asyncua").setLevel(logging.ERROR)
    server = Server()
    await server.init()
    server.set_endpoint(f"opc.tcp://{LOOPBACK}:0")
    server.set_server_name("polishd simulated PLC")
    server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
    index = await server.register_namespace(NAMESPACE)
    space = server.iserver.aspace
    folder = await server.nodes.objects.add_object(index, "polishd")
    for name, kind in OPCUA_TYPES.items():
        value = plc.inputs[name] if name in plc.inputs else plc.shown[name]
        node = await folder.add_variable(ua.NodeId.from_string(f"ns={index};s={name}"), name, value, kind)
        if name in plc.inputs:
            await node.set_writable()
            space.set_attribute_value_setter(node.nodeid, ua.AttributeIds.Value, partial(_take, plc, name))
        else:
            server.set_attribute_value_callback(node.nodeid, partial(_shown, plc, name, kind))
    await server.start()
    try:
        assert server.bserver is not None
        yield server.bserver.port
    finally:
        await server.stop()


def _take(plc: Plc, name: str, node: NodeData, attribute: ua.AttributeIds, value: ua.DataValue) -> ua.DataValue:
    """Take a client's write: the controller sees it in its next cycle."""
    assert value.Value is not None
    node.attributes[attribute].value = value
    plc.inputs[name] = value.Value.Value
    return value


def _shown(plc: Plc, name: str, kind: ua.VariantType, _node: ua.NodeId, _attribute: ua.AttributeIds) -> ua.DataValue:
    """Answer a client's read with the values of the last report."""
    return ua.DataValue(ua.Variant(plc.shown[name], kind), ServerTimestamp=ua.DateTime.now(UTC))


# A faulty link in front of a library's own server: bytes both ways; bytes to the client may be late or damaged.


class Relay:
    """Pass each client's bytes to the server behind, on loopback."""

    def __init__(self, runtime: SimRuntime, port: int) -> None:
        self._runtime = runtime
        self._port = port

    def connected(self, outlet: FaultyLink) -> Feed:
        """Return the receiver of a client's bytes."""
        queue: asyncio.Queue[bytes] = asyncio.Queue()
        task = self._runtime.group.create_task(self._serve(queue, outlet))

        def close() -> None:
            task.cancel()

        outlet.on_closed = close
        return queue.put_nowait

    async def _serve(self, queue: asyncio.Queue[bytes], outlet: FaultyLink) -> None:
        reader, writer = await asyncio.open_connection(LOOPBACK, self._port)
        async with asyncio.TaskGroup() as group:
            forward = group.create_task(self._forward(queue, writer))
            try:
                with contextlib.suppress(ConnectionError):  # the server closes the connection on invalid data
                    while data := await reader.read(1 << 16):
                        outlet.send(data)
            finally:
                forward.cancel()
                writer.close()

    async def _forward(self, queue: asyncio.Queue[bytes], writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(ConnectionError):
            while True:
                writer.write(await queue.get())
                await writer.drain()


# The process: the PLC's cycle, its server, and reports to the plant.

CYCLE_S = 0.01
PROGRAMS = "programs"


class PlcServer:
    """All state of the process."""

    def __init__(self, runtime: SimRuntime, folder: Path) -> None:
        machine = SimRobotBody(runtime)
        robot = runtime.start.config.robot
        self.plc = Plc(robot, machine.motion, folder, machine.reach, machine.event, runtime.boot_id)
        machine.blocks_of = self.plc.blocks_of
        self._machine = machine
        self.plc.tick(time.monotonic())

    async def run(self) -> None:
        """Cycle until cancelled."""
        while True:
            now = time.monotonic()
            self._machine.set_pace(now)
            self.plc.tick(now)
            self._machine.report()
            await asyncio.sleep(CYCLE_S)

    def press(self, button: str) -> None:
        """Do an operator's action at the controller."""
        self.plc.press(button, time.monotonic())


async def main(runtime: SimRuntime) -> None:
    """Run the device."""
    folder = runtime.start.state / PROGRAMS
    folder.mkdir(exist_ok=True)
    server = PlcServer(runtime, folder)
    runtime.button(signal.SIGUSR1, lambda: server.press("emergency stop"), "estop")
    runtime.button(signal.SIGUSR2, lambda: server.press("feed hold"))
    runtime.script.panel["manual"] = lambda: server.press("manual")
    over = {"opcua": _over_opcua, "ads": _over_ads, "modbus": _over_modbus, "hses": _over_hses}
    await over[runtime.start.config.robot.kind](runtime, server)


async def _over_opcua(runtime: SimRuntime, server: PlcServer) -> None:
    robot = runtime.start.config.robot
    async with served(server.plc) as port:
        wire = SimWire(runtime, Relay(runtime, port).connected)
        wire.ready(f"opc.tcp://{await wire.open_tcp(robot.port)}")
        await server.run()


async def _over_modbus(runtime: SimRuntime, server: PlcServer) -> None:
    robot = runtime.start.config.robot
    wire = SimWire(runtime, ModbusServer(server.plc).connected)
    wire.ready(f"tcp://{await wire.open_tcp(robot.port)}")
    await server.run()


async def _over_hses(runtime: SimRuntime, server: PlcServer) -> None:
    server.plc.goes_on = False  # after a hold a job stands until the next start
    wire = SimWire(runtime, HsesServer(server.plc).connected)
    wire.ready(f"hses://{await open_udp(wire, runtime.start.config.robot.port)}")
    await server.run()


async def _over_ads(runtime: SimRuntime, server: PlcServer) -> None:
    """ADS has one fixed TCP port: the configured port selects a loopback address instead."""
    robot = runtime.start.config.robot
    wire = SimWire(runtime, AdsServer(server.plc).connected)
    high, low = divmod(robot.port, 256)
    host = f"127.{high}.{low}.1"
    loop = asyncio.get_running_loop()
    await loop.create_server(lambda: SimTcpConnection(wire), host, TCP_PORT)
    wire.ready(f"ads://{host}/{host}.1.1:{AMS_PORT}")
    await server.run()


SIM_DEVICES = [
    SimDevice(
        name="plc_robot",
        device="robot",
        section=SimRobotSection,
        links={"opcua": {"": "opcua"}, "ads": {"": "ads"}, "modbus": {"": "modbus_tcp"}, "hses": {"": "hses"}},
        main=main,
        faults=(*MOTION, "estop", "manual"),
    )
]
