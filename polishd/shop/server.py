"""The shop's API: cells report and request parts; people and programs add, list and release parts."""

from __future__ import annotations

import asyncio
import base64
import binascii
import json
import time
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import asdict
from operator import itemgetter
from pathlib import Path
from typing import Any

from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route

from polishd.config.server_sections import ShopFile
from polishd.model.errors import ConfigError, PolishdError
from polishd.shop import database as feed
from polishd.shop import parts as shop_parts
from polishd.shop.database import Database, DatabaseTransaction
from polishd.shop.parts import digests, part_of
from polishd.util.serialization import json_object, require_unicode
from polishd.web.http import server as http_server
from polishd.web.http.certificates import Certificate
from polishd.web.http.server import HANDLERS, RateLimiter, RequestGuard, hosts_of, json_response, refusal
from polishd.web.http.users import Role, SessionStore, UserFile, address_of, forged

# Views of a shop's data, for people and programs.

UNHEARD_S = 60.0
"""Time without a report after which a cell counts as away."""


def status_view(sql: DatabaseTransaction, names: Iterable[str]) -> dict[str, Any]:
    """Cells with their states and ages, and the number of parts in each state.

    ``names``: of cells with a token; a cell that has never reported has ``heard_s`` None.
    """
    now_s = time.time()
    cells = [
        {
            "cell": row["name"],
            "heard_s": round(max(now_s - row["heard"], 0.0), 1),
            "away": now_s - row["heard"] > UNHEARD_S,
            **json.loads(row["now"]),
            "claims": _count(sql, "SELECT count(*) AS n FROM claim WHERE cell = ? AND ended IS NULL", row["name"]),
            "passes": _count(sql, "SELECT count(*) AS n FROM pass WHERE cell = ?", row["name"]),
        }
        for row in sql.rows("SELECT name, heard, now FROM cell ORDER BY name")
    ]
    silent = set(names) - {cell["cell"] for cell in cells}
    cells += [{"cell": name, "heard_s": None, "away": True, "claims": 0, "passes": 0} for name in silent]
    parts = {row["state"]: row["n"] for row in sql.rows("SELECT state, count(*) AS n FROM part GROUP BY state")}
    return {"cells": sorted(cells, key=itemgetter("cell")), "parts": parts}


def parts_view(sql: DatabaseTransaction) -> dict[str, Any]:
    """All parts in order of arrival, with their cells."""
    rows = sql.rows(
        "SELECT part.job, part.part_id, part.state, part.added, part.by, part.verdict, part.reason, part.ended, "
        "claim.cell, claim.given, claim.back FROM part LEFT JOIN claim ON claim.part = part.id "
        "AND claim.request = (SELECT request FROM claim AS last WHERE last.part = part.id AND last.how NOT IN "
        "('refused', 'given back', 'gone', 'gone, and had begun') ORDER BY given DESC LIMIT 1) ORDER BY part.id"
    )
    why = {row["part"]: row["why"] for row in sql.rows(
        "SELECT part.job AS part, group_concat(not_for.cell || ': ' || not_for.why, '; ') AS why FROM not_for "
        "JOIN part ON part.id = not_for.part WHERE part.state = 'waiting' GROUP BY part.id"
    )}  # fmt: skip
    return {"parts": [{**row, "not_for": why.get(row["job"], "")} for row in rows]}


def decisions(sql: DatabaseTransaction, most: int = 1000) -> list[dict[str, Any]]:
    """The last decisions of the shop, and their authors."""
    return sql.rows("SELECT * FROM (SELECT * FROM word ORDER BY id DESC LIMIT ?) ORDER BY id", most)


def history(sql: DatabaseTransaction) -> dict[str, Any]:
    """All jobs of all cells, in order of their start."""
    maps: dict[tuple[str, ...], list[float]] = {}
    for row in sql.rows("SELECT cell, journal, job, stats FROM map ORDER BY cell, journal, job, cycle"):
        maps.setdefault((row["cell"], row["journal"], row["job"]), []).append(json.loads(row["stats"]).get("rms_nm"))
    jobs = sql.rows(
        "SELECT cell, journal, job AS number, name, part_id, started, ended, ifnull(outcome, '') AS outcome, "
        "(SELECT count(*) FROM pass WHERE pass.cell = job.cell AND pass.journal = job.journal AND pass.job = job.job "
        "AND how = 'done') AS passes FROM job ORDER BY started"
    )
    for job in jobs:
        job["rms_nm"] = maps.get((job["cell"], job["journal"], job.pop("number")), [])
        del job["journal"]
    return {"jobs": jobs}


def lessons(sql: DatabaseTransaction) -> dict[str, Any]:
    """Latest rates of each cell and recipe."""
    return {"lessons": sql.rows("SELECT * FROM lesson ORDER BY recipe, at_s")}


def _count(sql: DatabaseTransaction, query: str, *values: Any) -> int:
    return int(sql.rows(query, *values)[0]["n"])


BODY_BYTES = 16 << 20
"""Largest report, or job with its files."""

Work = Callable[[DatabaseTransaction, str, dict[str, Any]], Any]
"""One transaction: (transaction, user, request) -> answer."""


def cells_of(shop: ShopFile) -> UserFile:
    """The cells' names and token hashes."""
    return UserFile(shop.state_dir / "shop-cells.json")


def users_of(shop: ShopFile) -> UserFile:
    """Names and token hashes of people and programs."""
    return UserFile(shop.state_dir / "shop-users.json" if shop.web.users is None else shop.resolve(shop.web.users))


def application(shop: ShopFile, database: Database, certificate: Certificate | None = None) -> RequestGuard:
    """Application of a shop; ``certificate``: the one of its server."""
    cells, users, rate = SessionStore(cells_of(shop)), SessionStore(users_of(shop)), RateLimiter()

    def cell_route(path: str, work: Work) -> Route:
        return Route(f"/api/cell/{path}", _endpoint(database, cells, rate, Role.WATCH, work), methods=["POST"])

    def user_route(path: str, work: Work, role: Role = Role.WATCH) -> Route:
        method = "GET" if role is Role.WATCH else "POST"
        return Route(f"/api/{path}", _endpoint(database, users, rate, role, work), methods=[method])

    def status(sql: DatabaseTransaction, _user: str, _body: dict[str, Any]) -> Any:
        tls = None if certificate is None else certificate.facts()
        return {"shop": shop.shop.name, "certificate": tls, **status_view(sql, cells_of(shop))}

    routes = [
        cell_route("report", _report),
        cell_route("claim", lambda sql, cell, body: shop_parts.claim(sql, cell, _text(body, "request"))),
        cell_route("refuse", _refuse),
        cell_route("file", _file),
        user_route("status", status),
        user_route("parts", lambda sql, _user, _body: {**parts_view(sql), "words": decisions(sql)}),
        user_route("history", lambda sql, _user, _body: history(sql)),
        user_route("lessons", lambda sql, _user, _body: lessons(sql)),
        user_route("add", _add, Role.OPERATE),
        user_route("release", _release, Role.OPERATE),
        user_route("remove", _remove, Role.OPERATE),
    ]
    return RequestGuard(Starlette(routes=routes, exception_handlers=HANDLERS), hosts_of(shop.web), BODY_BYTES)


def serve(shop: ShopFile) -> None:
    """Serve until Ctrl-C or SIGTERM. ConfigError where it would listen beyond this computer without any token."""
    if not shop.web.loopback and not (users_of(shop) or cells_of(shop)):
        raise shop.error("web.address", "is beyond this computer, and there is no token; make one: polishd shop serve "
                         "SHOP.toml --add-cell NAME")  # fmt: skip
    certificate = Certificate.of(shop, shop.web)
    with Database.open(shop.state_dir) as database:
        http_server.serve(application(shop, database, certificate), shop.web, certificate)


def _endpoint(
    database: Database, sessions: SessionStore, rate: RateLimiter, role: Role, work: Work
) -> Callable[[Request], Awaitable[Response]]:
    async def respond(request: Request) -> Response:
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
        return await json_response(_run_transaction(database, work, session.user.name, await request.body()))

    return respond


async def _run_transaction(database: Database, work: Work, user: str, body: bytes) -> Any:
    def transaction() -> Any:
        parsed = _json(body)
        with database.transaction() as sql:
            return work(sql, user, parsed)

    found = await asyncio.to_thread(transaction)
    return found if isinstance(found, Response) else {"ok": True, **found}


def _report(sql: DatabaseTransaction, cell: str, body: dict[str, Any]) -> Any:
    try:
        report = feed.CellReport(**body)
        upto = feed.take(sql, cell, report)
        reply = shop_parts.report(sql, cell, report.journal, report.claims)
    except (TypeError, ValueError, KeyError, AttributeError, OverflowError) as error:
        raise ConfigError(f"that is no report of a cell: {type(error).__name__}; are both of one polishd?") from error
    return {"upto": upto, **asdict(reply), "offers": feed.offers(sql, cell)}


def _refuse(sql: DatabaseTransaction, cell: str, body: dict[str, Any]) -> Any:
    shop_parts.refuse(sql, cell, _text(body, "request"), _text(body, "why")[:2000])
    return {}


def _file(sql: DatabaseTransaction, _cell: str, body: dict[str, Any]) -> Any:
    found = sql.row("SELECT content FROM file WHERE sha256 = ?", _text(body, "sha256"))
    if found is None:
        raise ConfigError("there is no file of that hash")
    return Response(found["content"], media_type="application/octet-stream")


def _add(sql: DatabaseTransaction, user: str, body: dict[str, Any]) -> Any:
    files = body.get("files", {})
    if not isinstance(files, dict):
        raise ConfigError("files is an object: base64 of each content by its name")
    try:
        part = part_of(
            _text(body, "content"),
            {str(Path(name)): base64.b64decode(one, validate=True) for name, one in files.items()},
        )
    except (binascii.Error, TypeError, ValueError) as error:
        raise ConfigError("files is an object: base64 of each content by its name") from error
    shop_parts.add(sql, [part], user, [digests(part)])
    return {"added": part.job}


def _release(sql: DatabaseTransaction, user: str, body: dict[str, Any]) -> Any:
    cell_is_gone = body.get("cell_is_gone", False) is True
    why = str(body.get("why", ""))[:500]
    return {"said": shop_parts.release(sql, _text(body, "job"), user, why, gone=cell_is_gone)}


def _remove(sql: DatabaseTransaction, user: str, body: dict[str, Any]) -> Any:
    shop_parts.remove(sql, _text(body, "job"), user, str(body.get("why", ""))[:500])
    return {}


def _json(body: bytes) -> dict[str, Any]:
    found = json_object(body)
    if b"\\u" in body:  # without such an escape the text is valid Unicode
        require_unicode(json.dumps(found, ensure_ascii=False), "the body")
    return found


def _text(body: dict[str, Any], key: str) -> str:
    found = body.get(key)
    if not isinstance(found, str) or not found:
        raise ConfigError(f"{key} must be given, as text")
    return found
