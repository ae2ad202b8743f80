"""The daemon around the cycle: orders, interruptions, and what it leaves whichever way it ends."""

from __future__ import annotations

import asyncio
import json
import os
import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Self

import pytest

from polishd.daemon import app, job_assembly
from polishd.daemon.cell import cell
from polishd.daemon.job_assembly import run_folder
from polishd.daemon.job_runner import JobRunner
from polishd.daemon.job_source import SingleJob
from polishd.daemon.journal.journal import Journal
from polishd.daemon.journal.records import BlockRecord
from polishd.daemon.queue.requests import QueueRequests
from polishd.daemon.runtime.events import EventBus
from polishd.daemon.socket.client import request
from polishd.model.devices import ExecutedBlock
from polishd.model.errors import (
    ConfigError,
    DeviceBusy,
    DeviceFault,
    DeviceRefused,
    LinkError,
    MapError,
    PolishdError,
    SafetyStop,
)
from polishd.model.events import CommandReceived, Event
from polishd.model.program import Program
from polishd.model.states import Outcome
from tests.unit.daemon.small_job import (
    LIMITS,
    MOVES,
    Bench,
    accept,
    compute,
    open_journal,
    run_cell,
    small_map,
    small_program,
    small_recipe,
)

SAFE = ["spindle.make_safe", "actuator.make_safe", "robot.make_safe"]
CLOSED = ["actuator.close", "robot.close", "spindle.close", "metrology.close"]


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with open_journal(tmp_path) as journal:
        yield Bench(tmp_path, journal)


class Running:
    """A daemon on the bench's cell, and the run of it."""

    def __init__(self, bench: Bench, *, holds: bool = True, start_held: bool = False, **changes: Any) -> None:
        self.bench = bench
        self.published: list[Event] = []
        job = bench.job(**{"recipe": small_recipe(tolerance_nm=1.5)} | changes)
        bus = EventBus(sinks=(bench.journal.record_event, self.published.append))
        jobs = SingleJob(bench.journal, job.folder, job)
        requests = QueueRequests(None, None, jobs.queue)  # type: ignore[arg-type]
        self.daemon = JobRunner(bench.fake.cell, jobs, requests, bus, holds=holds, start_held=start_held)
        self.task: asyncio.Task[Outcome] | None = None

    async def __aenter__(self) -> Self:
        self.task = asyncio.ensure_future(self.daemon.run())
        return self

    async def __aexit__(self, *error: object) -> None:
        assert self.task is not None
        self.task.cancel()
        with suppress(asyncio.CancelledError, PolishdError, OSError):
            await self.task

    async def outcome(self) -> Outcome:
        assert self.task is not None
        return await self.task

    async def in_contact(self, done: int = 100) -> None:
        """pytest's timeout is the limit."""
        while "actuator.set_force 12" not in self.bench.fake.events or self.bench.fake.robot.done < done:  # noqa: ASYNC110
            await asyncio.sleep(0)

    async def held(self) -> None:
        while self.daemon.state != "held":  # noqa: ASYNC110
            await asyncio.sleep(0)

    def states(self) -> list[str]:
        return [event.data["state"] for event in self.published if event.name == "state_changed"]


def begin_earlier(tmp_path: Path, *, interrupted: bool) -> None:
    """An earlier run of the daemon, which was killed."""
    with open_journal(tmp_path) as journal:
        if interrupted:
            journal.begin_pass(0, "sha", "boot-0", 300, contact=(4, 290))
            journal.record_executed(0, [BlockRecord(ExecutedBlock(4, 0.0, 1.0), True)])


# its end


async def test_a_job_to_its_end(bench: Bench) -> None:
    async with Running(bench) as running:
        assert await running.outcome() is Outcome.IN_TOLERANCE
    calls = bench.fake.of("make_safe", "close", "open")
    assert calls[:4] == [f"{name}.open" for name in ("actuator", "robot", "spindle", "metrology")]
    assert calls[4:] == [*SAFE, *SAFE, *CLOSED], "safe before anything else, and after everything"
    opened = running.published[0]
    assert (opened.name, opened.data["robot"]["model"]) == ("cell_opened", "robot")
    assert running.states() == ["polishing"]


async def test_an_error_in_contact_leaves_the_cell_safe_and_closed(bench: Bench) -> None:
    bench.fake.robot.acts.before["send"] = lambda: bench.fake.robot.acts.fails.update(
        {"send": LinkError("cut")} if bench.fake.robot.done > 5 else {}
    )
    async with Running(bench) as running:
        with pytest.raises(LinkError, match="cut"):
            await running.outcome()
    assert bench.fake.events[-7:] == [*SAFE, *CLOSED]


async def test_a_cell_that_is_not_safe_is_held_until_it_is(bench: Bench) -> None:
    spindle = bench.fake.spindle.acts
    spindle.fails["make_safe"] = LinkError("deaf")
    async with Running(bench) as running:
        await running.held()
        assert running.daemon.reason == "DeviceFault: not confirmed to be safe: spindle: deaf"
        assert (await running.daemon.status())["unsafe"] == ["spindle: deaf"]
        with pytest.raises(DeviceRefused, match=r"resume is refused, the cell stays held: DeviceFault: .* deaf"):
            await running.daemon.handlers["resume"]()
        assert bench.fake.of(*MOVES, "metrology.next_map") == []
        spindle.fails.clear()
        assert (await running.daemon.handlers["resume"]())["state"] == "polishing"
        assert await running.outcome() is Outcome.IN_TOLERANCE
    assert running.states() == ["held", "held", "polishing"]
    assert bench.fake.events[-4:] == CLOSED


async def test_a_cell_that_is_not_safe_ends_without_an_operator(bench: Bench) -> None:
    bench.fake.spindle.acts.fails["make_safe"] = LinkError("deaf")
    async with Running(bench, holds=False) as running:
        with pytest.raises(DeviceFault, match="spindle: deaf"):
            await running.outcome()
    assert bench.fake.of(*MOVES, "metrology.next_map") == []
    assert bench.fake.events[-4:] == CLOSED


async def test_a_pass_is_settled_once_the_cell_is_safe_and_reported_before_it_goes_on(tmp_path: Path) -> None:
    begin_earlier(tmp_path, interrupted=True)
    with open_journal(tmp_path) as journal:
        bench = Bench(tmp_path, journal)
        bench.fake.robot.acts.fails["make_safe"] = LinkError("it still moves")
        async with Running(bench) as running:
            await running.held()
            assert journal.unfinished() is not None, "a robot that may move has not done yet"
            bench.fake.robot.acts.fails.clear()
            with pytest.raises(DeviceRefused, match="pass 0 was interrupted: 1 of 300"):
                await running.daemon.handlers["resume"]()
            assert bench.fake.of(*MOVES, "metrology.next_map") == []
            await running.daemon.handlers["resume"]()
            assert await running.outcome() is Outcome.IN_TOLERANCE


async def test_a_robot_that_still_serves_an_earlier_run_is_waited_for(bench: Bench) -> None:
    robot, clock = bench.fake.robot, bench.fake.clock
    robot.acts.fails["open"] = DeviceBusy("robot: HELLO was refused: busy")
    async with Running(bench) as running:
        for _ in range(3):
            while not clock._sleepers:  # noqa: ASYNC110
                await asyncio.sleep(0)
            clock.advance(1.0)
        assert running.daemon.state == "starting"
        assert running.daemon.reason == "robot still serves its last client; the daemon retries for up to 16 s"
        robot.acts.fails.clear()
        while running.daemon.state == "starting":
            clock.advance(1.0)
            await asyncio.sleep(0)
        assert await running.outcome() is Outcome.IN_TOLERANCE
    assert bench.fake.events.count("robot.open") == 4
    assert running.states() == ["starting", "polishing"], "published once"


async def test_a_robot_that_another_program_has_is_not_waited_for_for_ever(bench: Bench) -> None:
    bench.fake.robot.acts.fails["open"] = DeviceBusy("robot: HELLO was refused: busy")
    async with Running(bench) as running:
        while running.task and not running.task.done():
            bench.fake.clock.advance(1.0)
            await asyncio.sleep(0)
        with pytest.raises(DeviceBusy, match=r"busy; it stayed busy for 16 s, .*\. Stop the program"):
            await running.outcome()
    assert bench.fake.of(*MOVES, "make_safe") == []
    assert bench.fake.events[-4:] == CLOSED


async def test_a_start_that_waits_for_a_device_can_be_stopped(bench: Bench) -> None:
    bench.fake.spindle.acts.hangs.add("open")
    async with Running(bench) as running:
        while "spindle.open" not in bench.fake.events:  # noqa: ASYNC110
            await asyncio.sleep(0)
        hold = asyncio.create_task(running.daemon.handlers["hold"]())
        await asyncio.sleep(0)
        running.daemon.stop()
        assert await running.outcome() is Outcome.STOPPED
        hold.cancel()
    assert bench.fake.events[-4:] == CLOSED


async def test_hold_at_a_start_holds_when_the_cell_is_open(bench: Bench) -> None:
    async with Running(bench) as running:
        assert (await running.daemon.handlers["hold"]())["state"] == "held"
        assert bench.moved() == []


async def test_a_device_that_is_not_there(bench: Bench) -> None:
    bench.fake.spindle.acts.fails["open"] = LinkError("spindle: no answer")
    async with Running(bench) as running:
        with pytest.raises(LinkError, match="spindle: no answer"):
            await running.outcome()
    assert bench.fake.events[-4:] == CLOSED
    assert bench.fake.of(*MOVES, "metrology.next_map", "metrology.open") == []


@pytest.mark.parametrize("call", ["open", "identify"])
async def test_a_device_that_never_answers_is_a_lost_link(
    bench: Bench, call: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cell, "OPEN_S", 0.5)
    bench.fake.robot.acts.hangs.add(call)
    async with Running(bench) as running:
        with pytest.raises(LinkError, match="robot: no answer"):
            await running.outcome()
    assert bench.fake.events[-4:] == CLOSED


async def test_a_device_that_hangs_when_it_is_opened_again(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    bench.fake.spindle.acts.hangs.add("status")

    def lost() -> None:
        monkeypatch.setattr(cell, "OPEN_S", 0.5)
        bench.fake.spindle.acts.hangs.add("open")

    bench.fake.metrology.acts.before["next_map"] = lost
    async with Running(bench, holds=False) as running:
        with pytest.raises(LinkError, match="spindle: no answer"):
            await running.outcome()
    assert bench.moved() == []


async def test_all_devices_are_closed_though_one_will_not(bench: Bench) -> None:
    bench.fake.actuator.acts.fails["close"] = OSError("stuck")
    async with Running(bench) as running:
        with pytest.raises(OSError, match="stuck"):
            await running.outcome()
    assert bench.fake.events[-4:] == CLOSED


async def test_a_lost_journal_ends_contact(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    gone = asyncio.Event()

    async def lost() -> None:
        await gone.wait()
        raise SafetyStop("journal: no space left on device")

    monkeypatch.setattr(bench.journal, "lost", lost)
    async with Running(bench) as running:
        await running.in_contact()
        gone.set()
        with pytest.raises(SafetyStop, match="no space"):
            await running.outcome()
    assert bench.fake.of("make_safe", "robot.close")[3:] == [*SAFE, *SAFE, "robot.close"]


# orders


@pytest.mark.full
async def test_hold_leaves_contact_and_resume_measures_first(bench: Bench) -> None:
    async with Running(bench) as running:
        verbs = running.daemon.handlers
        await running.in_contact()
        answer = await verbs["hold"]()
        assert answer["state"] == "held"
        assert "pass 0 was interrupted" in answer["reason"]
        assert bench.fake.actuator.retracted
        contact = bench.fake.events.index("actuator.set_force 12")
        assert bench.fake.of("make_safe")[3:6] == SAFE
        assert "robot.make_safe" in bench.fake.events[contact:]
        assert bench.journal.passes[0].how == "interrupted"
        count = len(bench.fake.events)
        assert (await verbs["resume"]())["state"] == "polishing"
        assert await running.outcome() is Outcome.IN_TOLERANCE
    since = [event for event in bench.fake.events[count:] if event.startswith((*MOVES, "metrology.next_map"))]
    assert since[0] == "metrology.next_map", "nothing moves before a new measurement"
    assert [record.cycle for record in bench.journal.passes][:2] == [0, 1], "pass 0 is not run again"
    assert running.states() == ["polishing", "held", "polishing"]


@pytest.mark.full
async def test_an_emergency_stop_by_order_stops_motion_before_the_tool_is_up(bench: Bench) -> None:
    async with Running(bench) as running:
        verbs = running.daemon.handlers
        await running.in_contact()
        stopped: list[bool] = []
        bench.fake.robot.acts.before["make_safe"] = lambda: stopped.append(bench.fake.actuator.retracted)
        answer = await verbs["estop"]()
        assert (answer["state"], stopped[0]) == ("held", False)
        assert answer["reason"].startswith("motion was stopped at once, by command; pass 0 was interrupted")
        assert bench.fake.actuator.retracted
        await verbs["resume"]()
        assert await running.outcome() is Outcome.IN_TOLERANCE
    assert stopped[-1], "the next time the tool is lifted first again"


async def test_the_reason_of_an_order_is_kept_and_shown(bench: Bench) -> None:
    async with Running(bench) as running:
        orders = running.daemon.handlers
        await running.in_contact()
        answer = await orders["hold"](reason="a scratch\n at 3 o'clock")
        assert answer["reason"].startswith("held by command: a scratch at 3 o'clock; pass 0 was interrupted")
        assert (await running.daemon.status())["reason"] == answer["reason"]
        await orders["hold"](reason="ask Ada")
        while "Ada" not in running.daemon.reason:  # noqa: ASYNC110
            await asyncio.sleep(0)
        assert running.daemon.reason == f"{answer['reason']}; held by command: ask Ada"
        stop = asyncio.create_task(orders["stop"](reason="Ada said so"))
        assert await running.outcome() is Outcome.STOPPED
        stop.cancel()
        assert running.daemon.exit_facts(Outcome.STOPPED, None)["reason"].startswith(
            "stopped by command: Ada said so; "
        )
    given = [(event.order, event.reason) for event in running.published if isinstance(event, CommandReceived)]
    assert given == [("hold", "a scratch at 3 o'clock"), ("hold", "ask Ada"), ("stop", "Ada said so")]


async def test_an_order_is_obeyed_though_it_cannot_be_written_down(bench: Bench) -> None:
    async with Running(bench) as running:
        await running.in_contact()

        def lost(event: Event) -> None:
            if isinstance(event, CommandReceived):
                raise SafetyStop("journal lost")

        running.daemon.bus._sinks = (lost,)
        assert (await running.daemon.handlers["hold"]())["state"] == "held"
        running.daemon.bus._sinks = ()


@pytest.mark.full
async def test_hold_between_passes_goes_on_with_the_same_cycle(bench: Bench) -> None:
    waiting = asyncio.Event()

    async def slow(function: Any, *arguments: Any, within_s: float = 600.0) -> Any:
        if function.__name__ == "solve_first" and len(bench.journal.passes) == 1 and not waiting.is_set():
            waiting.set()
            await asyncio.Event().wait()
        return await compute(function, *arguments)

    async with Running(bench, compute=slow, recipe=small_recipe(tolerance_nm=1e-6), max_cycles=2) as running:
        await waiting.wait()
        answer = await running.daemon.handlers["hold"]()
        assert answer["reason"].startswith("held by command")
        await running.daemon.handlers["resume"]()
        assert await running.outcome() is Outcome.CYCLES_USED
    assert [record.how for record in bench.journal.passes] == ["done", "done"]


async def test_stop_in_contact(bench: Bench) -> None:
    async with Running(bench) as running:
        await running.in_contact()
        running.daemon.stop()
        assert await running.outcome() is Outcome.STOPPED
    assert bench.fake.events[-7:] == [*SAFE, *CLOSED]
    assert bench.journal._store.read("SELECT outcome FROM job") == [(None,)], "it can be gone on with"


@pytest.mark.full
@pytest.mark.parametrize("order", ["resume", "stop"])
async def test_orders_while_held(bench: Bench, order: str) -> None:
    async with Running(bench) as running:
        await running.in_contact()
        await running.daemon.handlers["hold"]()
        assert (await running.daemon.handlers["hold"]())["state"] == "held", "held already"
        if order == "stop":
            running.daemon.stop()
            assert await running.outcome() is Outcome.STOPPED
        else:
            await running.daemon.handlers["resume"]()
            assert await running.outcome() is Outcome.IN_TOLERANCE


async def test_resume_while_polishing_changes_nothing(bench: Bench) -> None:
    async with Running(bench) as running:
        await running.in_contact()
        assert (await running.daemon.handlers["resume"]())["state"] == "polishing"
        assert await running.outcome() is Outcome.IN_TOLERANCE
    assert running.states() == ["polishing"]


async def test_status(bench: Bench) -> None:
    async with Running(bench) as running:
        assert (await running.daemon.status())["state"] == "starting"
        await running.in_contact()
        status = await running.daemon.status()
        await running.outcome()
    assert (status["state"], status["phase"], status["cycle"], len(status["cycles"])) == ("polishing", "run", 0, 1)


# after an earlier run


async def test_an_interrupted_pass_comes_up_held(tmp_path: Path) -> None:
    begin_earlier(tmp_path, interrupted=True)
    with open_journal(tmp_path) as journal:
        async with Running(Bench(tmp_path, journal)) as running:
            await running.held()
            assert "pass 0 was interrupted: 1 of 300" in running.daemon.reason
            assert running.bench.moved() == []
            assert "metrology.next_map" not in running.bench.fake.events
        assert journal.passes[0].how == "interrupted"


async def test_a_job_that_was_begun_earlier_comes_up_held(tmp_path: Path) -> None:
    begin_earlier(tmp_path, interrupted=False)
    with open_journal(tmp_path) as journal:
        async with Running(Bench(tmp_path, journal)) as running:
            await running.held()
            assert "begun earlier" in running.daemon.reason
            await running.daemon.handlers["resume"]()
            assert await running.outcome() is Outcome.IN_TOLERANCE


async def test_a_new_job_that_is_started_held_moves_nothing_before_resume(tmp_path: Path) -> None:
    with open_journal(tmp_path) as journal:
        async with Running(Bench(tmp_path, journal), start_held=True) as running:
            await running.held()
            assert running.daemon.reason == "the daemon was started without an order to move"
            assert running.bench.moved() == []
            assert "metrology.next_map" not in running.bench.fake.events
            await running.daemon.handlers["resume"]()
            assert await running.outcome() is Outcome.IN_TOLERANCE
        assert running.states().count("held") == 1


# run_cell: what is left for people


class Site:
    """A config, hooks and a cell in memory for ``run_cell``."""

    def __init__(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.path = tmp_path / "cell.toml"
        self.path.write_text("# a cell")
        self.published: list[Event] = []
        self.bench: Bench | None = None
        self.measure: Any = None
        self.recipe = small_recipe(tolerance_nm=1.5)
        self.part = {"id": "P-1", "edge_mm": 2.0}
        self.program = small_program()
        (tmp_path / "program.rnc").write_bytes(self.program.text)
        self.config: Any = SimpleNamespace(
            path=self.path,
            cell=SimpleNamespace(name="bench"),
            state_dir=tmp_path / "state",
            run_dir=tmp_path / "run",
            profile_path=None,
            base_dir=tmp_path,
            notify={},
            part=SimpleNamespace(id="P-1"),
            program=SimpleNamespace(paths=("program.rnc",), format="gcode"),
            job=SimpleNamespace(id="small", max_cycles=3, stream_ahead_s=8.0),
            resolve=lambda text: tmp_path / text,
            effective=lambda: {"part": self.part, "program": {"path": "program.rnc"}},
            error=lambda key, problem: ConfigError(f"cell.toml: {key}: {problem}"),
        )
        self.config.turns, self.config.tools = (self.config,), {}
        self.hooks: Any = SimpleNamespace(on_event=self.published.append, check_plan=accept, program_formats=dict)
        journal = app._journal

        def kept(config: Any, hooks: Any, programs: Sequence[Program]) -> Journal:
            found = journal(config, hooks, programs)
            assert self.bench is not None
            self.bench.journal = found
            return found

        monkeypatch.setattr(app, "require_commissioned", lambda config, instrument: None)
        monkeypatch.setattr(app, "require_fit", lambda config, recipe, program: "")
        monkeypatch.setattr(app, "require_accepted_by_robot", lambda config, hooks, program: None)
        monkeypatch.setattr(app, "read_recipes", lambda config, hooks: (self.recipe,))
        monkeypatch.setattr(app, "read_programs", lambda config, recipe: (self.program,))
        monkeypatch.setattr(app, "build_cell", self.build)
        monkeypatch.setattr(job_assembly, "contact_limits", lambda config: LIMITS)
        monkeypatch.setattr(app, "Compute", InProcess)
        monkeypatch.setattr(app, "_journal", kept)

    def build(self, config: Any, hooks: Any) -> cell.Cell:
        self.bench = Bench(self.path.parent, None)  # type: ignore[arg-type]
        if self.measure is not None:
            self.bench.fake.metrology.measure = self.measure
        return self.bench.fake.cell

    def summary(self) -> dict[str, Any]:
        return dict(json.loads((self.config.run_dir / "summary.json").read_text()))

    async def in_contact(self) -> None:
        while self.bench is None or self.bench.fake.robot.done < 100:  # noqa: ASYNC110
            await asyncio.sleep(0)


class InProcess:
    """Compute without a worker process."""

    async def __aenter__(self) -> Any:
        return compute

    async def __aexit__(self, *error: object) -> None:
        return None


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Site:
    return Site(tmp_path, monkeypatch)


def test_a_job_that_no_map_could_end_is_refused_before_anything_is_opened(site: Site) -> None:
    site.recipe = small_recipe(tolerance_nm=1.5, accept_by="bound")
    with pytest.raises(ConfigError, match=r"no map can be accepted.*power"):
        app._own_work(site.config, site.hooks)
    assert site.bench is None


async def test_the_loop_goes_first_until_the_end(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    steps: list[str] = []

    @contextmanager
    def first() -> Iterator[None]:
        steps.append("first")
        yield
        steps.append("as before")

    monkeypatch.setattr(app, "loop_first", first)
    monkeypatch.setattr(app, "run_folder", lambda *given: steps.append("run") or run_folder(*given))
    await run_cell(site.config, site.hooks)
    assert steps == ["first", "run", "as before"]


async def test_run_cell_leaves_a_whole_folder(site: Site) -> None:
    summary = await run_cell(site.config, site.hooks)
    assert summary["outcome"] == "in_tolerance"
    assert site.summary() == json.loads(json.dumps(summary))
    assert summary["notes"] == []
    assert (site.config.run_dir / "cell.toml").read_text() == "# a cell"
    assert (site.config.run_dir / "journal.sqlite").stat().st_size > 0
    assert not (site.config.state_dir / "polishd.sock").exists()
    finished = next(event for event in site.published if event.name == "run_folder_completed")
    assert finished.data["run_dir"] == str(site.config.run_dir)
    assert [e.data["state"] for e in site.published if e.name == "state_changed"][-1] == "finished"
    with Journal.open(site.config.state_dir, job="small", part_id="P-1") as journal:
        assert not journal.resumed, "the job is over: the next one is a new one"


async def test_run_cell_tells_what_failed_and_leaves_the_summary(site: Site) -> None:
    def refuse() -> None:
        raise MapError("all holes")

    site.measure = refuse
    returned = await run_cell(site.config, site.hooks, holds=False)
    summary = site.summary()
    assert summary == json.loads(json.dumps(returned))
    assert (summary["outcome"], summary["exit_code"]) == ("failed", 8)
    assert [(cause["kind"], cause["error"], cause["ended"]) for cause in summary["causes"]] == [
        ("MapError", "all holes", True)
    ]
    assert summary["notes"][0].endswith(" ended: MapError: all holes")
    failed = next(event for event in site.published if event.name == "daemon_failed")
    assert (failed.data["error"], failed.data["kind"], failed.data["tool_off"]) == ("all holes", "MapError", "yes")
    assert failed.data["next"] == summary["next"]
    with Journal.open(site.config.state_dir, job="small", part_id="P-1") as journal:
        assert journal.resumed, "it may be gone on with"


@pytest.mark.one_of_each
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
async def test_a_signal_stops_safely(site: Site, number: int) -> None:
    async with asyncio.TaskGroup() as group:
        task = group.create_task(run_cell(site.config, site.hooks))
        await site.in_contact()
        os.kill(os.getpid(), number)
    assert task.result()["outcome"] == "stopped"
    assert site.bench is not None
    assert site.bench.fake.events[-7:] == [*SAFE, *CLOSED]


@pytest.mark.full
async def test_stop_over_the_socket_is_answered(site: Site) -> None:
    async with asyncio.TaskGroup() as group:
        task = group.create_task(run_cell(site.config, site.hooks))
        await site.in_contact()
        assert (await asyncio.to_thread(request, site.config.state_dir, "stop"))["state"] == "finished"
    assert task.result()["outcome"] == "stopped"


async def test_one_daemon_a_cell(site: Site) -> None:
    async with asyncio.TaskGroup() as group:
        task = group.create_task(run_cell(site.config, site.hooks))
        await site.in_contact()
        bench = site.bench
        with pytest.raises(ConfigError, match="another polishd runs this cell"):
            await run_cell(site.config, site.hooks)
        assert site.bench is not None
        assert site.bench.fake.events == [], "the second opened nothing"
        site.bench = bench
        os.kill(os.getpid(), signal.SIGTERM)
    assert task.result()["outcome"] == "stopped"


def test_the_run_folder_of_a_job_that_goes_on_is_the_same(site: Site, tmp_path: Path) -> None:
    with open_journal(tmp_path) as journal:
        first = run_folder(site.config, journal)
        journal.record_map(0, small_map().sha256, "", {})
    site.config.run_dir = tmp_path / "another"
    with open_journal(tmp_path) as journal:
        assert run_folder(site.config, journal).path == first.path


def test_a_job_that_has_measured_nothing_takes_the_run_folder_that_is_named_now(site: Site, tmp_path: Path) -> None:
    with open_journal(tmp_path) as journal:
        run_folder(site.config, journal)
    site.config.run_dir = tmp_path / "another"
    with open_journal(tmp_path) as journal:
        assert run_folder(site.config, journal).path == tmp_path / "another"


def test_a_new_job_without_a_run_dir_has_a_folder_of_its_own(site: Site, tmp_path: Path) -> None:
    site.config.run_dir = None
    with Journal.open(tmp_path, job="small", part_id="P-1") as journal:
        path = run_folder(site.config, journal).path
    assert path.parent == site.config.state_dir / "runs"
    assert path.name.startswith("small-")
