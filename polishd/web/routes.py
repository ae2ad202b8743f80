"""The one table of routes: what each does, and which role it needs.

The server, the OpenAPI document and docs/web.md follow it.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Any

from starlette.requests import Request

from polishd.door.sessions import HttpSession
from polishd.door.users import Role
from polishd.web.api import Api

Handler = Callable[[Api, Request, HttpSession], Awaitable[Any]]

AT_CYCLE = "/api/jobs/{job:int}/cycles/{cycle:int}"


@dataclass(frozen=True, slots=True)
class ApiRoute:
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

ROUTES: tuple[ApiRoute, ...] = (
    ApiRoute("GET", "/api/session", WATCH, "who is signed in, and the csrf token of the page", Api.who),
    ApiRoute("DELETE", "/api/session", WATCH, "sign out", Api.sign_out),
    ApiRoute("GET", "/api/state", WATCH, "what the cell does, what its devices told last, and how old that is", Api.state),
    ApiRoute("GET", "/api/health", WATCH, "link ages, disk, memory and loop", Api.health),
    ApiRoute("GET", "/api/events", WATCH, "what happens, as a stream (SSE): `state`, `happened`", Api.events),
    ApiRoute("GET", "/api/alarms", WATCH, "alarms that nobody has acknowledged, the first one first", Api.alarms),
    ApiRoute("GET", "/api/queue", WATCH, "the jobs of the queue", Api.queue),
    ApiRoute("GET", "/api/jobs", WATCH, "all jobs of the journal", Api.jobs),
    ApiRoute("GET", "/api/jobs/{job:int}/cycles", WATCH, "measurements of a job, and the pass after each", Api.cycles),
    ApiRoute("GET", AT_CYCLE + "/map/{kind}", WATCH, "a map as an array: `measured`, `predicted`, `removal`", Api.map),
    ApiRoute("GET", AT_CYCLE + "/psd", WATCH, "power over spatial frequency of the measured map", Api.psd),
    ApiRoute("GET", AT_CYCLE + "/plan", WATCH, "the path, its dwell, compliance and gamma", Api.plan),
    ApiRoute("GET", AT_CYCLE + "/certificate", WATCH, "what the dwell's solver proved", Api.certificate),
    ApiRoute("GET", "/api/history", WATCH, "what became of the cell's parts", Api.history),
    ApiRoute("GET", "/api/journal", WATCH, "what happened and who ordered it, newest first; `?before=N`", Api.journal),
    ApiRoute("GET", "/api/config", ENGINEER, "all values of the cell's configuration in force", Api.config),
    ApiRoute(
        "POST", "/api/orders/hold", WATCH, "leave contact and wait; not an emergency stop", Api.safe_order, _REASON,
        exempt=True,
    ),
    ApiRoute(
        "POST", "/api/orders/stop", WATCH, "leave contact and end; not an emergency stop", Api.safe_order, _REASON,
        exempt=True,
    ),
    ApiRoute("POST", "/api/orders/resume", OPERATE, "go on, with a new measurement first", Api.resume, _REASON),
    ApiRoute("POST", "/api/approve", OPERATE, "the plan that waits runs", Api.approve, (("program_sha256", "string"),)),
    ApiRoute("POST", "/api/alarms/acknowledge", OPERATE, "they were seen", Api.acknowledge, (("alarms", "array"),)),
    ApiRoute(
        "POST", "/api/queue/move", OPERATE, "move a job: `before`, `after`, `first`, `last`", Api.move,
        (("job", "string"), ("where", "string"), ("other?", "string")),
    ),
    ApiRoute(
        "POST", "/api/queue/remove", OPERATE, "take a job out", Api.remove, (("job", "string"), ("reason?", "string")),
    ),
)  # fmt: skip
"""Beside them: ``POST /api/session`` signs in; ``GET /api/openapi.json`` and the page's files are for everybody."""
