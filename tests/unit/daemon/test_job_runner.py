"""The daemon of a queue: which job comes next, who changes the parts, and what each ending leads to."""

from __future__ import annotations

import asyncio
import json
import sqlite3
import weakref
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, Self

import pytest

from polishd.config.job_file import JobFile
from polishd.daemon import job_runner as daemon_module
from polishd.daemon.app import _serve
from polishd.daemon.cycle import short_collections
from polishd.daemon.job.job import Job
from polishd.daemon.job_runner import IN_THE_WAY, JobRunner, run_until_finished
from polishd.daemon.job_source import QueuedJobs
from polishd.daemon.journal.journal import Journal
from polishd.daemon.journal.records import BlockRecord
from polishd.daemon.queue.queue import NewJob, Queue, QueueEntry
from polishd.daemon.queue.requests import QueueRequests
from polishd.daemon.runtime.events import EventBus
from polishd.model.devices import ExecutedBlock
from polishd.model.errors import (
    ConfigError,
    DeviceFault,
    DeviceRefused,
    LinkError,
    MapError,
    PlanRefused,
    PolishdError,
    RemovalCheckStop,
    SafetyStop,
    SeatNotLeft,
    ToolStop,
    WrongPart,
    WrongSeat,
)
from polishd.model.estimates import Finding
from polishd.model.events import Event
from polishd.model.states import CyclePhase, DaemonState, Outcome, Severity
from polishd.pipeline.records import FIGURES
from polishd.pipeline.run_folder import RunFolder
from tests.fakes.devices import FakeCell
from tests.unit.daemon.job.test_part_handling_clearance import CLEAR
from tests.unit.daemon.small_job import small_job

End = Outcome | PolishdError | Callable[[Job], Any]


class Hall:
    """A cell whose jobs end as the test says, and the daemon that works its queue."""

    def __init__(self, tmp_path: Path, journal: Journal, ends: dict[str, list[End]]) -> None:
        self.tmp_path, self.journal = tmp_path, journal
        self.ends = ends
        self.fake = FakeCell()
        self.refused: dict[str, PolishdError] = {}
        """Jobs that cannot begin."""
        self.taken_out: set[str] = set()
        """Jobs that an operator removes while they are prepared."""
        self.published: list[Event] = []
        self.polished: list[str] = []
        self.queue = Queue(journal.store)

    def add(self, *names: str) -> Self:
        """Jobs of that name, each with a part ``P-<name>``."""
        self.queue.add([NewJob(name, f"P-{name}", JobFile(Path(f"/{name}.toml"), ""), {}) for name in names])
        return self

    async def make(self, entry: QueueEntry, queue: Queue, journal: Journal, publish: Any) -> tuple[Job, RunFolder]:
        if entry.name in self.refused:
            raise self.refused[entry.name]
        if entry.name in self.taken_out:
            queue.remove(entry.name, "by the test")
        own = journal.of_job(entry.name, entry.part_id, {})
        queue.begin(entry, own.number)
        folder = RunFolder(self.tmp_path / "runs" / entry.name)
        folder.create()
        return small_job(self.tmp_path, own, folder=folder, publish=publish), folder

    async def polish(self, _cell: Any, job: Job, journal: Journal) -> Outcome:
        entry = self.jobs.entry
        assert entry is not None
        assert job.journal is journal
        self.polished.append(entry.name)
        end = self.ends[entry.name].pop(0) if self.ends.get(entry.name) else Outcome.IN_TOLERANCE
        if callable(end) and not isinstance(end, Outcome):
            end = end(job)
            if asyncio.iscoroutine(end):
                end = await end
        if isinstance(end, PolishdError):
            raise end
        assert isinstance(end, Outcome)
        return end

    async def start(self, **options: Any) -> None:
        await self.build(**options)
        self.task = asyncio.ensure_future(self.daemon.run())

    async def build(self, **options: Any) -> None:
        self.jobs = QueuedJobs(self.journal, self.make)
        self.bus = self.jobs.bus = EventBus(sinks=(self.jobs.record, self.published.append))
        await self.jobs.resume()
        requests = QueueRequests(None, None, self.jobs.queue, self.jobs.added)  # type: ignore[arg-type]
        self.queue = self.jobs.queue
        self.daemon = JobRunner(self.fake.cell, self.jobs, requests, self.bus, **options)

    async def run(self, **options: Any) -> Outcome:
        await self.start(**{"until_empty": True} | options)
        return await self.task

    async def until(self, state: str) -> None:
        """pytest's timeout is the limit."""
        while self.daemon.state != state and not self.task.done():  # noqa: ASYNC110
            await asyncio.sleep(0)
        assert self.daemon.state == state, self.task

    async def until_again(self, state: str) -> None:
        """Once all that is to happen has happened."""
        for _ in range(100):
            await asyncio.sleep(0)
        await self.until(state)

    async def wait(self, condition: Callable[[], Any]) -> None:
        """Wait until the condition is true; pytest's timeout is the limit."""
        while not condition() and not self.task.done():  # noqa: ASYNC110
            await asyncio.sleep(0)
        assert condition(), self.task

    async def order(self, verb: str, **arguments: str) -> Any:
        return await self.daemon.handlers[verb](**arguments)

    async def end(self) -> None:
        self.task.cancel()
        with suppress(asyncio.CancelledError, PolishdError):
            await self.task

    def verdicts(self) -> dict[str, str]:
        return {entry.name: entry.state for entry in self.queue.entries()}

    def events(self, name: str) -> list[dict[str, Any]]:
        return [dict(event.data) for event in self.published if event.name == name]


@pytest.fixture
def hall(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Hall]:
    with Journal.of_cell(tmp_path) as journal:
        hall = Hall(tmp_path, journal, {})
        monkeypatch.setattr(daemon_module, "polish", hall.polish)
        yield hall


class Knot:
    """Garbage that only the collector finds, as what a pass leaves may be."""

    def __init__(self) -> None:
        self.itself = self


@pytest.mark.full
async def test_what_the_passes_of_a_job_froze_does_not_outlive_it(hall: Hall) -> None:
    """The collector looks for garbage among what is old when a quarter of it is new: parts after it was frozen."""
    knots: list[weakref.ref[Knot]] = []
    lived: list[bool] = []

    def passes(_: Job) -> Outcome:
        lived.extend(knot() is not None for knot in knots)
        knots.append(weakref.ref(Knot()))
        with short_collections():
            pass
        return Outcome.IN_TOLERANCE

    hall.ends = {"one": [passes], "two": [passes]}
    hall.add("one", "two").fake.with_loader()
    await hall.run()
    assert lived == [False]


def torn(error: PolishdError | None = None) -> Callable[[Job], Any]:
    """An end that cuts off a pass; without an error it waits there for an order."""

    async def end(job: Job) -> Outcome:
        async with job.journal.phase(0, CyclePhase.RUN):
            job.journal.begin_pass(0, "sha", "boot-0", 300, contact=(4, 290))
            job.journal.record_executed(0, [BlockRecord(ExecutedBlock(4, 0.0, 1.0), True)])
            if error is None:
                await asyncio.Event().wait()
            raise error or RuntimeError

    return end


async def whole(job: Job) -> Outcome:
    """An end after a whole pass."""
    async with job.journal.phase(0, CyclePhase.RUN):
        job.journal.begin_pass(0, "sha", "boot-0", 300, contact=(4, 290))
        job.journal.record_executed(0, [BlockRecord(ExecutedBlock(4, 0.0, 1.0), True)])
        job.journal.end_pass(0, "done")
    return Outcome.IN_TOLERANCE


def touching(error: PolishdError) -> Callable[[Job], Any]:
    """An end in a touch-off."""

    async def end(job: Job) -> Outcome:
        async with job.journal.phase(0, CyclePhase.TOUCH_OFF):
            raise error

    return end


async def killed_amid_a_pass(hall: Hall, name: str) -> None:
    """An earlier daemon left that job so."""
    own = hall.journal.of_job(name, f"P-{name}", {})
    hall.queue.begin(next(entry for entry in hall.queue.to_do() if entry.name == name), own.number)
    with suppress(SafetyStop):
        await torn(SafetyStop("killed"))(small_job(hall.tmp_path, own))


# from job to job


async def test_a_loader_brings_part_after_part_to_a_cell_that_is_opened_once(hall: Hall) -> None:
    loader = hall.add("a", "b", "c").fake.with_loader()
    loader.seat = "P-old"
    assert await hall.run() is Outcome.IN_TOLERANCE
    assert hall.verdicts() == dict.fromkeys("abc", "accepted")
    moves = ["unload P-old", "load P-a", "unload P-a", "load P-b", "unload P-b", "load P-c"]
    assert hall.fake.of("loader.unload", "loader.load") == [f"loader.{move}" for move in moves]
    assert len(hall.fake.of("actuator.open")) == len(hall.fake.of("actuator.close")) == 1
    assert [(event["job"], event["part_id"]) for event in hall.events("job_started")] == [
        ("a", "P-a"),
        ("b", "P-b"),
        ("c", "P-c"),
    ]
    assert [event["verdict"] for event in hall.events("queue_job_ended")] == ["accepted"] * 3
    assert [event["by"] for event in hall.events("part_changed")] == ["loader"] * 3
    summary = json.loads((hall.tmp_path / "runs" / "b" / "summary.json").read_text())
    assert (summary["job"], summary["verdict"], summary["outcome"]) == ("b", "accepted", "in_tolerance")


async def test_before_a_loader_moves_every_device_is_made_safe(hall: Hall) -> None:
    hall.add("a", "b").fake.with_loader()
    await hall.run()
    events = hall.fake.of("make_safe", "loader.load")
    for load in (at for at, event in enumerate(events) if event.startswith("loader.load")):
        assert {event.split(".")[0] for event in events[load - 4 : load]} == {"actuator", "robot", "spindle", "loader"}


async def test_without_a_loader_a_person_changes_the_parts(hall: Hall) -> None:
    hall.add("a", "b")
    await hall.start(until_empty=True)
    for name in ("a", "b"):
        await hall.until("changing")
        status = await hall.order("status")
        assert status["reason"] == f"{name}: an operator has to put part 'P-{name}' in"
        assert "polishd resume" in status["next"]
        assert hall.polished == ["a"] * (name == "b")
        await hall.order("resume")
        await hall.wait(lambda done=1 + (name == "b"): len(hall.polished) == done)
    assert await hall.task is Outcome.IN_TOLERANCE
    assert hall.verdicts() == {"a": "accepted", "b": "accepted"}


async def test_a_part_that_a_person_put_in_is_not_polished_until_the_cell_is_clear(hall: Hall) -> None:
    hall.add("a")
    monitor = hall.fake.with_monitor(CLEAR, clear=False)
    await hall.start(until_empty=True)
    await hall.until("changing")
    with pytest.raises(DeviceRefused, match="clear is off, must be on"):
        await hall.order("resume")
    assert hall.daemon.state == "held"
    assert hall.polished == []
    assert not hall.events("part_changed")
    monitor.values["clear"] = True
    await hall.order("resume")
    await hall.until("changing")
    await hall.order("resume")
    await hall.task
    assert hall.verdicts() == {"a": "accepted"}


async def test_without_a_loader_the_queue_waits_for_no_absent_operator(hall: Hall) -> None:
    hall.add("a")
    with pytest.raises(DeviceRefused, match="put part 'P-a' in, but --no-hold"):
        await hall.run(holds=False)
    assert hall.verdicts() == {"a": "under way"}


async def test_it_waits_for_a_job_and_takes_one_that_is_added(hall: Hall) -> None:
    hall.fake.with_loader()
    await hall.start()
    await hall.until("idle")
    hall.add("a")
    hall.jobs.added()
    await hall.wait(lambda: hall.verdicts() == {"a": "accepted"})
    await hall.until("idle")
    hall.daemon.stop()
    assert await hall.task is Outcome.STOPPED


async def test_status_tells_the_job_and_what_comes_next(hall: Hall) -> None:
    hall.add("a", "b", "c")
    await hall.start()
    await hall.until("changing")
    status = await hall.order("status")
    assert (status["waiting"], status["next_job"]) == (2, "b (part P-b)")
    await hall.end()


# what endings lead to


@pytest.mark.parametrize("error", [MapError("x"), PlanRefused("x"), WrongPart("x")])
async def test_what_is_the_parts_own_fault_puts_it_aside_and_the_queue_goes_on(hall: Hall, error: PolishdError) -> None:
    hall.add("a", "b").fake.with_loader()
    hall.ends["a"] = [error]
    await hall.run()
    assert hall.verdicts() == {"a": "set aside", "b": "accepted"}
    (first, _) = hall.events("queue_job_ended")
    assert (first["reason"], first["stops"]) == (f"{type(error).__name__}: x", "")


async def test_a_job_that_cannot_begin_is_put_aside_and_nothing_moves_for_it(hall: Hall) -> None:
    hall.add("a", "b").fake.with_loader()
    hall.refused["a"] = ConfigError("lens.rnc was changed since")
    await hall.run()
    assert hall.verdicts() == {"a": "set aside", "b": "accepted"}
    assert hall.fake.of("loader.load") == ["loader.load P-b"]


async def test_a_job_that_is_taken_out_while_it_is_made_ready_does_not_begin(hall: Hall) -> None:
    hall.add("a", "b").fake.with_loader()
    hall.taken_out.add("a")
    await hall.run()
    assert hall.verdicts() == {"a": "removed", "b": "accepted"}
    assert hall.polished == ["b"]


async def test_two_parts_in_a_row_with_the_same_fault_stop_it_and_resume_goes_on_with_the_next(hall: Hall) -> None:
    hall.add("a", "b", "c").fake.with_loader()
    hall.ends = {"a": [MapError("x")], "b": [MapError("y")]}
    await hall.start(until_empty=True)
    await hall.until("held")
    assert hall.daemon.reason == (
        "the queue stopped: two parts in a row ended with the same fault, MapError; b was set aside: MapError: y"
    )
    await hall.order("resume")
    assert await hall.task is Outcome.IN_TOLERANCE
    assert hall.verdicts() == {"a": "set aside", "b": "set aside", "c": "accepted"}


async def test_other_faults_in_a_row_do_not(hall: Hall) -> None:
    hall.add("a", "b", "c", "d").fake.with_loader()
    hall.ends = {"a": [MapError("x")], "b": [Outcome.CYCLES_USED], "c": [MapError("y")]}
    await hall.run()
    assert list(hall.verdicts().values()) == ["set aside", "rejected", "set aside", "accepted"]


async def test_the_gate_stops_it_at_once(hall: Hall) -> None:
    hall.add("a", "b").fake.with_loader()
    hall.ends["a"] = [RemovalCheckStop("turned by 90 degrees")]
    await hall.start()
    await hall.until("held")
    assert "the queue stopped: instrument or alignment is wrong" in hall.daemon.reason
    assert hall.verdicts() == {"a": "set aside", "b": "waiting"}
    await hall.end()


async def test_a_device_at_fault_between_passes_holds_the_same_job(hall: Hall) -> None:
    hall.add("a", "b").fake.with_loader()
    hall.ends["a"] = [LinkError("gone"), Outcome.IN_TOLERANCE]
    await hall.start(until_empty=True)
    await hall.until("held")
    assert hall.verdicts() == {"a": "under way", "b": "waiting"}
    await hall.order("resume")
    await hall.task
    assert hall.polished == ["a", "a", "b"]
    assert hall.verdicts() == {"a": "accepted", "b": "accepted"}
    assert hall.fake.of("loader.load") == ["loader.load P-a", "loader.load P-a", "loader.load P-b"], "asked for again"


async def test_a_part_whose_pass_was_cut_off_is_put_aside_and_no_loader_moves_under_the_robot(hall: Hall) -> None:
    hall.add("a", "b", "c").fake.with_loader()
    hall.ends |= {"a": [torn(SafetyStop("force"))], "b": [whole]}
    await hall.start(until_empty=True)
    await hall.until("held")
    assert hall.verdicts() == {"a": "set aside", "b": "under way", "c": "waiting"}
    assert IN_THE_WAY in hall.daemon.reason
    assert hall.fake.of("loader.load") == ["loader.load P-a"]
    ((ended,),) = hall.journal.store.read("SELECT ended IS NOT NULL FROM pass WHERE job = 1")
    assert ended, "the pass is settled before the job ends"
    await hall.order("resume")
    await hall.task
    assert hall.fake.of("loader.load") == ["loader.load P-a", "loader.load P-b", "loader.load P-c"], "asked once"
    assert hall.verdicts()["c"] == "accepted"


@pytest.mark.parametrize("order", ["hold", "unfit"])
async def test_no_loader_moves_under_a_robot_that_an_order_stopped_amid_a_pass(hall: Hall, order: str) -> None:
    hall.add("a", "b").fake.with_loader()
    hall.ends["a"] = [torn()]
    await hall.start(until_empty=True)
    await hall.wait(hall.journal.cut_off)
    if order == "hold":
        await hall.order("hold")
    else:
        hall.daemon._endangered("state_disk_mb 60, at least 64")
        await hall.until("held")
    assert IN_THE_WAY in hall.daemon.reason
    await hall.order("queue_remove", job="a")
    await hall.until_again("held")
    assert hall.fake.of("loader.load") == ["loader.load P-a"]
    assert IN_THE_WAY in hall.daemon.reason
    await hall.order("resume")
    await hall.task
    assert hall.verdicts() == {"a": "set aside", "b": "accepted"}


async def test_nor_under_one_that_a_kill_left_there_though_its_job_was_removed_meanwhile(hall: Hall) -> None:
    hall.add("a", "b").fake.with_loader()
    await killed_amid_a_pass(hall, "a")
    hall.queue.remove("a")
    await hall.start(until_empty=True)
    await hall.until("held")
    assert IN_THE_WAY in hall.daemon.reason
    assert hall.fake.of("loader.load") == []
    await hall.order("resume")
    await hall.task
    assert hall.fake.of("loader.load") == ["loader.load P-b"]


@pytest.mark.parametrize("error", [SeatNotLeft("no part"), SafetyStop("force")])
async def test_nor_under_one_that_stands_where_a_touch_off_was_cut_off(hall: Hall, error: PolishdError) -> None:
    hall.add("a", "b").fake.with_loader()
    hall.ends["a"] = [touching(error)]
    await hall.start(until_empty=True)
    await hall.until("held")
    assert IN_THE_WAY in hall.daemon.reason
    assert hall.fake.of("loader.load") == ["loader.load P-a"]
    await hall.end()


async def test_a_robot_that_has_left_a_wrong_seat_is_not_in_the_way(hall: Hall) -> None:
    hall.add("a", "b").fake.with_loader()
    hall.ends["a"] = [touching(WrongSeat("too high"))]
    await hall.run()
    assert hall.verdicts() == {"a": "set aside", "b": "accepted"}


async def test_without_confirmation_a_cut_pass_ends_the_daemon_and_the_job_stays_open(hall: Hall) -> None:
    hall.add("a", "b").fake.with_loader()

    def end(job: Job) -> Any:
        hall.fake.actuator.acts.fails["make_safe"] = LinkError("silent")
        return torn(SafetyStop("force"))(job)

    hall.ends["a"] = [end]
    with pytest.raises(SafetyStop, match="force"):
        await hall.run()
    assert hall.verdicts() == {"a": "under way", "b": "waiting"}


async def test_a_lost_journal_ends_the_daemon_and_nothing_goes_on(hall: Hall) -> None:
    hall.add("a", "b").fake.with_loader()

    def end(_job: Job) -> PolishdError:
        hall.journal.store._fail(sqlite3.OperationalError("disk I/O error"))
        return MapError("x")

    hall.ends["a"] = [end]
    with pytest.raises(SafetyStop, match="journal lost"):
        await hall.run()
    assert hall.polished == ["a"]
    assert hall.fake.of("loader.load") == ["loader.load P-a"]


async def test_without_a_person_it_ends_where_it_would_stop(hall: Hall) -> None:
    hall.add("a", "b").fake.with_loader()
    hall.ends["a"] = [RemovalCheckStop("turned")]
    with pytest.raises(RemovalCheckStop):
        await hall.run(holds=False)
    assert hall.verdicts() == {"a": "set aside", "b": "waiting"}


async def test_a_tool_that_stops_the_queue_ends_it_with_an_error_without_an_operator(hall: Hall) -> None:
    def end(job: Job) -> Outcome:
        job.findings = (Finding("wear", "the tool wore", "cell"),)
        return Outcome.IN_TOLERANCE

    hall.add("a", "b").fake.with_loader()
    hall.ends["a"] = [end]
    with pytest.raises(ToolStop, match="the queue stopped: the tool wore; a was accepted"):
        await hall.run(holds=False)
    assert hall.verdicts() == {"a": "accepted", "b": "waiting"}


async def test_an_error_that_ends_a_job_is_one_of_its_causes(hall: Hall) -> None:
    hall.add("a", "b").fake.with_loader()
    hall.ends = {"a": [MapError("unreadable")], "b": [RemovalCheckStop("turned")]}
    await hall.start()
    await hall.until("held")
    assert [event["error"] for event in hall.events("cell_held")] == ["unreadable", "turned"]
    for name, error in (("a", "unreadable"), ("b", "turned")):
        summary = json.loads((hall.tmp_path / "runs" / name / "summary.json").read_text())
        assert [cause["error"] for cause in summary["causes"]] == [error]
    await hall.end()


async def test_a_computer_that_nears_a_limit_as_a_job_ends_holds_and_loses_nothing(
    hall: Hall, monkeypatch: pytest.MonkeyPatch
) -> None:
    make = hall.make

    async def slow(*known: Any) -> tuple[Job, RunFolder]:
        for _ in range(10):
            await asyncio.sleep(0)
        return await make(*known)

    def end(_job: Job) -> Outcome:
        hall.daemon._endangered("state_disk_mb 60, at least 64")
        return Outcome.IN_TOLERANCE

    monkeypatch.setattr(hall, "make", slow)
    hall.add("a", "b").fake.with_loader()
    hall.ends["a"] = [end]
    await hall.start(until_empty=True)
    await hall.until("held")
    assert "state_disk_mb 60, at least 64" in hall.daemon.reason
    await hall.order("resume")
    await hall.task
    assert set(hall.verdicts().values()) == {"accepted"}


async def test_a_part_that_was_put_aside_is_asked_for_again(hall: Hall) -> None:
    hall.add("a")
    hall.ends["a"] = [WrongPart("shows Q")]
    await hall.start()
    await hall.until("changing")
    await hall.order("resume")
    await hall.until("idle")
    hall.queue.add([NewJob("a", "P-a", JobFile(Path("/a.toml"), ""), {})])
    hall.jobs.added()
    await hall.until("changing")
    assert [event["part_id"] for event in hall.events("part_requested")] == ["P-a", "P-a"]
    await hall.end()


# the loader's faults


async def test_another_part_by_the_loaders_own_word_is_put_aside(hall: Hall) -> None:
    hall.add("a", "b").fake.with_loader().brings = {"P-a": "OTHER-7"}
    await hall.run()
    assert hall.verdicts() == {"a": "set aside", "b": "accepted"}
    assert hall.polished == ["b"]
    assert hall.events("queue_job_ended")[0]["reason"] == "WrongPart: loader: 'OTHER-7' is on the seat instead of 'P-a'"


async def test_a_jam_holds_and_the_same_part_is_tried_again(hall: Hall) -> None:
    loader = hall.add("a").fake.with_loader()
    loader.acts.fails["load"] = DeviceFault("jammed")
    await hall.start(until_empty=True)
    await hall.until("held")
    assert hall.fake.events[-3:] != []
    assert hall.daemon.reason == "DeviceFault: jammed"
    assert "loader.make_safe" in hall.fake.events[hall.fake.events.index("loader.load P-a") :]
    assert (await hall.order("resume"))["state"] in {"idle", "changing", "held"}, "it was taken, and jams again"
    await hall.until_again("held")
    del loader.acts.fails["load"]
    await hall.order("resume")
    await hall.task
    assert hall.verdicts() == {"a": "accepted"}


@pytest.mark.parametrize("verb", ["hold", "stop"])
async def test_an_order_stops_a_loader_that_moves(hall: Hall, verb: str) -> None:
    loader = hall.add("a").fake.with_loader()
    loader.acts.hangs.add("load")
    await hall.start()
    await hall.wait(lambda: hall.fake.of("loader.load"))
    if verb == "hold":
        await hall.order("hold")
        assert hall.daemon.state == "held"
    else:
        hall.daemon.stop()
        assert await hall.task is Outcome.STOPPED
    assert "loader.make_safe" in hall.fake.events[hall.fake.events.index("loader.load P-a") :]
    assert hall.verdicts() == {"a": "under way"}
    await hall.end()


async def test_no_loader_moves_while_a_device_is_not_confirmed_safe(hall: Hall) -> None:
    hall.add("a").fake.with_loader()
    await hall.start(until_empty=True)
    hall.fake.actuator.acts.fails["make_safe"] = LinkError("silent")
    await hall.until("held")
    assert hall.fake.of("loader.load", "loader.unload") == []
    with pytest.raises(DeviceRefused, match="stays held"):
        await hall.order("resume")
    del hall.fake.actuator.acts.fails["make_safe"]
    await hall.order("resume")
    await hall.task
    assert hall.verdicts() == {"a": "accepted"}


async def test_no_loader_moves_where_a_device_fails_just_before(hall: Hall) -> None:
    hall.add("a").fake.with_loader()
    await hall.build(until_empty=True)
    make = hall.make

    async def breaks(entry: QueueEntry, *rest: Any) -> tuple[Job, RunFolder]:
        hall.fake.actuator.acts.fails["make_safe"] = LinkError("silent")
        return await make(entry, *rest)

    hall.jobs._make = breaks
    hall.task = asyncio.ensure_future(hall.daemon.run())
    await hall.until("held")
    assert "not confirmed to be safe" in hall.daemon.reason
    assert hall.fake.of("loader.load") == []
    hall.fake.actuator.acts.fails.clear()
    await hall.order("resume")
    await hall.task
    assert hall.verdicts() == {"a": "accepted"}


async def test_a_part_is_changed_for_a_job_only(hall: Hall) -> None:
    await hall.build()
    with pytest.raises(RuntimeError, match="no job is under way"):
        await hall.daemon._change()


async def test_a_lost_contact_is_published_at_once_and_a_lost_journal_hides_no_error(hall: Hall) -> None:
    await hall.build()
    hall.fake.cell.on_broken(SafetyStop("force 40 N"))
    ((found,),) = (hall.events("contact_aborted"),)
    assert (found["error"], found["kind"]) == ("force 40 N", "SafetyStop")

    def lost(_: Event) -> None:
        raise SafetyStop("journal lost")

    hall.bus.publish = lost  # type: ignore[method-assign]
    hall.fake.cell.on_broken(SafetyStop("force 40 N"))


@pytest.mark.parametrize("late", [LinkError("no answer"), OSError("wire")])
async def test_an_error_as_the_cell_is_closed_is_noted_at_the_one_that_ended_the_daemon(
    hall: Hall, monkeypatch: pytest.MonkeyPatch, late: Exception
) -> None:
    async def close(_: Any) -> None:
        raise late

    hall.add("a").fake.with_loader()
    hall.ends["a"] = [LinkError("gone")]
    monkeypatch.setattr(type(hall.fake.cell), "close", close)
    with pytest.raises(LinkError, match="gone") as ended:
        await hall.run(holds=False)
    assert ended.value.__notes__ == [f"and then: {late}"]


async def test_an_emergency_stays_one_whatever_is_commanded_after_it(hall: Hall) -> None:
    hall.fake.with_loader()
    await hall.start()
    await hall.until("idle")
    await hall.order("estop")
    await hall.order("hold", reason="looked at")
    assert hall.fake.cell.emergency
    await hall.end()


async def test_the_reason_of_a_stop_and_the_run_folder_are_in_the_last_facts(hall: Hall) -> None:
    hall.add("a").fake.with_loader()
    await hall.build(until_empty=True)
    assert "run_dir" not in hall.daemon.exit_facts(Outcome.STOPPED, None)

    async def never(_job: Job) -> None:
        await asyncio.Event().wait()

    hall.ends["a"] = [never]
    hall.task = asyncio.ensure_future(hall.daemon.run())
    await hall.until("polishing")
    await hall.order("hold", reason="cleaning")
    assert hall.daemon.exit_facts(Outcome.STOPPED, None)["run_dir"] == str(hall.tmp_path / "runs" / "a")
    stopping = asyncio.ensure_future(hall.order("stop", reason="the shift ends"))
    assert await hall.task is Outcome.STOPPED
    stopping.cancel()
    assert "the shift ends; held by command: cleaning" in hall.daemon.reason


# orders


async def test_a_command_that_came_first_is_obeyed_and_the_job_is_not_removed(
    hall: Hall, monkeypatch: pytest.MonkeyPatch
) -> None:
    hall.add("a", "b").fake.with_loader()
    hall.ends |= {name: [LinkError("gone"), Outcome.IN_TOLERANCE] for name in ("a", "b")}
    obey, removals = JobRunner._obey, []

    async def obey_and_remove(daemon: JobRunner) -> Any:
        """Remove the job as the command to resume has just been obeyed."""
        found = await obey(daemon)
        if not removals:
            removals.append(asyncio.ensure_future(hall.order("queue_remove", job="a")))
        return found

    monkeypatch.setattr(JobRunner, "_obey", obey_and_remove)
    await hall.start(until_empty=True)
    await hall.until("held")
    await hall.order("resume")
    with pytest.raises(DeviceRefused, match="'a' goes on: another command came first"):
        await removals[0]
    await hall.wait(lambda: hall.polished == ["a", "a", "b"])
    await hall.until("held")
    assert hall.verdicts() == {"a": "accepted", "b": "under way"}, "nor is the next job removed in its place"
    await hall.order("resume")
    await hall.task
    assert hall.verdicts() == {"a": "accepted", "b": "accepted"}


async def test_the_job_over_which_it_is_held_can_be_put_aside(hall: Hall) -> None:
    hall.add("a", "b").fake.with_loader()
    hall.ends["a"] = [LinkError("gone")]
    await hall.start(until_empty=True)
    await hall.until("held")
    answer = await hall.order("queue_remove", job="a", reason="it fell")
    assert answer["jobs"][0]["state"] == "set aside"
    assert answer["jobs"][0]["reason"] == "it fell"
    await hall.task
    assert hall.verdicts() == {"a": "set aside", "b": "accepted"}


async def test_a_job_under_way_is_not_taken_out_while_it_is_worked(hall: Hall) -> None:
    hall.add("a", "b").fake.with_loader()

    async def never(_job: Job) -> None:
        await asyncio.Event().wait()

    hall.ends["a"] = [never]
    await hall.start()
    await hall.until("polishing")
    with pytest.raises(DeviceRefused, match=r"'a' is under way, and the cell is polishing\. Hold the cell first"):
        await hall.order("queue_remove", job="a")
    assert (await hall.order("queue_remove", job="b"))["jobs"][0]["state"] == "removed"
    await hall.order("hold")
    await hall.order("queue_remove", job="a")
    assert hall.verdicts() == {"a": "set aside", "b": "removed"}
    await hall.until("idle")
    await hall.end()


async def test_idle_it_can_be_held(hall: Hall) -> None:
    hall.fake.with_loader()
    await hall.start()
    await hall.until("idle")
    assert (await hall.order("hold", reason="cleaning"))["reason"] == "held by command: cleaning"
    hall.add("a")
    hall.jobs.added()
    assert (await hall.order("resume"))["state"] != "held"
    await hall.wait(lambda: hall.verdicts() == {"a": "accepted"})
    await hall.end()


async def test_a_job_is_not_taken_out_while_it_is_made_ready(hall: Hall, monkeypatch: pytest.MonkeyPatch) -> None:
    hall.add("a").fake.with_loader()
    make = hall.make

    async def slow(entry: QueueEntry, *rest: Any) -> tuple[Job, RunFolder]:
        found = await make(entry, *rest)
        with pytest.raises(DeviceRefused, match=r"'a' is under way, and the cell is idle\. Hold the cell first"):
            await hall.order("queue_remove", job="a")
        return found

    monkeypatch.setattr(hall, "make", slow)
    await hall.run()
    assert hall.verdicts() == {"a": "accepted"}


async def test_one_whose_device_cannot_be_asked_can_be_put_aside(hall: Hall, monkeypatch: pytest.MonkeyPatch) -> None:
    hall.add("a", "b").fake.with_loader()
    make = hall.make

    async def no_instrument(entry: QueueEntry, *rest: Any) -> tuple[Job, RunFolder]:
        found = await make(entry, *rest)
        if entry.name == "a":
            raise LinkError("no instrument")
        return found

    monkeypatch.setattr(hall, "make", no_instrument)
    await hall.start(until_empty=True)
    await hall.until("held")
    assert (await hall.order("queue_remove", job="a"))["jobs"][0]["state"] == "set aside"
    await hall.task
    assert [(event["job"], event["verdict"]) for event in hall.events("queue_job_ended")] == [
        ("a", "set aside"),
        ("b", "accepted"),
    ]


async def test_answers_name_the_command_of_a_queue(hall: Hall) -> None:
    await hall.start()
    await hall.until("idle")
    answer = await hall.order("hold")
    assert "polishd run CELL.toml --queue" in answer["next"]
    assert answer["next"] == hall.events("state_changed")[-1]["next"] == (await hall.order("status"))["next"]
    assert "--queue --queue" not in hall.daemon.exit_facts(Outcome.STOPPED, None)["next"]
    await hall.end()


@pytest.mark.parametrize("ends", [None, SafetyStop("force")])
async def test_a_job_that_stays_open_has_a_summary_and_the_end_is_reported(hall: Hall, ends: SafetyStop | None) -> None:
    def end(job: Job) -> Any:
        if ends is not None:
            hall.fake.actuator.acts.fails["make_safe"] = LinkError("silent")
        return torn(ends)(job)

    hall.add("a").fake.with_loader()
    hall.ends["a"] = [end]
    await hall.build()
    serving: Any = _serve(hall.tmp_path, hall.daemon)
    hall.task = asyncio.ensure_future(serving)
    await hall.wait(hall.journal.cut_off)
    hall.daemon.stop()
    await hall.task
    summary = json.loads((hall.tmp_path / "runs" / "a" / "summary.json").read_text())
    outcome = "stopped" if ends is None else "failed"
    assert (summary["job"], summary["outcome"]) == ("a", outcome)
    assert (hall.tmp_path / "runs" / "a" / "journal.sqlite").exists()
    assert [event["outcome"] for event in hall.events("run_folder_completed")] == [outcome]
    assert [event["outcome"] for event in hall.events("queue_stopped")] == ["stopped"] * (ends is None)
    concerns = [event for event in hall.published if event.name in {"queue_stopped", "daemon_failed"}]
    assert [concern.severity for event in concerns if (concern := event.concern())] == [
        Severity.INFO if ends is None else Severity.ALARM
    ]


# what is reported, kept and refused


async def never(_job: Job) -> None:
    """Polish until a command comes."""
    await asyncio.Event().wait()


def summary(hall: Hall, job: str) -> dict[str, Any]:
    """The summary in the run folder of a job."""
    found: dict[str, Any] = json.loads((hall.tmp_path / "runs" / job / "summary.json").read_text())
    return found


def fault_of(hall: Hall, job: str) -> tuple[str, str]:
    """Kind of the fault over which a job of the queue ended, and why it did."""
    ((fault, reason),) = hall.journal.store.read("SELECT fault, reason FROM queue WHERE name = ?", (job,))
    return str(fault), str(reason)


async def test_the_summary_of_each_job_says_how_and_why_it_ended(hall: Hall) -> None:
    hall.add("a", "b", "c", "d").fake.with_loader()
    hall.ends = {"a": [Outcome.IN_TOLERANCE], "b": [MapError("x")], "c": [never], "d": [RemovalCheckStop("turned")]}
    await hall.start()
    await hall.wait(lambda: hall.polished == ["a", "b", "c"])
    await hall.order("hold")
    await hall.order("queue_remove", job="c", reason="it  fell", by="anna")
    await hall.wait(lambda: hall.polished == ["a", "b", "c", "d"])
    await hall.until("held")
    found = {name: summary(hall, name) for name in "abcd"}
    assert [(one["job"], one["verdict"], one["outcome"]) for one in found.values()] == [
        ("a", "accepted", "in_tolerance"),
        ("b", "set aside", "failed"),
        ("c", "set aside", "set aside"),
        ("d", "set aside", "failed"),
    ]
    assert [one["reason"] for one in found.values()] == [
        "the part is in tolerance",
        "MapError: x",
        "it fell",
        "RemovalCheckStop: turned",
    ]
    stops = "instrument or alignment is wrong, also for the next part"
    assert [one["next"] for one in found.values()] == ["", "", "", stops]
    assert found["a"]["notes"] == []
    assert [found[name]["notes"][-1] for name in "bcd"] == ["MapError: x", "it fell", "RemovalCheckStop: turned"]
    (removed,) = [one for one in hall.events("command_received") if one["order"] == "queue_remove"]
    assert (removed["reason"], removed["by"]) == ("c: it fell", "anna")
    assert fault_of(hall, "c") == ("", "it fell"), "no fault held it"
    await hall.end()


async def test_a_job_that_is_removed_without_a_reason_says_over_what_it_was_held(hall: Hall) -> None:
    hall.add("a", "b").fake.with_loader()
    hall.ends = {"a": [LinkError("gone")], "b": [never]}
    await hall.start()
    await hall.until("held")
    await hall.order("queue_remove", job="a")
    assert fault_of(hall, "a") == ("LinkError", "set aside by an operator, held over: LinkError: gone")
    await hall.until("polishing")
    assert (await hall.order("hold"))["reason"] == "held by command"
    await hall.order("queue_remove", job="b")
    assert fault_of(hall, "b") == ("", "set aside by an operator, held over: held by command")
    await hall.end()


async def test_a_job_whose_part_another_cell_has_is_set_aside_without_a_fault(hall: Hall) -> None:
    hall.add("a").fake.with_loader()
    hall.ends["a"] = [LinkError("gone")]
    await hall.start()
    await hall.until("held")

    async def settled(_: object) -> str:
        return "cell 2 has the part"

    hall.jobs.claims.settled = settled  # type: ignore[method-assign]
    hall.jobs.claims.stands = lambda _: False  # type: ignore[method-assign]
    await hall.order("resume")
    await hall.wait(lambda: hall.verdicts() == {"a": "set aside"})
    assert fault_of(hall, "a") == ("", "cell 2 has the part")
    await hall.end()


async def test_a_job_is_not_removed_while_a_device_is_not_safe(hall: Hall) -> None:
    hall.add("a").fake.with_loader()
    hall.ends["a"] = [never]
    await hall.start()
    await hall.until("polishing")
    before = len(hall.fake.of("robot.make_safe"))
    hall.fake.actuator.acts.fails["make_safe"] = LinkError("silent")
    assert (await hall.order("hold"))["reason"] == "held by command"
    assert len(hall.fake.of("robot.make_safe")) == before + 1
    with pytest.raises(DeviceRefused, match=r"'a' is under way, and a device is not confirmed to be safe"):
        await hall.order("queue_remove", job="a")
    await hall.end()


async def test_a_waiting_job_can_be_removed_while_none_is_under_way(hall: Hall) -> None:
    hall.fake.with_loader()
    await hall.start()
    await hall.until("idle")
    await hall.order("hold")
    hall.add("a")
    assert (await hall.order("queue_remove", job="a"))["jobs"][0]["state"] == "removed"
    await hall.end()


async def test_a_command_to_hold_again_keeps_the_error_that_holds_the_cell(hall: Hall) -> None:
    hall.add("a").fake.with_loader()
    hall.ends["a"] = [LinkError("gone")]
    await hall.start()
    await hall.until("held")
    await hall.order("hold", reason="look")
    await hall.wait(lambda: hall.daemon.reason == "LinkError: gone; held by command: look")
    assert [event["kind"] for event in hall.events("cell_held")] == ["LinkError"], "reported once"
    hall.daemon.stop()
    with pytest.raises(LinkError, match="gone"):
        await hall.task


async def test_the_last_facts_of_an_error_are_its_own(hall: Hall) -> None:
    await hall.build()
    error = LinkError("gone")
    failed, stopped = hall.daemon.exit_facts(Outcome.STOPPED, error), hall.daemon.exit_facts(Outcome.STOPPED, None)
    assert (failed["state"], failed["reason"], failed["exit_code"]) == ("failed", "LinkError: gone", error.exit_code)
    assert (stopped["state"], stopped["reason"], stopped["exit_code"]) == ("stopped", "", 0)


async def test_a_fault_of_polishd_ends_the_daemon_and_no_job(hall: Hall) -> None:
    def fails(_: Job) -> Outcome:
        raise ValueError("a fault")

    hall.add("a").fake.with_loader()
    hall.ends["a"] = [fails]
    with pytest.raises(ValueError, match="a fault"):
        await hall.run()
    assert hall.verdicts() == {"a": "under way"}


async def test_states_are_published_with_their_reason_and_what_a_kill_would_leave(hall: Hall) -> None:
    loader = hall.add("a").fake.with_loader()
    loader.acts.hangs.add("load")
    await hall.build(until_empty=True)
    assert hall.daemon.reason == ""
    ends = asyncio.ensure_future(run_until_finished(hall.daemon))
    hall.task = ends  # type: ignore[assignment]
    await hall.wait(lambda: hall.fake.of("loader.load"))
    assert hall.daemon.reason == "a: the loader puts part 'P-a' in"
    loader.acts.hangs.clear()
    await hall.order("hold", reason="looked at")
    await hall.order("resume")
    assert await ends == (Outcome.IN_TOLERANCE, None)
    states = hall.events("state_changed")
    assert (states[0]["state"], states[0]["reason"]) == ("starting", "")
    assert {one["reason"] for one in states if one["state"] == "polishing"} == {""}
    assert {one["tool_off"] for one in states if one["state"] == "held"} == {"yes"}
    assert {one["tool_off"] for one in states if one["state"] == "polishing"} != {"yes"}
    ((opened,),) = (hall.events("cell_opened"),)
    assert set(opened) >= {"actuator", "robot", "spindle", "loader"}


async def test_a_loader_in_the_way_is_said_once_and_of_a_held_cell_alone(hall: Hall) -> None:
    hall.add("a", "b").fake.with_loader()
    hall.ends["a"] = [torn(SafetyStop("force"))]
    await hall.start(until_empty=True)
    await hall.until("held")
    await hall.order("hold", reason="look")
    await hall.wait(lambda: hall.daemon.reason.endswith("look"))
    assert hall.daemon.reason.count(IN_THE_WAY) == 1
    await hall.order("resume")
    await hall.task
    assert {one["state"] for one in hall.events("state_changed") if IN_THE_WAY in one["reason"]} == {"held"}


async def test_without_a_loader_no_robot_is_in_its_way(hall: Hall) -> None:
    hall.add("a", "b")
    hall.ends["a"] = [torn(SafetyStop("force"))]
    await hall.start(until_empty=True)
    await hall.until("changing")
    await hall.order("resume")
    await hall.wait(lambda: hall.verdicts()["a"] == "set aside")
    await hall.until("changing")
    assert not [one for one in hall.events("state_changed") if IN_THE_WAY in one["reason"]]
    await hall.end()


def of_one_part(hall: Hall, *names: str) -> None:
    """Jobs for the same part."""
    hall.queue.add([NewJob(name, "P", JobFile(Path(f"/{name}.toml"), ""), {}) for name in names])


async def test_a_part_that_a_person_has_put_in_is_not_asked_for_by_its_next_job(hall: Hall) -> None:
    of_one_part(hall, "a", "b")
    await hall.start(until_empty=True)
    await hall.until("changing")
    await hall.order("resume")
    await hall.task
    assert hall.verdicts() == {"a": "accepted", "b": "accepted"}
    assert [one["job"] for one in hall.events("part_requested")] == ["a"]
    assert [(one["part_id"], one["by"]) for one in hall.events("part_changed")] == [("P", "a person")]


async def test_no_part_counts_as_in_once_another_was_asked_for(hall: Hall) -> None:
    of_one_part(hall, "a")
    hall.add("b")
    of_one_part(hall, "c")
    await hall.start(until_empty=True)
    await hall.until("changing")
    await hall.order("resume")
    await hall.wait(lambda: len(hall.events("part_requested")) == 2)
    await hall.order("hold")
    await hall.order("queue_remove", job="b")
    await hall.wait(lambda: len(hall.events("part_requested")) == 3)
    assert hall.events("part_requested")[-1]["job"] == "c"
    await hall.end()


async def test_a_pass_after_an_emergency_is_none_any_more(hall: Hall) -> None:
    emergency: list[bool] = []

    def polishes(_: Job) -> Outcome:
        emergency.append(hall.fake.cell.emergency)
        return Outcome.IN_TOLERANCE

    hall.add("a").fake.with_loader()
    hall.ends["a"] = [never, polishes]
    await hall.start(until_empty=True)
    await hall.until("polishing")
    await hall.order("estop")
    assert hall.fake.cell.emergency
    await hall.order("resume")
    await hall.task
    assert emergency == [False]


async def test_a_command_is_obeyed_though_it_cannot_be_recorded(hall: Hall) -> None:
    hall.fake.with_loader()
    await hall.start()
    await hall.until("idle")
    publish = hall.bus.publish

    def lost(event: Event) -> None:
        if event.name == "command_received":
            raise SafetyStop("journal lost")
        publish(event)

    hall.bus.publish = lost  # type: ignore[method-assign]
    assert (await hall.order("hold"))["state"] == "held"
    await hall.end()


async def test_a_stop_says_its_reason_alone_where_nothing_else_is_to_say(hall: Hall) -> None:
    hall.fake.with_loader()
    await hall.start()
    await hall.until("idle")
    stopping = asyncio.ensure_future(hall.order("stop", reason="the shift ends"))
    assert await hall.task is Outcome.STOPPED
    stopping.cancel()
    assert hall.daemon.reason == "stopped by command: the shift ends"


async def test_the_computer_is_looked_at_before_anything_moves_and_watched_from_then_on(
    hall: Hall, monkeypatch: pytest.MonkeyPatch
) -> None:
    hall.add("a").fake.with_loader()
    await hall.build(until_empty=True)
    health, seen = type(hall.daemon._health), list[str]()
    plain_look, plain_watching = health.look, health.watching

    async def look(self: Any) -> None:
        seen.append("look")
        await plain_look(self)

    def wrong(_: Any, *, in_contact: bool) -> str:
        seen.append(f"in contact: {in_contact}")
        return ""

    def watching(self: Any, endangered: Any) -> Any:
        seen.append("watched")
        return plain_watching(self, endangered)

    monkeypatch.setattr(health, "look", look)
    monkeypatch.setattr(health, "wrong", wrong)
    monkeypatch.setattr(health, "watching", watching)
    assert await hall.daemon.run() is Outcome.IN_TOLERANCE
    assert seen[:1] == ["watched"]
    at = seen.index("in contact: False")
    assert seen[at - 1] == "look"


async def test_two_jobs_that_cannot_begin_end_an_unattended_queue_with_their_error(hall: Hall) -> None:
    hall.add("a", "b", "c").fake.with_loader()
    hall.refused = dict.fromkeys("ab", ConfigError("lens.rnc was changed since"))
    with pytest.raises(ConfigError, match=r"lens.rnc was changed since"):
        await hall.run(holds=False)


async def test_status_names_the_job_and_the_part_and_counts_tasks(hall: Hall) -> None:
    hall.add("a").fake.with_loader()
    hall.ends["a"] = [never]
    await hall.start()
    await hall.until("polishing")
    status = await hall.order("status")
    assert {key: status[key] for key in hall.daemon.job.names()} == hall.daemon.job.names()
    assert status["tasks"] == len(asyncio.all_tasks())
    await hall.end()


async def test_a_computer_near_a_limit_holds_the_job_and_it_goes_on(hall: Hall) -> None:
    hall.add("a").fake.with_loader()
    hall.ends["a"] = [never, Outcome.IN_TOLERANCE]
    await hall.start(until_empty=True)
    await hall.until("polishing")
    hall.daemon._endangered("state_disk_mb 60, at least 64")
    await hall.until("held")
    assert hall.verdicts() == {"a": "under way"}
    await hall.order("resume")
    await hall.task
    assert hall.verdicts() == {"a": "accepted"}


# over restarts


@pytest.mark.parametrize("why", ["gate", "gate, unattended", "order"])
async def test_a_queue_that_was_held_comes_up_held(hall: Hall, why: str) -> None:
    hall.add(*"ab" if why != "order" else "").fake.with_loader()
    hall.ends["a"] = [RemovalCheckStop("turned")]
    if "unattended" in why:
        with pytest.raises(RemovalCheckStop):
            await hall.run(holds=False)
        reason = "the queue stopped: instrument or alignment is wrong, also for the next part; "
        reason += "a was set aside: RemovalCheckStop: turned"
    else:
        await hall.start()
        if why == "order":
            await hall.until("idle")
            await hall.order("hold", reason="cleaning")
        await hall.until("held")
        reason = hall.daemon.reason
        await hall.end()
    await hall.start(until_empty=True)
    await hall.until("held")
    assert hall.daemon.reason == reason
    await hall.order("resume")
    await hall.task
    assert set(hall.verdicts().values()) <= {"set aside", "accepted"}
    await hall.run()


async def test_a_queue_that_is_started_held_loads_nothing_before_resume(hall: Hall) -> None:
    hall.add("a").fake.with_loader()
    await hall.start(until_empty=True, start_held=True)
    await hall.until_again("held")
    assert hall.fake.of("loader.load") == []
    await hall.order("resume")
    await hall.task
    assert hall.verdicts() == {"a": "accepted"}


async def test_a_job_that_was_under_way_goes_on_held_and_then_the_queue(hall: Hall) -> None:
    hall.add("a", "b").fake.with_loader()
    await killed_amid_a_pass(hall, "a")
    await hall.start(until_empty=True)
    await hall.until("held")
    assert "pass 0 was interrupted" in hall.daemon.reason
    assert hall.fake.of("loader.load") == []
    await hall.order("resume")
    await hall.task
    assert hall.verdicts() == {"a": "accepted", "b": "accepted"}
    assert hall.polished == ["a", "b"]
    assert [event["job"] for event in hall.events("job_started")] == ["a", "b"]


async def test_a_part_that_a_person_had_put_in_is_not_asked_for_again(hall: Hall) -> None:
    hall.add("a")
    own = hall.journal.of_job("a", "P-a", {})
    hall.queue.begin(hall.queue.to_do()[0], own.number)
    own.record_map(0, "aa", "x", dict.fromkeys(FIGURES, 1.0))
    hall.ends["a"] = [Outcome.CYCLES_USED]

    async def load(_job: Job) -> None:
        """Nothing: the map of this test is none."""

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Job, "load", load)
        await hall.start(until_empty=True)
        await hall.until("held")
        await hall.order("resume")
        await hall.task
    states = [event["state"] for event in hall.events("state_changed")]
    assert states[states.index("held") :] == ["held", "polishing", "idle"], "nothing is changed for it"
    assert not hall.events("part_requested")
    assert hall.verdicts() == {"a": "rejected"}


async def test_a_job_under_way_that_cannot_go_on_is_reported_before_anything_is_opened(hall: Hall) -> None:
    hall.add("a")
    hall.queue.begin(hall.queue.to_do()[0], hall.journal.of_job("a", "P-a", {}).number)
    hall.refused["a"] = ConfigError("cell.toml:3: part.edge_mm: is 5")
    with pytest.raises(ConfigError, match=r"(?s)edge_mm.*set it aside: polishd queue remove CELL.toml a"):
        await hall.start()
    assert hall.fake.events == []


def test_states_of_a_queue_are_reported_when_the_daemon_is_gone() -> None:
    from polishd.daemon.runtime.exit_record import NEXT

    assert {DaemonState.IDLE, DaemonState.CHANGING} <= set(NEXT)
