"""The one table of routes: what each does, and which role it needs.

The server, the OpenAPI document and docs/web.md follow it.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any

from starlette.requests import Request

from polishd.door.sessions import Session
from polishd.door.users import Role
from polishd.web.api import Api

Handler = Callable[[Api, Request, Session], Awaitable[Any]]

AT_CYCLE = "/api/jobs/{job:int}/cycles/{cycle:int}"


@dataclass(frozen=True, slots=True)
class Route:
    """One of them."""

    method: str
    path: str
    role: Role
    what: str
    does: Handler
    fields: tuple[tuple[str, str], ...] = ()
    """Of its body: name, and JSON type; ``?`` ends the name of one that may be left away."""
    exempt: bool = False
    """From rate limits and lockout: it makes the cell stand still."""


WATCH, OPERATE, ENGINEER = Role
_REASON = (("reason?", "string"),)

ROUTES: tuple[Route, ...] = (
    Route("GET", "/api/session", WATCH, "who is signed in, and the csrf token of the page", Api.who),
    Route("DELETE", "/api/session", WATCH, "sign out", Api.sign_out),
    Route("GET", "/api/state", WATCH, "what the cell does, what its devices told last, and how old that is", Api.state),
    Route("GET", "/api/health", WATCH, "link ages, disk, memory and loop", Api.health),
    Route("GET", "/api/events", WATCH, "what happens, as a stream (SSE): `state`, `happened`", Api.events),
    Route("GET", "/api/alarms", WATCH, "alarms that nobody has acknowledged, the first one first", Api.alarms),
    Route("GET", "/api/queue", WATCH, "the jobs of the queue", Api.queue),
    Route("GET", "/api/jobs", WATCH, "all jobs of the journal", Api.jobs),
    Route("GET", "/api/jobs/{job:int}/cycles", WATCH, "measurements of a job, and the pass after each", Api.cycles),
    Route("GET", AT_CYCLE + "/map/{kind}", WATCH, "a map as an array: `measured`, `predicted`, `removal`", Api.map),
    Route("GET", AT_CYCLE + "/psd", WATCH, "power over spatial frequency of the measured map", Api.psd),
    Route("GET", AT_CYCLE + "/plan", WATCH, "the path, its dwell, compliance and gamma", Api.plan),
    Route("GET", AT_CYCLE + "/certificate", WATCH, "what the dwell's solver proved", Api.certificate),
    Route("GET", "/api/history", WATCH, "what became of the cell's parts", Api.history),
    Route("GET", "/api/journal", WATCH, "what happened and who ordered it, newest first; `?before=N`", Api.journal),
    Route("GET", "/api/config", ENGINEER, "all values of the cell's configuration in force", Api.config),
    Route(
        "POST", "/api/orders/hold", WATCH, "leave contact and wait; not an emergency stop", Api.safe_order, _REASON,
        exempt=True,
    ),
    Route(
        "POST", "/api/orders/stop", WATCH, "leave contact and end; not an emergency stop", Api.safe_order, _REASON,
        exempt=True,
    ),
    Route("POST", "/api/orders/resume", OPERATE, "go on, with a new measurement first", Api.resume, _REASON),
    Route("POST", "/api/approve", OPERATE, "the plan that waits runs", Api.approve, (("program_sha256", "string"),)),
    Route("POST", "/api/alarms/acknowledge", OPERATE, "they were seen", Api.acknowledge, (("alarms", "array"),)),
    Route(
        "POST", "/api/queue/move", OPERATE, "move a job: `before`, `after`, `first`, `last`", Api.move,
        (("job", "string"), ("where", "string"), ("other?", "string")),
    ),
    Route(
        "POST", "/api/queue/remove", OPERATE, "take a job out", Api.remove, (("job", "string"), ("reason?", "string")),
    ),
)  # fmt: skip
"""Beside them: ``POST /api/session`` signs in; ``GET /api/openapi.json`` and the page's files are for everybody."""
