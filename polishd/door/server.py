"""The server of an application: one process, one address, and the errors that all applications answer alike."""

from __future__ import annotations

import logging
from collections.abc import Awaitable, Mapping
from typing import Any

import uvicorn
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.types import ASGIApp

from polishd.config.web import WebSection
from polishd.door.certificates import Certificate, Watch
from polishd.door.connections import Bounded
from polishd.door.finite import finite
from polishd.door.guard import Json, refusal
from polishd.model.errors import ConfigError, JournalDamage, PolishdError

log = logging.getLogger(__name__)

LEAVE_S = 2
"""For so long the process waits at its end for those who watch."""
NONE = ("none of that job", "no such map")
"""Words of what is not there, and was not asked for wrongly."""


def serve(app: ASGIApp, web: WebSection, certificate: Certificate | None) -> None:
    """Until Ctrl-C or SIGTERM, where that section says; ``certificate``: the one that it names."""
    settings = uvicorn.Config(
        app,
        host=web.address,
        port=web.port,
        access_log=False,  # of whoever watches; who ordered what is in a journal
        log_config=None,  # so that what it logs reaches the terminal as all else does
        log_level="warning",
        server_header=False,
        date_header=False,
        proxy_headers=False,
        timeout_keep_alive=30,
        timeout_graceful_shutdown=LEAVE_S,
        http=Bounded,
        ws="none",
    )
    settings.load()
    settings.ssl = None if certificate is None else certificate.context()
    watch = None if certificate is None else Watch(certificate)
    try:
        _Server(settings).run()
    finally:
        if watch is not None:
            watch.end()


class _Server(uvicorn.Server):
    """Says where it listens, once it does."""

    async def startup(self, sockets: list[Any] | None = None) -> None:
        await super().startup(sockets)
        scheme = "https" if self.config.ssl is not None else "http"
        for server in self.servers:
            for socket in server.sockets:
                host, port = socket.getsockname()[:2]
                name = f"[{host}]" if ":" in host else host
                print(f"{scheme}://{name}:{port}/", flush=True)  # noqa: T201 - whoever started it waits for this line


async def answered(work: Awaitable[Any]) -> Response:
    """What a handler gives, as JSON; an error of the tree as a refusal."""
    try:
        found = await work
    except JournalDamage as error:
        return refusal(503, str(error))
    except ConfigError as error:
        return refusal(404 if any(said in str(error) for said in NONE) else 400, str(error))
    except PolishdError as error:
        return refusal(502, str(error))
    return found if isinstance(found, Response) else Json(finite(found))


async def _no_such(_request: Request, error: Exception) -> Response:
    status = error.status_code if isinstance(error, HTTPException) else 500
    said = refusal(status, "there is nothing of that name" if status == 404 else "that cannot be done there")
    said.headers.update((isinstance(error, HTTPException) and error.headers) or {})  # 405 says what can be done
    return said


async def _fault(request: Request, error: Exception) -> Response:
    """It is in the log; nobody outside is told what the source looks like."""
    log.error("%s %s failed: %s", request.method, request.url.path, type(error).__name__)
    return refusal(500, "a fault of polishd; its log says more")


HANDLERS: Mapping[Any, Any] = {HTTPException: _no_such, Exception: _fault}
"""Of a Starlette application: how it answers what nobody foresaw."""
