"""Handlers of the routes: each gets the request and its session, and returns a value for JSON."""

from __future__ import annotations

import asyncio
import logging
import re
import threading
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from typing import Any
from urllib.parse import quote

from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response, StreamingResponse
from starlette.types import Receive, Scope, Send

from polishd.config.cell import CellConfig
from polishd.daemon.socket import client
from polishd.model.errors import ConfigError, LinkError, NoDaemon, NoSuchResource, PolishdError
from polishd.util.serialization import json_object, require_unicode
from polishd.web.http.certificates import Certificate
from polishd.web.http.server import ClientShares, JsonAnswer, RateLimiter, refusal
from polishd.web.http.users import COOKIE, HttpSession, SessionStore, address_of, foreign_origin
from polishd.web.map_data import MapQuery, query_number
from polishd.web.overview import Overview
from polishd.web.part_history import MOST_FILTER, MOST_PAGE, PAGE, RESULTS, PartFilter, PartHistory
from polishd.web.queue_view import QueueView
from polishd.web.run_data import LARGEST_PLAN, MOST_POINTS, NO_CYCLE, RunData
from polishd.web.run_files import RunFiles
from polishd.web.watcher import Watcher

log = logging.getLogger(__name__)

# Orders on their way to the daemon, each in a separate thread, so that none waits for another that hangs.

OBEYED_S = 5.0
"""Time after which the answer is that the order is not obeyed yet; the order remains valid."""


class CommandForwarder:
    """Orders to one cell."""

    def __init__(self, state_dir: Path) -> None:
        self._state_dir = state_dir
        self._pending: dict[tuple[str, str], asyncio.Future[dict[str, Any]]] = {}

    async def send(self, verb: str, args: Mapping[str, Any], *, joined: bool = False) -> dict[str, Any] | None:
        """The daemon's answer; None: it has not obeyed yet. PolishdError where it cannot be sent.

        ``joined``: return the answer of the same order of the same person that is under way: a second press needs no
        second thread. The journal then has the reason of the first press. An order of another person is separate, with
        its own ``by`` in the journal.
        """
        pending = self._pending.get(_key(verb, args)) if joined else None
        if pending is None:
            pending = self._send(verb, args)
        try:
            async with asyncio.timeout(OBEYED_S):
                return await asyncio.shield(pending)
        except TimeoutError:
            return None

    def _send(self, verb: str, args: Mapping[str, Any]) -> asyncio.Future[dict[str, Any]]:
        """Send the order in a thread. LinkError where no thread can be started."""
        loop, key = asyncio.get_running_loop(), _key(verb, args)
        future: asyncio.Future[dict[str, Any]] = loop.create_future()
        future.add_done_callback(
            lambda one: one.cancelled() or one.exception()
        )  # retrieved, also when no request waits any more

        def settle(reply: dict[str, Any] | None, error: PolishdError | None) -> None:
            if self._pending.get(key) is future:
                del self._pending[key]
            if future.done():
                return
            if error is not None:
                future.set_exception(error)
            else:
                future.set_result(reply or {})

        def request_daemon() -> None:
            reply, failure = None, None
            try:
                reply = client.request(self._state_dir, verb, args=args)
            except PolishdError as error:
                failure = error
            except Exception as error:  # an order that never ends would swallow every later one that joins it
                log.exception("the order %s failed on its way to the daemon", verb)
                failure = _unsent_error(verb, error)
            if not loop.is_closed():
                loop.call_soon_threadsafe(settle, reply, failure)

        try:
            threading.Thread(target=request_daemon, name=f"order {verb}", daemon=True).start()
        except RuntimeError as error:  # the process has too many threads
            log.exception("the order %s could not be sent", verb)
            raise _unsent_error(verb, error) from error
        self._pending[key] = future
        return future


def _unsent_error(verb: str, error: Exception) -> LinkError:
    return LinkError(
        f"{verb}: this server failed to send it to the daemon ({type(error).__name__}: {error}), which may not have "
        "received it. Send it again, or use the command line"
    )


def _key(verb: str, args: Mapping[str, Any]) -> tuple[str, str]:
    """Key of an order: verb and author. Other arguments do not count: who presses Hold twice gives one order."""
    return verb, str(args.get("by", ""))


MOST_REASON = 500
MOST_WATCHERS = 200
MOST_OF_USER = 10
"""Largest number of event streams of one user, one for each page."""
MOST_NUMBER = 1 << 53


class Api:
    """Handlers of one cell."""

    def __init__(self, config: CellConfig, sessions: SessionStore, certificate: Certificate | None = None) -> None:
        self._config, self.sessions, self._certificate = config, sessions, certificate
        self._disk, self._orders = RunData(config.state_dir), CommandForwarder(config.state_dir)
        self._history = PartHistory(config.state_dir)
        self._overview, self._overview_read = Overview(config), asyncio.Lock()
        self._queue = QueueView(config, self._history)
        self.watcher = Watcher(config.state_dir)
        self._streams = ClientShares(MOST_OF_USER, MOST_WATCHERS)

    # session

    async def sign_in(self, request: Request, rate: RateLimiter) -> Response:
        """Sign in: a cookie for a token."""
        if foreign_origin(request):
            return refusal(403, "it comes from another site's page")
        address, token = address_of(request), _text(await _json(request), "token", whatever=True)
        if not rate.takes(self.sessions.bucket(token, address)):
            return refusal(429, "too many requests")
        if self.sessions.locked(token, address):
            return refusal(429, "too many wrong tokens came from this address: wait a minute and sign in again")
        user = self.sessions.user_of(token, address)
        if user is None:
            return refusal(401, "the token is wrong: check it, or have a new one made with polishd web --add-user")
        session = self.sessions.begin(user)
        response = JsonAnswer(_session_facts(session))
        secure = request.url.scheme == "https"
        response.set_cookie(COOKIE, session.cookie, httponly=True, samesite="strict", secure=secure, path="/")
        return response

    async def who(self, _request: Request, session: HttpSession) -> Any:
        """Name, role, and CSRF token of the page."""
        return _session_facts(session)

    async def sign_out(self, request: Request, _session: HttpSession) -> Any:
        """Sign out: the cookie becomes invalid."""
        self.sessions.end(request)
        return {}

    # reading

    async def state(self, _request: Request, _session: HttpSession) -> Any:
        """State of the cell, from memory."""
        return {"cell": self._config.cell.name, **self.watcher.state()}

    async def health(self, _request: Request, _session: HttpSession) -> Any:
        """Health of the cell, and of this server's TLS certificate (null where there is none)."""
        state = self.watcher.state()
        live = state["live"] or {}
        facts = {"daemon": state["daemon"], "age_s": state["age_s"], **{k: live.get(k) for k in ("health", "ages_s")}}
        return {**facts, "certificate": None if self._certificate is None else self._certificate.facts()}

    async def overview(self, _request: Request, _session: HttpSession) -> Any:
        """Limits, tolerance, and progress of the pass."""
        async with self._overview_read:  # one reader: the others get its answer
            return await asyncio.to_thread(self._overview.facts)

    async def readings(self, _request: Request, _session: HttpSession) -> Any:
        """Readings of the last minutes."""
        return {"columns": ["at_s", "force_n", "setpoint_n", "rpm"], "rows": self.watcher.readings()}

    async def queue(self, _request: Request, _session: HttpSession) -> Any:
        """Jobs of the queue, from the journal: it needs no daemon."""
        return await asyncio.to_thread(self._queue.facts)

    async def jobs(self, _request: Request, _session: HttpSession) -> Any:
        """All jobs."""
        return {"jobs": await asyncio.to_thread(self._disk.jobs)}

    async def cycles(self, request: Request, _session: HttpSession) -> Any:
        """Cycles of one job."""
        return {"cycles": await asyncio.to_thread(self._disk.cycles, _number(request, "job"))}

    async def map(self, request: Request, _session: HttpSession) -> Any:
        """A map as an array."""
        query = MapQuery.of(request.path_params["kind"], request.query_params)
        return await _in_thread(self._disk.map, *_cycle(request), query)

    async def cell(self, request: Request, _session: HttpSession) -> Any:
        """Joints of the robot along a plan, its path, and the part."""
        return await _in_thread(self._disk.cell, *_cycle(request), self._config)

    async def psd(self, request: Request, _session: HttpSession) -> Any:
        """Spectrum of a measured map."""
        return await asyncio.to_thread(self._disk.psd, *_cycle(request))

    async def plan(self, request: Request, _session: HttpSession) -> Any:
        """Points, dwell, compliance and gamma of a plan."""
        points = query_number(request.query_params, "points", MOST_POINTS, 2, LARGEST_PLAN)
        return await asyncio.to_thread(self._disk.plan, *_cycle(request), points)

    async def certificate(self, request: Request, _session: HttpSession) -> Any:
        """Certificate of a plan's dwell."""
        return await asyncio.to_thread(self._disk.certificate, *_cycle(request))

    async def job(self, request: Request, _session: HttpSession) -> Any:
        """One part: its row of the history, its measurements and passes, approvals and files."""
        return await asyncio.to_thread(self._job, _number(request, "job"))

    def _job(self, number: int) -> dict[str, Any]:
        folder = self._disk.run_folder(number)
        row = self._history.row(number)
        if row is None:
            raise NoSuchResource(f"there is no job {number} in this cell's journal")
        return {
            **row.facts(),
            "cycles": self._disk.cycles(number),
            "approvals": self._disk.approvals(number),
            "files": None if not folder else RunFiles(self._config.resolve(folder)).facts(),
        }

    async def file(self, request: Request, _session: HttpSession) -> Response:
        """A picture, the report or a certificate of a job's run folder."""
        number, name = _number(request, "job"), request.path_params["name"]
        folder = await asyncio.to_thread(self._disk.run_folder, number)
        found = None if not folder else await asyncio.to_thread(RunFiles(self._config.resolve(folder)).file, name)
        content = None if found is None else await asyncio.to_thread(found.content)
        if found is None or content is None:
            raise NoSuchResource(f"the run folder of job {number} has no picture, report or certificate of that name")
        kind = "inline" if found.is_picture else "attachment"
        headers = {"content-disposition": f"{kind}; filename*=UTF-8''{quote(found.name, safe='')}"}
        return Response(content, media_type=found.media_type, headers=headers)

    async def history(self, request: Request, _session: HttpSession) -> Any:
        """A page of the table of all parts."""
        query = request.query_params
        offset = query_number(query, "offset", 0, 0, MOST_NUMBER)
        limit = query_number(query, "limit", PAGE, 0, MOST_PAGE)
        return await asyncio.to_thread(self._history.page, _filter(query), query.get("sort", ""), offset, limit)

    def read_history(self) -> None:
        """Read the journal's finished jobs, which take seconds in a long history, before the first request for them."""
        with suppress(PolishdError):  # a damaged journal is named at each request
            self._history.rows()

    async def weeks(self, request: Request, _session: HttpSession) -> Any:
        """Figures of each week."""
        return {"weeks": await asyncio.to_thread(self._history.weeks, _filter(request.query_params))}

    async def waiting_plan(self, request: Request, _session: HttpSession) -> Any:
        """Figures of a plan that waits for approval, beside those of the last pass."""
        program = request.path_params["program"]
        if not re.fullmatch("[0-9a-f]{64}", program):
            raise NoSuchResource("there is no such plan: its name is the SHA-256 of its program, 64 hexadecimal digits")
        return await asyncio.to_thread(self._disk.waiting_plan, program)

    async def journal(self, request: Request, _session: HttpSession) -> Any:
        """Events and orders."""
        before = query_number(request.query_params, "before", None, 0, MOST_NUMBER)
        return {"events": await asyncio.to_thread(self._disk.events, before)}

    async def alarms(self, _request: Request, _session: HttpSession) -> Any:
        """Alarms that are not acknowledged."""
        return {"alarms": await asyncio.to_thread(self._disk.alarms)}

    async def config(self, _request: Request, _session: HttpSession) -> Any:
        """All values in force; a config contains no secrets."""
        return self._config.effective()

    async def events(self, _request: Request, session: HttpSession) -> Any:
        """Events, as long as the page is connected and its user has access: checked before each message."""
        if (why := self._streams.refusal(session.user.name)) is not None:
            return refusal(*why)

        async def messages() -> Any:
            with self.watcher.page() as page:
                async for message in page:
                    if not self._is_open(session):
                        return
                    yield message

        return _Stream(messages(), self._streams.one(session.user.name))

    def _is_open(self, session: HttpSession) -> bool:
        try:
            return self.sessions.is_open(session)
        except PolishdError as error:  # the next request names the problem to its user
            log.warning("an event stream of %s ends: %s", session.user.name, error)
            return False

    # orders

    async def safe_order(self, request: Request, session: HttpSession) -> Any:
        """Hold or stop."""
        verb = request.url.path.rpartition("/")[2]
        try:
            reason = _reason(await _json(request))
        except (ConfigError, HTTPException, ClientDisconnect):  # any other content: the cell must stand still
            reason = ""
        return await self._ordered(verb, {"reason": reason, "by": _by(session)}, joined=True)

    async def resume(self, request: Request, session: HttpSession) -> Any:
        """Resume."""
        reason = _reason(await _json(request))
        return await self._ordered("resume", {"reason": reason, "by": _by(session)})

    async def approve(self, request: Request, session: HttpSession) -> Any:
        """Approve that plan, and no other."""
        program = _text(await _json(request), "program_sha256")
        return await self._ordered("approve", {"program_sha256": program, "by": _by(session)})

    async def acknowledge(self, request: Request, session: HttpSession) -> Any:
        """Acknowledge those alarms."""
        alarms = (await _json(request)).get("alarms")
        if not isinstance(alarms, list) or not all(map(_is_whole_number, alarms)):
            raise ConfigError("alarms must be given: a list of their numbers")
        return await self._ordered("acknowledge", {"alarms": [int(one) for one in alarms], "by": _by(session)})

    async def move(self, request: Request, session: HttpSession) -> Any:
        """Move a waiting job."""
        body = await _json(request)
        args = {"job": _text(body, "job"), "where": _text(body, "where"), "other": _text(body, "other", "")}
        return await self._ordered("queue_move", {**args, "by": _by(session)})

    async def remove(self, request: Request, session: HttpSession) -> Any:
        """Remove a waiting job, or the job over which the cell is held."""
        body = await _json(request)
        args = {"job": _text(body, "job"), "reason": _reason(body)}
        return await self._ordered("queue_remove", {**args, "by": _by(session)})

    async def _ordered(self, verb: str, args: Mapping[str, Any], *, joined: bool = False) -> Any:
        try:
            reply = await self._orders.send(verb, args, joined=joined)
        except PolishdError as error:
            return _failed(error)
        if reply is None:
            return JsonAnswer({"ok": True, "obeyed": False}, 202)
        return reply if reply.get("ok") else refusal(409, str(reply.get("error")))


class _Stream(StreamingResponse):
    """Server-sent events; the stream counts against the user's streams from the answer's head to its end."""

    def __init__(self, messages: AsyncIterator[str], share: AbstractContextManager[None]) -> None:
        super().__init__(messages, media_type="text/event-stream")
        self._share = share

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send until either side ends."""
        with self._share:
            await super().__call__(scope, receive, send)


async def _in_thread(read: Callable[..., dict[str, Any]], *arguments: Any) -> JsonAnswer:
    """A large answer, computed and encoded beside the event loop."""
    return await asyncio.to_thread(lambda: JsonAnswer(read(*arguments)))


def _failed(error: PolishdError) -> JSONResponse:
    status = 503 if isinstance(error, NoDaemon) else 504 if isinstance(error, LinkError) else 502
    return refusal(status, str(error))


def _session_facts(session: HttpSession) -> dict[str, Any]:
    return {"ok": True, "name": session.user.name, "role": session.user.role.value, "csrf": session.csrf}


def _by(session: HttpSession) -> str:
    return f"{session.user.name} (web)"


def _cycle(request: Request) -> tuple[int, int]:
    return _number(request, "job"), _number(request, "cycle")


def _number(request: Request, name: str) -> int:
    """Return a number of the path. NoSuchResource where it is larger than the journal's numbers."""
    found: int = request.path_params[name]
    if found > MOST_NUMBER:
        raise NoSuchResource(NO_CYCLE)
    return found


def _filter(query: Mapping[str, str]) -> PartFilter:
    """Return the filter of a query; ConfigError where a value is wrong."""
    text, result = query.get("text", ""), query.get("result")
    if len(text) > MOST_FILTER:
        raise ConfigError(f"text has {len(text)} characters; at most {MOST_FILTER}")
    if result is not None and result not in RESULTS:
        raise ConfigError(f"result must be one of {', '.join(RESULTS)}")
    times = [query_number(query, key, None, 0, MOST_NUMBER) for key in ("since", "until")]
    since_s, until_s = (None if one is None else float(one) for one in times)
    return PartFilter(text, result or "", since_s, until_s)


async def _json(request: Request) -> dict[str, Any]:
    return json_object(await request.body())


def _is_whole_number(value: Any) -> bool:
    """A number of the journal; JSON counts 3.0 as one, too."""
    return type(value) in {int, float} and 0 <= value <= MOST_NUMBER and value == int(value)


def _text(body: Mapping[str, Any], key: str, default: str | None = None, *, whatever: bool = False) -> str:
    """Return the text of a key. ConfigError where it is missing without default, is no text, or no Unicode.

    ``whatever``: accept invalid Unicode, too.
    """
    if not isinstance(found := body.get(key, default), str):
        raise ConfigError(f"{key} must be given: a text" if key not in body else f"{key} must be a text")
    if not whatever:
        require_unicode(found, key)
    return found


def _reason(body: Mapping[str, Any]) -> str:
    return _text(body, "reason", "")[:MOST_REASON]
