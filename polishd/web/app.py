"""The application of a cell: its routes behind the guard, and the page's files; and the server that serves it."""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager
from importlib import resources

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route as Path
from starlette.types import ASGIApp

from polishd.config.cell import CellConfig
from polishd.door import server as door
from polishd.door.certificates import Certificate
from polishd.door.guard import Json, RequestGuard, hosts_of, refusal
from polishd.door.limits import RateLimiter
from polishd.door.server import HANDLERS, answered
from polishd.door.sessions import SessionStore, address_of, forged
from polishd.door.users import Role, UserFile, users_path
from polishd.model.errors import PolishdError
from polishd.web.api import Api
from polishd.web.openapi import document
from polishd.web.routes import ROUTES, ApiRoute
from polishd.web.watcher import polling_daemon

FILES = {
    "/": ("index.html", "text/html"),
    "/page.css": ("page.css", "text/css"),
    "/page.js": ("page.js", "text/javascript"),
    "/draw.js": ("draw.js", "text/javascript"),
    "/strings.js": ("strings.js", "text/javascript"),
}
"""All that is served beside the API, by its path: nothing else can be asked for."""


def application(config: CellConfig, certificate: Certificate | None = None) -> ASGIApp:
    """Of that cell; its users are read as they are at each request. ``certificate``: the one by which it is served."""
    sessions = SessionStore(UserFile(users_path(config)))
    api, rate = Api(config, sessions, certificate), RateLimiter()

    @asynccontextmanager
    async def lifespan(_app: Starlette) -> AsyncIterator[None]:
        async with polling_daemon(config.state_dir) as watcher:
            api.watcher = watcher
            yield

    async def sign_in(request: Request) -> Response:
        return await answered(api.sign_in(request, rate))

    async def described(_request: Request) -> Response:
        return Json(document())

    routes = [Path(route.path, _endpoint(api, rate, route), methods=[route.method]) for route in ROUTES]
    routes += [
        Path("/api/session", sign_in, methods=["POST"]),
        Path("/api/openapi.json", described, methods=["GET"]),
        *(Path(route.path, _endpoint(api, rate, route), methods=[route.method]) for route in _metrics(config)),
        *(Path(path, _file(*file), methods=["GET"]) for path, file in FILES.items()),
    ]
    app = Starlette(routes=routes, lifespan=lifespan, exception_handlers=HANDLERS)
    return RequestGuard(app, hosts_of(config.web))


def serve(config: CellConfig) -> None:
    """Until Ctrl-C or SIGTERM. ConfigError where it would listen beyond this computer without users."""
    web = config.web
    if not web.loopback and not UserFile(users_path(config)):
        raise config.error("web.address", "is beyond this computer, and there are no users; add one: polishd web "
                           "CELL.toml --add-user NAME --role ROLE")  # fmt: skip
    certificate = Certificate.of(config, web)
    door.serve(application(config, certificate), web, certificate)


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
        return await answered(route.does(api, request, session))

    return answer


def _metrics(config: CellConfig) -> Iterator[ApiRoute]:
    """One, where they are wanted. ConfigError where their library is missing."""
    if not config.web.metrics:
        return
    try:
        from polishd.web.metrics import Metrics
    except ImportError as error:
        raise config.error("web.metrics", "needs prometheus-client, which is not installed: pip install "
                           "'polishd[metrics]', or leave it out") from error  # fmt: skip
    metrics = Metrics(config)
    yield ApiRoute("GET", "/metrics", Role.WATCH, "figures for Prometheus", metrics.answer)


def _file(name: str, kind: str) -> Callable[[Request], Awaitable[Response]]:
    content = (resources.files("polishd.web") / "static" / name).read_bytes()

    async def answer(_request: Request) -> Response:
        return Response(content, media_type=f"{kind}; charset=utf-8")

    return answer
