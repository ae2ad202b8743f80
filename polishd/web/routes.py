"""The application of a cell: its routes behind the guard, the page's files, and the server."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass
from typing import Any

from starlette.applications import Starlette
from starlette.convertors import Convertor, register_url_convertor
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route as Path
from starlette.types import ASGIApp

from polishd import __version__
from polishd.config.cell import CellConfig
from polishd.model.errors import PolishdError
from polishd.util.extras import missing_message
from polishd.web.api import MOST_NUMBER, Api
from polishd.web.http import server as http_server
from polishd.web.http.certificates import Certificate
from polishd.web.http.server import HANDLERS, JsonAnswer, RateLimiter, RequestGuard, hosts_of, json_response, refusal
from polishd.web.http.static_files import static_files
from polishd.web.http.users import HttpSession, Role, SessionStore, UserFile, address_of, forged, users_path
from polishd.web.map_data import ENCODINGS, LEAST_PX, MAP_KINDS
from polishd.web.part_history import MOST_PAGE, RESULTS, SORTS
from polishd.web.run_data import LARGEST_PLAN
from polishd.web.watcher import polling_daemon


class _NumberConvertor(Convertor[int]):
    """Numbers in a path: as ``int``, without numbers of more digits than the journal's, which ``int()`` may refuse."""

    regex = f"[0-9]{{1,{len(str(MOST_NUMBER))}}}"

    def convert(self, value: str) -> int:
        return int(value)

    def to_string(self, value: int) -> str:
        return str(value)


register_url_convertor("number", _NumberConvertor())

# The table of routes: handler and required role.

Handler = Callable[[Api, Request, HttpSession], Awaitable[Any]]

AT_CYCLE = "/api/jobs/{job:number}/cycles/{cycle:number}"
AT_FILE = "/api/jobs/{job:number}/files/{name}"
AT_MAP = AT_CYCLE + "/map/{kind}"


@dataclass(frozen=True, slots=True)
class ApiRoute:
    """One route."""

    method: str
    path: str
    role: Role
    what: str
    does: Handler
    fields: tuple[tuple[str, str], ...] = ()
    """Fields of its body: name and JSON type; ``?`` ends the name of an optional one."""
    exempt: bool = False
    """Exempt from rate limits and lockout: it makes the cell stand still."""


WATCH, OPERATE, ENGINEER = Role
_REASON = (("reason?", "string"),)

ROUTES: tuple[ApiRoute, ...] = (
    ApiRoute("GET", "/api/session", WATCH, "who is signed in, and the csrf token of the page", Api.who),
    ApiRoute("DELETE", "/api/session", WATCH, "sign out", Api.sign_out),
    ApiRoute("GET", "/api/state", WATCH, "state of the cell, last readings of its devices, and their ages", Api.state),
    ApiRoute("GET", "/api/health", WATCH, "link ages, disk, memory and loop", Api.health),
    ApiRoute("GET", "/api/events", WATCH, "events as a stream (SSE): `state`, `happened`", Api.events),
    ApiRoute("GET", "/api/overview", WATCH, "limits, tolerance, progress of pass and phase, time left", Api.overview),
    ApiRoute("GET", "/api/readings", WATCH, "force and speed of the last ten minutes, twice a second", Api.readings),
    ApiRoute("GET", "/api/alarms", WATCH, "alarms that are not acknowledged, the oldest first", Api.alarms),
    ApiRoute("GET", "/api/queue", WATCH, "the jobs of the queue", Api.queue),
    ApiRoute("GET", "/api/jobs", WATCH, "all jobs of the journal", Api.jobs),
    ApiRoute("GET", "/api/jobs/{job:number}", WATCH, "one part: result, passes, approvals, files", Api.job),
    ApiRoute("GET", AT_FILE, WATCH, "a picture, the report or a certificate of its run folder", Api.file),
    ApiRoute(
        "GET", "/api/jobs/{job:number}/cycles", WATCH, "measurements of a job, and the pass after each", Api.cycles
    ),
    ApiRoute("GET", AT_MAP, WATCH, f"a map as an array: {', '.join(f'`{kind}`' for kind in MAP_KINDS)}", Api.map),
    ApiRoute("GET", AT_CYCLE + "/psd", WATCH, "power over spatial frequency of the measured map", Api.psd),
    ApiRoute("GET", AT_CYCLE + "/plan", WATCH, "the path, its dwell, compliance and gamma", Api.plan),
    ApiRoute("GET", AT_CYCLE + "/cell", WATCH, "the robot's joints along the plan, its path and the part", Api.cell),
    ApiRoute("GET", AT_CYCLE + "/certificate", WATCH, "certificate of the solved dwell", Api.certificate),
    ApiRoute("GET", "/api/history", WATCH, "the cell's parts, filtered, sorted, in pages", Api.history),
    ApiRoute("GET", "/api/history/weeks", WATCH, "figures of the cell's parts by week", Api.weeks),
    ApiRoute(
        "GET",
        "/api/plans/{program}",
        WATCH,
        "figures of a plan that waits for approval, and of the last pass",
        Api.waiting_plan,
    ),
    ApiRoute("GET", "/api/journal", WATCH, "events with their users, newest first; `?before=N`", Api.journal),
    ApiRoute("GET", "/api/config", ENGINEER, "all values of the cell's configuration in force", Api.config),
    ApiRoute(
        "POST",
        "/api/orders/hold",
        WATCH,
        "leave contact and wait; not an emergency stop",
        Api.safe_order,
        _REASON,
        exempt=True,
    ),
    ApiRoute(
        "POST",
        "/api/orders/stop",
        WATCH,
        "leave contact and end; not an emergency stop",
        Api.safe_order,
        _REASON,
        exempt=True,
    ),
    ApiRoute("POST", "/api/orders/resume", OPERATE, "continue, with a new measurement first", Api.resume, _REASON),
    ApiRoute("POST", "/api/approve", OPERATE, "approve the waiting plan", Api.approve, (("program_sha256", "string"),)),
    ApiRoute("POST", "/api/alarms/acknowledge", OPERATE, "acknowledge alarms", Api.acknowledge, (("alarms", "array"),)),
    ApiRoute(
        "POST",
        "/api/queue/move",
        OPERATE,
        "move a job: `before`, `after`, `first`, `last`",
        Api.move,
        (("job", "string"), ("where", "string"), ("other?", "string")),
    ),
    ApiRoute(
        "POST",
        "/api/queue/remove",
        OPERATE,
        "remove a job",
        Api.remove,
        (("job", "string"), ("reason?", "string")),
    ),
)
"""Beside them: ``POST /api/session`` signs in; ``GET /api/openapi.json`` and the page's files are public."""


# The OpenAPI document, from the table of routes.

ERROR = {"type": "object", "properties": {"ok": {"type": "boolean"}, "error": {"type": "string"}}}
NUMBER = {"type": "integer", "minimum": 0, "maximum": MOST_NUMBER}
TYPES = {"string": {"type": "string"}, "array": {"type": "array", "items": NUMBER}}
PATH_SCHEMAS: Mapping[str, Any] = {
    "kind": {"enum": list(MAP_KINDS)},
    "name": TYPES["string"],
    "program": {"type": "string", "pattern": "^[0-9a-f]{64}$"},
}
_PARTS = {"text": TYPES["string"], "result": {"enum": list(RESULTS)}, "since": NUMBER, "until": NUMBER}
QUERIES: Mapping[str, Mapping[str, Any]] = {
    "/api/journal": {"before": NUMBER},
    "/api/history": {
        **_PARTS,
        "sort": {"enum": [sign + name for name in SORTS for sign in ("", "-")]},
        "offset": NUMBER,
        "limit": {"type": "integer", "minimum": 0, "maximum": MOST_PAGE},
    },
    "/api/history/weeks": _PARTS,
    AT_CYCLE + "/plan": {"points": {"type": "integer", "minimum": 2, "maximum": LARGEST_PLAN}},
    AT_MAP: {
        "px": {"type": "integer", "minimum": LEAST_PX, "maximum": max(ENCODINGS.values())},
        "encoding": {"enum": list(ENCODINGS)},
    },
}
"""Schemas of the query of a route, by its path."""
REFUSALS = {
    "400": "the request is wrong, and says how",
    "401": "not signed in",
    "403": "the role does not suffice, or the request is forged",
    "404": "there is none",
    "405": "that cannot be done there",
    "408": "the body came too slowly",
    "409": "the daemon refuses it, and says why",
    "413": "the body is too large",
    "421": "asked for by a name that is none of this server's",
    "429": "too many requests",
    "502": "the daemon answered what cannot be understood",
    "503": "no daemon runs, or the journal is damaged",
    "504": "the daemon does not answer",
}


def document() -> dict[str, Any]:
    """The document, in OpenAPI 3.1."""
    paths: dict[str, dict[str, Any]] = {}
    for route in ROUTES:
        paths.setdefault(open_path(route.path), {})[route.method.lower()] = _operation(route)
    token = {"type": "object", "properties": {"token": {"type": "string"}}, "required": ["token"]}
    sign_in = {"summary": "sign in: a cookie for a token", "security": [], "requestBody": _body(token)}
    paths["/api/session"]["post"] = {**sign_in, "responses": _responses()}
    paths["/api/openapi.json"] = {"get": {"summary": "this document", "security": [], "responses": _responses()}}
    schemes = {
        "token": {"type": "http", "scheme": "bearer"},
        "cookie": {"type": "apiKey", "in": "cookie", "name": "polishd"},
    }
    return {
        "openapi": "3.1.0",
        "info": {"title": "polishd", "version": __version__, "description": "Hold and stop are no emergency stop."},
        "paths": paths,
        "components": {"securitySchemes": schemes},
        "security": [{"token": []}, {"cookie": []}],
    }


def open_path(path: str) -> str:
    """A route in OpenAPI syntax."""
    return re.sub(r":number}", "}", path)


def _operation(route: ApiRoute) -> dict[str, Any]:
    names = re.findall(r"{(\w+)(:number)?}", route.path)
    found: dict[str, Any] = {
        "summary": route.what,
        "description": f"Needs the role {route.role.value}, or more.",
        "responses": _responses(stream=route.path == "/api/events", order=route.method == "POST"),
        "parameters": [
            {"name": name, "in": "path", "required": True, "schema": NUMBER if number else PATH_SCHEMAS[name]}
            for name, number in names
        ],
    }
    for name, schema in QUERIES.get(route.path, {}).items():
        found["parameters"].append({"name": name, "in": "query", "schema": schema})
    if route.fields:
        properties = {name.rstrip("?"): TYPES[kind] for name, kind in route.fields}
        required = [name for name, _ in route.fields if not name.endswith("?")]
        schema = {"type": "object", "properties": properties, **({"required": required} if required else {})}
        # standing still is always safe: the order is taken with any body
        found["requestBody"] = _body({} if route.exempt else schema, required=bool(required))
    return found


def _body(schema: dict[str, Any], *, required: bool = True) -> dict[str, Any]:
    return {"required": required, "content": {"application/json": {"schema": schema}}}


def _responses(*, stream: bool = False, order: bool = False) -> dict[str, Any]:
    kind = "text/event-stream" if stream else "application/json"
    good = {"description": "done", "content": {kind: {"schema": {"type": "string" if stream else "object"}}}}
    error = {"application/json": {"schema": ERROR}}
    later = {"202": {**good, "description": "not obeyed yet; it stands"}} if order else {}
    return {"200": good, **later, **{code: {"description": why, "content": error} for code, why in REFUSALS.items()}}


def application(config: CellConfig, certificate: Certificate | None = None) -> ASGIApp:
    """Application of a cell; its users are read at each request. ``certificate``: of this server."""
    sessions = SessionStore(UserFile(users_path(config)))
    api, rate = Api(config, sessions, certificate), RateLimiter()

    @asynccontextmanager
    async def lifespan(_app: Starlette) -> AsyncIterator[None]:
        async with polling_daemon(config.state_dir) as watcher:
            api.watcher = watcher
            reading = asyncio.get_running_loop().run_in_executor(None, api.read_history)
            yield
            await reading

    async def sign_in(request: Request) -> Response:
        return await json_response(api.sign_in(request, rate))

    async def described(_request: Request) -> Response:
        return JsonAnswer(document())

    routes = [Path(route.path, _endpoint(api, rate, route), methods=[route.method]) for route in ROUTES]
    routes += [
        Path("/api/session", sign_in, methods=["POST"]),
        Path("/api/openapi.json", described, methods=["GET"]),
        *(Path(route.path, _endpoint(api, rate, route), methods=[route.method]) for route in _metrics(config)),
        *(Path(path, file.answer, methods=["GET"]) for path, file in static_files().items()),
    ]
    app = Starlette(routes=routes, lifespan=lifespan, exception_handlers=HANDLERS)
    return RequestGuard(app, hosts_of(config.web))


def serve(config: CellConfig) -> None:
    """Serve until Ctrl-C or SIGTERM. ConfigError where it would listen beyond this computer without users."""
    web = config.web
    if not web.loopback and not UserFile(users_path(config)):
        raise config.error("web.address", "is beyond this computer, and there are no users; add one: polishd web "
                           "CELL.toml --add-user NAME --role ROLE")  # fmt: skip
    certificate = Certificate.of(config, web)
    http_server.serve(application(config, certificate), web, certificate)


def _endpoint(api: Api, rate: RateLimiter, route: ApiRoute) -> Callable[[Request], Awaitable[Response]]:
    async def answer(request: Request) -> Response:
        try:
            session = api.sessions.of(request, exempt=route.exempt)
        except PolishdError as error:
            return refusal(503, str(error))
        name = f"address {address_of(request)}" if session is None else f"user {session.user.name}"
        if not route.exempt and not rate.takes(name):
            return refusal(429, "too many requests")
        if session is None:
            return refusal(401, "sign in first, or bring a token: Authorization: Bearer TOKEN")
        if not session.user.role.may(route.role):
            return refusal(403, f"needs the role {route.role.value}")
        if route.method != "GET" and (why := forged(request, session)):
            return refusal(403, why)
        return await json_response(route.does(api, request, session))

    return answer


def _metrics(config: CellConfig) -> Iterator[ApiRoute]:
    """Metrics, where they are configured. ConfigError where their library is missing."""
    if not config.web.metrics:
        return
    try:
        from polishd.web.metrics import Metrics
    except ImportError as error:
        raise config.error("web.metrics", missing_message("GET /metrics", "metrics") + ", or remove the key") from error
    metrics = Metrics(config)
    yield ApiRoute("GET", "/metrics", Role.WATCH, "figures for Prometheus", metrics.answer)
