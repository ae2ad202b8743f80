"""Each endpoint with each role; orders with their givers' names; the document that matches the routes."""

from __future__ import annotations

import asyncio
import json
import re
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from starlette.requests import Request

from docs.reference.code_tables import OPEN_ENDPOINTS
from polishd.commissioning.rehearsal.simulated_cell import write_demo
from polishd.config.cell import load_config
from polishd.daemon.journal.journal import Journal
from polishd.model.errors import LinkError
from polishd.model.events import AlarmAcknowledged, CellHeld
from polishd.web import api, run_data
from polishd.web.http import server
from polishd.web.http.users import COOKIE, Role, SessionStore, UserFile, users_path
from polishd.web.routes import ROUTES, ApiRoute, document, open_path
from tests.time_limits import SOON_S
from tests.unit.web.page_server import Served, served

FIELDS = {"string": "x", "array": [1]}


@pytest.fixture
def web(tmp_path: Path) -> Iterator[Served]:
    with served(tmp_path) as found:
        yield found


def path_of(route: ApiRoute) -> str:
    """With numbers that do not exist."""
    found = re.sub(r"{\w+:number}", "9", route.path).replace("{kind}", "measured")
    return found.replace("{name}", "report.html").replace("{program}", "ab" * 32)


ALL_BUT_THE_STREAM = [one for one in ROUTES if one.path != "/api/events"]


@pytest.mark.one_of_each
@pytest.mark.parametrize("route", ALL_BUT_THE_STREAM, ids=lambda one: one.method + one.path)
def test_each_endpoint_with_each_role(web: Served, route: ApiRoute) -> None:
    """Who may gets an answer that is no refusal of him; who may not is refused before anything is done."""
    body = {name.rstrip("?"): FIELDS[kind] for name, kind in route.fields}
    for role in (None, *Role):
        said = web.ask(route.method, path_of(route), role, **({"json": body} if route.method == "POST" else {}))
        if role is None:
            assert said.status_code == 401
        elif not role.may(route.role):
            assert said.status_code == 403
        else:
            assert said.status_code in {200, 404}, said.text
        assert said.headers["content-type"] == "application/json"
    asked = [args["by"] for _, args in web.daemon.asked if "by" in args]
    assert asked == ([f"{role}-person (web)" for role in Role if role.may(route.role)] if asked else [])


def test_the_document_has_every_route_and_no_other(web: Served) -> None:
    paths = web.ask("GET", "/api/openapi.json", None).json()["paths"]
    described = {(method.upper(), path) for path, methods in paths.items() for method in methods}
    alone = {("POST", "/api/session"), ("GET", "/api/openapi.json")}
    assert described == {(route.method, open_path(route.path)) for route in ROUTES} | alone
    assert json.loads(json.dumps(document()))["openapi"] == "3.1.0"


def test_what_is_open_is_open(web: Served) -> None:
    for method, path, _ in OPEN_ENDPOINTS:
        said = web.ask(method, path, None, **({"json": {"token": web.tokens[Role.WATCH]}} if method == "POST" else {}))
        assert said.status_code == 200


def test_405_says_what_can_be_done(web: Served) -> None:
    said = web.ask("POST", "/api/state")
    assert (said.status_code, set(said.headers["allow"].split(", "))) == (405, {"GET", "HEAD"})


@pytest.mark.full
def test_hold_and_stop_get_through_while_all_else_hangs_and_over_every_limit(
    web: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a token, from every role; also where too many wrong tokens came from, and after too many requests."""
    monkeypatch.setattr(server, "PER_S", 0.0)
    web.daemon.hang = threading.Event()
    resume = ("POST", "/api/orders/resume", Role.OPERATE)
    threads = [threading.Thread(target=web.ask, args=resume, daemon=True) for _ in range(50)]
    try:
        for thread in threads:
            thread.start()
        codes = {web.ask("GET", "/api/state", Role.WATCH).status_code for _ in range(150)}
        assert codes == {200, 429}
        for _ in range(10):
            web.client.get("/api/state", headers={"Authorization": "Bearer engineer-person.wrong"})
        assert web.ask("GET", "/api/state", Role.ENGINEER).status_code == 401
        for role in Role:
            for verb in ("hold", "stop"):
                said = web.ask("POST", f"/api/orders/{verb}", role, content=b"no json")
                assert (said.status_code, said.json()["ok"]) == (200, True)
    finally:
        web.daemon.hang.set()
        for thread in threads:
            thread.join(SOON_S)
    assert {"hold", "stop"} <= {verb for verb, _ in web.daemon.asked}


def test_an_order_that_is_not_obeyed_yet_says_so(web: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(api, "OBEYED_S", 0.01)
    web.daemon.hang = threading.Event()
    said = web.ask("POST", "/api/orders/resume", Role.OPERATE)
    web.daemon.hang.set()
    assert (said.status_code, said.json()) == (202, {"ok": True, "obeyed": False})


def test_an_alarm_is_found_however_much_came_after_it(web: Served, monkeypatch: pytest.MonkeyPatch) -> None:
    """An acknowledged alarm stays acknowledged, also where the record is on another page of the journal."""
    monkeypatch.setattr(run_data, "MOST_ROWS", 3)
    with Journal.open(web.config.state_dir, job="demo", part_id="P", terms={}) as journal:
        for number in range(8):
            journal.record_event(CellHeld(error=f"fault {number}", kind="LinkError"))
        journal.flush()
        first = web.ask("GET", "/api/alarms").json()["alarms"]
        assert [one["what"] for one in first] == ["fault 0", "fault 1", "fault 2"]
        journal.record_event(AlarmAcknowledged(alarms=[one["number"] for one in first], by="ada"))
        journal.flush()
    assert [one["what"] for one in web.ask("GET", "/api/alarms").json()["alarms"]] == ["fault 3", "fault 4", "fault 5"]


async def test_a_hold_that_is_under_way_is_joined_by_its_user_and_by_no_other(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The journal names the person who gave the order, also after the same order of another person."""
    answer, asked = threading.Event(), []

    def request(_state_dir: Path, verb: str, *, args: dict[str, str]) -> dict[str, bool]:
        asked.append((verb, args["by"]))
        answer.wait(SOON_S)
        return {"ok": True}

    monkeypatch.setattr(api.client, "request", request)
    monkeypatch.setattr(api, "OBEYED_S", 0.01)
    ours = api.CommandForwarder(tmp_path)
    for by in ("anna (web)", "ben (web)", "anna (web)"):
        assert await ours.send("hold", {"by": by}, joined=True) is None
    answer.set()
    monkeypatch.setattr(api, "OBEYED_S", SOON_S)
    assert await ours.send("stop", {"by": "anna (web)"}) == {"ok": True}
    assert asked == [("hold", "anna (web)"), ("hold", "ben (web)"), ("stop", "anna (web)")]


async def test_an_order_that_fails_on_its_way_ends_and_the_next_one_is_sent(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A hold that was never sent must not take every later hold of its user with it."""
    answers: list[Exception | dict[str, bool]] = [OSError(24, "too many open files"), {"ok": True}]

    def request(_state_dir: Path, _verb: str, *, args: dict[str, str]) -> dict[str, bool]:
        answer = answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer

    monkeypatch.setattr(api.client, "request", request)
    monkeypatch.setattr(api, "OBEYED_S", SOON_S)
    ours, by = api.CommandForwarder(tmp_path), {"by": "anna (web)"}
    with pytest.raises(LinkError, match=r"hold: .*too many open files.*Send it again"):
        await ours.send("hold", by, joined=True)
    with monkeypatch.context() as full:
        full.setattr(api.threading.Thread, "start", lambda _: (_ for _ in ()).throw(RuntimeError("can't start")))
        with pytest.raises(LinkError, match="can't start"):
            await ours.send("hold", by, joined=True)
    assert await ours.send("hold", by, joined=True) == {"ok": True}


@pytest.mark.parametrize(
    ("path", "code"),
    [
        (f"journal?before={'0' * 17}{'9' * 20}", 400),
        (f"journal?before={'9' * 5000}", 400),
        (f"journal?before={'0' * 5000}1", 200),
        (f"history?offset={'0' * 17}{'9' * 20}", 400),
        (f"history?since={'9' * 5000}", 400),
        (f"jobs/{'9' * 5000}/cycles", 404),
        (f"jobs/{'0' * 17}{'9' * 20}", 404),
    ],
    ids=lambda one: str(one)[:24],
)
def test_a_number_of_any_length_is_no_fault(web: Served, path: str, code: int) -> None:
    assert web.ask("GET", f"/api/{path}").status_code == code


@pytest.mark.parametrize("change", ["removed", "new token", "signed out"])
async def test_an_event_stream_ends_with_the_access_of_its_user(tmp_path: Path, change: str) -> None:
    config = load_config(write_demo(tmp_path / "demo", None, 2.0, 4, None).cell)
    users = UserFile(users_path(config))
    users.add("anna", Role.WATCH)
    sessions = SessionStore(users)
    token = users.add("anna", Role.WATCH)
    user = users.of_token(token)
    assert user is not None
    session = sessions.begin(user)
    ours = api.Api(config, sessions)
    headers = [(b"cookie", f"{COOKIE}={session.cookie}".encode())]
    request = Request({"type": "http", "method": "GET", "path": "/api/events", "headers": headers})
    assert sessions.of(request) is session
    stream = await ours.events(request, session)
    async with asyncio.timeout(SOON_S):
        assert "event: state" in await anext(stream.body_iterator)
        ours.watcher._on_event({"name": "measured", "data": {}})
        assert "event: happened" in await anext(stream.body_iterator)
        if change == "removed":
            users.remove("anna")
        elif change == "new token":
            users.add("anna", Role.WATCH)
        else:
            sessions.end(request)
        assert sessions.of(request) is None
        ours.watcher._on_event({"name": "measured", "data": {}})
        with pytest.raises(StopAsyncIteration):
            await anext(stream.body_iterator)
    assert ours.watcher.pages == 0


def test_what_the_daemon_refuses_is_said_in_its_words(web: Served) -> None:
    web.daemon.refuse = "resume is refused: clear is off, must be on"
    said = web.ask("POST", "/api/orders/resume", Role.OPERATE)
    assert (said.status_code, said.json()["error"]) == (409, web.daemon.refuse)


def test_alarms_stay_until_a_user_has_seen_them_and_the_first_is_named(web: Served) -> None:
    with Journal.open(web.config.state_dir, job="demo", part_id="P", terms={}) as journal:
        journal.record_event(CellHeld(error="the wire is cut; mend it", kind="LinkError"))
        journal.record_event(CellHeld(error="and the spindle", kind="DeviceFault"))
        journal.flush()
        first, second = web.ask("GET", "/api/alarms").json()["alarms"]
        assert (first["first"], first["what"], second["first"]) == (True, "the wire is cut; mend it", False)
        assert first["todo"]
        journal.record_event(AlarmAcknowledged(alarms=[first["number"]], by="ada"))
        journal.flush()
        (left,) = web.ask("GET", "/api/alarms").json()["alarms"]
        assert (left["number"], left["first"]) == (second["number"], True)
    trail = web.ask("GET", "/api/journal").json()["events"]
    assert [one["name"] for one in trail] == ["alarm_acknowledged", "cell_held", "cell_held"]
