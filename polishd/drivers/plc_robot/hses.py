"""Variables over Yaskawa's High-Speed Ethernet Server (HSES, UDP port 10040), which every DX200 and YRC1000 has.

Sources: layout of frames, commands and error codes as Yaskawa's manuals of the function (178942-1CD, 160766-1CD) state
them, by way of the public client moto-hses; widths of writes and the attribute of the job select as the public client
YaskawaRobot (Palatis) sends them to a controller. Nothing here was tried on a controller.
"""

from __future__ import annotations

import asyncio
import math
import re
import struct
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import Literal

from polishd.api import ConfigError, DeviceIdentity, DeviceRefused, LinkError, ProtocolError
from polishd.config.controller_profile import Kind, Value, Variable, VariablesTable
from polishd.drivers.plc_robot.variables import VariableSnapshot, of_kind, watched, written
from polishd.drivers.transport.address import Tcp
from polishd.drivers.transport.claims import claim_address
from polishd.util.address_claims import Claim

# Frames: a request and its answer are a datagram each. Sans-IO.

_HEAD = struct.Struct("<4sHHBBBBI8s")
_REQUEST = struct.Struct("<HHBBH")
_ANSWER = struct.Struct("<BBBBHH")
HEAD_BYTES = _HEAD.size + _REQUEST.size
MAGIC, RESERVED, CONTROL = b"YERC", b"99999999", 1
GET_ALL, SET_ALL, GET, SET = 0x01, 0x02, 0x0E, 0x10
ANSWERS = 0x80
"""Added to the service in the answer."""
REASONS = {
    0x2010: "it moves", 0x2020: "hold at the pendant", 0x2030: "hold at the panel", 0x2040: "external hold",
    0x2050: "hold by a command", 0x2060: "alarm or error", 0x2070: "the servo power is off", 0x2080: "wrong mode",
    0x2090: "a file is in use", 0x2100: "command remote is off", 0x2110: "no access", 0x2130: "a job is edited",
    0x4040: "no such job", 0x4060: "no job is selected", 0xA000: "unknown command", 0xA001: "unknown number",
    0xA002: "unknown element", 0xB003: "wrong size", 0xB004: "out of range",
}  # fmt: skip
"""Added status codes that an operator can do something about."""
STATUSES = {0x08: "unknown command", 0x09: "unknown element", 0x28: "unknown number"}


@dataclass(frozen=True, slots=True)
class HsesRequest:
    """A request, without the number that its answer repeats."""

    command: int
    instance: int
    attribute: int
    service: int
    data: bytes = b""

    def packed(self, number: int) -> bytes:
        """Return the datagram."""
        head = _HEAD.pack(MAGIC, HEAD_BYTES, len(self.data), 3, CONTROL, 0, number, 0, RESERVED)
        return head + _REQUEST.pack(self.command, self.instance, self.attribute, self.service, 0) + self.data


@dataclass(frozen=True, slots=True)
class HsesAnswer:
    """An answer."""

    number: int
    service: int
    status: int
    added: int
    data: bytes

    @property
    def refusal(self) -> str:
        """Why the controller refuses; empty if it does not."""
        if not self.status:
            return ""
        reason = REASONS.get(self.added) or STATUSES.get(self.status) or "see its manual"
        return f"{reason} (status {self.status:#04x}, added status {self.added:#06x})"


def answer_of(datagram: bytes) -> HsesAnswer | None:
    """Return the answer in a datagram, None if it has none."""
    if len(datagram) < HEAD_BYTES:
        return None
    magic, head, size, _, division, ack, number, _, _ = _HEAD.unpack_from(datagram)
    service, status, words, _, added, _ = _ANSWER.unpack_from(datagram, _HEAD.size)
    data = datagram[HEAD_BYTES:]
    if (magic, head, division, ack) != (MAGIC, HEAD_BYTES, CONTROL, 1) or size != len(data) or not service & ANSWERS:
        return None
    return HsesAnswer(number, service & ~ANSWERS, status, added if words else 0, data)


# What a profile can name: variables of the controller by letter and number, values of its status, and orders.


@dataclass(frozen=True, slots=True)
class Letter:
    """A kind of variables in the controller."""

    command: int
    form: str
    kinds: tuple[Kind, ...]


LETTERS = {
    "B": Letter(0x7A, "<B", ("bool", "int16", "uint16")),
    "I": Letter(0x7B, "<h", ("bool", "int16")),
    "D": Letter(0x7C, "<i", ("bool", "int32")),
    "R": Letter(0x7D, "<f", ("float", "double")),
    "S": Letter(0x8C, "<32s", ("string",)),
}
"""S: the command for 32 characters; a DX100 has only the one for 16."""
MOST_TEXT = 32
_WHOLE: tuple[Kind, ...] = ("int16", "uint16", "int32", "uint32")
_FLAG: tuple[Kind, ...] = ("bool",)
_TEXT: tuple[Kind, ...] = ("string",)
STATUS_VALUES: Mapping[str, tuple[Kind, ...]] = {
    "status.state": _TEXT, "status.running": _FLAG, "status.held": _FLAG, "status.held_by_command": _FLAG,
    "status.alarm": _FLAG, "status.error": _FLAG, "status.teach": _FLAG, "status.remote": _FLAG,
    "status.servo_on": _FLAG, "job.name": _TEXT, "job.line": _WHOLE, "job.step": _WHOLE, "job.override": _WHOLE,
    "alarm.code": _WHOLE, "alarm.text": _TEXT, "position.moves": _FLAG,
}  # fmt: skip
ORDERS: Mapping[str, tuple[Kind, ...]] = {"hold": _FLAG, "start": _FLAG, "reset": _FLAG, "select": _TEXT}
_NUMBERED = re.compile(r"([BIDRS])(\d{1,3})")
ENDING = ".JBI"
"""Ending of a job's file; the controller names the job without it."""
MOST_NAME = 32


@dataclass(frozen=True, slots=True)
class HsesVariable:
    """A variable such as D010."""

    address: str
    kind: Kind

    @property
    def letter(self) -> Letter:
        """Return its kind in the controller."""
        return LETTERS[self.address[0]]

    @property
    def number(self) -> int:
        """Return its number in the controller."""
        return int(self.address[1:])

    @property
    def read(self) -> HsesRequest:
        """Return the request for its value."""
        return HsesRequest(self.letter.command, self.number, 1, GET)

    def value(self, data: bytes) -> Value | None:
        """Return the value in an answer, whose data may fill 32 bits; None if it is too short."""
        size = struct.calcsize(self.letter.form)
        if len(data) < size and self.kind != "string":
            return None
        found: bytes | int | float = struct.unpack(self.letter.form, data[:size].ljust(size, b"\0"))[0]
        return _text(found) if isinstance(found, bytes) else found

    def write(self, value: Value) -> HsesRequest:
        """Return the request that sets it. ProtocolError if the value does not fit."""
        raw = value.encode("latin-1", "replace") if isinstance(value, str) else value
        if isinstance(raw, bytes) and len(raw) > MOST_TEXT:  # struct.pack would cut it
            raise ProtocolError(f"{value!r} does not fit into {self.address}: at most {MOST_TEXT} characters")
        try:
            data = struct.pack(self.letter.form, raw)
        except (struct.error, OverflowError) as error:
            raise ProtocolError(f"{value!r} does not fit into {self.address}: {error}") from error
        return HsesRequest(self.letter.command, self.number, 1, SET, data)


HsesPlace = HsesVariable | str
"""A variable, or the name of a value of the status or of an order."""


def place(name: str, variable: Variable, role: Literal["read", "written"]) -> HsesPlace:
    """Return what an address names. ConfigError if it names nothing, or something of another type."""
    address = variable.address
    known = STATUS_VALUES if role == "read" else ORDERS
    found: HsesPlace = address
    if numbered := _NUMBERED.fullmatch(address):
        kinds, found = LETTERS[numbered[1]].kinds, HsesVariable(address, variable.type)
    elif address in known:
        kinds = known[address]
    else:
        raise ConfigError(
            f"variables.{name}.address {address!r}: write B010, I010, D010, R010, S010, or one of {', '.join(known)}"
        )
    if variable.type not in kinds:
        raise ConfigError(f"variables.{name}.type {variable.type!r}: {address} is one of {', '.join(kinds)}")
    if role == "written" and address[0] == "B" and variable.type != "bool":  # the heartbeat counts to 32767
        raise ConfigError(f"variables.{name}.address {address!r}: B holds 0 to 255, write an I or D variable")
    return found


# Values of the status, from the data of the controller's status, executing job, alarm and position.

ONE_CYCLE, RUNNING, TEACH, REMOTE = 0x02, 0x08, 0x20, 0x80
"""Bits of the first word of the status, ..."""
HELD, HELD_BY_COMMAND, ALARM, ERROR, SERVO_ON = 0x06, 0x08, 0x10, 0x20, 0x40
"""... and of the second. HELD: at the pendant, or by the external signal."""
STATUS, JOB = HsesRequest(0x72, 1, 0, GET_ALL), HsesRequest(0x73, 1, 0, GET_ALL)
ALARM_DATA, POSITION = HsesRequest(0x70, 1, 0, GET_ALL), HsesRequest(0x75, 101, 0, GET_ALL)
SYSTEM = HsesRequest(0x89, 11, 0, GET_ALL)
_STATUS, _JOB, _ALARM = struct.Struct("<II"), struct.Struct("<32sIII"), struct.Struct("<III16s32s")
_POSITION, _SYSTEM = struct.Struct("<5I8i"), struct.Struct("<24s16s8s")
STANDS_UNITS = 5
"""Change of an axis within ``STANDS_S`` that is none: um, or 0.0001 deg."""
STANDS_S = 0.2
"""Longer than a controller takes to update its position, and than most intervals of readings."""


class Standstill:
    """Whether the axes move, from their positions: down to 25 um/s, however often they are read."""

    def __init__(self) -> None:
        self._axes: tuple[int, ...] | None = None
        self._moved_s = -math.inf

    def moves(self, now_s: float, axes: tuple[int, ...]) -> bool:
        """Return whether an axis has changed within the last ``STANDS_S``. False for the first position."""
        if self._axes is None:
            self._axes = axes
        elif any(abs(now - was) > STANDS_UNITS for now, was in zip(axes, self._axes, strict=True)):
            self._axes, self._moved_s = axes, now_s
        return now_s - self._moved_s < STANDS_S


def status_values(status: bytes, job: bytes, alarm: bytes = b"", *, moves: bool = False) -> dict[str, Value]:
    """Return the value of each of ``STATUS_VALUES``. ``alarm``: empty without one.

    ``status.state`` is ``fault`` (no job could run as written, see ``alarm.text``), ``running``, ``top`` (stands at
    line 0: selected, or ended) or ``stopped``.
    """
    one, two = _STATUS.unpack(status)
    name, line, step, override = _JOB.unpack(job)
    job_name = _text(name)
    code, _, _, _, text = _ALARM.unpack(alarm) if alarm else (0, 0, 0, b"", b"")
    if two & (ALARM | ERROR):
        why = f"{'alarm' if two & ALARM else 'error'} {code}: {_text(text)}"
    elif one & TEACH or not one & REMOTE:
        why = "the mode is teach" if one & TEACH else "command remote is off"
    elif not two & SERVO_ON:
        why = "the servo power is off"
    else:
        why = "" if one & ONE_CYCLE else "the cycle is not 1 CYCLE: the job would begin again at its end"
    state = "fault" if why else "running" if one & RUNNING else "stopped" if line else "top"
    return {
        "status.state": state, "status.running": bool(one & RUNNING), "status.held": bool(two & HELD),
        "status.held_by_command": bool(two & HELD_BY_COMMAND), "status.alarm": bool(two & ALARM),
        "status.error": bool(two & ERROR), "status.teach": bool(one & TEACH), "status.remote": bool(one & REMOTE),
        "status.servo_on": bool(two & SERVO_ON), "job.name": job_name and job_name + ENDING, "job.line": line,
        "job.step": step, "job.override": override, "alarm.code": code, "alarm.text": why, "position.moves": moves,
    }  # fmt: skip


def _text(raw: bytes) -> str:
    return raw.partition(b"\0")[0].decode("latin-1").strip()


def order_of(name: str, value: Value) -> list[HsesRequest]:
    """Return the requests of an order. ProtocolError for a name that is none of a job."""
    if name == "select":
        job = PurePosixPath(str(value).replace("\\", "/")).name
        job = job[: -len(ENDING)] if job.upper().endswith(ENDING) else job
        raw = job.encode("ascii", "replace")
        if not 0 < len(raw) <= MOST_NAME or b"?" in raw:
            raise ProtocolError(f"{value!r} is no name of a job: write up to {MOST_NAME} letters of ASCII")
        return [HsesRequest(0x87, 1, 0, SET_ALL, raw.ljust(MOST_NAME, b"\0") + struct.pack("<I", 0))]
    if name == "hold":
        return [_set(0x83, 1, 1 if value else 2)]
    if not value:
        return []
    return [_set(0x86, 1, 1)] if name == "start" else [_set(0x82, 1, 1), _set(0x82, 2, 1)]


def _set(command: int, instance: int, value: int) -> HsesRequest:
    return HsesRequest(command, instance, 1, SET, struct.pack("<I", value))


# The link. A datagram may be lost, repeated or late.


class _Datagrams(asyncio.DatagramProtocol):
    def __init__(self, link: Hses) -> None:
        self._link = link

    def datagram_received(self, data: bytes, _addr: object) -> None:
        self._link.received(data)

    def error_received(self, exc: Exception) -> None:
        self._link.failed(exc)


class Hses:
    """Variables of the controller at ``host:port``. This computer's clock times the readings.

    One request is under way at a time. Without an answer a reading is asked for again until ``silence_s`` is over, and
    so is what may be sent twice: hold on, and the value of a variable. Any other order is sent once: a job that ran to
    its next pause and got a second start would pass the pause. Answers to other requests are dropped.
    """

    def __init__(self, address: Tcp, table: VariablesTable, silence_s: float, again_s: float) -> None:
        """``again_s``: time without an answer after which it is asked again. ConfigError for an invalid address."""
        self._name = f"hses://{address.host}:{address.port}"
        self._address, self._silence_s, self._again_s = address, silence_s, again_s
        self._watched = watched(table)
        self._places = {name: place(name, point, "read") for name, point in self._watched.items()}
        self._written = written(table)
        self._orders = {name: place(name, point, "written") for name, point in self._written.items()}
        self._transport: asyncio.DatagramTransport | None = None
        self._turn = asyncio.Lock()
        self._number = 0
        self._asked: dict[int, float] = {}
        """Numbers of the request under way, each with the time at which it was sent."""
        self._answered_s = 0.0
        """Time halfway between the last request and its answer."""
        self._service = 0
        self._found: asyncio.Future[HsesAnswer] | None = None
        self._standstill = Standstill()
        self._claimed = Claim()

    async def open(self) -> None:
        """See Variables."""
        await self.close()
        self._claimed = await claim_address(self._address, part="hses")
        try:
            await self._connect()
            for spot in self._orders.values():
                if isinstance(spot, HsesVariable):
                    await self._data(spot.read, f"read {spot.address}")
            await self.read()
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        """See Variables."""
        transport, self._transport = self._transport, None
        self._standstill = Standstill()
        if transport is not None:
            transport.close()
        self.failed(ConnectionError("the link is closed"))
        self._claimed.release()

    async def identify(self) -> DeviceIdentity:
        """See Variables. HSES reports no serial number and no start."""
        version, model, _ = _SYSTEM.unpack(await self._data(SYSTEM, "read its system", _SYSTEM.size))
        return DeviceIdentity("Yaskawa", _text(model), self._name, _text(version))

    async def read(self) -> VariableSnapshot:
        """See Variables. The time is that of the line; the status is read after it."""
        spots = [spot for spot in self._places.values() if isinstance(spot, HsesVariable)]
        variables = {spot: spot.value(await self._data(spot.read, f"read {spot.address}")) for spot in spots}
        found, line_s = await self._read_status()
        values = {}
        for name, spot in self._places.items():
            value = variables[spot] if isinstance(spot, HsesVariable) else found[spot]
            values[name] = of_kind(self._watched[name].type, value, name)
        return VariableSnapshot(line_s, values)

    async def write(self, values: Mapping[str, Value]) -> None:
        """See Variables. DeviceRefused if the controller refuses an order."""
        for name, value in values.items():
            typed, spot = of_kind(self._written[name].type, value, name), self._orders[name]
            if isinstance(spot, HsesVariable):
                answer = await self._ask(spot.write(typed), again=True)
                if answer.refusal:
                    raise ProtocolError(f"{self._name}: {name} cannot be written: {answer.refusal}")
                continue
            for request in order_of(spot, typed):
                if spot == "hold" and typed:
                    refusal = await self._hold(request)
                else:
                    refusal = (await self._ask(request, again=False)).refusal
                if refusal and spot != "reset":  # what a reset leaves, the state shows
                    raise DeviceRefused(f"{self._name}: the controller refuses {spot}: {refusal}")

    def received(self, datagram: bytes) -> None:
        """Process a datagram."""
        answer = answer_of(datagram)
        if answer is None or self._found is None or self._found.done():
            return
        if answer.number in self._asked and answer.service == self._service:
            self._answered_s = (self._asked[answer.number] + time.monotonic()) / 2
            self._found.set_result(answer)

    def failed(self, error: Exception) -> None:
        """Process an error of the socket: the computer answers that nothing listens there."""
        if self._found is not None and not self._found.done():
            self._found.set_exception(error)

    async def _connect(self) -> None:
        loop, where = asyncio.get_running_loop(), (self._address.host, self._address.port)
        try:
            async with asyncio.timeout(self._silence_s):
                self._transport, _ = await loop.create_datagram_endpoint(lambda: _Datagrams(self), remote_addr=where)
        except OSError as error:  # TimeoutError is one
            raise LinkError(f"{self._name}: cannot be opened: {error}") from error

    async def _read_status(self) -> tuple[dict[str, Value], float]:
        """Return the values of the status, and the time of the line."""
        job = await self._data(JOB, "read the job", _JOB.size)
        line_s = self._answered_s
        status = await self._data(STATUS, "read the status", _STATUS.size)
        is_alarm = bool(_STATUS.unpack(status)[1] & (ALARM | ERROR))
        alarm = await self._data(ALARM_DATA, "read the alarm", _ALARM.size) if is_alarm else b""
        moves = False
        if "position.moves" in self._places.values():
            axes = _POSITION.unpack(await self._data(POSITION, "read the position", _POSITION.size))[5:]
            moves = self._standstill.moves(self._answered_s, axes)
        return status_values(status, job, alarm, moves=moves), line_s

    async def _hold(self, request: HsesRequest) -> str:
        """Repeat the hold until the controller accepts it or no job runs: with the key turned, it refuses a hold.

        Return the refusal after ``silence_s``, or an empty text.
        """
        end_s = time.monotonic() + self._silence_s
        while refusal := (await self._ask(request, again=True)).refusal:
            status = await self._data(STATUS, "read the status", _STATUS.size)
            if not _STATUS.unpack(status)[0] & RUNNING:
                return ""
            if time.monotonic() > end_s:
                return refusal
            await asyncio.sleep(self._again_s)
        return ""

    async def _data(self, request: HsesRequest, what: str, size: int | None = None) -> bytes:
        """Return the data of a reading, of that size if given."""
        answer = await self._ask(request, again=True)
        if answer.refusal:
            raise ProtocolError(
                f"{self._name}: the controller refuses to {what} (command {request.command:#04x}): {answer.refusal}. "
                "Check the addresses in the profile."
            )
        if size is not None and len(answer.data) != size:
            raise ProtocolError(
                f"{self._name}: {len(answer.data)} of {size} bytes received to {what}. Check the server."
            )
        return answer.data

    async def _ask(self, request: HsesRequest, *, again: bool) -> HsesAnswer:
        async with self._turn:
            loop = asyncio.get_running_loop()
            end_s, self._service = loop.time() + self._silence_s, request.service
            self._found = loop.create_future()
            try:
                while (left_s := end_s - loop.time()) > 0.0:
                    self._send(request)
                    done, _ = await asyncio.wait({self._found}, timeout=min(self._again_s, left_s) if again else left_s)
                    if done:
                        return self._found.result()
                why = f"does not answer within {self._silence_s:g} s"
            except OSError as error:
                why = f"does not answer: {error}"
            finally:
                self._found = None
                self._asked.clear()
        await self.close()
        unknown = "" if again else f"; whether command {request.command:#04x} was executed is unknown"
        raise LinkError(f"{self._name}: {why}{unknown}")

    def _send(self, request: HsesRequest) -> None:
        if self._transport is None:
            raise LinkError(f"{self._name}: is not open")
        self._number = (self._number + 1) & 0xFF
        self._asked[self._number] = time.monotonic()
        self._transport.sendto(request.packed(self._number))
