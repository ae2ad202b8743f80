"""Client of a running daemon's socket: for the command line and for other programs.

Calls block until the daemon answers; a program with an event loop makes them in a thread (``asyncio.to_thread``).
"""

from __future__ import annotations

import json
import logging
import os
import socket
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

from polishd.model.errors import LinkError, NoDaemon, ProtocolError

# Addresses of Unix sockets: the kernel allows 107 bytes, paths may be longer.

SOCKET_NAME = "polishd.sock"
LINE_BYTES = 1 << 22
"""Longest line of a request: some thousand jobs."""
_LONGEST = 100


@contextmanager
def address_of(path: Path) -> Iterator[str]:
    """Yield a path that bind and connect accept: the path, or a short one through an open folder (Linux)."""
    if len(os.fsencode(path)) <= _LONGEST:
        yield str(path)
        return
    folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
    try:
        yield f"/proc/self/fd/{folder}/{path.name}"
    finally:
        os.close(folder)


# Commands of the socket. The table in docs/reference/daemon.md is made from this one.

SUBSCRIBE = "subscribe"


@dataclass(frozen=True, slots=True)
class CommandArgument:
    """One argument."""

    name: str
    kind: type
    what: str
    required: bool = False


@dataclass(frozen=True, slots=True)
class SocketCommand:
    """A query or a command."""

    name: str
    what: str
    changes: Literal["", "an order", "the queue", "the journal", "an approval"] = ""
    """What the command changes; empty for a query. An order changes the cell."""
    arguments: tuple[CommandArgument, ...] = ()


REASON = CommandArgument("reason", str, "reason, for the journal and `status`")
BY = CommandArgument("by", str, "name of the person who gives the command, for the journal")

FILES = CommandArgument(
    "files",
    list,
    "for each job file its absolute `path`, to which paths in it are relative, and its `content`",
    required=True,
)
ORDERED = (REASON, BY)
PROGRAM = CommandArgument("program_sha256", str, "hash of its program, from `live`", required=True)
ALARMS = CommandArgument("alarms", list, "numbers of events in the journal", required=True)
CLAIM = CommandArgument("claim", str, "claim by which a shop gave the part of this job to the cell")
CLAIMS = (
    CommandArgument("stands", list, "confirmed claims: their jobs may begin"),
    CommandArgument("back", list, "claims that the shop withdraws: their waiting jobs leave the queue"),
    CommandArgument("lost", list, "lost claims: their jobs may not begin, nor continue after a hold"),
)
OFFERS = CommandArgument(
    "offers", list, "for each `recipe`, `cell`, `job`, `of_cycle`, `at_s`, `rate`, `sigma`", required=True
)
JOB = CommandArgument("job", str, "`job.id`", required=True)
WHERE = CommandArgument("where", str, "`before`, `after`, `first` or `last`", required=True)
OTHER = CommandArgument("other", str, "the waiting job that is the reference of `before` and `after`")

VERBS: Mapping[str, SocketCommand] = {
    verb.name: verb
    for verb in (
        SocketCommand("status", "state and reason, phase, cycle, devices, health, measurements so far"),
        SocketCommand("live", "state, last reading of each device with its age, signals and health"),
        SocketCommand(SUBSCRIBE, "events from now on, one a line, until either side ends"),
        SocketCommand("hold", "leave contact, stop motion, and wait for `resume`", "an order", ORDERED),
        SocketCommand("resume", "continue with a new measurement", "an order", ORDERED),
        SocketCommand("stop", "leave contact, stop motion, and end the daemon", "an order", ORDERED),
        SocketCommand(
            "estop", "stop motion at once, also at the cost of the part; then wait for `resume`", "an order", ORDERED
        ),
        SocketCommand("approve", "approve the waiting plan (`job.approve`)", "an approval", (PROGRAM, BY)),
        SocketCommand("acknowledge", "acknowledge these alarms", "the journal", (ALARMS, BY)),
        SocketCommand("queue_list", "list the jobs of the queue: under way, waiting and ended"),
        SocketCommand("queue_add", "add jobs at the end of the queue, all or none", "the queue", (FILES, BY, CLAIM)),
        SocketCommand("queue_move", "move a waiting job", "the queue", (JOB, WHERE, OTHER, BY)),
        SocketCommand(
            "queue_remove",
            "remove a waiting job, or set aside the job for which the cell is held",
            "the queue",
            (JOB, REASON, BY),
        ),
        SocketCommand(
            "shop_assignments", "report of the shop on the parts that it gave to this cell", "the queue", CLAIMS
        ),
        SocketCommand("shop_rates", "removal rates of other cells of the shop", "the journal", (OFFERS,)),
    )
}
"""The daemon answers a command after it has executed it."""

_WORDS = {str: "a string", int: "a whole number", float: "a number", bool: "true or false", list: "a list"}


def read_request(line: bytes, offered: Iterable[str]) -> tuple[str, dict[str, Any]]:
    """Return the command of a request, one of those offered, and its arguments; ValueError where it is invalid."""
    from polishd.config.toml_loader import (
        did_you_mean,
        join_words,  # only for the daemon: a client does not load the models
    )

    known = list(offered)
    try:
        request = _unicode(json.loads(line))
    except (ValueError, RecursionError):
        request = None
    verb, given = (request.get("verb"), request.get("args", {})) if isinstance(request, dict) else (None, {})
    if not isinstance(verb, str) or not isinstance(given, dict) or set(request) - {"verb", "args"}:
        raise ValueError(
            'a request is one JSON object a line, {"verb": ..., "args": {...}} (args is optional). '
            f"Commands: {join_words(known)}"
        )
    if verb not in known:
        raise ValueError(f"unknown verb {verb!r}{did_you_mean(verb, known)} Known: {join_words(known)}")
    arguments = VERBS[verb].arguments
    kinds = {argument.name: argument.kind for argument in arguments}
    if missing := [argument.name for argument in arguments if argument.required and argument.name not in given]:
        raise ValueError(f"{verb}: {', '.join(map(repr, missing))} must be given")
    for name, value in given.items():
        if name not in kinds:
            raise ValueError(f"{verb}: unknown argument {name!r}{did_you_mean(name, kinds)} Known: {join_words(kinds)}")
        if type(value) is not kinds[name] and (type(value), kinds[name]) != (int, float):
            raise ValueError(f"{verb}: {name} must be {_WORDS[kinds[name]]}, not {json.dumps(value)}")
    return verb, given


def _unicode(value: Any) -> Any:
    """Return the value with each lone surrogate escaped: files and databases refuse it."""
    if isinstance(value, str):
        return value.encode(errors="backslashreplace").decode()
    if isinstance(value, dict):
        return {_unicode(key): _unicode(one) for key, one in value.items()}
    return [_unicode(one) for one in value] if isinstance(value, list) else value


log = logging.getLogger(__name__)

ANSWER_S = 30.0
ORDER_S = 300.0
"""A command answers after it is executed: after a lift, a stop, and the wait for confirmations."""
NOTHING: Mapping[str, Any] = MappingProxyType({})


def request(
    state_dir: Path, verb: str, within_s: float | None = None, args: Mapping[str, Any] = NOTHING
) -> dict[str, Any]:
    """Send a request to the daemon of that state folder. Its answer has ``ok``, and ``error`` where that is false.

    ``VERBS`` lists the commands; the default of ``within_s`` is long for those that change something. NoDaemon where
    no daemon runs; LinkError where it does not answer in time.
    """
    if within_s is None:
        within_s = ORDER_S if verb in VERBS and VERBS[verb].changes else ANSWER_S
    with _connection(state_dir, verb, args, within_s) as connection, connection.makefile("rb") as lines:
        return _answer(lines.readline(), state_dir)


def subscribe(state_dir: Path, within_s: float = ANSWER_S) -> Iterator[dict[str, Any]]:
    """Yield later events, each ``{"name", "cycle", "data"}``, until the daemon ends.

    A line without an event is logged and ignored. NoDaemon, LinkError or ProtocolError where it cannot begin.
    """
    with _connection(state_dir, SUBSCRIBE, NOTHING, within_s) as connection, connection.makefile("rb") as lines:
        answer = _answer(lines.readline(), state_dir)
        if not answer.get("ok"):
            raise ProtocolError(f"the daemon refused: {answer.get('error')}")
        connection.settimeout(None)
        while line := lines.readline():
            if (event := _event(line, state_dir)) is not None:
                yield event


@contextmanager
def _connection(state_dir: Path, verb: str, args: Mapping[str, Any], within_s: float) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        connection.settimeout(within_s)
        try:
            with address_of(state_dir / SOCKET_NAME) as address:
                connection.connect(address)
        except PermissionError as error:
            raise LinkError(
                f"{state_dir / SOCKET_NAME}: only the user of the daemon has access. Use that account"
            ) from error
        except (BlockingIOError, TimeoutError):  # the daemon runs and is blocked: too many clients wait
            raise LinkError(f"{state_dir}: the daemon accepts no more connections. Read its log") from None
        except OSError as error:
            raise NoDaemon(
                f"no daemon is running for {state_dir} ({error.strerror}). Start it with: polishd run CELL.toml"
            ) from error
        try:
            connection.sendall(json.dumps({"verb": verb, **({"args": dict(args)} if args else {})}).encode() + b"\n")
            yield connection
        except TimeoutError:
            raise LinkError(f"{state_dir}: the daemon did not answer within {within_s:g} s. Read its log") from None
        except OSError as error:
            raise LinkError(f"{state_dir}: the daemon closed the connection: {error}. Read its log") from error


def _event(line: bytes, state_dir: Path) -> dict[str, Any] | None:
    """Return the event of a line; None, with a warning in the log, where it has none."""
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
        raise LinkError(f"{state_dir}: the daemon closed the connection before it answered. Read its log")
    try:
        answer = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise ProtocolError(f"{state_dir}: the daemon's answer is not JSON: {line[:80]!r}") from error
    if not isinstance(answer, dict):
        raise ProtocolError(f"{state_dir}: the daemon's answer is not an object: {line[:80]!r}")
    return answer
