"""Socket of the daemon: JSON lines on a Unix socket that only its owner may open.

Requests: see ``client.VERBS``. Answer: ``{"ok": true, ...}`` or ``{"ok": false, "error": "..."}``. After the answer to
``subscribe`` the daemon sends events, one a line: ``{"event": {"name", "cycle", "data"}}``, until either side ends.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import logging
import os
import socket
import stat
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

from polishd.daemon.runtime.events import EventBus
from polishd.daemon.socket.client import LINE_BYTES, SOCKET_NAME, SUBSCRIBE, address_of, read_request
from polishd.model.errors import ConfigError, PolishdError
from polishd.util.serialization import plain

log = logging.getLogger(__name__)

Handler = Callable[..., Awaitable[Mapping[str, Any]]]
"""Handler of a command, called with its arguments by name."""

WRITE_S = 5.0
"""A client that does not read for so long is dropped."""


class ControlSocket:
    """Answers requests with ``handlers`` and ``subscribe``. ``serving`` creates it."""

    def __init__(self, handlers: Mapping[str, Handler], bus: EventBus) -> None:
        self._handlers = handlers
        self._bus = bus
        self._sessions: set[asyncio.Task[None]] = set()
        self._answering = 0
        self._answered = asyncio.Condition()

    async def session(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Serve one client until it closes the connection, does not read its answers, or the daemon ends."""
        task = asyncio.current_task()
        if task is not None:
            self._sessions.add(task)
            task.add_done_callback(self._sessions.discard)
        try:
            await self._serve(reader, writer)
        except (OSError, TimeoutError, ValueError) as error:
            log.info("a client was dropped: %s: %s", type(error).__name__, error)
        except asyncio.CancelledError:
            log.debug("a client was still connected at the daemon's end")
        finally:
            writer.close()

    async def close(self) -> None:
        """End all sessions after running requests are answered, such as the ``stop`` that ends the daemon."""
        async with self._answered:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(WRITE_S):
                    await self._answered.wait_for(lambda: not self._answering)
        sessions = tuple(self._sessions)
        for task in sessions:
            task.cancel()
        await asyncio.gather(*sessions, return_exceptions=True)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while (line := await _line(reader)) != b"":
            try:
                if line is None:
                    raise ValueError(f"a request is at most {LINE_BYTES} bytes long")
                verb, arguments = read_request(line, [*self._handlers, SUBSCRIBE])
            except ValueError as refusal:
                await _send(writer, {"ok": False, "error": str(refusal)})
                continue
            if verb == SUBSCRIBE:
                await self._subscribe(reader, writer)
                return
            self._answering += 1
            try:
                await _send(writer, await self._answer(verb, arguments))
            finally:
                self._answering -= 1
                async with self._answered:
                    self._answered.notify_all()

    async def _answer(self, verb: str, arguments: Mapping[str, Any]) -> dict[str, Any]:
        try:
            return {"ok": True, **await self._handlers[verb](**arguments)}
        except PolishdError as error:
            return {"ok": False, "error": str(error), "exit_code": error.exit_code}
        except Exception as error:
            log.exception("verb %s failed", verb)
            return {"ok": False, "error": f"{verb} failed inside the daemon: {type(error).__name__}: {error}"}

    async def _subscribe(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with self._bus.subscription() as events:
            await _send(writer, {"ok": True})
            async with asyncio.TaskGroup() as group:
                sending = group.create_task(_send_events(events, writer), name="send events to subscriber")
                closed = group.create_task(_until_closed(reader, writer), name="subscriber closes")
                await asyncio.wait({sending, closed}, return_when=asyncio.FIRST_COMPLETED)
                sending.cancel()
                closed.cancel()


@asynccontextmanager
async def serving(state_dir: Path, handlers: Mapping[str, Handler], bus: EventBus) -> AsyncIterator[Path]:
    """Serve on ``state_dir/polishd.sock`` inside this block. Needs the folder's lock: a stale socket is removed."""
    path = state_dir / SOCKET_NAME
    service = ControlSocket(handlers, bus)
    server = await asyncio.start_unix_server(service.session, sock=_bind(path), limit=LINE_BYTES)
    try:
        yield path
    finally:
        server.close()
        await service.close()
        await server.wait_closed()
        with contextlib.suppress(FileNotFoundError):
            path.unlink()


def _bind(path: Path) -> socket.socket:
    if path.exists() or path.is_symlink():
        if not stat.S_ISSOCK(path.lstat().st_mode):
            raise ConfigError(f"{path}: is not a socket. Move the file to another folder, or set cell.state_dir")
        path.unlink()
    server = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        os.fchmod(server.fileno(), 0o600)  # before bind, so that others can never connect
        with address_of(path) as address:
            server.bind(address)
        path.chmod(0o600)
    except OSError as error:
        server.close()
        raise ConfigError(f"{path}: the socket cannot be created: {error}. Set cell.state_dir") from error
    server.setblocking(False)
    return server


async def _line(reader: asyncio.StreamReader) -> bytes | None:
    """Return the next line, empty at the end; None in place of a line that is too long."""
    is_too_long = False
    while True:
        try:
            line = await reader.readuntil(b"\n")
        except asyncio.IncompleteReadError as error:
            line = error.partial
        except asyncio.LimitOverrunError as error:
            is_too_long = True
            await reader.readexactly(error.consumed)
            continue
        return None if is_too_long and line else line


async def _until_closed(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Answer each line of a subscriber with an error until it closes the connection. It still receives events."""
    try:
        while await _line(reader) != b"":
            await _send(
                writer, {"ok": False, "error": "this connection is for events only. Send requests on another one"}
            )
    except OSError:
        log.debug("a subscriber closed the connection")


async def _send_events(events: AsyncIterator[Any], writer: asyncio.StreamWriter) -> None:
    try:
        async for event in events:
            await _send(writer, {"event": event.facts()})
    except OSError:
        log.debug("a subscriber closed the connection")


async def _send(writer: asyncio.StreamWriter, answer: Mapping[str, Any]) -> None:
    writer.write(json.dumps(answer, default=plain).encode() + b"\n")
    async with asyncio.timeout(WRITE_S):
        await writer.drain()
