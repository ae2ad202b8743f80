"""The other end of a recorded link, for a driver as it is: a support case is a file, and a test ten lines.

async with replayed(Path("case.wire.jsonl.gz"), "actuator") as link:
    actuator = build(options | {"address": link.endpoint})
    await actuator.open()
"""

from __future__ import annotations

import asyncio
import os
import tty
from collections import Counter
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from polishd.drivers.transport import lines as transport_lines
from polishd.model.errors import ConfigError
from polishd.util.wire_recording import Recording, WireMessage, read_recording

# A recorded link as requests and what came upon them. What is asked again is answered as it was last.

OWN_ENDS = ("the connection is closed", "the line is closed", "the bus is closed")
"""The driver closed it; whatever else ended a link is done again."""
SHOWN = 48
"""Bytes of a message in a mismatch."""


@dataclass
class RecordedExchange:
    """A request, or nothing where a link was opened, and what came until the next one."""

    line: int
    """Of the recording's file."""
    at_s: float
    out: bytes
    came: list[tuple[float, bytes]] = field(default_factory=list)
    """Seconds since the request, bytes."""
    cut: bool = False
    """The link was lost upon it."""


class ReplayDialect(Protocol):
    """What of a message is its number, which is another one each time."""

    def cut(self, data: bytes) -> int | None:
        """Length of the first message; None where it is not whole yet."""
        ...

    def key(self, message: bytes) -> bytes:
        """The message without its number."""
        ...

    def answer(self, recorded: bytes, asked: bytes, now: bytes) -> bytes:
        """What came, with the number of ``now`` in the place of that of ``asked``."""
        ...


class ModbusTcp:
    """Its number is the transaction's."""

    def cut(self, data: bytes) -> int | None:
        """See Dialect."""
        end = 6 + int.from_bytes(data[4:6]) if len(data) >= 6 else len(data) + 1
        return end if len(data) >= end else None

    def key(self, message: bytes) -> bytes:
        """See Dialect."""
        return message[2:]

    def answer(self, recorded: bytes, asked: bytes, now: bytes) -> bytes:
        """See Dialect."""
        done = b""
        while (end := self.cut(recorded)) is not None:
            frame, recorded = recorded[:end], recorded[end:]
            done += now[:2] + frame[2:] if frame[:2] == asked[:2] else frame
        return done + recorded


class NumberedLinesDialect:
    """``$number,body*checksum``."""

    def cut(self, data: bytes) -> int | None:
        """See Dialect."""
        return data.find(b"\n") + 1 or None

    def key(self, message: bytes) -> bytes:
        """See Dialect."""
        found = transport_lines.decode(message.removesuffix(b"\n"))
        return message if found is None else found[1].encode()

    def answer(self, recorded: bytes, asked: bytes, now: bytes) -> bytes:
        """See Dialect."""
        numbers = [transport_lines.decode(one.removesuffix(b"\n")) for one in (asked, now)]
        lines = []
        for line in recorded.splitlines(keepends=True):
            found = transport_lines.decode(line.removesuffix(b"\n"))
            ours = found and numbers[0] and numbers[1] and found[0] == numbers[0][0]
            lines.append(transport_lines.encode(numbers[1][0], found[1]) if ours and found and numbers[1] else line)
        return b"".join(lines)


class UnnumberedDialect:
    """No numbers. Where a message ends only the recording knows."""

    def __init__(self, outs: Sequence[bytes]) -> None:
        self._outs = sorted(set(outs), key=len, reverse=True)

    def cut(self, data: bytes) -> int | None:
        """See Dialect."""
        found = next((len(out) for out in self._outs if data.startswith(out)), None)
        if found is None and not any(out.startswith(data) for out in self._outs):
            return len(data)
        return found

    def key(self, message: bytes) -> bytes:
        """See Dialect."""
        return message

    def answer(self, recorded: bytes, asked: bytes, now: bytes) -> bytes:  # noqa: ARG002 -- there is no number
        """See Dialect."""
        return recorded


def exchanges(passed: Sequence[tuple[int, WireMessage]]) -> list[RecordedExchange]:
    """Of one link, with the lines of its records."""
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
    """Where in its recording a link is."""

    def __init__(
        self,
        name: str,
        found: Sequence[RecordedExchange],
        dialect: ReplayDialect | None = None,
        polls: frozenset[bytes] | None = None,
    ) -> None:
        """``name`` for messages. ``polls``: keys of what may come more or less often; without them, what does so."""
        self._name, self._found, self._next = name, found, 0
        outs = [one.out for one in found if one.out]
        self.dialect = dialect or _dialect(outs)
        self._keys = [self.dialect.key(one.out) if one.out else b"" for one in found]
        self._again = polls
        self._polls = polls or {key for key, times in Counter(self._keys).items() if times > 1}

    def opened(self) -> RecordedExchange | None:
        """What came when the link was opened, before anything was asked."""
        ahead = self._ahead(b"")
        if ahead is None:
            ahead = self._behind(b"")
        return None if ahead is None else self._at(ahead)

    def asked(self, message: bytes) -> RecordedExchange:
        """The exchange that a whole message of the driver is of; AssertionError where there is none."""
        key = self.dialect.key(message)
        found = self._ahead(key)
        if found is None and (self._again is None or key in self._again):
            found = self._behind(key)
        if found is None:
            raise AssertionError(f"{self._name}: the driver sent {_shown(message)}; {self._expected()}")
        return self._at(found)

    def has(self, message: bytes) -> bool:
        """Whether it comes next, or came before."""
        key = self.dialect.key(message)
        return self._ahead(key) is not None or self._behind(key) is not None

    def _at(self, found: int) -> RecordedExchange:
        self._next = max(self._next, found + 1)
        return self._found[found]

    def _ahead(self, key: bytes) -> int | None:
        """The next of that content; only what occurs again and again is passed over on the way."""
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
    """Text as text, other bytes as hexadecimal ones."""
    cut = message[:SHOWN]
    text = repr(cut)[1:] if all(32 <= byte < 127 or byte in b"\r\n\t" for byte in cut) else cut.hex(" ")
    return text + (" ..." if len(message) > SHOWN else "")


Send = Callable[[bytes], None]


class ReplayLink:
    """One end of a wire, as the recording has it."""

    def __init__(self, script: ReplayScript, *, paced: bool) -> None:
        self.endpoint = ""
        """The address for the driver's options."""
        self.mismatch: AssertionError | None = None
        """The first one; the link is closed over it, and the block raises it."""
        self._script, self._paced = script, paced
        self._got = b""
        self._loop = asyncio.get_running_loop()
        self._timers: list[asyncio.TimerHandle] = []

    def connected(self, send: Send, close: Callable[[], None]) -> None:
        """The driver opened it."""
        self.end()
        self._got, self._send, self._close = b"", send, close
        if (greeting := self._script.opened()) is not None:
            self._serve(greeting, b"")

    def came(self, data: bytes) -> None:
        """The driver sent that."""
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
        """Nothing more is sent."""
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
        """At once where nothing is paced."""
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
    """That device's end of its link, for the time of the block: TCP for TCP, a pseudo-terminal for serial and CAN.

    ``link``: which one, of a device that has several. ``paced``: answers take as long as they took; else none.

    Raises:
        ConfigError: the file, or that device in it, is not what is asked for; with file and line.
        AssertionError: as the block ends, where the driver sent what is not recorded: what, and what is.
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
        raise ConfigError(f"{recording.path}: {role} has the links {', '.join(links)}; say link= one of them")
    name = link or links[0]
    if any(one.values is not None for _, one in passed):
        raise ConfigError(
            f"{recording.path}: {role} is recorded as values of variables; replayed_controller plays them"
        )
    return name, [(line, one) for line, one in passed if one.link == name]


def _slcan(numbered: tuple[int, WireMessage]) -> tuple[int, WireMessage]:
    """A frame as a serial adapter writes it."""
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
    ours, theirs = os.openpty()  # theirs stays open: a driver may come again
    tty.setraw(theirs)
    os.set_blocking(ours, False)
    loop, opened = asyncio.get_running_loop(), False
    rest = b""

    def close() -> None:
        """A line whose other end is gone is hung up."""
        if loop.remove_reader(ours):
            os.close(ours)

    def readable() -> None:
        nonlocal opened, rest
        data = os.read(ours, 4096)
        now = not opened
        if on_bus:  # commands to the adapter are its own, not the bus's; O opens it
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
    """What the line has no room for is lost, as on a wire that nobody reads."""
    try:
        os.write(ours, text)
    except BlockingIOError:
        return
