"""Approval before motion: who gave it, and what clients see."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path

import pytest

from polishd.config.cell_sections import BoundsSection, SignalSection
from polishd.daemon.cell import readiness
from polishd.daemon.job import part_handling
from polishd.daemon.job.part_handling import approve, require_clear
from polishd.model.devices import SignalLimits, SignalRange
from polishd.model.errors import ConfigError, DeviceRefused, SignalFault
from polishd.model.events import AlarmAcknowledged, CommandReceived, PlanApproved, PlanAwaitingApproval
from tests.unit.daemon.small_job import Bench, open_journal, small_recipe
from tests.unit.daemon.test_app import Running
from tests.unit.daemon.test_health import at_once

CLEAR = SignalLimits("clear", "monitor", "clear", "", None, 0.0, None, 0.0, "hold", SignalRange(state=True))
MINE = "anna (web)"


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    monkeypatch.setattr(readiness, "LOOK_S", 0.0)
    monkeypatch.setattr(part_handling, "LOOK_S", 0.0)
    monkeypatch.setattr(asyncio, "to_thread", at_once)
    with open_journal(tmp_path) as journal:
        yield Bench(tmp_path, journal)


async def waits(running: Running) -> PlanAwaitingApproval:
    """Event of the waiting plan."""
    approval = running.bench.fake.cell.approval
    while not approval.wanted:  # noqa: ASYNC110 - pytest's timeout is the limit
        await asyncio.sleep(0)
    (event,) = (one for one in running.daemon.job.published if isinstance(one, PlanAwaitingApproval))  # type: ignore[union-attr]
    return event


async def test_nothing_moves_before_the_plan_that_waits_is_approved(bench: Bench) -> None:
    async with Running(bench, recipe=small_recipe(tolerance_nm=1.5, approve=True)) as running:
        waiting = await waits(running)
        assert waiting.predicted_rms_nm > 0
        assert waiting.concern().severity == "warning"
        handlers = running.daemon.handlers
        assert (await handlers["live"]())["approval"] == waiting.program_sha256
        with pytest.raises(DeviceRefused, match="another plan waits"):
            await handlers["approve"](program_sha256="ff" * 32)
        assert "robot.resume" not in " ".join(bench.fake.events)
        await handlers["approve"](program_sha256=waiting.program_sha256, by=MINE)
        await running.in_contact()
        assert [one.by for one in running.published if isinstance(one, PlanApproved)] == [MINE]
        assert bench.fake.cell.approval.wanted == ""


async def test_a_hold_ends_the_wait_for_approval(bench: Bench) -> None:
    async with Running(bench, recipe=small_recipe(tolerance_nm=1.5, approve=True)) as running:
        await waits(running)
        await running.daemon.handlers["hold"](reason="later", by=MINE)
        assert running.daemon.state == "held"
        with pytest.raises(DeviceRefused, match="no plan waits"):
            await running.daemon.handlers["approve"](program_sha256="ff" * 32)
        (ordered,) = (one for one in running.published if isinstance(one, CommandReceived))
        assert (ordered.order, ordered.reason, ordered.by) == ("hold", "later", MINE)


async def test_what_leads_to_motion_is_refused_until_the_cell_is_clear(bench: Bench) -> None:
    monitor = bench.fake.with_monitor(CLEAR, clear=False)
    async with Running(bench) as running:
        await running.in_contact()
        await running.daemon.handlers["hold"]()
        with pytest.raises(DeviceRefused, match=r"clear is off, must be on"):
            await running.daemon.handlers["resume"]()
        assert running.daemon.state == "held"
        with pytest.raises(DeviceRefused, match="approve is refused: clear is off"):
            await running.daemon.handlers["approve"](program_sha256="ff" * 32)
        monitor.values["clear"] = True
        while bench.fake.cell.signals.wrong_on_start():  # noqa: ASYNC110
            await asyncio.sleep(0)
        await running.daemon.handlers["resume"]()
        assert running.daemon.state == "polishing"


async def test_a_signal_without_a_value_is_not_clear(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(part_handling, "FIRST_VALUE_S", 0.0)
    bench.fake.with_monitor(CLEAR, clear=True)
    with pytest.raises(SignalFault, match="clear is not known"):
        await require_clear(bench.fake.cell)


async def test_a_cell_without_such_a_signal_asks_for_none(bench: Bench) -> None:
    await require_clear(bench.fake.cell)
    with pytest.raises(DeviceRefused, match="no plan waits"):
        await approve(bench.fake.cell, lambda _: None, "ff" * 32)


async def test_who_watches_sees_readings_with_their_ages(bench: Bench) -> None:
    async with Running(bench) as running:
        await running.in_contact()
        live = await running.daemon.handlers["live"]()
        assert live["pressing"]
        assert live["readings"]["force"]["age_s"] >= 0
        assert "at_s" not in live["readings"]["force"]
        assert live["readings"]["sensed"] is None
        assert {"state", "cycle", "phase", "ages_s", "signals", "health", "unsafe"} <= set(live)


async def test_alarms_are_acknowledged_by_name(bench: Bench) -> None:
    async with Running(bench) as running:
        await running.daemon.handlers["acknowledge"](alarms=[3, 4], by=MINE)
        (seen,) = (one for one in running.published if isinstance(one, AlarmAcknowledged))
        assert (list(seen.alarms), seen.by) == ([3, 4], MINE)
        for wrong in ([0], ["1"], [True], [1] * 1001):
            with pytest.raises(ConfigError, match="numbers of events"):
                await running.daemon.handlers["acknowledge"](alarms=wrong)


def test_a_signal_may_be_asked_for_orders_alone() -> None:
    section = SignalSection(on_start=BoundsSection(state=True))
    assert section.limits("clear").on_start == SignalRange(state=True)
    assert str(section.limits("clear")).endswith("when motion is ordered on")
    with pytest.raises(ValueError, match="has no requirement"):
        SignalSection()
