"""``polishd run``: the daemons of one or several cells in one process, which share its signals and its priority.

Each cell has a separate state folder, lock, journal, socket, log, compute worker and outcome.
The record of the last pass in a damaged journal is not reliable, and without a journal nothing is polished. A cell
with a damaged journal starts held, opens no device, reports the reason as for any other error (socket, page,
notifications, systemd), and ends by `stop`.
"""

from __future__ import annotations

import asyncio
import logging
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from contextvars import Context, copy_context
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from polishd.config.cell import CellConfig
from polishd.daemon.assembly import build_cell, build_notifiers, require_accepted_by_robot, require_time_limits
from polishd.daemon.cell.cell import Cell
from polishd.daemon.cell.recorder import place, recording_to
from polishd.daemon.contact.stall_removal import require_stall_depth
from polishd.daemon.job.resume_checks import require_same, terms_of
from polishd.daemon.job_assembly import JobMaker, make_job, read_recipes, run_folder
from polishd.daemon.job_runner import JobRunner, run_until_finished
from polishd.daemon.job_source import QueuedJobs, SingleJob
from polishd.daemon.journal.journal import Journal
from polishd.daemon.notifications.notifications import notifying
from polishd.daemon.notifications.sender import Notifier
from polishd.daemon.queue.queue import Queue
from polishd.daemon.queue.requests import QueueRequests
from polishd.daemon.runtime.compute import Compute
from polishd.daemon.runtime.events import EventBus, record_exit, recording_exit
from polishd.daemon.runtime.exit_record import locked, safety_sentence, unusable
from polishd.daemon.runtime.process import SystemdNotifier, logging_to, loop_first
from polishd.daemon.socket.client import SUBSCRIBE, VERBS
from polishd.daemon.socket.server import Handler, serving
from polishd.model import events
from polishd.model.errors import ConfigError, DeviceRefused, JournalDamage, PolishdError
from polishd.model.events import Event
from polishd.model.program import Program
from polishd.model.states import DaemonState
from polishd.pipeline.acceptance import require_acceptable
from polishd.pipeline.build_recipe import instrument_of, require_commissioned
from polishd.pipeline.precheck import read_programs, require_fit
from polishd.pipeline.recipe import Recipe
from polishd.plugin_loader import Hooks

log = logging.getLogger(__name__)

NEXT = "repair the journal as the reason says, then polishd stop CELL.toml and polishd run CELL.toml"


class DamagedCell:
    """Handlers of the socket's commands; ``stop`` ends ``until_stopped``."""

    def __init__(self, config: CellConfig, damage: JournalDamage) -> None:
        self._config = config
        self.reason = f"{type(damage).__name__}: {damage}"
        self._stopped = asyncio.Event()

    @property
    def handlers(self) -> dict[str, Handler]:
        """Handlers of all commands; those that need a journal are refused with the reason."""
        answered = {"status": self._status, "live": self._live, "stop": self._stop, "hold": self._stay}
        answered |= {"estop": self._stay}
        return {**{verb: self._refuse for verb in VERBS if verb != SUBSCRIBE}, **answered}

    def stop(self) -> None:
        """End the daemon, as SIGTERM does."""
        self._stopped.set()

    def state_event(self, state: DaemonState | str) -> events.StateChanged:
        """Return the state as an event; no device is open."""
        standing = replace(safety_sentence("held", None), next=NEXT)
        return events.StateChanged(state=state, reason=self.reason, standing=standing)

    async def until_stopped(self, bus: EventBus, damage: JournalDamage) -> None:
        """Publish why the cell is held, and wait for ``stop``."""
        bus.publish(events.CellHeld(error=str(damage), kind=type(damage).__name__))
        bus.publish(self.state_event(DaemonState.HELD))
        await self._stopped.wait()

    def _facts(self) -> dict[str, Any]:
        return {
            "state": DaemonState.HELD,
            "reason": self.reason,
            "next": NEXT,
            "job": self._config.job.id,
            "part": self._config.part.id,
            "cycle": None,
            "phase": None,
            "unsafe": [],
            "signals": {},
            "health": {},
        }

    async def _status(self) -> Mapping[str, Any]:
        return {**self._facts(), "cycles": [], "tasks": len(asyncio.all_tasks()), "devices": {}}

    async def _live(self) -> Mapping[str, Any]:
        readings = dict.fromkeys(("force", "speed", "sensed", "robot"))
        return {**self._facts(), "pressing": False, "leaving": "", "approval": "", "readings": readings, "ages_s": {}}

    async def _stay(self, reason: str = "", by: str = "") -> Mapping[str, Any]:
        log.info("already held because the journal is damaged; command by %s: %s", by or "an operator", reason)
        return {"state": DaemonState.HELD, "reason": self.reason, "next": NEXT}

    async def _stop(self, reason: str = "", by: str = "") -> Mapping[str, Any]:
        log.info("stopped by %s: %s", by or "command", reason)
        self.stop()
        return {"state": DaemonState.FINISHED, "reason": self.reason, "next": NEXT}

    async def _refuse(self, **_: Any) -> Mapping[str, Any]:
        raise DeviceRefused(f"the cell stays held: {self.reason}")


async def hold_damaged(
    config: CellConfig,
    notifiers: Sequence[Notifier],
    cell: DamagedCell,
    damage: JournalDamage,
    *,
    listeners: Sequence[Callable[[Event], None]],
    sink: Callable[[Event], None],
) -> None:
    """Serve the socket, held, until the cell is stopped; write the exit record for ``polishd status``."""
    known = {"job": config.job.id, "part": config.part.id, "run_dir": ""}
    kept = recording_exit(config.state_dir, lambda: None)
    async with (
        notifying(config, notifiers, known, listeners, (kept, sink)) as bus,
        serving(config.state_dir, cell.handlers, bus),
    ):
        await cell.until_stopped(bus, damage)
        last = {**cell.state_event("failed").data, "exit_code": damage.exit_code, "causes": [], "notes": []}
        record_exit(config.state_dir, {**last, "run_dir": ""})
        bus.publish(cell.state_event(DaemonState.FINISHED))


@dataclass(frozen=True, slots=True)
class CellRun:
    """A cell to run, with its options."""

    config: CellConfig
    hooks: Hooks
    show: Callable[[Event], None] = lambda _: None
    """Callback for each event, to display it."""
    queue: bool = False
    """Run the queue, not the job of the cell's file, ..."""
    until_empty: bool = False
    """... until it is empty."""
    start_held: bool = False
    """Move nothing before an operator's ``resume``."""
    record: Path | None = None
    """File or folder for the recording of all messages on its links."""


@dataclass(slots=True)
class ShutdownRequest:
    """SIGTERM and SIGINT stop all cells of the process, including cells that start later."""

    supervisor: SystemdNotifier
    requested: bool = False
    daemons: list[JobRunner | DamagedCell] = field(default_factory=list)

    def request(self) -> None:
        """Stop all cells."""
        self.requested = True
        self.supervisor.stopping()
        for daemon in self.daemons:
            daemon.stop()

    @contextmanager
    def stopping(self, daemon: JobRunner | DamagedCell) -> Iterator[None]:
        """Stop that daemon as well on a request during this block, or at once after an earlier request."""
        self.daemons.append(daemon)
        if self.requested:
            daemon.stop()
        try:
            yield
        finally:
            self.daemons.remove(daemon)

    @contextmanager
    def signals(self) -> Iterator[None]:
        """Let SIGTERM and SIGINT request the stop during this block."""
        loop = asyncio.get_running_loop()
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(number, self.request)
        try:
            yield
        finally:
            for number in (signal.SIGTERM, signal.SIGINT):
                loop.remove_signal_handler(number)


@dataclass(frozen=True, slots=True)
class _Ready:
    """A cell whose files are read; only its state folder is locked, which ``kept`` releases."""

    run: CellRun
    work: tuple[Sequence[Recipe], Sequence[Sequence[Program]]] | None
    """Recipes and programs of the cell's job, one for each tool; None if a queue is run."""
    cell: Cell
    notifiers: Sequence[Notifier]
    journal: Journal | JournalDamage
    """JournalDamage: the cell starts held and opens no device."""
    kept: ExitStack
    context: Context
    """Context of its tasks and threads, by which its log selects its lines."""


async def run_cells(cells: Sequence[CellRun], *, holds: bool = True) -> list[dict[str, Any] | Exception]:
    """Run the daemons of all cells to the ends of their jobs; one that ends does not end the others.

    Without ``holds`` a daemon ends where it would wait for an operator. Return the summaries, as written to the run
    folders, or the error of a daemon that ended before it opened a device.

    Raises PolishdError if one of the cells cannot begin; no device of any cell is opened then.
    """
    with ExitStack() as kept:
        ready = []
        for run in cells:
            context = copy_context()
            ready.append(context.run(_made_ready, run, context, kept.enter_context(ExitStack()), holds=holds))
        shutdown = ShutdownRequest(SystemdNotifier(len(ready)))
        with loop_first(), shutdown.signals():
            async with asyncio.TaskGroup() as group:
                tasks = [group.create_task(_run(one, shutdown, holds=holds), context=one.context) for one in ready]
                feeding = group.create_task(shutdown.supervisor.feed(partial(_written, ready)), name="watchdog")
                await asyncio.wait(tasks)
                feeding.cancel()
    return [task.result() for task in tasks]


def _written(cells: Sequence[_Ready], within_s: float) -> bool:
    """Return whether no journal has waited longer than that for its disk."""
    return all(one.journal.unsaved_s < within_s for one in cells if not isinstance(one.journal, JournalDamage))


def _made_ready(run: CellRun, context: Context, kept: ExitStack, *, holds: bool) -> _Ready:
    config, hooks = run.config, run.hooks
    work = None if run.queue else _own_work(config, hooks)
    if run.queue and config.profile_path is not None:  # without a profile in the cell, each job names one
        require_commissioned(config, instrument_of(config))
    cell = build_cell(config, hooks)
    require_time_limits(config, cell)
    if work:
        for tool, recipe in zip(config.turns, work[0], strict=True):
            require_stall_depth(tool, cell, recipe)
    notifiers = build_notifiers(config, hooks)
    kept.enter_context(locked(config.state_dir))
    try:
        kept.enter_context(logging_to(config.state_dir))
    except OSError as error:
        raise unusable(config.state_dir, error) from error
    if run.record is not None:
        kept.enter_context(recording_to(place(run.record, config), config))
    journal: Journal | JournalDamage
    try:
        journal = kept.enter_context(_journal(config, hooks, work[1][0]) if work else Journal.of_cell(config.state_dir))
    except JournalDamage as damage:
        if not holds:
            raise
        journal = damage
    return _Ready(run, work, cell, notifiers, journal, kept, context)


def _own_work(config: CellConfig, hooks: Hooks) -> tuple[Sequence[Recipe], Sequence[Sequence[Program]]]:
    """Return recipe and programs of each tool of the job in the cell's file."""
    recipes = read_recipes(config, hooks)
    require_commissioned(config, recipes[0].instrument)
    require_acceptable(recipes[0])
    programs = []
    for tool, recipe in zip(config.turns, recipes, strict=True):
        programs.append(read_programs(tool, recipe))
        for program in programs[-1]:
            require_accepted_by_robot(tool, hooks, program)
            require_fit(tool, recipe, program)
    return recipes, programs


async def _run(ready: _Ready, shutdown: ShutdownRequest, *, holds: bool) -> dict[str, Any] | Exception:
    """Run one cell to its end; return its summary or its error."""
    try:
        with ready.kept:
            if isinstance(ready.journal, JournalDamage):
                return await _hold(ready, shutdown, ready.journal)
            try:
                return await _run_job(ready, ready.journal, shutdown, holds=holds)
            except Exception:
                log.exception("the daemon failed at its start or its end")
                raise
    except Exception as error:  # noqa: BLE001 - the others go on
        shutdown.supervisor.status(_name(ready), f"{_name(ready)}: ended: {error}")
        return error


def _name(ready: _Ready) -> str:
    """Return the name of the cell with its file, which is unique."""
    return f"{ready.run.config.cell.name} ({ready.run.config.path.name})"


async def _hold(ready: _Ready, shutdown: ShutdownRequest, damage: JournalDamage) -> JournalDamage:
    """Hold the cell because of its journal until it is stopped; return that error."""
    log.error("%s", damage)
    cell = DamagedCell(ready.run.config, damage)
    listeners = (ready.run.hooks.on_event, ready.run.show)
    with shutdown.stopping(cell):
        sink = shutdown.supervisor.status_sink(_name(ready))
        await hold_damaged(ready.run.config, ready.notifiers, cell, damage, listeners=listeners, sink=sink)
    return damage


async def _run_job(ready: _Ready, journal: Journal, shutdown: ShutdownRequest, *, holds: bool) -> dict[str, Any]:
    """Run the cell's jobs; return the summary. PolishdError if the job under way cannot go on; nothing was opened."""
    config, hooks, run = ready.run.config, ready.run.hooks, ready.run
    async with Compute() as compute:
        jobs, known = _jobs(ready, journal, compute)
        keep = recording_exit(config.state_dir, jobs.run_dir, queue=jobs.of_queue)
        sinks = (jobs.record, keep, shutdown.supervisor.status_sink(_name(ready)))
        async with notifying(config, ready.notifiers, known, (hooks.on_event, run.show), sinks) as bus:
            jobs.bus = bus
            await jobs.resume()
            requests = QueueRequests(config, hooks, jobs.queue, jobs.added, bus.publish)
            how = {"holds": holds, "until_empty": run.until_empty, "start_held": run.start_held}
            runner = JobRunner(ready.cell, jobs, requests, bus, **how)
            with shutdown.stopping(runner):
                return await _serve(config.state_dir, runner)


def _jobs(ready: _Ready, journal: Journal, compute: Compute) -> tuple[SingleJob | QueuedJobs, dict[str, str]]:
    """Return the source of the jobs, and the job's names for notifications."""
    config, hooks = ready.run.config, ready.run.hooks
    if ready.work is None:
        make = JobMaker(config, hooks, ready.cell, compute)
        return QueuedJobs(journal, make), {"job": "", "part": "", "run_dir": ""}
    folder = run_folder(config, journal)
    jobs = SingleJob(journal, folder)
    jobs.job = make_job(
        config, hooks, *ready.work, journal=journal, folder=folder, compute=compute, publish=jobs.publish
    )
    return jobs, {"job": config.job.id, "part": config.part.id, "run_dir": str(folder.path)}


async def _serve(state_dir: Path, runner: JobRunner) -> dict[str, Any]:
    """Answer the socket until the runner ends; the cell is safe then, and the run folder has its summary."""
    async with serving(state_dir, runner.handlers, runner.bus):
        outcome, failure = await run_until_finished(runner)
        last = runner.exit_facts(outcome, failure)
        record_exit(state_dir, last)
        summary = await runner.jobs.close(last, failed=failure is not None)
        with suppress(PolishdError):  # the journal is lost, which was published
            await runner.become(DaemonState.FINISHED, summary["outcome"])
            runner.job.journal.flush()
    return summary


def _journal(config: CellConfig, hooks: Hooks, programs: Sequence[Program]) -> Journal:
    """Return the cell's journal; ConfigError if its job was begun with other settings, or with other programs."""
    terms = terms_of(config, hooks.program_formats(), *(program.sha256 for program in programs))
    cell = Journal.of_cell(config.state_dir)
    try:
        if (other := Queue(cell.store).under_way()) is not None:
            raise ConfigError(
                f"{config.state_dir}: the job {other.name!r} of the queue is under way. Continue it with polishd run "
                f"{config.path} --queue, or set it aside with polishd queue remove {config.path} {other.name}"
            )
        journal = cell.of_job(config.job.id, config.part.id, terms)
        require_same(config, terms, journal)
    except ConfigError:
        cell.close()
        raise
    return journal
