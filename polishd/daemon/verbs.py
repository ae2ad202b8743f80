"""What may be asked of a running daemon: the verbs of its socket. The table in docs/cycle.md is made from this one.

A request is one JSON object a line: ``{"verb": "hold", "args": {"reason": "a scratch"}}``; ``args`` may be left away.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

SUBSCRIBE = "subscribe"


@dataclass(frozen=True, slots=True)
class Argument:
    """One argument."""

    name: str
    kind: type
    what: str
    required: bool = False


@dataclass(frozen=True, slots=True)
class Verb:
    """What is asked, or ordered."""

    name: str
    what: str
    changes: Literal["", "an order", "the queue", "the journal", "an approval"] = ""
    """An order: the cell is another one afterwards."""
    arguments: tuple[Argument, ...] = ()


REASON = Argument("reason", str, "why, for whoever reads the journal and `status`")
BY = Argument("by", str, "who wants it, for the journal; whoever passes an order on says for whom")

FILES = Argument(
    "files",
    list,
    "of each job's file `path`, absolute, from whose folder paths in it start, and `content`",
    required=True,
)
ORDERED = (REASON, BY)
PROGRAM = Argument("program_sha256", str, "hash of its program, as `live` tells it", required=True)
ALARMS = Argument("alarms", list, "numbers of events in the journal", required=True)
CLAIM = Argument("claim", str, "by which a shop gave the part of this one job to the cell")
CLAIMS = (
    Argument("stands", list, "claims: their parts are this cell's, and may begin"),
    Argument("back", list, "claims that the shop wants back: those that wait are taken out"),
    Argument("lost", list, "claims that the shop has given up: their parts may not begin, nor go on after a hold"),
)
OFFERS = Argument("offers", list, "of each `recipe`, `cell`, `job`, `of_cycle`, `at_s`, `rate`, `sigma`", required=True)
JOB = Argument("job", str, "`job.id`", required=True)
WHERE = Argument("where", str, "`before`, `after`, `first` or `last`", required=True)
OTHER = Argument("other", str, "the job that waits before or after which")

VERBS: Mapping[str, Verb] = {
    verb.name: verb
    for verb in (
        Verb("status", "state and why, phase, cycle, devices, health, what was measured so far"),
        Verb("live", "state, what the devices told last, each with its age, signals and health"),
        Verb(SUBSCRIBE, "events from now on, one a line, until either side ends"),
        Verb("hold", "leave contact, stand still, and wait for `resume`", "an order", ORDERED),
        Verb("resume", "go on, with a new measurement first", "an order", ORDERED),
        Verb("stop", "leave contact, stand still, and end the daemon", "an order", ORDERED),
        Verb("estop", "stop motion at once, whatever the part costs; then wait for `resume`", "an order", ORDERED),
        Verb("approve", "the plan that waits may run (`job.approve`)", "an approval", (PROGRAM, BY)),
        Verb("acknowledge", "a person has seen these alarms", "the journal", (ALARMS, BY)),
        Verb("job_list", "the jobs of the queue: that under way, those that wait, those that ended"),
        Verb("job_add", "put jobs at the end of the queue, all or none", "the queue", (FILES, BY, CLAIM)),
        Verb("job_move", "move a job that waits", "the queue", (JOB, WHERE, OTHER, BY)),
        Verb(
            "job_remove",
            "take a job out that waits, or put the one aside over which the cell is held",
            "the queue",
            (JOB, REASON, BY),
        ),
        Verb("shop_word", "what the shop says of the parts that it gave to this cell", "the queue", CLAIMS),
        Verb("shop_offer", "what other cells of the shop have learned", "the journal", (OFFERS,)),
    )
}
"""An order is answered when it is obeyed."""

_WORDS = {str: "a string", int: "a whole number", float: "a number", bool: "true or false", list: "a list"}


def read_request(line: bytes, offered: Iterable[str]) -> tuple[str, dict[str, Any]]:
    """The verb of a request, one of those offered, and its arguments; ValueError says what is wrong with it."""
    from polishd.config.places import did_you_mean, listed  # the daemon's: who asks has no need of the models

    known = list(offered)
    try:
        request = _unicode(json.loads(line))
    except (ValueError, RecursionError):
        request = None
    verb, given = (request.get("verb"), request.get("args", {})) if isinstance(request, dict) else (None, {})
    if not isinstance(verb, str) or not isinstance(given, dict) or set(request) - {"verb", "args"}:
        raise ValueError(
            'a request is one JSON object a line, {"verb": ..., "args": {...}} (args may be left away); '
            f"verbs: {listed(known)}"
        )
    if verb not in known:
        raise ValueError(f"unknown verb {verb!r}{did_you_mean(verb, known)} Known: {listed(known)}")
    arguments = VERBS[verb].arguments
    kinds = {argument.name: argument.kind for argument in arguments}
    if missing := [argument.name for argument in arguments if argument.required and argument.name not in given]:
        raise ValueError(f"{verb}: {', '.join(map(repr, missing))} must be given")
    for name, value in given.items():
        if name not in kinds:
            raise ValueError(f"{verb}: unknown argument {name!r}{did_you_mean(name, kinds)} Known: {listed(kinds)}")
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
