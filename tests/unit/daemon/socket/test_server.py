"""The socket and its clients."""

from __future__ import annotations

import asyncio
import json
import os
import socket
from collections.abc import AsyncIterator, Mapping
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

import pytest

from polishd.daemon.runtime.events import EventBus
from polishd.daemon.socket import client
from polishd.daemon.socket import server as service
from polishd.daemon.socket.client import LINE_BYTES, request, subscribe
from polishd.daemon.socket.server import serving
from polishd.model.errors import ConfigError, DeviceRefused, LinkError, ProtocolError
from polishd.model.events import CellHeld, DaemonFailed, PassEnded, PassProgressed
from tests.time_limits import SOON_S


async def status() -> Mapping[str, Any]:
    return {"state": "held", "cycle": 2}


async def hold(reason: str = "") -> Mapping[str, Any]:
    if reason:
        return {"reason": reason}
    raise DeviceRefused("the robot said no")


async def resume() -> Mapping[str, Any]:
    raise KeyError("bug")


async def stop() -> Mapping[str, Any]:
    await asyncio.Event().wait()
    return {}


async def ask(state_dir: Path, verb: str, within_s: float = 60.0, **args: Any) -> dict[str, Any]:
    return await asyncio.to_thread(request, state_dir, verb, within_s, args)


HANDLERS = {"status": status, "hold": hold, "resume": resume, "stop": stop}


@pytest.fixture
async def bus() -> AsyncIterator[EventBus]:
    found = EventBus()
    yield found
    await found.close()


@pytest.fixture
async def daemon(tmp_path: Path, bus: EventBus, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Path]:
    async with serving(tmp_path, HANDLERS, bus):
        yield tmp_path
        monkeypatch.setattr(service, "WRITE_S", 0.0)  # no wait for a handler that never returns


async def until_subscribed(bus: EventBus, count: int = 1) -> None:
    """pytest's timeout is the limit."""
    while len(bus._subscribers) != count:  # noqa: ASYNC110
        await asyncio.sleep(0)


async def test_answers(daemon: Path) -> None:
    assert await ask(daemon, "status") == {"ok": True, "state": "held", "cycle": 2}


async def test_only_the_owner_may_connect(daemon: Path) -> None:
    assert (daemon / "polishd.sock").stat().st_mode & 0o777 == 0o600


async def test_socket_is_private_from_its_first_moment(
    tmp_path: Path, bus: EventBus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without the chmod afterwards, under the most generous umask."""
    monkeypatch.setattr(Path, "chmod", lambda self, mode: None)
    before = os.umask(0)
    try:
        async with serving(tmp_path, HANDLERS, bus) as path:
            assert path.stat().st_mode & 0o777 == 0o600
    finally:
        os.umask(before)


async def test_errors_are_answers(daemon: Path, caplog: pytest.LogCaptureFixture) -> None:
    assert await ask(daemon, "hold") == {"ok": False, "error": "the robot said no", "exit_code": 5}
    answer = await ask(daemon, "resume")
    assert answer == {"ok": False, "error": "resume failed inside the daemon: KeyError: 'bug'"}
    assert "verb resume failed" in caplog.text
    answer = await ask(daemon, "statsu")
    assert answer["error"].startswith("unknown verb 'statsu'; did you mean 'status'? Known: 'hold'")


@pytest.mark.parametrize(
    "line",
    [
        b"status",
        b"[]",
        b'{"verb": 3}',
        b"{}",
        b"\xff\xfe",
        b"",
        b"null",
        b'{"verb": "status", "args": []}',
        b'{"verb": "status", "arg": {}}',
        b"[" * 100_000,
    ],
)
async def test_what_is_no_request_is_answered_and_the_session_goes_on(daemon: Path, line: bytes) -> None:
    reader, writer = await asyncio.open_unix_connection(daemon / "polishd.sock")
    writer.write(line + b"\n" + b'{"verb": "status"}\n')
    first, second = json.loads(await reader.readline()), json.loads(await reader.readline())
    assert not first["ok"]
    assert first["error"].startswith("a request is one JSON object a line")
    assert second["ok"]
    writer.close()


async def test_arguments_reach_who_obeys(daemon: Path) -> None:
    assert await ask(daemon, "hold", reason="a scratch") == {"ok": True, "reason": "a scratch"}


@pytest.mark.parametrize(
    ("verb", "args", "says"),
    [
        ("hold", {"reasn": "x"}, "hold: unknown argument 'reasn'; did you mean 'reason'? Known: 'by', 'reason'"),
        ("hold", {"reason": 3}, "hold: reason must be a string, not 3"),
        ("status", {"reason": "x"}, "status: unknown argument 'reason'. Known: none"),
    ],
)
async def test_arguments_that_a_verb_has_not_are_refused(
    daemon: Path, verb: str, args: dict[str, Any], says: str
) -> None:
    assert await ask(daemon, verb, **args) == {"ok": False, "error": says}


async def test_a_line_that_is_too_long_is_answered_and_the_session_goes_on(daemon: Path) -> None:
    reader, writer = await asyncio.open_unix_connection(daemon / "polishd.sock")
    for end in (b"\n", b'{"verb": "hold"}\n'):
        writer.write(b"x" * (3 * LINE_BYTES) + end + b'{"verb": "status"}\n')
        first, second = json.loads(await reader.readline()), json.loads(await reader.readline())
        assert first == {"ok": False, "error": f"a request is at most {LINE_BYTES} bytes long"}
        assert second["ok"]
    writer.write(b"x" * (2 * LINE_BYTES))
    writer.write_eof()
    assert json.loads(await reader.read())["error"] == f"a request is at most {LINE_BYTES} bytes long"
    writer.close()


async def test_a_subscriber_that_sends_lines_is_answered_and_goes_on_to_hear(daemon: Path, bus: EventBus) -> None:
    reader, writer = await asyncio.open_unix_connection(daemon / "polishd.sock")
    writer.write(b'{"verb": "subscribe"}\n')
    assert json.loads(await reader.readline()) == {"ok": True}
    for line in (b"what?", b'{"verb": "status"}', b"\xff" * (2 * LINE_BYTES)):
        writer.write(line + b"\n")
        refused = json.loads(await reader.readline())
        assert refused == {"ok": False, "error": "this connection is for events only. Send requests on another one"}
        bus.publish(CellHeld(error="a scratch", kind="LinkError"))
        assert json.loads(await reader.readline())["event"]["name"] == "cell_held"
    writer.close()


async def test_half_a_character_reaches_who_obeys_as_its_escape(daemon: Path) -> None:
    assert await ask(daemon, "hold", reason="a \ud800 scratch") == {"ok": True, "reason": "a \\ud800 scratch"}


async def test_a_waiting_verb_holds_up_no_other(daemon: Path) -> None:
    waiting = asyncio.create_task(ask(daemon, "stop"))
    assert (await ask(daemon, "status"))["ok"]
    waiting.cancel()
    with pytest.raises(asyncio.CancelledError):
        await waiting


async def test_an_order_is_given_time_to_be_obeyed(daemon: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client, "ORDER_S", 0.05)
    with pytest.raises(LinkError, match=r"did not answer within 0\.05 s"):
        await asyncio.to_thread(request, daemon, "stop")
    assert (await asyncio.to_thread(request, daemon, "status"))["ok"]


async def test_a_silent_daemon_is_reported(daemon: Path) -> None:
    with pytest.raises(LinkError, match=r"did not answer within 0\.05 s"):
        await ask(daemon, "stop", 0.05)


async def test_subscribers_receive_events(daemon: Path, bus: EventBus) -> None:
    received = [asyncio.create_task(asyncio.to_thread(lambda: list(subscribe(daemon)))) for _ in range(2)]
    await until_subscribed(bus, 2)
    bus.publish(PassEnded(cycle=1, executed_s=2.5))
    bus.publish(CellHeld(error="cut", kind="LinkError"))
    await bus.close()
    expected = [
        {"name": "pass_ended", "cycle": 1, "data": {"executed_s": 2.5}},
        {"name": "cell_held", "cycle": None, "data": {"error": "cut", "kind": "LinkError"}},
    ]
    assert await asyncio.gather(*received) == [expected, expected]


async def test_a_subscriber_that_hangs_up_is_forgotten(daemon: Path, bus: EventBus) -> None:
    events = subscribe(daemon)
    first = asyncio.create_task(asyncio.to_thread(next, events, {}))
    await until_subscribed(bus)
    bus.publish(PassProgressed(block=1))
    assert (await first)["data"] == {"block": 1}
    events.close()  # type: ignore[attr-defined]
    await until_subscribed(bus, 0)
    assert (await ask(daemon, "status"))["ok"]


async def test_a_subscriber_that_never_reads_is_dropped(
    daemon: Path, bus: EventBus, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(service, "WRITE_S", 0.05)
    with socket.socket(socket.AF_UNIX) as deaf:
        deaf.connect(str(daemon / "polishd.sock"))
        deaf.sendall(b'{"verb": "subscribe"}\n')
        await until_subscribed(bus)
        while bus._subscribers:
            bus.publish(DaemonFailed(error="x" * 100_000, kind="much"))
            await asyncio.sleep(0)
        assert (await ask(daemon, "status"))["ok"]


async def test_daemons_end_ends_sessions_and_removes_the_socket(
    tmp_path: Path, bus: EventBus, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = asyncio.Event()

    async def asked_to_stop() -> Mapping[str, Any]:
        asked.set()
        return await stop()

    async with AsyncExitStack() as stack:
        await stack.enter_async_context(serving(tmp_path, HANDLERS | {"stop": asked_to_stop}, bus))
        waiting = asyncio.create_task(ask(tmp_path, "stop"))
        async with asyncio.timeout(SOON_S):
            await asked.wait()
        idle, writer = await asyncio.open_unix_connection(tmp_path / "polishd.sock")
        assert (await ask(tmp_path, "status"))["ok"]
        monkeypatch.setattr(service, "WRITE_S", 0.1)
    with pytest.raises(LinkError, match="closed the connection before it answered"):
        await waiting
    assert await idle.read() == b""
    writer.close()
    assert os.listdir(tmp_path) == []  # noqa: PTH208


@pytest.mark.parametrize("leftover", [False, True])
def test_no_daemon_is_reported(tmp_path: Path, leftover: bool) -> None:
    if leftover:
        with socket.socket(socket.AF_UNIX) as dead:
            dead.bind(str(tmp_path / "polishd.sock"))
    message = rf"no daemon is running for {tmp_path} \(.*\)\. Start it with: polishd run"
    with pytest.raises(LinkError, match=message):
        request(tmp_path, "status")
    with pytest.raises(LinkError, match=message):
        next(subscribe(tmp_path))


async def test_stale_socket_is_replaced(tmp_path: Path, bus: EventBus) -> None:
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(tmp_path / "polishd.sock"))
    async with serving(tmp_path, HANDLERS, bus):
        assert (await ask(tmp_path, "status"))["ok"]


async def test_file_of_that_name_is_not_removed(tmp_path: Path, bus: EventBus) -> None:
    (tmp_path / "polishd.sock").write_text("mine")
    with pytest.raises(ConfigError, match="is not a socket"):
        async with serving(tmp_path, HANDLERS, bus):
            pytest.fail("served")
    assert (tmp_path / "polishd.sock").read_text() == "mine"


async def test_deep_folders(tmp_path: Path, bus: EventBus) -> None:
    deep = tmp_path / ("d" * 100) / ("e" * 100)
    deep.mkdir(parents=True)
    async with serving(deep, HANDLERS, bus):
        assert (await ask(deep, "status"))["ok"]
    assert list(deep.iterdir()) == []


@pytest.mark.parametrize(
    ("answer", "error", "message"),
    [
        (b"", LinkError, "closed the connection"),
        (b"what?\n", ProtocolError, "is not JSON"),
        (b"3\n", ProtocolError, "is not an object"),
    ],
)
async def test_strange_daemons(tmp_path: Path, answer: bytes, error: type[Exception], message: str) -> None:
    async def strange(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readline()
        writer.write(answer)
        writer.close()

    server = await asyncio.start_unix_server(strange, tmp_path / "polishd.sock")
    with pytest.raises(error, match=message):
        await ask(tmp_path, "status")
    server.close()
    await server.wait_closed()


async def test_refused_subscription(tmp_path: Path) -> None:
    async def refusing(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readline()
        writer.write(b'{"ok": false, "error": "not now"}\n')
        writer.close()

    server = await asyncio.start_unix_server(refusing, tmp_path / "polishd.sock")
    with pytest.raises(ProtocolError, match="not now"):
        await asyncio.to_thread(lambda: list(subscribe(tmp_path)))
    server.close()
    await server.wait_closed()
