"""The other end of a recorded link, for a driver as it is: a support case is a file, and a test ten lines.

async with replayed(Path("case.wire.jsonl.gz"), "actuator") as link:
    actuator = build(options | {"address": link.endpoint})
    await actuator.open()
"""

from __future__ import annotations

import asyncio
import os
import tty
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path

from polishd.model.errors import ConfigError
from polishd.ports.tap import WireMessage
from polishd.ports.wire_file import Recording, read_recording
from polishd.testing.replay_script import RecordedExchange, ReplayScript, exchanges

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
