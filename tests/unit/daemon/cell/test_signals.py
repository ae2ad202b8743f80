"""Signals of the cell before contact and in it: their limits, their grace, their silence, and what they lead to."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest

from polishd.daemon.cell import readiness
from polishd.daemon.cell.cell import Signals
from polishd.daemon.cell.readiness import monitoring_signals, report_once, until_ready
from polishd.model.devices import Signal, SignalLimits, SignalRange
from polishd.model.errors import DeviceFault, LinkError, SignalFault
from polishd.model.events import Event, SignalOutOfRange
from tests.fakes.devices import FakeCell

FLOW = SignalLimits("flow", "monitor", "AI3", "l/min", SignalRange(min=1.0), 5.0, SignalRange(min=0.8), 2.0, "lift")
GUARD = SignalLimits(
    "guard", "monitor", "guard", "", SignalRange(state=True), 0.0, SignalRange(state=True), 0.0, "estop"
)


class Monitored:
    """Signals that a monitor sends every 0.1 s."""

    def __init__(self, *limits: SignalLimits) -> None:
        self.signals = Signals(limits or (FLOW, GUARD), {"monitor": 1.0})

    def run(
        self, seconds: float, flow: float | None, *, guard: bool | None = True, in_contact: bool = True
    ) -> list[str]:
        """Messages of that time."""
        said = []
        for _ in range(round(seconds / 0.1)):
            for name, value in (("AI3", flow), ("guard", guard)):
                self.signals.update("monitor", Signal(0.0, name, value))
            said += [what for _, what in self.signals.pass_by(0.1, in_contact=in_contact)]
        return said

    def silent(self, seconds: float) -> list[str]:
        steps = round(seconds / 0.1)
        return [what for _ in range(steps) for _, what in self.signals.pass_by(0.1, in_contact=True)]


def test_what_holds_is_not_reported() -> None:
    monitored = Monitored()
    assert monitored.run(10.0, 0.8) == []


def test_what_is_wrong_for_longer_than_its_grace_is_reported_once() -> None:
    monitored = Monitored()
    assert monitored.run(1.0, 1.2) == []
    assert monitored.run(1.9, 0.2) == []
    said = "flow is 0.2 l/min, must be at least 0.8 l/min in contact; it was wrong for more than 2 s"
    assert monitored.run(10.0, 0.2) == [said]


def test_a_short_fault_is_forgiven_each_time() -> None:
    monitored = Monitored()
    for _ in range(5):
        assert monitored.run(1.9, 0.2) == []
        assert monitored.run(0.1, 1.2) == []


def test_without_grace_it_is_reported_at_once() -> None:
    monitored = Monitored()
    monitored.run(1.0, 1.2)
    assert monitored.run(0.1, 1.2, guard=False) == [
        "guard is off, must be on in contact; it was wrong for more than 0 s"
    ]


def test_out_of_contact_nothing_is_reported_and_the_next_contact_counts_anew() -> None:
    monitored = Monitored()
    assert len(monitored.run(5.0, 0.2)) == 1
    assert monitored.run(5.0, 0.2, in_contact=False) == []
    assert monitored.run(1.9, 0.2) == []
    assert len(monitored.run(0.3, 0.2)) == 1


def test_a_silent_monitor_knows_nothing() -> None:
    monitored = Monitored()
    monitored.run(1.0, 1.2)
    assert monitored.silent(0.9) == []
    guard, flow = monitored.silent(3.0)
    assert guard.startswith("guard is not known, must be on")
    assert flow.startswith("flow is not known, must be at least 0.8 l/min")


def test_a_value_that_the_monitor_does_not_know_is_wrong() -> None:
    assert len(Monitored().run(3.0, None)) == 1


def test_before_contact_other_limits_hold() -> None:
    monitored = Monitored()
    assert set(monitored.signals.not_ready().values()) == {
        "flow is not known, must be at least 1 l/min", "guard is not known, must be on"
    }  # fmt: skip
    monitored.run(0.1, 0.9)
    assert monitored.signals.not_ready() == {FLOW: "flow is 0.9 l/min, must be at least 1 l/min"}
    monitored.run(0.1, 1.0)
    assert monitored.signals.not_ready() == {}


def test_limits_of_contact_alone_do_not_keep_it_from_beginning() -> None:
    monitored = Monitored(replace(FLOW, before=None))
    assert monitored.signals.not_ready() == {}
    assert monitored.run(3.0, 0.1) != []


def test_status_has_each_with_what_is_wrong() -> None:
    monitored = Monitored()
    monitored.run(0.1, 0.9, in_contact=False)
    facts = monitored.signals.facts()
    assert facts["flow"] == {
        "value": 0.9, "text": "0.9 l/min", "wrong": "flow is 0.9 l/min, must be at least 1 l/min", "action": "lift"
    }  # fmt: skip
    assert (facts["guard"]["value"], facts["guard"]["text"], facts["guard"]["wrong"]) == (True, "on", "")


# of a cell


@pytest.fixture
def fake() -> FakeCell:
    fake = FakeCell()
    fake.with_monitor(FLOW, GUARD, silence_s=1.0, AI3=1.5, guard=True, unused=3.0)
    return fake


@pytest.fixture(autouse=True)
def quickly(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(readiness, "LOOK_S", 0.01)
    monkeypatch.setattr(readiness, "AGAIN_S", 0.01)


async def test_what_is_wrong_in_contact_is_reported_with_what_it_leads_to(fake: FakeCell) -> None:
    alarms: asyncio.Queue[tuple[SignalLimits, str]] = asyncio.Queue()
    async with monitoring_signals(fake.cell, lambda *what: alarms.put_nowait(what)):
        while fake.cell.signals.not_ready():  # noqa: ASYNC110
            await asyncio.sleep(0.01)
        fake.cell.pressing = True
        fake.monitor.values["guard"] = False
        limits, said = await alarms.get()
    assert (limits, limits.action) == (GUARD, "estop")
    assert said.startswith("guard is off, must be on in contact")


async def test_a_monitor_that_fails_is_read_again(fake: FakeCell) -> None:
    monitor = fake.monitor
    async with monitoring_signals(fake.cell, lambda *_: None):
        for failure in (LinkError("gone"), RuntimeError("a plugin's own")):
            while fake.cell.signals.not_ready():  # noqa: ASYNC110
                await asyncio.sleep(0.01)
            monitor.fails = failure
            while not fake.cell.signals.not_ready():
                fake.cell.signals.pass_by(0.1, in_contact=False)
                await asyncio.sleep(0.01)
            monitor.fails = None


async def test_contact_waits_until_signals_are_ready(fake: FakeCell) -> None:
    monitor, published = fake.monitor, list[Event]()
    monitor.values["AI3"] = 0.2
    async with monitoring_signals(fake.cell, lambda *_: None):
        while len(fake.cell.signals.not_ready()) == 2:  # noqa: ASYNC110
            await asyncio.sleep(0.01)
        waiting = asyncio.ensure_future(until_ready(fake.cell, published.append, 3))
        while not published:  # noqa: ASYNC110
            await asyncio.sleep(0.01)
        fake.clock.advance(1.0)
        await asyncio.sleep(0)
        assert not waiting.done()
        monitor.values["AI3"] = 1.0
        while not waiting.done():
            fake.clock.advance(0.01)
            await asyncio.sleep(0.01)
    what = "flow is 0.2 l/min, must be at least 1 l/min before contact; the daemon waits for up to 5 s"
    assert published == [SignalOutOfRange(cycle=3, signal="flow", what=what, action="wait")], "published once"


async def test_what_is_waited_for_in_vain_holds_the_cell(fake: FakeCell) -> None:
    monitor = fake.monitor
    monitor.values["AI3"] = 0.2
    async with monitoring_signals(fake.cell, lambda *_: None):
        while len(fake.cell.signals.not_ready()) == 2:  # noqa: ASYNC110
            await asyncio.sleep(0.01)
        waiting = asyncio.ensure_future(until_ready(fake.cell, lambda _: None, 0))
        while not waiting.done():
            fake.clock.advance(0.5)
            await asyncio.sleep(0)
        with pytest.raises(SignalFault, match=r"^before contact flow is 0\.2 l/min, .* nothing was moved$"):
            await waiting
    assert SignalFault.mendable


async def test_what_may_not_be_waited_for_holds_at_once(fake: FakeCell) -> None:
    fake.monitor.values["guard"] = False
    async with monitoring_signals(fake.cell, lambda *_: None):
        while len(fake.cell.signals.not_ready()) == 2:  # noqa: ASYNC110
            await asyncio.sleep(0.01)
        with pytest.raises(SignalFault, match="guard is off"):
            await until_ready(fake.cell, lambda _: None, 0)


# probe


async def test_probe_tells_each_watched_signal(fake: FakeCell) -> None:
    await report_once(fake.cell, "monitor")
    assert {name: facts["text"] for name, facts in fake.cell.signals.facts().items()} == {
        "flow": "1.5 l/min",
        "guard": "on",
    }


async def test_probe_names_what_a_monitor_does_not_tell(fake: FakeCell) -> None:
    del fake.monitor.values["AI3"]
    with pytest.raises(DeviceFault, match="monitor: has no signal 'AI3'; it has 'guard', 'unused'"):
        await report_once(fake.cell, "monitor")


async def test_probe_does_not_wait_for_ever(fake: FakeCell, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(readiness, "OPEN_S", 0.02)
    fake.monitor.silent = True
    with pytest.raises(LinkError, match="did not report all its signals"):
        await report_once(fake.cell, "monitor")


async def test_a_monitor_whose_link_was_just_opened_again_is_waited_for(fake: FakeCell) -> None:
    """What may not be waited for is judged once it is known."""
    fake.monitor.silent = True
    waiting = asyncio.ensure_future(until_ready(fake.cell, lambda _: None, 0))
    fake.clock.advance(1.0)
    await asyncio.sleep(0.01)
    assert not waiting.done()
    for name, value in fake.monitor.values.items():
        fake.cell.signals.update("monitor", Signal(0.0, name, value))
    while not waiting.done():
        fake.clock.advance(0.1)
        await asyncio.sleep(0)
    await waiting


async def test_a_monitor_that_says_nothing_holds_the_cell(fake: FakeCell) -> None:
    waiting = asyncio.ensure_future(until_ready(fake.cell, lambda _: None, 0))
    while not waiting.done():
        fake.clock.advance(0.5)
        await asyncio.sleep(0)
    with pytest.raises(SignalFault, match=r"flow is not known, .*guard is not known, must be on"):
        await waiting
    assert fake.clock.at_s >= readiness.UNKNOWN_S
