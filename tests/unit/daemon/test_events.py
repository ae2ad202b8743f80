"""The event bus and the log: everybody is told, nobody holds it up."""

from __future__ import annotations

import asyncio
import json
import logging
import threading
from pathlib import Path

import pytest

from polishd.daemon import events
from polishd.daemon.events import EventBus
from polishd.daemon.log import logging_to
from polishd.model.cycle import Event
from polishd.model.errors import SafetyStop


async def test_all_are_told_in_order() -> None:
    plugins: list[Event] = []
    sink: list[Event] = []
    bus = EventBus(plugins.append, sinks=(sink.append,))
    happened = [Event(f"e{n}", n, {"n": n}) for n in range(20)]
    with bus.subscription() as one, bus.subscription() as two:
        for event in happened:
            bus.publish(event)
        assert sink == happened
        await bus.close()
        assert [event async for event in one] == happened
        assert [event async for event in two] == happened
    assert plugins == happened


async def test_a_busy_plugin_holds_up_nothing() -> None:
    entered, release = threading.Event(), threading.Event()
    told: list[str] = []

    def busy(event: Event) -> None:
        entered.set()
        assert release.wait(30)
        told.append(event.name)

    bus = EventBus(busy)
    bus.publish(Event("one"))
    assert entered.wait(30)
    bus.publish(Event("two"))  # returns although the plugin is busy
    assert told == []
    release.set()
    await bus.close()
    assert told == ["one", "two"]


async def test_a_hanging_plugin_is_left_behind(caplog: pytest.LogCaptureFixture) -> None:
    release = threading.Event()

    def hangs(event: Event) -> None:
        assert release.wait(30)

    bus = EventBus(hangs)
    bus.publish(Event("one"))
    await bus.close(within_s=0.05)
    assert "still busy" in caplog.text
    release.set()
    await bus.close()


async def test_a_raising_listener_is_logged_and_told_again(caplog: pytest.LogCaptureFixture) -> None:
    told: list[str] = []

    def raises(event: Event) -> None:
        told.append(event.name)
        raise RuntimeError("oh")

    bus = EventBus(raises)
    bus.publish(Event("one"))
    bus.publish(Event("two"))
    await bus.close()
    assert told == ["one", "two"]
    assert caplog.text.count("RuntimeError: oh") == 2


async def test_a_lost_journal_is_heard_after_all_were_told() -> None:
    def lost(event: Event) -> None:
        raise SafetyStop("journal lost")

    plugins: list[Event] = []
    bus = EventBus(plugins.append, sinks=(lost,))
    with pytest.raises(SafetyStop):
        bus.publish(Event("one"))
    await bus.close()
    assert [event.name for event in plugins] == ["one"]


async def test_a_subscriber_far_behind_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(events, "SUBSCRIBER_EVENTS", 5)
    bus = EventBus()
    with bus.subscription() as slow:
        for n in range(8):
            bus.publish(Event(f"e{n}"))
        assert [event.name async for event in slow] == ["e1", "e2", "e3", "e4"]
    assert not bus._subscribers


async def test_closed_bus_ends_subscriptions_at_once() -> None:
    bus = EventBus()
    await bus.close()
    await bus.close()
    with bus.subscription() as late:
        assert [event async for event in late] == []
    bus.publish(Event("late"))


async def test_subscription_waits_for_what_comes() -> None:
    bus = EventBus()
    with bus.subscription() as waiting:
        task = asyncio.ensure_future(anext(waiting))
        await asyncio.sleep(0)
        bus.publish(Event("now"))
        assert (await task).name == "now"
    await bus.close()


async def test_log_is_json_lines_with_events_and_errors(tmp_path: Path) -> None:
    with logging_to(tmp_path):
        EventBus().publish(Event("pass_started", 2, {"path": tmp_path}))
        logging.getLogger("polishd.somewhere").warning("%d things", 3)
        try:
            raise ValueError("oh")
        except ValueError:
            logging.getLogger("polishd.somewhere").exception("it failed")
        logging.getLogger("polishd.somewhere").debug("not kept")
    logging.getLogger("polishd.somewhere").error("after")
    lines = [json.loads(line) for line in (tmp_path / "polishd.log").read_text().splitlines()]
    assert [(line["level"], line["message"]) for line in lines] == [
        ("info", "pass_started"),
        ("warning", "3 things"),
        ("error", "it failed"),
    ]
    assert lines[0]["event"] == {"name": "pass_started", "cycle": 2, "data": {"path": str(tmp_path)}}
    assert lines[1]["logger"] == "polishd.somewhere"
    assert lines[1]["at"].endswith("+00:00")
    assert "ValueError: oh" in lines[2]["error"]
