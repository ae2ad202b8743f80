"""The server of an application: one process, one address, and common answers to errors."""

from __future__ import annotations

import asyncio
import ipaddress
import json
import logging
import time
from collections import Counter
from collections.abc import Awaitable, Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import h11
import uvicorn
from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol, RequestResponseCycle

from polishd.config.server_sections import WebSection
from polishd.model.errors import ConfigError, JournalDamage, NoSuchResource, PolishdError
from polishd.util.serialization import finite
from polishd.web.http.certificates import Certificate, CertificateMonitor

# Limits of connections: number for each address, and time for the head of a request.

HEAD_S = 10.0
"""Time limit for the head of a request, from its first byte or from the connection."""
MOST_OF_ADDRESS = 300
"""Most open connections from one address: each page has two or three."""
MOST = 1000
"""Most open connections in all."""


class BoundedProtocol(H11Protocol):
    """Uvicorn's protocol with these limits; a client that exceeds them is disconnected."""

    _head: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Accept the connection, or close it where there are too many."""
        super().connection_made(transport)
        host = self.client[0] if self.client else ""
        of_it = sum(
            1 for one in self.connections if isinstance(one, BoundedProtocol) and one.client and one.client[0] == host
        )
        if len(self.connections) > MOST or of_it > MOST_OF_ADDRESS:
            transport.abort()
        else:
            self._await_head()

    def data_received(self, data: bytes) -> None:
        """End the time limit after the head of a request: the guard limits its body.

        The rest of a body after the answer, which no handler reads, has the time limit of a head.
        """
        super().data_received(data)
        if self.conn.their_state is not h11.IDLE and not self._has_responded():
            self._end_head_limit()
        elif self._head is None:
            self._await_head()

    def connection_lost(self, exc: Exception | None) -> None:
        """End the time limit."""
        self._end_head_limit()
        super().connection_lost(exc)

    def _has_responded(self) -> bool:
        cycle: RequestResponseCycle | None = self.cycle  # None before a first request, despite its type
        return cycle is None or cycle.response_complete

    def _await_head(self) -> None:
        self._head = self.loop.call_later(HEAD_S, self._too_slow)

    def _end_head_limit(self) -> None:
        if self._head is not None:
            self._head.cancel()
            self._head = None

    def _too_slow(self) -> None:
        self._head = None
        if not self.transport.is_closing() and self._has_responded():
            self.transport.abort()


# Checks before every handler: host names, size and time of a body, and headers.

BODY_BYTES = 1 << 16
BODY_S = 5.0
"""Time limit for a body of a few bytes."""
LEAST_BYTES_PER_S = 1 << 16
"""Rate at which the time limit of a body grows while it arrives: 16 MiB may take 261 s, and silence ends after 5 s."""
HEADERS = {
    "content-security-policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
        "font-src 'self'; manifest-src 'self'; base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
    ),
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "x-frame-options": "DENY",
}
CACHING = {"cache-control": "no-store"}
"""Of every answer that does not say otherwise, as the page's files do."""


def hosts_of(web: WebSection) -> set[str]:
    """Valid host names, without ports, in the form of ``host_name``."""
    return {host_name(one) for one in ("localhost", "127.0.0.1", "::1", web.address, *web.hosts)}


class RequestGuard:
    """An ASGI application around another one.

    A handler reads the body after it has checked the session: without a session, and for GET, no body is read.
    """

    def __init__(self, app: ASGIApp, hosts: Collection[str], most_bytes: int = BODY_BYTES) -> None:
        self._app, self._hosts, self._most_bytes = app, hosts, most_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Refuse the request, or pass it on with its limited body."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers[name] = value
                for name, value in CACHING.items():
                    headers.setdefault(name, value)
            await send(message)

        headers = Headers(scope=scope)
        if host_name(headers.get("host", "")) not in self._hosts:
            await refusal(421, "this is not one of this server's names; see web.hosts")(scope, receive, with_headers)
            return
        await self._app(scope, _limited(receive, headers, self._most_bytes), with_headers)


def _limited(receive: Receive, headers: Headers, most_bytes: int) -> Receive:
    """Return ``receive`` with limits of size and time until the body has arrived. It raises HTTPException."""
    loop = asyncio.get_running_loop()
    began_s, size, is_complete = loop.time(), 0, False
    length = headers.get("content-length", "0")
    announced = int(length) if length.isdecimal() and len(length) < 20 else most_bytes + 1

    async def limited() -> Message:
        nonlocal size, is_complete
        if is_complete:  # what follows is the end of the connection
            return await receive()
        if max(announced, size) > most_bytes:
            raise HTTPException(413, f"the body is more than {most_bytes} bytes")
        try:
            async with asyncio.timeout_at(began_s + BODY_S + size / LEAST_BYTES_PER_S):
                message = await receive()
        except TimeoutError:
            raise HTTPException(
                408, f"of the body came {size} bytes in {loop.time() - began_s:.0f} s: too slow"
            ) from None
        size += len(message.get("body", b""))
        is_complete = not message.get("more_body", False)
        if size > most_bytes:
            raise HTTPException(413, f"the body is more than {most_bytes} bytes")
        return message

    return limited


class JsonAnswer(JSONResponse):
    """JSON in ASCII: every text can be encoded, and control characters cannot reach a terminal."""

    def render(self, content: Any) -> bytes:
        """See JSONResponse."""
        return json.dumps(content, allow_nan=False, separators=(",", ":")).encode("ascii")


def refusal(status: int, error: str) -> JSONResponse:
    """Error answer in the common form."""
    return JsonAnswer({"ok": False, "error": error}, status)


def host_name(value: str) -> str:
    """Name in a ``Host`` header, without its port."""
    name = value.strip().lower()
    if name.startswith("["):
        name = name[1:].partition("]")[0]
    elif name.count(":") == 1:
        name = name.partition(":")[0]
    try:
        return str(ipaddress.ip_address(name))
    except ValueError:
        return name


log = logging.getLogger(__name__)

LEAVE_S = 2
"""Time for which the process waits at its end for open streams."""


def serve(app: ASGIApp, web: WebSection, certificate: Certificate | None) -> None:
    """Serve at the section's address until Ctrl-C or SIGTERM; ``certificate``: the one of the section."""
    settings = uvicorn.Config(
        app,
        host=web.address,
        port=web.port,
        access_log=False,  # orders are in a journal
        log_config=None,  # so that its log reaches the terminal
        log_level="warning",
        server_header=False,
        date_header=False,
        proxy_headers=False,
        timeout_keep_alive=30,
        timeout_graceful_shutdown=LEAVE_S,
        http=BoundedProtocol,
        ws="none",
    )
    settings.load()
    settings.ssl = None if certificate is None else certificate.context()
    watch = None if certificate is None else CertificateMonitor(certificate)
    try:
        _Server(settings).run()
    finally:
        if watch is not None:
            watch.end()


class _Server(uvicorn.Server):
    """Print the address once it listens."""

    async def startup(self, sockets: list[Any] | None = None) -> None:
        await super().startup(sockets)
        scheme = "https" if self.config.ssl is not None else "http"
        for server in self.servers:
            for socket in server.sockets:
                host, port = socket.getsockname()[:2]
                name = f"[{host}]" if ":" in host else host
                print(f"{scheme}://{name}:{port}/", flush=True)  # noqa: T201 - the starting process waits for this line


async def json_response(work: Awaitable[Any]) -> Response:
    """Result of a handler as JSON; a polishd error as a refusal."""
    try:
        found = await work
    except JournalDamage as error:
        return refusal(503, str(error))
    except NoSuchResource as error:
        return refusal(404, str(error))
    except ConfigError as error:
        return refusal(400, str(error))
    except PolishdError as error:
        return refusal(502, str(error))
    return found if isinstance(found, Response) else JsonAnswer(finite(found))


async def _no_such(_request: Request, error: Exception) -> Response:
    status = error.status_code if isinstance(error, HTTPException) else 500
    detail = str(getattr(error, "detail", ""))
    texts = {404: "there is nothing of that name", 408: detail, 413: detail}
    response = refusal(status, texts.get(status, "that cannot be done there"))
    response.headers.update((isinstance(error, HTTPException) and error.headers) or {})  # 405 lists the allowed methods
    return response


async def _disconnected(_request: Request, _error: Exception) -> Response:
    return refusal(400, "the connection ended before the body")  # it is not read


async def _fault(request: Request, error: Exception) -> Response:
    """Log the fault; the answer reveals nothing about the source."""
    log.error("%s %s failed: %s", request.method, request.url.path, type(error).__name__)
    return refusal(500, "a fault of polishd; its log says more")


HANDLERS: Mapping[Any, Any] = {
    ClientDisconnect: _disconnected,
    HTTPException: _no_such,
    Exception: _fault,
}
"""Exception handlers of a Starlette application."""


# Rate limits and lockout.

PER_S, BURST = 50.0, 100.0
"""Requests of one user, or of one address without a user."""
WRONG, LOCKED_S = 5, 60.0
"""Wrong tokens of one user at one address, and the time of the lockout there."""
BUDGET = 30
"""Wrong tokens of one address for any users, within ``LOCKED_S``."""
MAX_ENTRIES = 10_000
"""Most remembered addresses, and users at addresses."""


class RateLimiter:
    """Token bucket for each name, filled at ``PER_S``."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._remaining: dict[str, tuple[float, float]] = {}

    def takes(self, name: str) -> bool:
        """Whether one more request is allowed."""
        now_s = self._clock()
        remaining, at_s = self._remaining.pop(name, (BURST, now_s))
        remaining = min(BURST, remaining + PER_S * (now_s - at_s))
        self._remaining[name] = (remaining - 1.0 if remaining >= 1.0 else remaining, now_s)
        _forget(self._remaining)
        return remaining >= 1.0


class LoginLockout:
    """Count wrong tokens, by user and address, and by address alone.

    Wrong tokens of others do not lock out a user who has signed in from the same address.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._wrong: dict[tuple[str, str], tuple[float, float]] = {}
        self._spent: dict[str, tuple[float, float]] = {}
        self._signed_in: dict[tuple[str, str], tuple[float, float]] = {}

    def knows(self, address: str, user: str) -> bool:
        """Return whether that user has used a valid token from that address."""
        return (address, user) in self._signed_in

    def locked(self, address: str, user: str) -> bool:
        """Return whether that user is locked out at that address now."""
        key = address, user
        count, at_s = self._wrong.get(key, (0, 0.0))
        if count and self._clock() - at_s > LOCKED_S:
            del self._wrong[key]
            count = 0
        return count >= WRONG or self._budget(address) < 1.0

    def wrong(self, address: str, user: str) -> None:
        """Count one more wrong token; trials of a locked-out user do not count against the address."""
        key = address, user
        count, _ = self._wrong.pop(key, (0, 0.0))
        self._wrong[key] = (count + 1, self._clock())
        remaining = self._budget(address)
        if count < WRONG:
            self._spent.pop(address, None)
            self._spent[address] = (max(remaining - 1.0, 0.0), self._clock())
        _forget(self._wrong)
        _forget(self._spent)

    def right(self, address: str, user: str) -> None:
        """Note that this user has a token and is at that address."""
        key = address, user
        self._wrong.pop(key, None)
        self._signed_in.pop(key, None)
        self._signed_in[key] = (0.0, self._clock())
        _forget(self._signed_in)

    def _budget(self, address: str) -> float:
        remaining, at_s = self._spent.get(address, (float(BUDGET), 0.0))
        return min(float(BUDGET), remaining + BUDGET / LOCKED_S * (self._clock() - at_s))


class ClientShares:
    """Open streams of each user, at most ``most`` each and ``in_all`` together."""

    def __init__(self, most: int, in_all: int) -> None:
        self._most, self._in_all = most, in_all
        self._open: Counter[str] = Counter()

    def refusal(self, user: str) -> tuple[int, str] | None:
        """Return status and reason where one more stream is refused; None where it is allowed."""
        if self._open[user] >= self._most:
            return 429, f"{user} holds {self._most} event streams open, the most for one user: close a page"
        if self._open.total() >= self._in_all:
            return 503, f"{self._in_all} event streams are open, the most for all users: close a page"
        return None

    @contextmanager
    def one(self, user: str) -> Iterator[None]:
        """Hold one stream of that user open inside this block."""
        self._open[user] += 1
        try:
            yield
        finally:
            self._open[user] -= 1
            self._open += Counter()  # forget names at zero


def _forget(entries: dict[Any, tuple[float, float]]) -> None:
    while len(entries) > MAX_ENTRIES:
        del entries[next(iter(entries))]
