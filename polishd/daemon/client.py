"""Talking to a running daemon over its socket: for the command line, and for anybody's program."""

from __future__ import annotations

import asyncio
import json
import socket
from collections.abc import AsyncGenerator, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from polishd.daemon.sockets import SOCKET_NAME, address_of
from polishd.model.errors import LinkError, NoDaemon, ProtocolError

ANSWER_S = 30.0
ORDER_S = 300.0
"""An order answers when it is obeyed: a lift, a stop, and who does not confirm is waited for."""


def request(state_dir: Path, verb: str, within_s: float = ANSWER_S) -> dict[str, Any]:
    """Ask the daemon of that state folder; its answer has ``ok``, and ``error`` where that is false.

    NoDaemon where none runs; LinkError where it does not answer in time.
    """
    with _asked(state_dir, verb, within_s) as connection, connection.makefile("rb") as lines:
        return _answer(lines.readline(), state_dir)


def subscribe(state_dir: Path, within_s: float = ANSWER_S) -> Iterator[dict[str, Any]]:
    """Events from now on, each ``{"name", "cycle", "data"}``; ends with the daemon."""
    with _asked(state_dir, "subscribe", within_s) as connection, connection.makefile("rb") as lines:
        _refused(_answer(lines.readline(), state_dir))
        connection.settimeout(None)
        while line := lines.readline():
            yield _answer(line, state_dir)["event"]


async def request_async(state_dir: Path, verb: str, within_s: float = ANSWER_S) -> dict[str, Any]:
    """``request`` for an event loop."""
    try:
        async with asyncio.timeout(within_s):
            reader, writer = await _open_async(state_dir, verb)
            try:
                return _answer(await reader.readline(), state_dir)
            finally:
                writer.close()
    except TimeoutError:
        raise _silent(state_dir, within_s) from None


async def subscribe_async(state_dir: Path) -> AsyncGenerator[dict[str, Any], None]:
    """``subscribe`` for an event loop; close it (``contextlib.aclosing``) to hang up."""
    reader, writer = await _open_async(state_dir, "subscribe")
    try:
        _refused(_answer(await reader.readline(), state_dir))
        while line := await reader.readline():
            yield _answer(line, state_dir)["event"]
    finally:
        writer.close()


async def _open_async(state_dir: Path, verb: str) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
    try:
        with address_of(state_dir / SOCKET_NAME) as address:
            reader, writer = await asyncio.open_unix_connection(address, limit=1 << 24)
    except OSError as error:
        raise _absent(state_dir, error) from error
    writer.write(_request(verb))
    return reader, writer


@contextmanager
def _asked(state_dir: Path, verb: str, within_s: float) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        connection.settimeout(within_s)
        try:
            with address_of(state_dir / SOCKET_NAME) as address:
                connection.connect(address)
        except OSError as error:
            raise _absent(state_dir, error) from error
        try:
            connection.sendall(_request(verb))
            yield connection
        except TimeoutError:
            raise _silent(state_dir, within_s) from None
        except OSError as error:
            raise LinkError(f"{state_dir}: the daemon hung up: {error}; look at its log") from error


def _request(verb: str) -> bytes:
    return json.dumps({"verb": verb}).encode() + b"\n"


def _answer(line: bytes, state_dir: Path) -> dict[str, Any]:
    if not line:
        raise LinkError(f"{state_dir}: the daemon hung up before it answered; look at its log")
    try:
        answer = json.loads(line)
    except ValueError as error:
        raise ProtocolError(f"{state_dir}: the daemon's answer is not JSON: {line[:80]!r}") from error
    if not isinstance(answer, dict):
        raise ProtocolError(f"{state_dir}: the daemon's answer is no object: {line[:80]!r}")
    return answer


def _refused(answer: dict[str, Any]) -> None:
    if not answer.get("ok"):
        raise ProtocolError(f"the daemon refused: {answer.get('error')}")


def _absent(state_dir: Path, error: OSError) -> LinkError:
    if isinstance(error, PermissionError):
        return LinkError(f"{state_dir / SOCKET_NAME}: only the daemon's own user may talk to it; use that account")
    return NoDaemon(f"no daemon is running for {state_dir} ({error.strerror}); start it with: polishd run CELL.toml")


def _silent(state_dir: Path, within_s: float) -> LinkError:
    return LinkError(f"{state_dir}: the daemon did not answer within {within_s:g} s; look at its log")
