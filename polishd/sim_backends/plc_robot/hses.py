"""Yaskawa's High-Speed Ethernet Server of the simulated controller: datagrams in, datagrams out.

Layout and codes as Yaskawa's manuals of the function state them, by way of public clients
(docs/protocols/plc_robot.md).
Readings are those of the controller's last report; an order is answered at once, with the reason of a refusal.
"""

from __future__ import annotations

import asyncio
import math
import struct
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import cast

from polishd.sim_backends.common.runtime import LOOPBACK
from polishd.sim_backends.common.wire import FaultyLink, Feed, SimWire
from polishd.sim_backends.plc_robot.controller import DONE, FAULT, IDLE, READY, RUNNING, Plc
from polishd.sim_backends.plc_robot.language import turned_in_order
from polishd.sim_backends.universal_robots.arm import turned

HEADER = struct.Struct("<4sHHBBBBI8sHHBBH")
ANSWER = struct.Struct("<4sHHBBBBI8sBBBBHH")
LAST_BLOCK = 0x8000_0000
GET_ALL, SET_ALL, GET, SET = 0x01, 0x02, 0x0E, 0x10
UNKNOWN_COMMAND, UNKNOWN_ELEMENT, UNKNOWN_NUMBER, SEE_ADDED = 0x08, 0x09, 0x28, 0x1F
MOVES, PENDANT_HOLD, EXTERNAL_HOLD, COMMAND_HOLD, IN_ALARM, SERVO_OFF, WRONG_MODE = (
    0x2010, 0x2020, 0x2040, 0x2050, 0x2060, 0x2070, 0x2080,
)  # fmt: skip
NO_SUCH_JOB, NO_JOB, WRONG_SIZE, OUT_OF_RANGE = 0x4040, 0x4060, 0xB003, 0xB004
BAD_SIZE_OF_HEADER, BAD_SIZE_OF_DATA = 0xE4A5, 0xE4A7
SIZES = {0x7A: 1, 0x7B: 2, 0x7C: 4, 0x7D: 4, 0x7E: 16, 0x8C: 32}
"""By command: bytes of a variable B, I, D, R, S (16 characters), S (32)."""
OF = {0x7E: 0x8C}
"""Two commands for the same variables."""
VARIABLES = 100
HEARTBEAT = (0x7C, 10)
"""D010."""


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why the controller refuses a request."""

    status: int
    added: int = 0


def refused(added: int) -> Refusal:
    """Return a refusal with its reason."""
    return Refusal(SEE_ADDED, added)


@dataclass(slots=True)
class HsesServer:
    """Answer datagrams of any number of clients."""

    plc: Plc
    now: Callable[[], float] = time.monotonic
    _stored: dict[tuple[int, int], bytes] = field(default_factory=dict)
    """Variables that were written, by command and number."""

    def connected(self, outlet: FaultyLink) -> Feed:
        """Return the receiver of a client's datagrams."""

        def feed(datagram: bytes) -> None:
            if answer := self.answer(datagram):
                outlet.send(answer)

        return feed

    def answer(self, datagram: bytes) -> bytes:
        """Return the answer to a datagram; empty if it is no request."""
        if len(datagram) < HEADER.size or not datagram.startswith(b"YERC"):
            return b""
        _, head, size, _, division, ack, number, _, _, command, instance, attribute, service, _ = HEADER.unpack_from(
            datagram
        )
        if ack or division != 1:
            return b""
        data = datagram[HEADER.size :]
        found: bytes | Refusal
        if head != HEADER.size:
            found = refused(BAD_SIZE_OF_HEADER)
        elif size != len(data):
            found = refused(BAD_SIZE_OF_DATA)
        else:
            found = self._command(command, instance, attribute, service, data)
        why, body = (found, b"") if isinstance(found, Refusal) else (Refusal(0), found)
        shape = (b"YERC", ANSWER.size, len(body), 3, 1, 1, number, LAST_BLOCK, b"99999999")
        return ANSWER.pack(*shape, service | 0x80, why.status, int(bool(why.added)), 0, why.added, 0) + body

    def _command(self, command: int, instance: int, attribute: int, service: int, data: bytes) -> bytes | Refusal:
        if command in SIZES:
            return self._variable(command, instance, service, data)
        if command in RECORDS:
            instances, record = RECORDS[command]
            if instance not in instances:
                return Refusal(UNKNOWN_NUMBER)
            return _elements(record(self, instance), attribute, service)
        order = ORDERS.get(command)
        if order is None:
            return Refusal(UNKNOWN_COMMAND)
        return order(self, instance, service, data) or b""

    # Variables.

    def _variable(self, command: int, number: int, service: int, data: bytes) -> bytes | Refusal:
        size, key = SIZES[command], (OF.get(command, command), number)
        if number >= VARIABLES:
            return Refusal(UNKNOWN_NUMBER)
        if service in {GET, GET_ALL}:
            return self._stored.get(key, b"").ljust(size, b"\0")[:size]
        if service not in {SET, SET_ALL}:
            return Refusal(UNKNOWN_COMMAND)
        # a B or an I comes in its own size or in 32 bits: the manual draws 32, clients send both
        if len(data) not in {size, max(size, 4)}:
            return refused(WRONG_SIZE)
        self._stored[key] = data[:size]
        if key == HEARTBEAT:
            (self.plc.inputs["heartbeat"],) = struct.unpack("<i", data)
        return b""

    # Readings: each a record of elements.

    def _status(self, _instance: int) -> list[bytes]:
        plc, state = self.plc, self.plc.shown["state"]
        stopped = plc.is_emergency_stopped
        one = 0x02 | (0x08 if state == RUNNING else 0) | (0x20 if plc.manual else 0x40 | 0x80)
        two = (0x02 if plc.feed_held else 0) | (0x04 if plc.is_silent(self.now()) else 0)
        two |= (0x08 if plc.inputs["hold"] else 0) | (0x10 if state == FAULT and not stopped else 0)
        return [struct.pack("<I", word) for word in (one, two | (0 if stopped else 0x40))]

    def _job(self, _instance: int) -> list[bytes]:
        shown = self.plc.shown
        line = 0 if shown["state"] in {IDLE, READY, DONE} else int(shown["line"])
        name = str(shown["loaded"]).rpartition(".")[0].encode("latin-1", "replace")
        numbers = (line, self.plc.moves_to(line), round(100.0 * float(shown["feed_override"])))
        return [name.ljust(32, b"\0")[:32], *(struct.pack("<I", number) for number in numbers)]

    def _alarm(self, instance: int) -> list[bytes]:
        shown = self.plc.shown
        has = instance == 1 and shown["state"] == FAULT and not self.plc.is_emergency_stopped
        code, text = (int(shown["alarm"]), str(shown["alarm_text"])) if has else (0, "")
        named = text.encode("latin-1", "replace")[:32].ljust(32, b"\0")
        when = (time.strftime("%Y/%m/%d %H:%M") if has else "").encode().ljust(16, b"\0")
        return [struct.pack("<I", code), struct.pack("<I", 0), struct.pack("<I", int(has)), when, named]

    def _position(self, _instance: int) -> list[bytes]:
        """Base coordinates, in um and 0.0001 deg; the third turn is that about the tool's axis, 0."""
        x, y, z, a, c = self.plc.motion.pose
        # the tool's axis, down at a = 0, as turns about the fixed axes x and y
        down = turned(turned_in_order((2, 0), (c, a)), (0.0, 0.0, -1.0))
        ry = math.degrees(math.asin(max(-1.0, min(1.0, down[0]))))
        rx = math.degrees(math.atan2(-down[1], down[2]))
        axes = (round(1e3 * x), round(1e3 * y), round(1e3 * z), round(1e4 * rx), round(1e4 * ry), 0, 0, 0)
        return [struct.pack("<i", value) for value in (16, 0, 0, 0, 0, *axes)]

    def _system(self, _instance: int) -> list[bytes]:
        return [b"YAS5.40.00A. (JP/US) -00", b"polishd sim".ljust(16, b"\0"), b"12.34".ljust(8, b"\0")]

    # Orders.

    def _unready(self) -> Refusal | None:
        """Refuse what needs an automatic mode and no alarm."""
        if self.plc.manual:
            return refused(WRONG_MODE)
        if self.plc.is_emergency_stopped:
            return refused(SERVO_OFF)
        if self.plc.alarm:
            return refused(IN_ALARM)
        return None

    def _hold_or_servo(self, instance: int, service: int, data: bytes) -> Refusal | None:
        if instance not in {1, 2, 3}:
            return Refusal(UNKNOWN_NUMBER)
        if why := _unlike(service, data, 1, 2):
            return why
        if self.plc.manual:
            return refused(WRONG_MODE)
        if instance == 1:
            self.plc.hold(self.now(), on=data[0] == 1)
        return refused(SERVO_OFF) if instance == 2 and self.plc.is_emergency_stopped else None

    def _reset(self, instance: int, service: int, data: bytes) -> Refusal | None:
        if instance not in {1, 2}:
            return Refusal(UNKNOWN_NUMBER)
        why = _unlike(service, data, 1)
        if instance == 1 and why is None:
            self.plc.cancel_alarm()
        return why

    def _cycle(self, instance: int, service: int, data: bytes) -> Refusal | None:
        """The simulated controller stays at 1 CYCLE."""
        return Refusal(UNKNOWN_NUMBER) if instance != 2 else _unlike(service, data, 2)

    def _start(self, instance: int, service: int, data: bytes) -> Refusal | None:
        if instance != 1:
            return Refusal(UNKNOWN_NUMBER)
        if why := _unlike(service, data, 1) or self._unready():
            return why
        plc = self.plc
        obstacles = (
            (PENDANT_HOLD, plc.feed_held),
            (EXTERNAL_HOLD, plc.is_silent(self.now())),
            (COMMAND_HOLD, bool(plc.inputs["hold"])),
            (MOVES, plc.motion.state == "running"),
            (NO_JOB, plc.program is None),
        )
        if added := next((added for added, is_so in obstacles if is_so), 0):
            return refused(added)
        plc.start(self.now())
        return None

    def _select(self, instance: int, service: int, data: bytes) -> Refusal | None:
        if instance != 1:
            return Refusal(UNKNOWN_NUMBER)
        if service != SET_ALL:
            return Refusal(UNKNOWN_COMMAND)
        if len(data) != 36:
            return refused(WRONG_SIZE)
        if why := self._unready():
            return why
        if self.plc.motion.state == "running":
            return refused(MOVES)
        name = data[:32].partition(b"\0")[0].decode("latin-1")
        if struct.unpack_from("<I", data, 32)[0]:
            return refused(OUT_OF_RANGE)  # a job begins at its top here
        return None if self.plc.select(f"{name}.JBI") else refused(NO_SUCH_JOB)


RECORDS: Mapping[int, tuple[range, Callable[[HsesServer, int], list[bytes]]]] = {
    0x70: (range(1, 5), HsesServer._alarm),
    0x72: (range(1, 2), HsesServer._status),
    0x73: (range(1, 2), HsesServer._job),
    0x75: (range(101, 102), HsesServer._position),
    0x89: (range(11, 12), HsesServer._system),
}
"""By command: its instances, and its record."""
ORDERS: Mapping[int, Callable[[HsesServer, int, int, bytes], Refusal | None]] = {
    0x82: HsesServer._reset,
    0x83: HsesServer._hold_or_servo,
    0x84: HsesServer._cycle,
    0x86: HsesServer._start,
    0x87: HsesServer._select,
}


def _elements(record: Sequence[bytes], attribute: int, service: int) -> bytes | Refusal:
    if service == GET_ALL:
        return b"".join(record)
    if service != GET:
        return Refusal(UNKNOWN_COMMAND)
    if not 1 <= attribute <= len(record):
        return Refusal(UNKNOWN_ELEMENT)
    return record[attribute - 1]


def _unlike(service: int, data: bytes, *numbers: int) -> Refusal | None:
    """Refuse an order whose number is none of these."""
    if service != SET:
        return Refusal(UNKNOWN_COMMAND)
    if len(data) != 4:
        return refused(WRONG_SIZE)
    return None if struct.unpack("<I", data)[0] in numbers else refused(OUT_OF_RANGE)


# Datagrams with the faults of the link: each client has its own two directions.

MOST_CLIENTS = 32


class SimDatagrams(asyncio.DatagramProtocol):
    """The UDP port of a device."""

    def __init__(self, wire: SimWire) -> None:
        self._wire = wire
        self._clients: dict[tuple[str, int], tuple[FaultyLink, list[asyncio.Task[None]]]] = {}

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Remember the port."""
        self._transport = cast("asyncio.DatagramTransport", transport)  # asyncio's own is no subclass

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        """Pass a datagram on; a cable that is pulled loses it."""
        if self._wire.pulled:
            return
        if addr not in self._clients:
            self._meet(addr)
        self._clients[addr] = self._clients.pop(addr)  # the one that has sent nothing for longest is the first
        self._clients[addr][0].send(data)

    def _meet(self, addr: tuple[str, int]) -> None:
        if len(self._clients) >= MOST_CLIENTS:
            _, workers = self._clients.pop(next(iter(self._clients)))
            for worker in workers:
                worker.cancel()
        outlet = self._wire.outlet(lambda data: self._transport.sendto(data, addr), "to_host")
        inlet = self._wire.inlet(outlet)
        group = self._wire.runtime.group
        self._clients[addr] = (inlet, [group.create_task(way.run()) for way in (outlet, inlet)])


async def open_udp(wire: SimWire, port: int) -> str:
    """Open a UDP port on loopback; return ``host:port``."""
    loop = asyncio.get_running_loop()
    transport, _ = await loop.create_datagram_endpoint(lambda: SimDatagrams(wire), local_addr=(LOOPBACK, port))
    return f"{LOOPBACK}:{transport.get_extra_info('sockname')[1]}"
