"""Attacks on the page and its API. docs/explanation/security.md names these tests with their results."""

from __future__ import annotations

import asyncio
import logging
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse
from starlette.routing import Route
from starlette.types import Message

from polishd.commissioning.rehearsal.simulated_cell import write_demo
from polishd.config.cell import load_config
from polishd.config.server_sections import WebSection
from polishd.daemon.journal.journal import Journal
from polishd.model.errors import ConfigError
from polishd.model.events import PartRequested
from polishd.model.states import NOT_ASKED
from polishd.web import routes
from polishd.web.http import server, users
from polishd.web.http.server import BUDGET, LOCKED_S, WRONG, LoginLockout, RateLimiter
from polishd.web.http.users import Role, UserFile, users_path
from tests.time_limits import SOON_S
from tests.unit.web.page_server import Served, served

STATIC = Path(routes.__file__).parent / "static"


@pytest.fixture
def web(tmp_path: Path) -> Iterator[Served]:
    with served(tmp_path) as found:
        yield found


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    "path",
    [
        "/../pyproject.toml", "/%2e%2e/%2e%2e/etc/passwd", "/static/../routes.py", "/..%2froutes.py",
        "/page.js/../../routes.py",
        "/api/jobs/1/cycles/0/map/..%2f..%2fjournal", "/api/jobs/../../x", "//etc/passwd", "/page.js%00.css",
        "/api/jobs/-1/cycles", "/api/jobs/99999999999999999999/cycles",
    ],
)  # fmt: skip
def test_traversal_finds_nothing(web: Served, path: str) -> None:
    said = web.ask("GET", path)
    assert said.status_code in {400, 404}, said.text
    assert "root:" not in said.text


def test_a_body_that_is_too_large_is_refused(web: Served) -> None:
    said = web.ask("POST", "/api/orders/resume", content=b"x" * (server.BODY_BYTES + 1))
    assert (said.status_code, said.json()["error"]) == (413, f"the body is more than {server.BODY_BYTES} bytes")

    assert web.ask("POST", "/api/orders/resume", content=b'{"reason": "' + b"y" * 60000 + b'"}').status_code == 200
    ((_, args),) = web.daemon.asked
    assert len(args["reason"]) == 500


def test_a_hold_with_a_body_that_is_too_large_is_obeyed(web: Served) -> None:
    assert web.ask("POST", "/api/orders/hold", content=b"x" * (server.BODY_BYTES + 1)).status_code == 200
    assert [(verb, args["reason"]) for verb, args in web.daemon.asked] == [("hold", "")]


@pytest.mark.parametrize("name", ["evil.example", "127.0.0.1.evil.example", "localhost.evil.example:8750", "", "[::2]"])
def test_rebinding_by_another_hosts_name_is_refused(web: Served, name: str) -> None:
    assert web.ask("GET", "/api/state", headers={"host": name}).status_code == 421
    assert web.ask("GET", "/", headers={"host": name}).status_code == 421


def test_its_own_names_are_not(web: Served) -> None:
    for name in ("localhost", "localhost:8750", "127.0.0.1:8750", "[::1]:8750"):
        assert web.ask("GET", "/api/state", headers={"host": name}).status_code == 200


@pytest.mark.parametrize(
    "wrong",
    [
        {"origin": "http://evil.example"}, {"origin": "null"}, {"x-csrf-token": "guessed"}, {"x-csrf-token": ""},
        {"origin": "http://127.0.0.1:9999"},
    ],
)  # fmt: skip
def test_a_forged_request_of_another_page_is_refused(web: Served, wrong: dict[str, str]) -> None:
    good = web.sign_in()
    assert web.client.post("/api/orders/resume", json={}, headers=good).status_code == 200
    assert web.client.post("/api/orders/resume", json={}, headers={**good, **wrong}).status_code == 403
    assert len(web.daemon.asked) == 1
    foreign = {"origin": "http://evil.example"}
    token = {"token": web.tokens[Role.WATCH]}
    assert web.client.post("/api/session", json=token, headers=foreign).status_code == 403


def test_the_cookie_is_for_this_page_alone(web: Served) -> None:
    answer = web.client.post("/api/session", json={"token": web.tokens[Role.WATCH]})
    cookie = answer.headers["set-cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=strict" in cookie
    assert web.tokens[Role.WATCH] not in answer.text
    assert web.client.get("/api/session").json()["name"] == "watch-person"
    headers = {"x-csrf-token": answer.json()["csrf"]}
    assert web.client.delete("/api/session", headers=headers).status_code == 200
    assert web.client.get("/api/session").status_code == 401


def codes(web: Served, *tokens: str) -> list[int]:
    """What each sign-in is answered."""
    return [web.client.post("/api/session", json={"token": token}).status_code for token in tokens]


def test_guessing_one_users_token_locks_that_user_out_and_no_other(web: Served) -> None:
    """All come from one address, as behind a proxy."""
    guesses = [f"operate-person.guess{k}" for k in range(WRONG + 2)]
    assert codes(web, *guesses) == [401] * WRONG + [429] * 2
    assert codes(web, web.tokens[Role.OPERATE]) == [429]
    assert codes(web, web.tokens[Role.ENGINEER], web.tokens[Role.WATCH]) == [200, 200]


def test_guessing_a_token_uses_up_the_budget_of_the_address(web: Served) -> None:
    assert codes(web, web.tokens[Role.WATCH]) == [200]
    guesses = [f"guess{k}" for k in range(BUDGET + 2)]
    assert codes(web, *guesses) == [401] * BUDGET + [429] * 2
    assert codes(web, web.tokens[Role.ENGINEER]) == [429]  # who has not been there
    assert codes(web, web.tokens[Role.WATCH]) == [200]  # who has


def test_a_program_with_a_stale_token_every_five_seconds_locks_no_other_client_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [0.0]
    monkeypatch.setattr(users, "LoginLockout", lambda: LoginLockout(lambda: now[0]))
    stale = {"Authorization": "Bearer " + "x" * 43}
    with served(tmp_path) as web:
        for k in range(100):
            now[0] = 5.0 * k
            assert web.client.get("/api/state", headers=stale).status_code == 401
            if k % 20 == 0:
                assert codes(web, web.tokens[Role.ENGINEER]) == [200]
                assert web.ask("GET", "/api/state", Role.OPERATE).status_code == 200
        assert codes(web, "y" * 43, web.tokens[Role.WATCH]) == [401, 200]


def test_who_is_signed_in_is_never_locked_out(web: Served) -> None:
    good = web.sign_in(Role.OPERATE)
    assert web.ask("GET", "/api/state", Role.ENGINEER).status_code == 200
    guesses = [f"{name}-person.guess{k}" for k in range(BUDGET) for name in ("operate", "engineer")]
    assert set(codes(web, *guesses)) == {401, 429}
    assert web.client.post("/api/orders/resume", json={}, headers=good).status_code == 200
    assert web.ask("GET", "/api/state", Role.ENGINEER).status_code == 200
    assert codes(web, web.tokens[Role.OPERATE]) == [200]


def test_the_lockout_ends_by_itself() -> None:
    now = [0.0]
    lockout = LoginLockout(lambda: now[0])
    for _ in range(WRONG):
        assert not lockout.locked("a", "ada")
        lockout.wrong("a", "ada")
    assert lockout.locked("a", "ada")
    assert not lockout.locked("a", "bob")
    assert not lockout.locked("b", "ada")
    now[0] = LOCKED_S + 1
    assert not lockout.locked("a", "ada")
    for k in range(BUDGET):
        assert not lockout.locked("a", f"#{k}")
        lockout.wrong("a", f"#{k}")
    assert lockout.locked("a", "bob")
    assert not lockout.locked("b", "bob")
    now[0] += LOCKED_S / BUDGET + 0.01
    assert not lockout.locked("a", "bob")


@pytest.mark.parametrize("token", ["\\ud800", "x\\udfffy", "anna.\\ud83d"])
def test_a_token_with_half_a_character_is_a_wrong_one(web: Served, token: str) -> None:
    said = web.client.post("/api/session", content=b'{"token": "%s"}' % token.encode())
    assert said.status_code == 401, said.text


def test_half_a_character_in_any_text_is_refused_and_a_hold_is_obeyed_all_the_same(web: Served) -> None:
    body = b'{"reason": "\\ud800", "job": "\\ud800", "where": "first", "program_sha256": "\\ud800"}'
    for path in ("orders/resume", "approve", "queue/move", "queue/remove"):
        said = web.ask("POST", f"/api/{path}", content=body)
        assert (said.status_code, "half a character" in said.text) == (400, True), path
    assert web.ask("POST", "/api/orders/hold", content=body).status_code == 200
    assert [verb for verb, _ in web.daemon.asked] == ["hold"]


def test_a_csrf_token_that_is_not_ascii_is_a_wrong_one(web: Served) -> None:
    good = web.sign_in()
    wrong = {**good, "x-csrf-token": "ä".encode("latin-1")}
    assert web.client.post("/api/orders/resume", json={}, headers=wrong).status_code == 403


def test_a_rate_fills_again() -> None:
    now = [0.0]
    rate = RateLimiter(lambda: now[0])
    assert sum(rate.takes("a") for _ in range(1000)) == 100
    assert rate.takes("b")
    now[0] = 1.0
    assert sum(rate.takes("a") for _ in range(1000)) == 50


def test_a_user_who_was_removed_is_out_at_once(web: Served) -> None:
    web.sign_in(Role.OPERATE)
    assert web.client.get("/api/state").status_code == 200
    UserFile(users_path(web.config)).remove("operate-person")
    assert web.client.get("/api/state").status_code == 401
    assert web.ask("GET", "/api/state", Role.OPERATE).status_code == 401


def test_a_new_token_ends_the_sessions_of_the_older_one(web: Served) -> None:
    web.sign_in(Role.OPERATE)
    assert web.client.get("/api/state").status_code == 200
    UserFile(users_path(web.config)).add("operate-person", Role.OPERATE)
    assert web.client.get("/api/state").status_code == 401


@pytest.mark.parametrize(
    ("address", "hosts", "asked"),
    [
        ("::0:1", (), "[::1]:8750"),
        ("127.0.0.1", ("FE80::0001",), "[fe80::1]"),
        ("127.0.0.1", ("Shop.example:1",), "shop.example"),
    ],
)
def test_a_name_is_known_in_each_of_its_forms(address: str, hosts: tuple[str, ...], asked: str) -> None:
    names = server.hosts_of(WebSection(address=address, hosts=hosts))
    assert server.host_name(asked) in names
    assert {"localhost", "127.0.0.1", "::1"} <= names


class Sender:
    """Body of a request that arrives in pieces and never ends."""

    def __init__(self, *pieces: bytes) -> None:
        self.pieces, self.read = list(pieces), 0

    async def __call__(self) -> Message:
        self.read += 1
        if not self.pieces:
            await asyncio.Event().wait()  # silence
        return {"type": "http.request", "body": self.pieces.pop(0), "more_body": True}


async def answer_of(sender: Sender, method: str, path: str, **headers: str) -> int:
    """Return the status of the answer to a request with that body; the application reads bodies of POST /read."""

    async def read(request: Request) -> JSONResponse:
        return JSONResponse(len(await request.body()))

    async def ignored(_request: Request) -> JSONResponse:
        return JSONResponse({})

    routes = [Route("/read", read, methods=["POST"]), Route("/", ignored, methods=["GET", "POST"])]
    guard = server.RequestGuard(Starlette(routes=routes, exception_handlers=server.HANDLERS), {"localhost"}, 1 << 20)
    found: list[int] = []

    async def send(message: Message) -> None:
        if message["type"] == "http.response.start":
            found.append(message["status"])

    raw = [
        (name.replace("_", "-").encode(), value.encode()) for name, value in {"host": "localhost", **headers}.items()
    ]
    scope = {"type": "http", "method": method, "path": path, "query_string": b"", "headers": raw}
    await guard(scope, sender, send)
    (status,) = found
    return status


async def test_a_body_is_read_by_its_handler_alone() -> None:
    """So a request without a valid token, or a GET, makes the server read nothing."""
    for method in ("GET", "POST"):
        sender = Sender(b"x" * 1000)
        assert await answer_of(sender, method, "/") == 200
        assert sender.read == 0


async def test_a_body_beyond_its_limit_is_not_read_further() -> None:
    sender = Sender(*[b"x" * (1 << 19)] * 9)
    assert await answer_of(sender, "POST", "/read") == 413
    assert sender.read == 3
    announced = Sender(b"x")
    assert await answer_of(announced, "POST", "/read", content_length=str((1 << 20) + 1)) == 413
    assert announced.read == 0


async def test_the_time_of_a_body_grows_with_what_has_arrived(monkeypatch: pytest.MonkeyPatch) -> None:
    """A report of 16 MiB on a slow line is not refused for its size; silence is."""
    monkeypatch.setattr(server, "BODY_S", 0.0)
    monkeypatch.setattr(server, "LEAST_BYTES_PER_S", 1e9)
    assert await answer_of(Sender(), "POST", "/read") == 408
    ends = []
    monkeypatch.setattr(server.asyncio, "timeout_at", lambda at_s: ends.append(at_s) or asyncio.timeout(None))
    monkeypatch.setattr(server, "LEAST_BYTES_PER_S", 100.0)
    with pytest.raises(TimeoutError):
        async with asyncio.timeout(0.01):
            await answer_of(Sender(b"x" * 500, b"y" * 500), "POST", "/read")
    first, second, third = ends
    assert (second - first, third - first) == (pytest.approx(5.0), pytest.approx(10.0))


def test_no_secret_is_in_a_file_a_log_or_an_answer(web: Served, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.DEBUG):
        web.sign_in()
        answers = [web.ask("GET", path).text for path in ("/api/state", "/api/config", "/api/session", "/api/journal")]
        web.client.get("/api/state", headers={"Authorization": "Bearer a-wrong-secret"})
        web.client.get("/api/nothing?token=a-wrong-secret")
    path = users_path(web.config)
    assert path.stat().st_mode & 0o777 == 0o600
    kept = [one.read_bytes() for one in web.config.state_dir.rglob("*") if one.is_file()]
    for token in (*web.tokens.values(), "a-wrong-secret"):
        assert not any(token.encode() in content for content in kept)
        assert not any(token in text for text in answers)
        assert token not in " ".join(
            f"{record.name} {record.getMessage()}" for record in caplog.records if record.name.startswith("polishd")
        )


@pytest.mark.full
def test_malicious_names_come_as_json_text_and_no_file_of_the_page_makes_markup_of_text(web: Served) -> None:
    """They are put on the page by textContent; the browser's test shows that nothing runs."""
    name = "<img src=x onerror=alert(1)></script><script>alert(2)</script>"
    with Journal.open(web.config.state_dir, job="demo", part_id=name, terms={}) as journal:
        journal.record_event(PartRequested(job=name, part_id=name, standing=NOT_ASKED))
        journal.flush()
        said = web.ask("GET", "/api/alarms")
    assert said.headers["content-type"] == "application/json"
    assert said.headers["x-content-type-options"] == "nosniff"
    assert said.json()["alarms"][0]["what"] == name
    ours = [path for path in STATIC.rglob("*.js") if "vendor" not in path.parts]
    script = "".join(path.read_text() for path in ours).replace("http://www.w3.org/2000/svg", "")  # a name
    for word in ("innerHTML", "outerHTML", "insertAdjacentHTML", "document.write", "eval(", "Function("):
        assert word not in script
    assert "http:" not in script
    assert "https:" not in script


def test_every_answer_has_a_strict_policy(web: Served) -> None:
    for path in ("/", "/page.js", "/api/state", "/nothing"):
        policy = web.client.get(path).headers["content-security-policy"]
        assert "default-src 'none'" in policy
        assert "unsafe" not in policy
    page = web.client.get("/").text
    assert "<script>" not in page
    assert "style=" not in page
    assert " on" not in "".join(part for part in page.split("<") if part.startswith("button"))


def test_beyond_this_computer_only_with_tls_and_users(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="needs TLS"):
        WebSection(address="0.0.0.0")
    with pytest.raises(ValueError, match="cert"):
        WebSection(cert="a.pem")
    files = write_demo(tmp_path / "demo", None, 2.0, 4, None)
    keys = 'address = "0.0.0.0"\ncert = "a.pem"\nkey = "b.pem"'
    files.cell.write_text(files.cell.read_text().replace("port = 8750", keys))
    with pytest.raises(ConfigError, match="there are no users"):
        routes.serve(load_config(files.cell))


@pytest.mark.parametrize("mode", [0o640, 0o660, 0o662, None])
def test_a_tls_key_that_others_may_read_is_refused(tmp_path: Path, mode: int | None) -> None:
    files = write_demo(tmp_path / "demo", None, 2.0, 4, None)
    files.cell.write_text(files.cell.read_text().replace("port = 8750", 'cert = "a.pem"\nkey = "b.pem"'))
    key = files.cell.parent / "b.pem"
    if mode is not None:
        key.touch()
        key.chmod(mode)
    says = r"cell\.toml:\d+: web\.key: " + ("mode .*Run: chmod 600 " if mode else ".*No such file")
    with pytest.raises(ConfigError, match=says):
        routes.serve(load_config(files.cell))


@pytest.fixture
def listening(tmp_path: Path) -> Iterator[tuple[str, int]]:
    """The real server, as a process."""
    files = write_demo(tmp_path / "demo", None, 2.0, 4, None)
    files.cell.write_text(files.cell.read_text().replace("port = 8750", "port = 0"))
    command = [sys.executable, "-m", "polishd.cli.app", "web", str(files.cell)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            host, port = line.strip().removeprefix("http://").rstrip("/").split(":")
            yield host, int(port)
        finally:
            process.terminate()
            process.wait(SOON_S)


@pytest.mark.full
def test_a_body_that_is_too_slow_is_refused_and_others_are_answered_meanwhile(listening: tuple[str, int]) -> None:
    head = b"POST /api/session HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 100\r\n\r\n"
    with socket.create_connection(listening, SOON_S) as slow, socket.create_connection(listening, SOON_S) as other:
        slow.sendall(head + b"{")
        other.sendall(b"GET /api/state HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        assert other.recv(1000).startswith(b"HTTP/1.1 401")
        assert slow.recv(1000).startswith(b"HTTP/1.1 408")
