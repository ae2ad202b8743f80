"""What stands before every handler: names by which it is asked for, how large and slow a body may be, and headers."""

from __future__ import annotations

import asyncio
import ipaddress
import json
from collections.abc import Collection
from typing import Any

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from polishd.config.web import WebSection

BODY_BYTES = 1 << 16
BODY_S = 5.0
"""Within so long all of a body must have come."""
HEADERS = {
    "content-security-policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
        "base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
    ),
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "x-frame-options": "DENY",
    "cache-control": "no-store",
}


def hosts_of(web: WebSection) -> set[str]:
    """Names by which it may be asked for, without ports."""
    return {"localhost", "127.0.0.1", "::1", web.address.lower(), *(host.lower() for host in web.hosts)}


class RequestGuard:
    """An ASGI application around another one."""

    def __init__(self, app: ASGIApp, hosts: Collection[str], most_bytes: int = BODY_BYTES) -> None:
        self._app, self._hosts, self._most_bytes = app, hosts, most_bytes

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Refuse it, or hand it on with its body whole."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers[name] = value
            await send(message)

        headers = Headers(scope=scope)
        if host_name(headers.get("host", "")) not in self._hosts:
            await refusal(421, "this is not one of this server's names; see web.hosts")(scope, receive, with_headers)
            return
        body = await _taken(scope["method"], headers, receive, self._most_bytes)
        if isinstance(body, JSONResponse):
            await body(scope, receive, with_headers)
            return
        handed = False

        async def whole() -> Message:
            nonlocal handed
            if handed:
                return await receive()
            handed = True
            return {"type": "http.request", "body": body, "more_body": False}

        await self._app(scope, whole, with_headers)


async def _taken(method: str, headers: Headers, receive: Receive, most_bytes: int) -> bytes | JSONResponse:
    """The whole body, or the refusal of it."""
    if method in {"GET", "HEAD"}:
        return b""
    try:
        return await _body(headers, receive, most_bytes)
    except TimeoutError:
        return refusal(408, f"the body did not come within {BODY_S:g} s")
    except ValueError as error:
        return refusal(413, str(error))


class Json(JSONResponse):
    """JSON in ASCII: all text has an encoding, and shown as it came, as by curl, it moves no terminal."""

    def render(self, content: Any) -> bytes:
        """See JSONResponse."""
        return json.dumps(content, allow_nan=False, separators=(",", ":")).encode("ascii")


def refusal(status: int, error: str) -> JSONResponse:
    """In the form that all errors have."""
    return Json({"ok": False, "error": error}, status)


def host_name(value: str) -> str:
    """Of a ``Host`` header, without its port."""
    name = value.strip().lower()
    if name.startswith("["):
        name = name[1:].partition("]")[0]
    elif name.count(":") == 1:
        name = name.partition(":")[0]
    try:
        return str(ipaddress.ip_address(name))
    except ValueError:
        return name


async def _body(headers: Headers, receive: Receive, most_bytes: int) -> bytes:
    told = headers.get("content-length", "0")
    if not told.isdecimal() or int(told) > most_bytes:
        raise ValueError(f"the body is more than {most_bytes} bytes")
    body, more = b"", True
    async with asyncio.timeout(BODY_S):
        while more:
            message = await receive()
            if message["type"] == "http.disconnect":
                return b""
            body += message.get("body", b"")
            more = message.get("more_body", False)
            if len(body) > most_bytes:
                raise ValueError(f"the body is more than {most_bytes} bytes")
    return body
