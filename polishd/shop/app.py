"""The shop's API: cells report and ask by their tokens, people and programs add parts, look, and release them."""

from __future__ import annotations

import asyncio
import base64
import binascii
import json
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from polishd.config.shop import ShopFile
from polishd.door import server as door
from polishd.door.certificates import Certificate
from polishd.door.finite import json_object, require_unicode
from polishd.door.guard import RequestGuard, hosts_of, refusal
from polishd.door.limits import RateLimiter
from polishd.door.server import HANDLERS, answered
from polishd.door.sessions import SessionStore, address_of, forged
from polishd.door.users import Role, UserFile
from polishd.model.errors import ConfigError, PolishdError
from polishd.shop import feed, parts, views
from polishd.shop.database import Database, DatabaseTransaction
from polishd.shop.jobs import digests, part_of

BODY_BYTES = 16 << 20
"""Of a report, or of a job with its files."""

Work = Callable[[DatabaseTransaction, str, dict[str, Any]], Any]
"""One whole transaction: (it, who asks, what was sent) -> what is answered."""


def cells_of(shop: ShopFile) -> UserFile:
    """Names of its cells, and hashes of their tokens."""
    return UserFile(shop.state_dir / "shop-cells.json")


def people_of(shop: ShopFile) -> UserFile:
    """The same of its people and programs."""
    return UserFile(shop.state_dir / "shop-users.json" if shop.web.users is None else shop.resolve(shop.web.users))


def application(shop: ShopFile, database: Database, certificate: Certificate | None = None) -> RequestGuard:
    """Of that shop; ``certificate``: the one by which it is served."""
    cells, people, rate = SessionStore(cells_of(shop)), SessionStore(people_of(shop)), RateLimiter()

    def of_cell(path: str, work: Work) -> Route:
        return Route(f"/api/cell/{path}", _endpoint(database, cells, rate, Role.WATCH, work), methods=["POST"])

    def of_people(path: str, work: Work, role: Role = Role.WATCH) -> Route:
        method = "GET" if role is Role.WATCH else "POST"
        return Route(f"/api/{path}", _endpoint(database, people, rate, role, work), methods=[method])

    def status(sql: DatabaseTransaction, _who: str, _said: dict[str, Any]) -> Any:
        tls = None if certificate is None else certificate.facts()
        return {"shop": shop.shop.name, "certificate": tls, **views.status_view(sql, cells_of(shop))}

    routes = [
        of_cell("report", _report),
        of_cell("claim", lambda sql, cell, said: parts.claim(sql, cell, _text(said, "request"))),
        of_cell("refuse", _refuse),
        of_cell("file", _file),
        of_people("status", status),
        of_people("parts", lambda sql, _who, _said: {**views.parts_view(sql), "words": views.words(sql)}),
        of_people("history", lambda sql, _who, _said: views.history(sql)),
        of_people("lessons", lambda sql, _who, _said: views.lessons(sql)),
        of_people("add", _add, Role.OPERATE),
        of_people("release", _release, Role.OPERATE),
        of_people("remove", _remove, Role.OPERATE),
    ]
    return RequestGuard(Starlette(routes=routes, exception_handlers=HANDLERS), hosts_of(shop.web), BODY_BYTES)


def serve(shop: ShopFile) -> None:
    """Until Ctrl-C or SIGTERM. ConfigError where it would listen beyond this computer and nobody has a token."""
    if not shop.web.loopback and not (people_of(shop) or cells_of(shop)):
        raise shop.error("web.address", "is beyond this computer, and nobody has a token; make one: polishd shop serve "
                         "SHOP.toml --add-cell NAME")  # fmt: skip
    certificate = Certificate.of(shop, shop.web)
    with Database.open(shop.state_dir) as database:
        door.serve(application(shop, database, certificate), shop.web, certificate)


def _endpoint(
    database: Database, sessions: SessionStore, rate: RateLimiter, role: Role, work: Work
) -> Callable[[Request], Awaitable[Response]]:
    async def answer(request: Request) -> Response:
        try:
            session = sessions.of(request)
        except PolishdError as error:
            return refusal(503, str(error))
        if not rate.takes(f"address {address_of(request)}" if session is None else f"user {session.user.name}"):
            return refusal(429, "too many requests")
        if session is None:
            return refusal(401, "bring a token of this shop: Authorization: Bearer TOKEN")
        if not session.user.role.may(role):
            return refusal(403, f"needs the role {role.value}")
        if request.method != "GET" and (why := forged(request, session)):
            return refusal(403, why)
        return await answered(_worked(database, work, session.user.name, await request.body()))

    return answer


async def _worked(database: Database, work: Work, who: str, body: bytes) -> Any:
    def transaction() -> Any:
        said = _json(body)
        with database.transaction() as sql:
            return work(sql, who, said)

    found = await asyncio.to_thread(transaction)
    return found if isinstance(found, Response) else {"ok": True, **found}


def _report(sql: DatabaseTransaction, cell: str, said: dict[str, Any]) -> Any:
    try:
        report = feed.CellReport(**said)
        upto = feed.take(sql, cell, report)
        word = parts.report(sql, cell, report.journal, report.claims)
    except (TypeError, ValueError, KeyError, AttributeError) as error:
        raise ConfigError(f"that is no report of a cell: {type(error).__name__}; are both of one polishd?") from error
    told = {"stands": word.stands, "back": word.back, "lost": word.lost}
    return {"upto": upto, **told, "offers": feed.offers(sql, cell)}


def _refuse(sql: DatabaseTransaction, cell: str, said: dict[str, Any]) -> Any:
    parts.refuse(sql, cell, _text(said, "request"), _text(said, "why")[:2000])
    return {}


def _file(sql: DatabaseTransaction, _cell: str, said: dict[str, Any]) -> Any:
    found = sql.row("SELECT content FROM file WHERE sha256 = ?", _text(said, "sha256"))
    if found is None:
        raise ConfigError("there is no file of that hash")
    return Response(found["content"], media_type="application/octet-stream")


def _add(sql: DatabaseTransaction, who: str, said: dict[str, Any]) -> Any:
    files = said.get("files", {})
    if not isinstance(files, dict):
        raise ConfigError("files is an object: base64 of each content by its name")
    try:
        part = part_of(
            _text(said, "content"),
            {str(Path(name)): base64.b64decode(one, validate=True) for name, one in files.items()},
        )
    except (binascii.Error, TypeError, ValueError) as error:
        raise ConfigError("files is an object: base64 of each content by its name") from error
    parts.add(sql, [part], who, [digests(part)])
    return {"added": part.job}


def _release(sql: DatabaseTransaction, who: str, said: dict[str, Any]) -> Any:
    gone = said.get("cell_is_gone", False) is True
    return {"said": parts.release(sql, _text(said, "job"), who, str(said.get("why", ""))[:500], gone=gone)}


def _remove(sql: DatabaseTransaction, who: str, said: dict[str, Any]) -> Any:
    parts.remove(sql, _text(said, "job"), who, str(said.get("why", ""))[:500])
    return {}


def _json(body: bytes) -> dict[str, Any]:
    found = json_object(body)
    if b"\\u" in body:  # without such an escape there is nothing but Unicode in it
        require_unicode(json.dumps(found, ensure_ascii=False), "the body")
    return found


def _text(said: dict[str, Any], key: str) -> str:
    found = said.get(key)
    if not isinstance(found, str) or not found:
        raise ConfigError(f"{key} must be given, as text")
    return found
