"""Talking to a running daemon over its socket: for the command line, and for anybody's program.

Calls wait for the daemon; a program with an event loop makes them in a thread (``asyncio.to_thread``).
"""

from __future__ import annotations

import json
import logging
import socket
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import Any

from polishd.daemon.sockets import SOCKET_NAME, address_of
from polishd.daemon.verbs import SUBSCRIBE, VERBS
from polishd.model.errors import LinkError, NoDaemon, ProtocolError

log = logging.getLogger(__name__)

ANSWER_S = 30.0
ORDER_S = 300.0
"""An order answers when it is obeyed: a lift, a stop, and who does not confirm is waited for."""
NOTHING: Mapping[str, Any] = MappingProxyType({})


def request(
    state_dir: Path, verb: str, within_s: float | None = None, args: Mapping[str, Any] = NOTHING
) -> dict[str, Any]:
    """Ask the daemon of that state folder; its answer has ``ok``, and ``error`` where that is false.

    Verbs and their arguments stand in ``daemon.verbs``; ``within_s`` is long for those that change something.
    NoDaemon where none runs; LinkError where it does not answer in time.
    """
    if within_s is None:
        within_s = ORDER_S if verb in VERBS and VERBS[verb].changes else ANSWER_S
    with _asked(state_dir, verb, args, within_s) as connection, connection.makefile("rb") as lines:
        return _answer(lines.readline(), state_dir)


def subscribe(state_dir: Path, within_s: float = ANSWER_S) -> Iterator[dict[str, Any]]:
    """Yield events from now on, each ``{"name", "cycle", "data"}``; ends with the daemon.

    A line that holds no event is logged and passed by. NoDaemon, LinkError or ProtocolError where it cannot begin.
    """
    with _asked(state_dir, SUBSCRIBE, NOTHING, within_s) as connection, connection.makefile("rb") as lines:
        answer = _answer(lines.readline(), state_dir)
        if not answer.get("ok"):
            raise ProtocolError(f"the daemon refused: {answer.get('error')}")
        connection.settimeout(None)
        while line := lines.readline():
            if (event := _event(line, state_dir)) is not None:
                yield event


@contextmanager
def _asked(state_dir: Path, verb: str, args: Mapping[str, Any], within_s: float) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        connection.settimeout(within_s)
        try:
            with address_of(state_dir / SOCKET_NAME) as address:
                connection.connect(address)
        except PermissionError as error:
            raise LinkError(
                f"{state_dir / SOCKET_NAME}: only the daemon's own user may talk to it; use that account"
            ) from error
        except (BlockingIOError, TimeoutError):  # so many wait already that no more fit: it is there, and hangs
            raise LinkError(f"{state_dir}: the daemon takes no more questions; look at its log") from None
        except OSError as error:
            raise NoDaemon(
                f"no daemon is running for {state_dir} ({error.strerror}); start it with: polishd run CELL.toml"
            ) from error
        try:
            connection.sendall(json.dumps({"verb": verb, **({"args": dict(args)} if args else {})}).encode() + b"\n")
            yield connection
        except TimeoutError:
            raise LinkError(f"{state_dir}: the daemon did not answer within {within_s:g} s; look at its log") from None
        except OSError as error:
            raise LinkError(f"{state_dir}: the daemon hung up: {error}; look at its log") from error


def _event(line: bytes, state_dir: Path) -> dict[str, Any] | None:
    """Return the event of a line; None, and a warning in the log, where it holds none."""
    try:
        event = _answer(line, state_dir).get("event")
    except ProtocolError as error:
        log.warning("%s", error)
        return None
    if not (isinstance(event, dict) and isinstance(event.get("name"), str) and isinstance(event.get("data"), dict)):
        log.warning("%s: the daemon sent a line without an event: %r", state_dir, line[:80])
        return None
    return event


def _answer(line: bytes, state_dir: Path) -> dict[str, Any]:
    if not line:
        raise LinkError(f"{state_dir}: the daemon hung up before it answered; look at its log")
    try:
        answer = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise ProtocolError(f"{state_dir}: the daemon's answer is not JSON: {line[:80]!r}") from error
    if not isinstance(answer, dict):
        raise ProtocolError(f"{state_dir}: the daemon's answer is no object: {line[:80]!r}")
    return answer
