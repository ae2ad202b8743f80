"""The socket and its clients."""

from __future__ import annotations

import asyncio
import json
import os
import socket
from collections.abc import AsyncIterator, Mapping
from contextlib import AsyncExitStack, aclosing
from pathlib import Path
from typing import Any

import pytest

from polishd.daemon import service
from polishd.daemon.client import request, request_async, subscribe, subscribe_async
from polishd.daemon.events import EventBus
from polishd.daemon.service import serving
from polishd.daemon.sockets import LINE_BYTES
from polishd.model.cycle import Event
from polishd.model.errors import ConfigError, DeviceRefused, LinkError, ProtocolError


async def status() -> Mapping[str, Any]:
    return {"state": "held", "cycle": 2}


async def hold() -> Mapping[str, Any]:
    raise DeviceRefused("the robot said no")


async def resume() -> Mapping[str, Any]:
    raise KeyError("bug")


async def stop() -> Mapping[str, Any]:
    await asyncio.Event().wait()
    return {}


VERBS = {"status": status, "hold": hold, "resume": resume, "stop": stop}


@pytest.fixture
async def bus() -> AsyncIterator[EventBus]:
    found = EventBus()
    yield found
    await found.close()


@pytest.fixture
async def daemon(tmp_path: Path, bus: EventBus, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Path]:
    async with serving(tmp_path, VERBS, bus):
        yield tmp_path
        monkeypatch.setattr(service, "WRITE_S", 0.0)  # nobody waits for a verb that never answers


async def until_subscribed(bus: EventBus, count: int = 1) -> None:
    """pytest's timeout is the limit."""
    while len(bus._subscribers) != count:  # noqa: ASYNC110
        await asyncio.sleep(0)


async def test_answers(daemon: Path) -> None:
    expected = {"ok": True, "state": "held", "cycle": 2}
    assert await request_async(daemon, "status") == expected
    assert await asyncio.to_thread(request, daemon, "status") == expected


async def test_only_the_owner_may_connect(daemon: Path) -> None:
    assert (daemon / "polishd.sock").stat().st_mode & 0o777 == 0o600


async def test_socket_is_private_from_its_first_moment(
    tmp_path: Path, bus: EventBus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without the chmod afterwards, under the most generous umask."""
    monkeypatch.setattr(Path, "chmod", lambda self, mode: None)
    before = os.umask(0)
    try:
        async with serving(tmp_path, VERBS, bus) as path:
            assert path.stat().st_mode & 0o777 == 0o600
    finally:
        os.umask(before)


async def test_errors_are_answers(daemon: Path, caplog: pytest.LogCaptureFixture) -> None:
    assert await request_async(daemon, "hold") == {"ok": False, "error": "the robot said no", "exit_code": 5}
    answer = await request_async(daemon, "resume")
    assert answer == {"ok": False, "error": "resume failed inside the daemon: KeyError: 'bug'"}
    assert "verb resume failed" in caplog.text
    answer = await request_async(daemon, "statsu")
    assert answer["error"].startswith("unknown verb 'statsu'; did you mean 'status'? Known: 'hold'")


@pytest.mark.parametrize("line", [b"status", b"[]", b'{"verb": 3}', b"{}", b"\xff\xfe", b"", b"null"])
async def test_what_is_no_request_is_answered_and_the_session_goes_on(daemon: Path, line: bytes) -> None:
    reader, writer = await asyncio.open_unix_connection(daemon / "polishd.sock")
    writer.write(line + b"\n" + b'{"verb": "status"}\n')
    first, second = json.loads(await reader.readline()), json.loads(await reader.readline())
    assert not first["ok"]
    assert first["error"].startswith("a request is one JSON object a line")
    assert second["ok"]
    writer.close()


async def test_endless_line_ends_the_session_only(daemon: Path) -> None:
    reader, writer = await asyncio.open_unix_connection(daemon / "polishd.sock")
    writer.write(b"x" * (3 * LINE_BYTES))
    try:
        assert await reader.read() == b""
    except ConnectionResetError:
        assert reader.at_eof() or reader.exception() is not None
    writer.close()
    assert (await request_async(daemon, "status"))["ok"]


async def test_a_waiting_verb_holds_up_no_other(daemon: Path) -> None:
    waiting = asyncio.create_task(request_async(daemon, "stop", within_s=60))
    assert (await request_async(daemon, "status"))["ok"]
    waiting.cancel()
    with pytest.raises(asyncio.CancelledError):
        await waiting


async def test_a_silent_daemon_is_told(daemon: Path) -> None:
    with pytest.raises(LinkError, match=r"did not answer within 0\.05 s"):
        await request_async(daemon, "stop", within_s=0.05)
    with pytest.raises(LinkError, match=r"did not answer within 0\.05 s"):
        await asyncio.to_thread(request, daemon, "stop", 0.05)


async def test_subscribers_hear_events(daemon: Path, bus: EventBus) -> None:
    async def hear() -> list[dict[str, Any]]:
        return [event async for event in subscribe_async(daemon)]

    heard = [asyncio.create_task(hear()), asyncio.create_task(asyncio.to_thread(lambda: list(subscribe(daemon))))]
    await until_subscribed(bus, 2)
    bus.publish(Event("measured", 1, {"rms_nm": 2.5}))
    bus.publish(Event("finished"))
    await bus.close()
    expected = [
        {"name": "measured", "cycle": 1, "data": {"rms_nm": 2.5}},
        {"name": "finished", "cycle": None, "data": {}},
    ]
    assert await asyncio.gather(*heard) == [expected, expected]


async def test_a_subscriber_that_hangs_up_is_forgotten(daemon: Path, bus: EventBus) -> None:
    async with aclosing(subscribe_async(daemon)) as events:
        first = asyncio.ensure_future(anext(events))
        await until_subscribed(bus)
        bus.publish(Event("one"))
        assert (await first)["name"] == "one"
    await until_subscribed(bus, 0)
    assert (await request_async(daemon, "status"))["ok"]


async def test_a_subscriber_that_never_reads_is_dropped(
    daemon: Path, bus: EventBus, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(service, "WRITE_S", 0.05)
    with socket.socket(socket.AF_UNIX) as deaf:
        deaf.connect(str(daemon / "polishd.sock"))
        deaf.sendall(b'{"verb": "subscribe"}\n')
        await until_subscribed(bus)
        while bus._subscribers:
            bus.publish(Event("much", data={"text": "x" * 100_000}))
            await asyncio.sleep(0)
        assert (await request_async(daemon, "status"))["ok"]


async def test_daemons_end_ends_sessions_and_removes_the_socket(
    tmp_path: Path, bus: EventBus, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with AsyncExitStack() as stack:
        await stack.enter_async_context(serving(tmp_path, VERBS, bus))
        waiting = asyncio.create_task(request_async(tmp_path, "stop", within_s=60))
        idle, writer = await asyncio.open_unix_connection(tmp_path / "polishd.sock")
        assert (await request_async(tmp_path, "status"))["ok"]
        monkeypatch.setattr(service, "WRITE_S", 0.1)
    with pytest.raises(LinkError, match="hung up before it answered"):
        await waiting
    assert await idle.read() == b""
    writer.close()
    assert os.listdir(tmp_path) == []  # noqa: PTH208


@pytest.mark.parametrize("leftover", [False, True])
def test_no_daemon_is_told(tmp_path: Path, leftover: bool) -> None:
    if leftover:
        with socket.socket(socket.AF_UNIX) as dead:
            dead.bind(str(tmp_path / "polishd.sock"))
    told = rf"no daemon is running for {tmp_path} \(.*\); start it with: polishd run"
    with pytest.raises(LinkError, match=told):
        request(tmp_path, "status")
    with pytest.raises(LinkError, match=told):
        next(subscribe(tmp_path))
    with pytest.raises(LinkError, match=told):
        asyncio.run(request_async(tmp_path, "status"))


async def test_stale_socket_is_replaced(tmp_path: Path, bus: EventBus) -> None:
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(tmp_path / "polishd.sock"))
    async with serving(tmp_path, VERBS, bus):
        assert (await request_async(tmp_path, "status"))["ok"]


async def test_file_of_that_name_is_not_removed(tmp_path: Path, bus: EventBus) -> None:
    (tmp_path / "polishd.sock").write_text("mine")
    with pytest.raises(ConfigError, match="is not a socket"):
        async with serving(tmp_path, VERBS, bus):
            pytest.fail("served")
    assert (tmp_path / "polishd.sock").read_text() == "mine"


async def test_deep_folders(tmp_path: Path, bus: EventBus) -> None:
    deep = tmp_path / ("d" * 100) / ("e" * 100)
    deep.mkdir(parents=True)
    async with serving(deep, VERBS, bus):
        assert (await request_async(deep, "status"))["ok"]
        assert (await asyncio.to_thread(request, deep, "status"))["ok"]
    assert list(deep.iterdir()) == []


@pytest.mark.parametrize(
    ("answer", "error", "told"),
    [(b"", LinkError, "hung up"), (b"what?\n", ProtocolError, "is not JSON"), (b"3\n", ProtocolError, "is no object")],
)
async def test_strange_daemons(tmp_path: Path, answer: bytes, error: type[Exception], told: str) -> None:
    async def strange(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readline()
        writer.write(answer)
        writer.close()

    server = await asyncio.start_unix_server(strange, tmp_path / "polishd.sock")
    with pytest.raises(error, match=told):
        await request_async(tmp_path, "status")
    with pytest.raises(error, match=told):
        await asyncio.to_thread(request, tmp_path, "status")
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
    with pytest.raises(ProtocolError, match="not now"):
        _ = [event async for event in subscribe_async(tmp_path)]
    server.close()
    await server.wait_closed()
