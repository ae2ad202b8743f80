"""One watcher for all pages, with a daemon that answers, is gone, or is silent."""

from __future__ import annotations

import asyncio
import json
import socket
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from polishd.daemon.runtime.events import record_exit
from polishd.daemon.socket import client
from polishd.model.errors import LinkError
from polishd.util.serialization import finite
from polishd.web import watcher as module
from polishd.web.watcher import Watcher, polling_daemon
from tests.time_limits import SOON_S
from tests.unit.web.page_server import answering


async def until(page: AsyncIterator[str], daemon: str) -> dict[str, Any]:
    """The first state that says so."""
    async with asyncio.timeout(SOON_S):
        async for message in page:
            kind, _, data = message.removeprefix("event: ").partition("\ndata: ")
            if kind == "state" and (state := json.loads(data))["daemon"] == daemon:
                return dict(state)
    raise AssertionError(f"never {daemon}")


async def test_a_daemon_that_comes_and_goes_is_reported_with_ages(tmp_path: Path) -> None:
    record_exit(tmp_path, {"state": "stopped", "reason": "by order"})
    async with polling_daemon(tmp_path) as watcher:
        with watcher.page() as page:
            gone = await until(page, "none")
            assert (gone["age_s"], gone["live"], gone["ending"]["reason"]) == (None, None, "by order")
            with answering(tmp_path):
                there = await until(page, "up")
                assert there["live"]["state"] == "polishing"
                assert there["age_s"] < SOON_S
            last = await until(page, "none")
            assert last["live"]["state"] == "polishing"  # and its age says that it is from before
            assert last["age_s"] >= 0


async def test_a_daemon_that_does_not_answer_is_silent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "REPLY_TIMEOUT_S", 0.05)
    with socket.socket(socket.AF_UNIX) as hangs:  # also once no more questions fit
        hangs.bind(str(tmp_path / "polishd.sock"))
        hangs.listen(1)
        async with polling_daemon(tmp_path) as watcher:
            with watcher.page() as page:
                assert (await until(page, "silent"))["live"] is None
            for _ in range(4):
                with pytest.raises(LinkError):
                    await asyncio.to_thread(client.request, tmp_path, "live", 0.05)


async def test_events_reach_every_page_and_one_that_does_not_read_is_let_go(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "MOST_BEHIND", 3)
    watcher = Watcher(tmp_path)
    with watcher.page() as slow, watcher.page() as quick:
        await anext(quick)
        for number in range(3):
            watcher._on_event({"name": "measured", "cycle": number, "data": {"pv_nm": float("nan")}})
            assert '"pv_nm": null' in await anext(quick)
        assert watcher.pages == 1
        assert len([message async for message in slow]) == 3
    assert (watcher.pages, watcher.number) == (0, 3)


@pytest.mark.parametrize(
    "line",
    [
        "what?", "{}", "[]", '{"event": 3}', '{"event": {}}', '{"event": {"name": "held", "data": 3}}', "[" * 100_000,
        '{"ok": false, "error": "a request is one JSON object a line"}',
    ],
)  # fmt: skip
async def test_a_malformed_line_is_ignored_and_the_next_event_arrives(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, line: str
) -> None:
    with answering(tmp_path) as daemon:
        async with polling_daemon(tmp_path) as watcher:
            with watcher.page() as page:
                await until(page, "up")
                while not daemon.subscribers:  # noqa: ASYNC110 -- pytest's timeout is the limit
                    await asyncio.sleep(0.01)
                daemon.say(line)
                daemon.send_event({"name": "held", "cycle": 1, "data": {}})
                async with asyncio.timeout(SOON_S):
                    while not (message := await anext(page)).startswith("event: happened"):
                        pass
                assert '"held"' in message
                assert len(daemon.subscribers) == 1  # the same subscription
    assert [record.levelname for record in caplog.records if "daemon" in record.message] == ["WARNING"]


async def test_whatever_goes_wrong_while_it_asks_or_listens_it_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(module, "POLL_S", 0.01)
    request, subscribe = client.request, client.subscribe

    def fails(*_: object) -> Any:
        raise ZeroDivisionError

    with monkeypatch.context() as patch:
        patch.setattr(client, "request", fails)
        patch.setattr(client, "subscribe", fails)
        async with polling_daemon(tmp_path) as watcher:
            with watcher.page() as page:
                await until(page, "silent")
                while "the watcher listens again" not in caplog.text:  # noqa: ASYNC110 -- pytest's timeout is the limit
                    await asyncio.sleep(0.01)
                patch.setattr(client, "request", request)
                patch.setattr(client, "subscribe", subscribe)
                with answering(tmp_path) as daemon:
                    await until(page, "up")
                    while not daemon.subscribers:  # noqa: ASYNC110 -- pytest's timeout is the limit
                        await asyncio.sleep(0.01)


def test_what_json_has_not_is_null() -> None:
    assert finite({1: [float("inf"), (1.5, "x", None, True)]}) == {"1": [None, [1.5, "x", None, True]]}
