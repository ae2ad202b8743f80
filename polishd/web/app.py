"""The application of a cell: its routes behind the guard, and the page's files; and the server that serves it."""

from __future__ import annotations

import logging
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from importlib import resources
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route as Path
from starlette.types import ASGIApp

from polishd.config.cell import CellConfig
from polishd.model.errors import ConfigError, PolishdError
from polishd.web.api import Api
from polishd.web.connections import Bounded
from polishd.web.finite import finite
from polishd.web.guard import Guard, hosts_of, refusal
from polishd.web.limits import Rate
from polishd.web.openapi import document
from polishd.web.routes import ROUTES, Route
from polishd.web.sessions import Sessions, address_of, forged
from polishd.web.users import Users, users_path
from polishd.web.watcher import watching

log = logging.getLogger(__name__)

FILES = {
    "/": ("index.html", "text/html"),
    "/page.css": ("page.css", "text/css"),
    "/page.js": ("page.js", "text/javascript"),
    "/draw.js": ("draw.js", "text/javascript"),
    "/strings.js": ("strings.js", "text/javascript"),
}
"""All that is served beside the API, by its path: nothing else can be asked for."""
LEAVE_S = 2
"""For so long the process waits at its end for those who watch."""


def application(config: CellConfig) -> ASGIApp:
    """Of that cell; its users are read as they are at each request."""
    sessions = Sessions(Users(users_path(config)))
    api, rate = Api(config, sessions), Rate()

    @asynccontextmanager
    async def lifespan(_app: Starlette) -> AsyncIterator[None]:
        async with watching(config.state_dir) as watcher:
            api.watcher = watcher
            yield

    async def sign_in(request: Request) -> Response:
        if not rate.takes(f"address {address_of(request)}"):
            return refusal(429, "too many requests")
        return await _answered(api.sign_in(request))

    async def described(_request: Request) -> Response:
        return JSONResponse(document())

    routes = [Path(route.path, _endpoint(api, rate, route), methods=[route.method]) for route in ROUTES]
    routes += [
        Path("/api/session", sign_in, methods=["POST"]),
        Path("/api/openapi.json", described, methods=["GET"]),
        *(Path(path, _file(*file), methods=["GET"]) for path, file in FILES.items()),
    ]
    handlers: dict[Any, Any] = {HTTPException: _no_such, Exception: _fault}
    return Guard(Starlette(routes=routes, lifespan=lifespan, exception_handlers=handlers), hosts_of(config.web))


def serve(config: CellConfig) -> None:
    """Until Ctrl-C or SIGTERM. ConfigError where it would listen beyond this computer without users."""
    web = config.web
    if not web.loopback and not Users(users_path(config)):
        raise config.error("web.address", "is beyond this computer, and there are no users; add one: polishd web "
                           "CELL.toml --add-user NAME --role ROLE")  # fmt: skip
    files = [None if name is None else str(config.resolve(name)) for name in (web.cert, web.key)]
    settings = uvicorn.Config(
        application(config),
        host=web.address,
        port=web.port,
        ssl_certfile=files[0],
        ssl_keyfile=files[1],
        access_log=False,  # of whoever watches; who ordered what is in the journal
        log_level="warning",
        server_header=False,
        date_header=False,
        proxy_headers=False,
        timeout_keep_alive=30,
        timeout_graceful_shutdown=LEAVE_S,
        http=Bounded,
        ws="none",
    )
    _Server(settings).run()


class _Server(uvicorn.Server):
    """Says where it listens, once it does."""

    async def startup(self, sockets: list[Any] | None = None) -> None:
        await super().startup(sockets)
        scheme = "https" if self.config.ssl_certfile else "http"
        for server in self.servers:
            for socket in server.sockets:
                host, port = socket.getsockname()[:2]
                name = f"[{host}]" if ":" in host else host
                print(f"{scheme}://{name}:{port}/", flush=True)  # noqa: T201 - whoever started it waits for this line


def _endpoint(api: Api, rate: Rate, route: Route) -> Callable[[Request], Awaitable[Response]]:
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
        return await _answered(route.does(api, request, session))

    return answer


async def _answered(work: Awaitable[Any]) -> Response:
    try:
        found = await work
    except ConfigError as error:
        return refusal(404 if "none of that job" in str(error) or "no such map" in str(error) else 400, str(error))
    except PolishdError as error:
        return refusal(502, str(error))
    return found if isinstance(found, Response) else JSONResponse(finite(found))


def _file(name: str, kind: str) -> Callable[[Request], Awaitable[Response]]:
    content = (resources.files("polishd.web") / "static" / name).read_bytes()

    async def answer(_request: Request) -> Response:
        return Response(content, media_type=f"{kind}; charset=utf-8")

    return answer


async def _no_such(_request: Request, error: Exception) -> Response:
    status = error.status_code if isinstance(error, HTTPException) else 500
    said = refusal(status, "there is nothing of that name" if status == 404 else "that cannot be done there")
    said.headers.update((isinstance(error, HTTPException) and error.headers) or {})  # 405 says what can be done
    return said


async def _fault(request: Request, error: Exception) -> Response:
    """It is in the log; nobody outside is told what the source looks like."""
    log.error("%s %s failed: %s", request.method, request.url.path, type(error).__name__)
    return refusal(500, "a fault of polishd; its log says more")
