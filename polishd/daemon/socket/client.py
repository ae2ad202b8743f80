"""Talking to a running daemon over its socket: for the command line, and for anybody's program.

Calls wait for the daemon; a program with an event loop makes them in a thread (``asyncio.to_thread``).
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

# Addresses of Unix sockets: the kernel allows 107 bytes, folders may be deeper.

SOCKET_NAME = "polishd.sock"
LINE_BYTES = 1 << 22
"""Longest line of a request: some thousands of jobs."""
_LONGEST = 100


@contextmanager
def address_of(path: Path) -> Iterator[str]:
    """A path that bind and connect accept: the path itself, or a short one through an open folder (Linux)."""
    if len(os.fsencode(path)) <= _LONGEST:
        yield str(path)
        return
    folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
    try:
        yield f"/proc/self/fd/{folder}/{path.name}"
    finally:
        os.close(folder)


# What may be asked of a running daemon: the verbs of its socket. The table in docs/cycle.md is made from this one.

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
    """What is asked, or ordered."""

    name: str
    what: str
    changes: Literal["", "an order", "the queue", "the journal", "an approval"] = ""
    """An order: the cell is another one afterwards."""
    arguments: tuple[CommandArgument, ...] = ()


REASON = CommandArgument("reason", str, "why, for whoever reads the journal and `status`")
BY = CommandArgument("by", str, "who wants it, for the journal; whoever passes an order on says for whom")

FILES = CommandArgument(
    "files",
    list,
    "of each job's file `path`, absolute, from whose folder paths in it start, and `content`",
    required=True,
)
ORDERED = (REASON, BY)
PROGRAM = CommandArgument("program_sha256", str, "hash of its program, as `live` tells it", required=True)
ALARMS = CommandArgument("alarms", list, "numbers of events in the journal", required=True)
CLAIM = CommandArgument("claim", str, "by which a shop gave the part of this one job to the cell")
CLAIMS = (
    CommandArgument("stands", list, "claims: their parts are this cell's, and may begin"),
    CommandArgument("back", list, "claims that the shop wants back: those that wait are taken out"),
    CommandArgument(
        "lost", list, "claims that the shop has given up: their parts may not begin, nor go on after a hold"
    ),
)
OFFERS = CommandArgument(
    "offers", list, "of each `recipe`, `cell`, `job`, `of_cycle`, `at_s`, `rate`, `sigma`", required=True
)
JOB = CommandArgument("job", str, "`job.id`", required=True)
WHERE = CommandArgument("where", str, "`before`, `after`, `first` or `last`", required=True)
OTHER = CommandArgument("other", str, "the job that waits before or after which")

VERBS: Mapping[str, SocketCommand] = {
    verb.name: verb
    for verb in (
        SocketCommand("status", "state and why, phase, cycle, devices, health, what was measured so far"),
        SocketCommand("live", "state, what the devices told last, each with its age, signals and health"),
        SocketCommand(SUBSCRIBE, "events from now on, one a line, until either side ends"),
        SocketCommand("hold", "leave contact, stand still, and wait for `resume`", "an order", ORDERED),
        SocketCommand("resume", "go on, with a new measurement first", "an order", ORDERED),
        SocketCommand("stop", "leave contact, stand still, and end the daemon", "an order", ORDERED),
        SocketCommand(
            "estop", "stop motion at once, whatever the part costs; then wait for `resume`", "an order", ORDERED
        ),
        SocketCommand("approve", "the plan that waits may run (`job.approve`)", "an approval", (PROGRAM, BY)),
        SocketCommand("acknowledge", "a person has seen these alarms", "the journal", (ALARMS, BY)),
        SocketCommand("queue_list", "the jobs of the queue: that under way, those that wait, those that ended"),
        SocketCommand("queue_add", "put jobs at the end of the queue, all or none", "the queue", (FILES, BY, CLAIM)),
        SocketCommand("queue_move", "move a job that waits", "the queue", (JOB, WHERE, OTHER, BY)),
        SocketCommand(
            "queue_remove",
            "take a job out that waits, or put the one aside over which the cell is held",
            "the queue",
            (JOB, REASON, BY),
        ),
        SocketCommand(
            "shop_assignments", "what the shop says of the parts that it gave to this cell", "the queue", CLAIMS
        ),
        SocketCommand("shop_rates", "what other cells of the shop have learned", "the journal", (OFFERS,)),
    )
}
"""An order is answered when it is obeyed."""

_WORDS = {str: "a string", int: "a whole number", float: "a number", bool: "true or false", list: "a list"}


def read_request(line: bytes, offered: Iterable[str]) -> tuple[str, dict[str, Any]]:
    """The verb of a request, one of those offered, and its arguments; ValueError says what is wrong with it."""
    from polishd.config.toml_loader import (
        did_you_mean,
        join_words,  # the daemon's: who asks has no need of the models
    )

    known = list(offered)
    try:
        request = _unicode(json.loads(line))
    except (ValueError, RecursionError):
        request = None
    verb, given = (request.get("verb"), request.get("args", {})) if isinstance(request, dict) else (None, {})
    if not isinstance(verb, str) or not isinstance(given, dict) or set(request) - {"verb", "args"}:
        raise ValueError(
            'a request is one JSON object a line, {"verb": ..., "args": {...}} (args may be left away); '
            f"verbs: {join_words(known)}"
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
    """Return the same with each lone surrogate of its text as its escape: no file and no database takes one."""
    if isinstance(value, str):
        return value.encode(errors="backslashreplace").decode()
    if isinstance(value, dict):
        return {_unicode(key): _unicode(one) for key, one in value.items()}
    return [_unicode(one) for one in value] if isinstance(value, list) else value


log = logging.getLogger(__name__)

ANSWER_S = 30.0
ORDER_S = 300.0
"""An order answers when it is obeyed: a lift, a stop, and who does not confirm is waited for."""
NOTHING: Mapping[str, Any] = MappingProxyType({})


def request(
    state_dir: Path, verb: str, within_s: float | None = None, args: Mapping[str, Any] = NOTHING
) -> dict[str, Any]:
    """Ask the daemon of that state folder; its answer has ``ok``, and ``error`` where that is false.

    Verbs and their arguments stand in ``daemon.socket.client``; ``within_s`` is long for those that change something.
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
