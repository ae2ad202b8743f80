"""Event bus and log: each event reaches all receivers, and no receiver blocks it."""

from __future__ import annotations

import asyncio
import json
import logging
import threading
from contextvars import copy_context
from pathlib import Path

import pytest

from polishd.daemon.runtime import events
from polishd.daemon.runtime.events import EventBus
from polishd.daemon.runtime.process import logging_to
from polishd.model.errors import SafetyStop
from polishd.model.events import Event, PassProgressed, PlanWritten


async def test_all_listeners_are_called_in_order() -> None:
    plugins: list[Event] = []
    sink: list[Event] = []
    bus = EventBus(plugins.append, sinks=(sink.append,))
    happened = [PassProgressed(cycle=1, block=n) for n in range(20)]
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
    received: list[int] = []

    def busy(event: Event) -> None:
        entered.set()
        assert release.wait(30)
        received.append(event.facts()["data"]["block"])

    bus = EventBus(busy)
    bus.publish(PassProgressed(block=1))
    assert entered.wait(30)
    bus.publish(PassProgressed(block=2))  # returns although the plugin is busy
    assert received == []
    release.set()
    await bus.close()
    assert received == [1, 2]


async def test_a_hanging_plugin_is_left_behind(caplog: pytest.LogCaptureFixture) -> None:
    release = threading.Event()

    def hangs(event: Event) -> None:
        assert release.wait(30)

    bus = EventBus(hangs)
    bus.publish(PassProgressed(block=1))
    await bus.close(within_s=0.05)
    assert "still processes an event" in caplog.text
    release.set()
    await bus.close()


async def test_a_raising_listener_is_logged_and_called_again(caplog: pytest.LogCaptureFixture) -> None:
    received: list[int] = []

    def raises(event: Event) -> None:
        received.append(event.facts()["data"]["block"])
        raise RuntimeError("oh")

    bus = EventBus(raises)
    bus.publish(PassProgressed(block=1))
    bus.publish(PassProgressed(block=2))
    await bus.close()
    assert received == [1, 2]
    assert caplog.text.count("RuntimeError: oh") == 2


async def test_a_lost_journal_raises_after_all_listeners_were_called() -> None:
    def lost(event: Event) -> None:
        raise SafetyStop("journal lost")

    plugins: list[Event] = []
    bus = EventBus(plugins.append, sinks=(lost,))
    with pytest.raises(SafetyStop):
        bus.publish(PassProgressed(block=1))
    await bus.close()
    assert plugins == [PassProgressed(block=1)]


async def test_a_subscriber_far_behind_is_dropped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(events, "SUBSCRIBER_EVENTS", 5)
    bus = EventBus()
    with bus.subscription() as slow:
        for n in range(8):
            bus.publish(PassProgressed(block=n))
        assert [event async for event in slow] == [PassProgressed(block=n) for n in (1, 2, 3, 4)]
    assert not bus._subscribers


async def test_closed_bus_ends_subscriptions_at_once() -> None:
    bus = EventBus()
    await bus.close()
    await bus.close()
    with bus.subscription() as late:
        assert [event async for event in late] == []
    bus.publish(PassProgressed(block=1))


async def test_subscription_waits_for_what_comes() -> None:
    bus = EventBus()
    with bus.subscription() as waiting:
        task = asyncio.ensure_future(anext(waiting))
        await asyncio.sleep(0)
        bus.publish(PassProgressed(block=1))
        assert await task == PassProgressed(block=1)
    await bus.close()


async def test_a_line_of_one_cell_is_in_no_others_log(tmp_path: Path) -> None:
    """From a task, from a thread of a task, and from a plugin that receives an event."""
    logger = logging.getLogger("polishd.somewhere")
    ready = asyncio.Barrier(2)

    async def cell(name: str) -> None:
        folder = tmp_path / name
        folder.mkdir()
        with logging_to(folder):
            await ready.wait()
            bus = EventBus(lambda event: logger.info("%s plugin", name))
            bus.publish(PassProgressed(block=1))
            logger.info("%s task", name)
            await asyncio.to_thread(logger.info, "%s thread", name)
            await bus.close()
            if name == "a":
                await ready.wait()
            else:
                threading.Thread(target=logger.info, args=("of no cell",)).start()
                await ready.wait()
        if name == "b":  # the other one has ended, or ends now
            logger.info("after")

    async with asyncio.TaskGroup() as group:
        for name in ("a", "b"):
            group.create_task(cell(name))
    for name in ("a", "b"):
        said = [json.loads(line)["message"] for line in (tmp_path / name / "polishd.log").read_text().splitlines()]
        assert sorted(said) == sorted(
            ["pass_progressed", f"{name} plugin", f"{name} task", f"{name} thread", "of no cell"]
        )


async def test_one_cells_end_leaves_the_others_log_as_it_is(tmp_path: Path) -> None:
    folders = [tmp_path / name for name in ("a", "b")]
    for folder in folders:
        folder.mkdir()
    logger = logging.getLogger("polishd.somewhere")
    with logging_to(folders[0]):
        context = copy_context()
        with logging_to(folders[1]):
            pass
        context.run(logger.info, "still here")
    assert "still here" in (folders[0] / "polishd.log").read_text()
    assert logging.getLogger("polishd").level == logging.NOTSET


async def test_log_is_json_lines_with_events_and_errors(tmp_path: Path) -> None:
    with logging_to(tmp_path):
        EventBus().publish(PlanWritten(cycle=2, run_dir=tmp_path))  # type: ignore[arg-type]
        logging.getLogger("polishd.somewhere").warning("%d things", 3)
        try:
            raise ValueError("oh")
        except ValueError:
            logging.getLogger("polishd.somewhere").exception("it failed")
        logging.getLogger("polishd.somewhere").debug("not kept")
    logging.getLogger("polishd.somewhere").error("after")
    lines = [json.loads(line) for line in (tmp_path / "polishd.log").read_text().splitlines()]
    assert [(line["level"], line["message"]) for line in lines] == [
        ("info", "plan_written"),
        ("warning", "3 things"),
        ("error", "it failed"),
    ]
    assert lines[0]["event"] == {"name": "plan_written", "cycle": 2, "data": {"run_dir": str(tmp_path)}}
    assert lines[1]["logger"] == "polishd.somewhere"
    assert lines[1]["at"].endswith("+00:00")
    assert "ValueError: oh" in lines[2]["error"]
