"""Actions of signals: the daemon notifies, holds, ends or stops motion; nothing moves before all are ready."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from polishd.daemon.cell import readiness
from polishd.model.devices import SignalAction, SignalLimits, SignalRange
from polishd.model.errors import SafetyStop, SignalFault
from polishd.model.events import CellHeld, SignalOutOfRange
from polishd.model.states import Outcome
from tests.fakes.devices import FakeMonitor
from tests.unit.daemon.small_job import Bench, open_journal
from tests.unit.daemon.test_app import SAFE, Running
from tests.unit.daemon.test_health import at_once

FLOW = SignalLimits("flow", "monitor", "flow", "l/min", SignalRange(min=1.0), 3.0, SignalRange(min=0.8), 0.0, "hold")
WRONG = "flow is 0.2 l/min, must be at least 0.8 l/min in contact; it was wrong for more than 0 s"


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    monkeypatch.setattr(readiness, "LOOK_S", 0.0)
    monkeypatch.setattr(readiness, "AGAIN_S", 0.0)
    monkeypatch.setattr(asyncio, "to_thread", at_once)
    with open_journal(tmp_path) as journal:
        yield Bench(tmp_path, journal)


def monitored(bench: Bench, action: SignalAction) -> FakeMonitor:
    return bench.fake.with_monitor(replace(FLOW, action=action), flow=1.5)


def published_alarms(running: Running) -> list[SignalOutOfRange]:
    """Return the alarms that the job published."""
    return [event for event in running.daemon.job.published if isinstance(event, SignalOutOfRange)]  # type: ignore[union-attr]


async def ready(bench: Bench) -> None:
    """Set all signals to good values directly, because the clock of the test stands still."""
    while bench.fake.cell.signals.not_ready():  # noqa: ASYNC110
        await asyncio.sleep(0)


@pytest.mark.full
async def test_hold_leaves_contact_in_order_and_a_person_goes_on(bench: Bench) -> None:
    monitor = monitored(bench, "hold")
    async with Running(bench) as running:
        await running.in_contact()
        monitor.values["flow"] = 0.2
        await running.held()
        assert bench.fake.of("make_safe")[3:6] == SAFE
        assert running.daemon.reason.startswith(f"SignalFault: {WRONG}; pass 0 was interrupted")
        (held,) = (event for event in running.published if isinstance(event, CellHeld))
        assert held.kind == "SignalFault"
        status = await running.daemon.status()
        assert status["signals"]["flow"]["wrong"] == "flow is 0.2 l/min, must be at least 1 l/min"
        assert status["devices"]["monitor"]["used"] is True
        monitor.values["flow"] = 1.5
        await ready(bench)
        await running.daemon.handlers["resume"]()
        assert await running.outcome() is Outcome.IN_TOLERANCE
    assert [event.what for event in running.published if isinstance(event, SignalOutOfRange)] == [WRONG]


async def test_lift_ends_the_daemon_as_any_safety_stop(bench: Bench) -> None:
    monitor = monitored(bench, "lift")
    async with Running(bench) as running:
        await running.in_contact()
        monitor.values["flow"] = 0.2
        with pytest.raises(SafetyStop, match=r"^flow is 0\.2 l/min"):
            await running.outcome()
    assert bench.fake.of("make_safe")[3:6] == SAFE
    assert bench.journal.unfinished() is not None, "the next start settles it, and comes up held"


async def test_of_two_that_are_wrong_the_worse_counts(bench: Bench) -> None:
    """A silent monitor makes all its signals unknown; `resume` must not go on from one of them."""
    limits = [replace(FLOW, name=f"{word} flow", action=word) for word in ("hold", "lift")]
    monitor = bench.fake.with_monitor(*limits, flow=1.5)
    async with Running(bench) as running:
        await running.in_contact()
        monitor.values["flow"] = 0.2
        with pytest.raises(SafetyStop, match=r"^lift flow is 0\.2 l/min.*; hold flow is 0\.2 l/min"):
            await running.outcome()


async def test_what_goes_wrong_on_the_way_to_the_part_is_found_as_the_tool_is_sent_out(bench: Bench) -> None:
    """Nothing is polished over it: limits in contact hold from before the spindle turns."""
    monitor = monitored(bench, "hold")
    bench.fake.robot.acts.before["resume"] = lambda: monitor.values.update(flow=0.2)
    async with Running(bench) as running:
        await running.held()
        assert running.daemon.reason.startswith(f"SignalFault: {WRONG}")
        assert bench.journal.uncertain(0) == ()
        assert bench.journal.contact_s(0) == 0.0


@pytest.mark.full
async def test_estop_stops_motion_whatever_the_part_costs(bench: Bench) -> None:
    monitor = monitored(bench, "estop")
    stopped: list[bool] = []
    bench.fake.robot.acts.before["make_safe"] = lambda: stopped.append(bench.fake.actuator.retracted)
    async with Running(bench) as running:
        await running.in_contact()
        monitor.values["flow"] = 0.2
        await running.held()
        assert stopped[1] is False, "the tool is still on the part; the first is the start's"
        assert "SignalFault: flow is 0.2 l/min" in running.daemon.reason
        monitor.values["flow"] = 1.5
        await ready(bench)
        await running.daemon.handlers["resume"]()
        assert await running.outcome() is Outcome.IN_TOLERANCE


@pytest.mark.full
async def test_notify_tells_and_goes_on(bench: Bench) -> None:
    monitor = monitored(bench, "notify")
    async with Running(bench) as running:
        await running.in_contact()
        monitor.values["flow"] = 0.2
        while not any(isinstance(event, SignalOutOfRange) for event in running.published):  # noqa: ASYNC110
            await asyncio.sleep(0)
        monitor.values["flow"] = 1.5
        assert await running.outcome() is Outcome.IN_TOLERANCE
    (wrong,) = (event for event in running.published if isinstance(event, SignalOutOfRange))
    assert (wrong.what, wrong.action) == (WRONG, "notify")
    concern = wrong.concern()
    assert concern is not None
    assert concern.what == WRONG


@pytest.mark.full
async def test_nothing_moves_before_it_is_ready_and_the_cell_is_held_in_the_end(bench: Bench) -> None:
    monitor = monitored(bench, "hold")
    monitor.values["flow"] = 0.9
    async with Running(bench) as running:
        while not published_alarms(running):  # noqa: ASYNC110
            await asyncio.sleep(0)
        assert running.daemon.state == "polishing"
        while running.daemon.state == "polishing":
            bench.fake.clock.advance(0.5)
            await asyncio.sleep(0)
        await running.held()
        assert running.daemon.reason.startswith("SignalFault: before contact flow is 0.9 l/min")
        assert bench.moved() == []
        assert bench.journal.passes == ()
        monitor.values["flow"] = 1.0
        await ready(bench)
        await running.daemon.handlers["resume"]()
        assert await running.outcome() is Outcome.IN_TOLERANCE


@pytest.mark.full
async def test_without_a_person_it_ends_there(bench: Bench) -> None:
    monitor = monitored(bench, "hold")
    monitor.values["flow"] = 0.9
    async with Running(bench, holds=False) as running:
        assert running.task is not None
        while not running.task.done():
            bench.fake.clock.advance(0.5)
            await asyncio.sleep(0)
        with pytest.raises(SignalFault):
            await running.outcome()
