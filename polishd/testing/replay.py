"""Replay of a recorded link for an unchanged driver: a recording becomes a test of ten lines.

async with replayed(Path("case.wire.jsonl.gz"), "actuator") as link:
    actuator = build(options | {"address": link.endpoint})
    await actuator.open()

A recorded controller that loads files is replayed with its variables and its file delivery:

async with replayed_controller(Path("case.wire.jsonl.gz"), "robot") as plc:
    robot = Handover("PLC", profile, plc.variables, plc)
    await robot.open()
"""

from __future__ import annotations

import asyncio
import json
import os
import tty
from collections import Counter
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from polishd.api import DeviceIdentity, DeviceRefused, LinkError
from polishd.config.controller_profile import Value
from polishd.drivers.plc_robot.variables import DELIVERED, VariableSnapshot
from polishd.drivers.transport import lines as transport_lines
from polishd.model.errors import ConfigError
from polishd.util.wire_recording import Recording, WireMessage, read_recording

# A recorded link as requests and answers. A repeated request gets its last answer.

OWN_ENDS = ("the connection is closed", "the line is closed", "the bus is closed")
"""Ends of a link by the driver; any other end is replayed."""
SHOWN = 48
"""Bytes of a message that an error shows."""


@dataclass
class RecordedExchange:
    """A request (empty at the opening of a link), and the data received until the next one."""

    line: int
    """Line of the recording's file."""
    at_s: float
    out: bytes
    came: list[tuple[float, bytes]] = field(default_factory=list)
    """(seconds since the request, data) of each answer."""
    cut: bool = False
    """Whether the link was lost after it."""


class ReplayDialect(Protocol):
    """Message framing, and the number in a message that changes each time."""

    def cut(self, data: bytes) -> int | None:
        """Return the length of the first message; None while it is incomplete."""
        ...

    def key(self, message: bytes) -> bytes:
        """Return the message without its number."""
        ...

    def answer(self, recorded: bytes, asked: bytes, now: bytes) -> bytes:
        """Return the recorded answer with the number of ``now`` instead of that of ``asked``."""
        ...


class ModbusTcp:
    """Modbus TCP: the number is the transaction's."""

    def cut(self, data: bytes) -> int | None:
        """See ReplayDialect."""
        end = 6 + int.from_bytes(data[4:6]) if len(data) >= 6 else len(data) + 1
        return end if len(data) >= end else None

    def key(self, message: bytes) -> bytes:
        """See ReplayDialect."""
        return message[2:]

    def answer(self, recorded: bytes, asked: bytes, now: bytes) -> bytes:
        """See ReplayDialect."""
        done = b""
        while (end := self.cut(recorded)) is not None:
            frame, recorded = recorded[:end], recorded[end:]
            done += now[:2] + frame[2:] if frame[:2] == asked[:2] else frame
        return done + recorded


class NumberedLinesDialect:
    """Numbered lines: ``$number,body*checksum``."""

    def cut(self, data: bytes) -> int | None:
        """See ReplayDialect."""
        return data.find(b"\n") + 1 or None

    def key(self, message: bytes) -> bytes:
        """See ReplayDialect."""
        found = transport_lines.decode(message.removesuffix(b"\n"))
        return message if found is None else found[1].encode()

    def answer(self, recorded: bytes, asked: bytes, now: bytes) -> bytes:
        """See ReplayDialect."""
        numbers = [transport_lines.decode(one.removesuffix(b"\n")) for one in (asked, now)]
        lines = []
        for line in recorded.splitlines(keepends=True):
            found = transport_lines.decode(line.removesuffix(b"\n"))
            ours = found and numbers[0] and numbers[1] and found[0] == numbers[0][0]
            lines.append(transport_lines.encode(numbers[1][0], found[1]) if ours and found and numbers[1] else line)
        return b"".join(lines)


class UnnumberedDialect:
    """Messages without numbers; the recording gives their ends."""

    def __init__(self, outs: Sequence[bytes]) -> None:
        self._outs = sorted(set(outs), key=len, reverse=True)

    def cut(self, data: bytes) -> int | None:
        """See ReplayDialect."""
        found = next((len(out) for out in self._outs if data.startswith(out)), None)
        if found is None and not any(out.startswith(data) for out in self._outs):
            return len(data)
        return found

    def key(self, message: bytes) -> bytes:
        """See ReplayDialect."""
        return message

    def answer(self, recorded: bytes, asked: bytes, now: bytes) -> bytes:  # noqa: ARG002 -- there is no number
        """See ReplayDialect."""
        return recorded


def exchanges(passed: Sequence[tuple[int, WireMessage]]) -> list[RecordedExchange]:
    """Return the exchanges of one link, with the lines of its records."""
    found: list[RecordedExchange] = []
    for line, one in passed:
        if one.way in ("open", "out") or not found:
            found.append(RecordedExchange(line, one.at_s, one.data if one.way == "out" else b""))
        if one.way == "in":
            found[-1].came.append((one.at_s - found[-1].at_s, one.data))
        elif one.way == "end":
            found[-1].cut = one.why not in OWN_ENDS
    return found


class ReplayScript:
    """Position of a link in its recording."""

    def __init__(
        self,
        name: str,
        found: Sequence[RecordedExchange],
        dialect: ReplayDialect | None = None,
        polls: frozenset[bytes] | None = None,
    ) -> None:
        """``name`` for messages. ``polls``: keys of requests whose number may differ; default: the repeated ones."""
        self._name, self._found, self._next = name, found, 0
        outs = [one.out for one in found if one.out]
        self.dialect = dialect or _dialect(outs)
        self._keys = [self.dialect.key(one.out) if one.out else b"" for one in found]
        self._again = polls
        self._polls = polls or {key for key, times in Counter(self._keys).items() if times > 1}

    def opened(self) -> RecordedExchange | None:
        """Return the data received at the opening of the link, before any request."""
        ahead = self._ahead(b"")
        if ahead is None:
            ahead = self._behind(b"")
        return None if ahead is None else self._at(ahead)

    def asked(self, message: bytes) -> RecordedExchange:
        """Return the exchange of a complete message of the driver; AssertionError if there is none."""
        key = self.dialect.key(message)
        found = self._ahead(key)
        if found is None and (self._again is None or key in self._again):
            found = self._behind(key)
        if found is None:
            raise AssertionError(f"{self._name}: the driver sent {_shown(message)}; {self._expected()}")
        return self._at(found)

    def has(self, message: bytes) -> bool:
        """Whether the message is next, or was before."""
        key = self.dialect.key(message)
        return self._ahead(key) is not None or self._behind(key) is not None

    def _at(self, found: int) -> RecordedExchange:
        self._next = max(self._next, found + 1)
        return self._found[found]

    def _ahead(self, key: bytes) -> int | None:
        """Return the next exchange of that key; only polls may be skipped."""
        for at in range(self._next, len(self._found)):
            if self._keys[at] == key:
                return at
            if self._keys[at] and self._keys[at] not in self._polls:
                return None
        return None

    def _behind(self, key: bytes) -> int | None:
        return next((at for at in reversed(range(self._next)) if self._keys[at] == key), None)

    def _expected(self) -> str:
        left = [one for one in self._found[self._next :] if one.out]
        return f"the recording has {_shown(left[0].out)} (line {left[0].line})" if left else "the recording ends here"


def _dialect(outs: Sequence[bytes]) -> ReplayDialect:
    if outs and all(len(out) > 7 and out[2:4] == b"\0\0" and ModbusTcp().cut(out) == len(out) for out in outs):
        return ModbusTcp()
    if outs and all(transport_lines.decode(out.removesuffix(b"\n")) is not None for out in outs):
        return NumberedLinesDialect()
    return UnnumberedDialect(outs)


def _shown(message: bytes) -> str:
    """Format text as text, and other bytes in hexadecimal."""
    cut = message[:SHOWN]
    text = repr(cut)[1:] if all(32 <= byte < 127 or byte in b"\r\n\t" for byte in cut) else cut.hex(" ")
    return text + (" ..." if len(message) > SHOWN else "")


Send = Callable[[bytes], None]


class ReplayLink:
    """Peer of a driver's link that replays the recording."""

    def __init__(self, script: ReplayScript, *, paced: bool) -> None:
        self.endpoint = ""
        """The address for the driver's options."""
        self.mismatch: AssertionError | None = None
        """The first mismatch: it closes the link, and the block raises it."""
        self._script, self._paced = script, paced
        self._got = b""
        self._loop = asyncio.get_running_loop()
        self._timers: list[asyncio.TimerHandle] = []

    def connected(self, send: Send, close: Callable[[], None]) -> None:
        """Handle the driver's connection."""
        self.end()
        self._got, self._send, self._close = b"", send, close
        if (greeting := self._script.opened()) is not None:
            self._serve(greeting, b"")

    def came(self, data: bytes) -> None:
        """Handle data from the driver."""
        self._got += data
        while self._got and (end := self._script.dialect.cut(self._got)) is not None:
            message, self._got = self._got[:end], self._got[end:]
            try:
                exchange = self._script.asked(message)
            except AssertionError as error:
                self.mismatch = self.mismatch or error
                self._hang_up()
                return
            self._serve(exchange, message)

    def end(self) -> None:
        """Stop sending."""
        for timer in self._timers:
            timer.cancel()
        self._timers.clear()

    def _hang_up(self) -> None:
        self._got = b""
        self.end()
        self._close()

    def _serve(self, exchange: RecordedExchange, asked: bytes) -> None:
        came = exchange.came if self._paced else [(0.0, b"".join(data for _, data in exchange.came))]
        for after_s, data in came:
            self._later(after_s, self._answer, exchange, data, asked)
        if exchange.cut:
            self._later(max((after_s for after_s, _ in came), default=0.0), self._hang_up)

    def _later(self, after_s: float, act: Callable[..., None], *given: object) -> None:
        """Call after a delay, or at once without ``paced``."""
        if not self._paced:
            act(*given)
            return
        self._timers = [timer for timer in self._timers if timer.when() > self._loop.time()]
        self._timers.append(self._loop.call_later(after_s, act, *given))

    def _answer(self, exchange: RecordedExchange, data: bytes, asked: bytes) -> None:
        if data:
            self._send(self._script.dialect.answer(data, exchange.out, asked) if asked else data)


@asynccontextmanager
async def replayed(recording: Path, role: str, *, link: str = "", paced: bool = False) -> AsyncIterator[ReplayLink]:
    """Replay a device's end of its link during the block: TCP for TCP, a pseudo-terminal for serial and CAN.

    ``link``: one of a device's several links. ``paced``: answers have the recorded delay, otherwise none.

    Raises:
        ConfigError: The file or its device does not fit; with file and line.
        AssertionError: At the end of the block, if the driver sent a message that is not recorded; with both messages.
    """
    found = await asyncio.to_thread(read_recording, recording)
    name, passed = _of_link(found, role, link)
    on_bus = name.startswith(("slcan:", "socketcand:"))
    script = ReplayScript(
        f"{recording.name}, {role} on {name}", exchanges([_slcan(one) for one in passed] if on_bus else passed)
    )
    served = ReplayLink(script, paced=paced)
    serving = _tcp(served) if name.startswith("tcp:") else _pty(served, on_bus=on_bus)
    try:
        async with serving:
            try:
                yield served
            finally:
                served.end()
    finally:
        if served.mismatch is not None:
            raise served.mismatch


def _of_link(recording: Recording, role: str, link: str) -> tuple[str, list[tuple[int, WireMessage]]]:
    passed = recording.of(role)
    links = list(dict.fromkeys(one.link for _, one in passed))
    if link not in links and (link or len(links) > 1):
        raise ConfigError(f"{recording.path}: {role} has the links {', '.join(links)}. Pass one as link=.")
    name = link or links[0]
    if any(one.values is not None for _, one in passed):
        raise ConfigError(f"{recording.path}: {role} is recorded as values of variables. Use replayed_controller.")
    return name, [(line, one) for line, one in passed if one.link == name]


def _slcan(numbered: tuple[int, WireMessage]) -> tuple[int, WireMessage]:
    """Return a frame as a serial adapter writes it."""
    line, one = numbered
    if one.identifier is None:
        return numbered
    text = b"t%03X%d%b\r" % (one.identifier, len(one.data), one.data.hex().upper().encode())
    return line, WireMessage(one.at_s, one.role, one.link, one.way, text)


@asynccontextmanager
async def _tcp(served: ReplayLink) -> AsyncIterator[None]:
    class Peer(asyncio.Protocol):
        def connection_made(self, transport: asyncio.BaseTransport) -> None:
            assert isinstance(transport, asyncio.Transport)  # noqa: S101 -- asyncio's own promise
            served.connected(transport.write, transport.close)

        def data_received(self, data: bytes) -> None:
            served.came(data)

    server = await asyncio.get_running_loop().create_server(Peer, "127.0.0.1", 0)
    served.endpoint = f"tcp://127.0.0.1:{server.sockets[0].getsockname()[1]}"
    async with server:
        yield


@asynccontextmanager
async def _pty(served: ReplayLink, *, on_bus: bool) -> AsyncIterator[None]:
    ours, theirs = os.openpty()  # theirs stays open: a driver may reconnect
    tty.setraw(theirs)
    os.set_blocking(ours, False)
    loop, opened = asyncio.get_running_loop(), False
    rest = b""

    def close() -> None:
        """Hang up the line."""
        if loop.remove_reader(ours):
            os.close(ours)

    def readable() -> None:
        nonlocal opened, rest
        data = os.read(ours, 4096)
        now = not opened
        if on_bus:  # commands to the adapter are not bus frames; O opens it
            *lines, rest = (rest + data).split(b"\r")
            now = b"O" in lines
            data = b"".join(line + b"\r" for line in lines if line.startswith(b"t"))
        if now:
            opened = True
            served.connected(lambda text: _write(ours, text), close)
        if data:
            served.came(data)

    loop.add_reader(ours, readable)
    served.endpoint = f"{'slcan' if on_bus else 'serial'}:{os.ttyname(theirs)}"
    try:
        yield
    finally:
        close()
        os.close(theirs)


def _write(ours: int, text: bytes) -> None:
    """Write to the line; data beyond its buffer is lost, as on an unread line."""
    try:
        os.write(ours, text)
    except BlockingIOError:
        return


# A recorded controller that loads files.

READ, BEAT = b"a reading", b"heartbeat"
CUT_OFF = "the recording ends here"

Numbered = Sequence[tuple[int, WireMessage]]


class ReplayVariableDialect:
    """A ReplayDialect of readings and writes; the value of a heartbeat is ignored."""

    def cut(self, data: bytes) -> int | None:
        """See ReplayDialect. Messages are always complete."""
        return len(data)

    def key(self, message: bytes) -> bytes:
        """See ReplayDialect."""
        return BEAT if message != READ and set(json.loads(message)) == {"heartbeat"} else message

    def answer(self, recorded: bytes, asked: bytes, now: bytes) -> bytes:  # noqa: ARG002 -- there is no number
        """See ReplayDialect."""
        return recorded


class RecordedController:
    """A controller from the recording. As ``Delivery`` it accepts the recorded files."""

    def __init__(self, name: str, variables: Numbered, files: Numbered) -> None:
        """``name`` for messages."""
        self._name = name
        self._files = _delivered(files)
        self._passed = dict(variables)
        self._ends: dict[int, str] = {}
        """End of the link after a record, by line."""
        found = self._exchanges()
        self._timed = frozenset({BEAT, *(one.out for one in found if _taken_back(one.out))})
        """Keys of writes that are due by time, independent of other commands."""
        self._script = ReplayScript(name, found, ReplayVariableDialect(), frozenset({READ, *self._timed}))
        self.mismatch: AssertionError | None = None
        """The first mismatch: the link is lost, and the block raises it."""

    def variables(self) -> Replayed:
        """Return a new, closed link."""
        return Replayed(self)

    async def put(self, name: str, text: bytes) -> None:  # noqa: ARG002 -- the dwells of its line check are random
        """See Delivery: replay the next recorded delivery of that name."""
        line, recorded, why = self._files.pop(0) if self._files else (0, "", "")
        if recorded != name:
            has = f"has {recorded!r} (line {line})" if recorded else "has no more files"
            raise self.differs(AssertionError(f"{self._name}: the driver delivered {name!r}; the recording {has}"))
        if why != DELIVERED:
            raise DeviceRefused(why)

    def differs(self, error: AssertionError) -> LinkError:
        """Record the mismatch; return the error to raise."""
        self.mismatch = self.mismatch or error
        return LinkError(str(error))

    def opened(self) -> str:
        """Return how the link was lost at the opening; empty if it was not."""
        exchange = self._script.opened()
        return CUT_OFF if exchange is None else self._ends.get(exchange.line, "")

    def is_early(self, message: bytes) -> bool:
        """Whether the message is recorded only later, and was due by the driver's clock."""
        return ReplayVariableDialect().key(message) in self._timed and not self._script.has(message)

    def asked(self, message: bytes) -> tuple[WireMessage, str]:
        """Return the recorded answer, and how the link was lost after it."""
        try:
            line = self._script.asked(message).line
        except AssertionError as error:
            raise self.differs(error) from error
        return self._passed[line], self._ends.get(line, "")

    def _exchanges(self) -> list[RecordedExchange]:
        found: list[RecordedExchange] = []
        for line, one in self._passed.items():
            if one.way == "end":
                if found and one.why not in OWN_ENDS:
                    self._ends[found[-1].line] = one.why
                continue
            out = {"open": b"", "in": READ}.get(one.way)
            found.append(RecordedExchange(line, one.at_s, _written(one.values or {}) if out is None else out))
        return found


class Replayed:
    """Variables of a recorded controller."""

    def __init__(self, controller: RecordedController) -> None:
        self._controller = controller
        self._lost = "is not open"

    async def open(self) -> None:
        """See Variables."""
        self._lost = self._controller.opened()
        self._require()

    async def close(self) -> None:
        """See Variables."""
        self._lost = "is not open"

    async def identify(self) -> DeviceIdentity:
        """See Variables. The identity is not recorded."""
        self._require()
        return DeviceIdentity("recorded", "controller", "", "")

    async def read(self) -> VariableSnapshot:
        """See Variables."""
        one = self._asked(READ)
        values = {
            name: value for name, value in (one.values or {}).items() if isinstance(value, bool | int | float | str)
        }
        return VariableSnapshot(one.at_s if one.clock_s is None else one.clock_s, values, one.changed_s or {})

    async def write(self, values: Mapping[str, Value]) -> None:
        """See Variables. The first heartbeat, or the reset of a command, may be due earlier than in the recording."""
        if self._controller.is_early(_written(values)):
            self._require()
        else:
            self._asked(_written(values))

    def _asked(self, message: bytes) -> WireMessage:
        self._require()
        one, self._lost = self._controller.asked(message)
        return one

    def _require(self) -> None:
        if self._lost:
            raise LinkError(self._lost)


@asynccontextmanager
async def replayed_controller(recording: Path, role: str) -> AsyncIterator[RecordedController]:
    """Replay the controller of a device during the block. Readings follow the driver's requests.

    Raises:
        ConfigError: The file or its device does not fit; with file and line.
        AssertionError: At the end of the block, if the driver wrote or delivered data that is not recorded; with both.
    """
    found = await asyncio.to_thread(read_recording, recording)
    passed = found.of(role)
    files = {one.link for _, one in passed if one.values is not None and "sha256" in one.values}
    variables = [(line, one) for line, one in passed if one.link not in files]
    if not any(one.values is not None for _, one in variables):
        raise ConfigError(f"{recording}: {role} is recorded as bytes, not as a controller's variables. Use replayed.")
    delivered = [(line, one) for line, one in passed if one.link in files]
    controller = RecordedController(f"{recording.name}, {role} on {variables[0][1].link}", variables, delivered)
    try:
        yield controller
    finally:
        if controller.mismatch is not None:
            raise controller.mismatch


def _delivered(files: Numbered) -> list[tuple[int, str, str]]:
    """Return (line, name, end) of each delivery."""
    found: list[tuple[int, str, str]] = []
    for line, one in files:
        if one.values is not None:
            found.append((line, str(one.values["file"]), CUT_OFF))
        elif one.way == "end" and found:
            found[-1] = (*found[-1][:2], one.why)
    return found


def _taken_back(out: bytes) -> bool:
    """Whether a write resets a command: one value, which is off."""
    values = json.loads(out) if out not in (b"", READ) else {}
    return len(values) == 1 and not any(values.values())


def _written(values: Mapping[str, object]) -> bytes:
    return json.dumps(dict(values)).encode()
