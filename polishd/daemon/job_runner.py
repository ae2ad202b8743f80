"""Daemon of one cell: it runs job after job, and an operator can hold, resume or stop it.

The table in ``state_machine`` defines its states. The single job of the cell's file is a queue of one.
Hold, stop, SIGTERM and every error leave contact in the same order (``safety.make_safe``). After an interruption
nothing moves until ``resume``. An error that the operator can correct holds the cell, any other one ends the daemon
(docs/explanation/cycle.md). Commands are taken in the order of arrival; a command ends the work that it interrupts.
"""

from __future__ import annotations

import asyncio
import gc
import logging
from collections.abc import Awaitable, Callable, Coroutine, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any, TypeVar, cast

from polishd.daemon.cell.cell import Cell
from polishd.daemon.cell.device_polling import root_cause
from polishd.daemon.cell.readiness import monitoring_signals
from polishd.daemon.contact.interruption import settle_interrupted_pass
from polishd.daemon.contact.safety import make_safe
from polishd.daemon.cycle import polish
from polishd.daemon.health import Health, health_snapshot, status_snapshot
from polishd.daemon.job.job import Job
from polishd.daemon.job.part_handling import require_clear
from polishd.daemon.job_assembly import NoJob, figures
from polishd.daemon.job_source import QueuedJobs, SingleJob
from polishd.daemon.queue.queue import BY_A_PERSON, JobResult, QueueEntry
from polishd.daemon.queue.requests import QueueRequests
from polishd.daemon.runtime.events import EventBus, causes, killed_safety, safety_of
from polishd.daemon.runtime.exit_record import next_action
from polishd.daemon.runtime.memory import named
from polishd.daemon.socket.server import Handler
from polishd.daemon.state_machine import ORDERS, StateEvent, following, obeyed
from polishd.interfaces import PartLoader
from polishd.model import events
from polishd.model.devices import SignalLimits
from polishd.model.errors import (
    DeviceFault,
    DeviceRefused,
    HostFault,
    PolishdError,
    SafetyStop,
    SignalFault,
    ToolStop,
    WrongPart,
)
from polishd.model.states import EXIT_CODES, DaemonState, Outcome

log = logging.getLogger(__name__)

_T = TypeVar("_T")

ORDERED, STOPPED, BEGUN = "held by command", "stopped by command", "this job was begun earlier"
STARTED_HELD = "the daemon was started without an order to move"
EMERGENCY = "motion was stopped at once, by command"
IN_THE_WAY = (
    "the robot stands where its last pass or touch-off was interrupted, and the loader must not move below it. Move "
    "the robot away at its controller, then resume"
)


@dataclass(slots=True)
class OperatorCommand:
    """One of ``state_machine.ORDERS`` with its reason, or ``UNFIT`` from the computer's health or a signal."""

    verb: StateEvent
    reason: str = ""
    error: type[PolishdError] = HostFault
    """For ``UNFIT``: the class of the error that holds the cell or ends its daemon."""
    refused: bool = False
    """The command failed, and the cell stays in its state."""
    taken: bool = False
    """The command succeeded, and the cell goes on, perhaps through states that it leaves at once."""

    def worsen(self, reason: str, error: type[PolishdError]) -> None:
        """Replace the error of ``UNFIT`` by one that an operator cannot mend, also after the command was taken."""
        if self.error.mendable and not error.mendable:
            self.error, self.reason = error, f"{reason}; {self.reason}"

    def describe(self, what: str) -> str:
        """Return ``what`` with the reason of the command, if it has one."""
        return f"{what}: {self.reason}" if self.reason else what


class OperatorCommandQueue:
    """Commands that were given and are not taken yet, in the order of arrival."""

    def __init__(self) -> None:
        self._waiting: asyncio.Queue[OperatorCommand] = asyncio.Queue()

    def give(self, order: OperatorCommand) -> None:
        """Add a command; it is taken as soon as the present work can be ended."""
        self._waiting.put_nowait(order)

    async def next(self) -> OperatorCommand:
        """Return the next command of an operator."""
        return await self._but(StateEvent.UNFIT)

    async def interrupting(self) -> OperatorCommand:
        """Return the next command that ends work: any except ``RESUME``."""
        return await self._but(StateEvent.RESUME)

    async def _but(self, passed: StateEvent) -> OperatorCommand:
        while (order := await self._waiting.get()).verb is passed:
            pass
        return order

    async def stop_command(self) -> OperatorCommand:
        """Wait for the command to stop while the cell is opened. All commands stay in the queue for later."""
        seen: list[OperatorCommand] = []
        try:
            while not seen or seen[-1].verb is not StateEvent.STOP:
                seen.append(await self._waiting.get())
            return seen[-1]
        finally:
            for order in seen:
                self._waiting.put_nowait(order)


async def run_unless_commanded(
    order: Coroutine[Any, Any, OperatorCommand],
    *work: Coroutine[Any, Any, None],
    late: Callable[[OperatorCommand], None] = lambda _: None,
) -> OperatorCommand | None:
    """Return the command that ended the work, or None if the first work ended before a command.

    A command that arrives at that moment, or with which the work fails, goes to ``late`` for the next state.
    """
    ordered: asyncio.Task[OperatorCommand] | None = None
    try:
        async with asyncio.TaskGroup() as group:
            ordered = group.create_task(order, name="orders")
            tasks = [group.create_task(one, name="work") for one in work]
            await asyncio.wait({ordered, *tasks}, return_when=asyncio.FIRST_COMPLETED)
            for task in (ordered, *tasks):
                task.cancel()
    except BaseExceptionGroup as errors:
        if ordered is not None and not ordered.cancelled() and ordered.exception() is None:
            late(ordered.result())
        raise root_cause(errors) from errors
    if tasks[0].cancelled():
        return ordered.result()
    if not ordered.cancelled():
        late(ordered.result())
    return None


@dataclass(frozen=True, slots=True)
class StateResult:
    """Result of the work of a state: the event of the next transition, with its reason, outcome or error."""

    trigger: StateEvent
    reason: str = ""
    outcome: Outcome = Outcome.STOPPED
    error: Exception | None = None


ENDED = StateResult(StateEvent.ENDED)


class JobRunner:
    """Runs jobs on a cell, which it opens and closes, and obeys commands at once."""

    def __init__(
        self,
        cell: Cell,
        jobs: SingleJob | QueuedJobs,
        requests: QueueRequests,
        bus: EventBus,
        *,
        holds: bool = True,
        until_empty: bool = False,
        start_held: bool = False,
    ) -> None:
        """``holds``: wait for an operator who can remove the cause; ``until_empty``: end with an empty queue.

        ``start_held``: move nothing before an operator's ``resume``.
        """
        self.jobs, self.bus = jobs, bus
        self._cell, self._requests = cell, requests
        cell.on_broken = partial(_publish_abort, bus)
        self._holds, self._until_empty, self._start_held = holds, until_empty, start_held
        self._error: Exception | None = None
        """The error that holds the cell."""
        self._orders = OperatorCommandQueue()
        self._asides: asyncio.Queue[tuple[QueueEntry, OperatorCommand]] = asyncio.Queue()
        self._unfit: OperatorCommand | None = None
        """Command because of the computer's health or a signal, since polishing began."""
        begun = jobs.entry is not None and jobs.job.journal.begun
        self._part_in = jobs.entry.part_id if begun and jobs.entry else ""
        """The part in the cell as far as is known, with a queue; a map verifies it."""
        self._seen: int | None = None
        """The interrupted pass (``Journal.cut_off``) after which an operator has resumed."""
        self._changed = asyncio.Condition()
        self._work: Mapping[DaemonState, Callable[[], Awaitable[StateResult]]] = {
            DaemonState.STARTING: self._start,
            DaemonState.IDLE: self._next,
            DaemonState.CHANGING: self._change,
            DaemonState.POLISHING: self._polish,
            DaemonState.HELD: self._wait,
        }
        self._health = Health(cell, lambda: self.job)
        self.state, self.reason = DaemonState.STARTING, ""

    @property
    def job(self) -> Job | NoJob:
        """The job under way, or the journal between jobs."""
        return self.jobs.job

    @property
    def handlers(self) -> dict[str, Handler]:
        """Handlers of the socket's commands."""
        found = status_snapshot(self._cell, self._health, self.bus, self._now)
        orders = {verb.value: partial(self._order, verb) for verb in ORDERS}
        own: dict[str, Handler] = {"status": self.status, **found, **orders, "queue_remove": self._remove}
        return {**self._requests.handlers, **self.jobs.handlers(), **own}

    async def status(self) -> Mapping[str, Any]:
        """Return state, reason, cycles, health, devices and the waiting jobs."""
        return {
            **self._now(),
            "cycles": self.job.cycles(),
            **health_snapshot(self._cell, self._health),
            "tasks": len(asyncio.all_tasks()),
            "devices": {name: self._health.device(name) for name in self._cell.devices},
            **self.jobs.status(),
        }

    def _now(self) -> dict[str, Any]:
        state = {"state": self.state, "reason": self.reason, "next": next_action(self.state, queue=self.jobs.of_queue)}
        return state | self.job.names() | dict(zip(("cycle", "phase"), self.job.journal.phase_now, strict=True))

    def stop(self) -> None:
        """Stop the daemon, as SIGTERM does."""
        self._orders.give(OperatorCommand(StateEvent.STOP))

    async def run(self) -> Outcome:
        """Go from state to state until the jobs or an operator end it; the cell is safe and closed then.

        Raises the error that ended it.
        """
        try:
            async with self._health.watching(self._endangered), monitoring_signals(self._cell, self._wrong):
                outcome = await self._until_finished()
        except BaseException as error:
            try:
                await self._leave()
            except (PolishdError, OSError) as late:
                error.add_note(f"and then: {late}")  # the first error is raised
            raise
        await self._leave()
        return outcome

    async def _until_finished(self) -> Outcome:
        while True:
            try:
                result = await self._work[self.state]()
            except Exception as error:  # noqa: BLE001 - it is raised below, or an operator mends its cause
                result = self._failed(error)
            state = following(self.state, result.trigger, unattended=not self._holds)
            if state is DaemonState.FINISHED:
                if result.error is not None:
                    raise result.error
                self.reason = result.reason or self.reason
                return result.outcome
            if result.error is not None and result.error is not self._error:
                self.bus.publish(events.CellHeld(error=str(result.error), kind=type(result.error).__name__))
            self._error = result.error
            await self.become(*self._passed_through(state, result.reason))

    def _passed_through(self, state: DaemonState, reason: str) -> tuple[DaemonState, str]:
        """Return the state after skipping IDLE with a job ready and CHANGING with its part in."""
        if state is DaemonState.IDLE and self.jobs.ready:
            state, reason = following(state, StateEvent.NEXT), self._to_change()
        if state is DaemonState.CHANGING and self._is_part_in():
            state, reason = following(state, StateEvent.CHANGED), ""
        return state, reason

    async def _leave(self) -> None:
        if self._cell.identities:
            await make_safe(self._cell)
            await self._cell.close()

    def _standing(self, state: str, reason: str, *, killed: bool = False) -> events.StateChanged:
        """Return the state with the safety of the devices; ``killed``: if the daemon is killed in this state."""
        unsafe = killed_safety(self._cell.acting) if killed else self._cell.unsafe if self._cell.identities else None
        return safety_of(state, reason, unsafe, queue=self.jobs.of_queue)

    def failure(self, error: Exception) -> events.DaemonFailed:
        """Return the event of an error that ends the daemon, with the state of the cell."""
        kind = type(error).__name__
        return events.DaemonFailed(error=str(error), kind=kind, standing=self._standing("failed", "").standing)

    def exit_facts(self, outcome: Outcome, failure: Exception | None) -> dict[str, Any]:
        """Return the exit record: outcome, reason, causes, safety of the devices, next action."""
        found = causes(self.job.journal, failure)
        reason = f"{type(failure).__name__}: {failure}" if failure else self.reason
        return {
            **self._standing("failed" if failure else outcome.value, reason).data,
            "exit_code": getattr(failure, "exit_code", 1) if failure else EXIT_CODES[outcome],
            "causes": [asdict(cause) for cause in found],
            "notes": [str(cause) for cause in found],
            **({} if failure else self.jobs.exit_facts(outcome)),
            **({"run_dir": str(self.jobs.run_dir())} if self.jobs.folder else {}),
        }

    # what happens in each state

    async def _start(self) -> StateResult:
        before = self.job.journal.held_last() if self.jobs.of_queue else ""
        stop = await run_unless_commanded(self._orders.stop_command(), self._cell.open(self._busy))
        if stop is not None:
            return StateResult(StateEvent.STOP, self._stopped_by(stop))
        self.bus.publish(events.CellOpened(devices=self._cell.identities))
        if (found := await self._made_safe()) is not None:
            return found
        if self.job.journal.resumed:
            return StateResult(StateEvent.INTERRUPTED, BEGUN)
        if before:  # no operator has resumed since
            return StateResult(StateEvent.INTERRUPTED, before)
        return StateResult(StateEvent.INTERRUPTED, STARTED_HELD) if self._start_held else StateResult(StateEvent.READY)

    async def _busy(self, what: str) -> None:
        await self.become(following(self.state, StateEvent.BUSY), what)

    async def _unless_interrupted(self, work: Callable[[], Awaitable[_T]]) -> _T | OperatorCommand:
        """Return the result of the work, or the command that ended it. SafetyStop if the journal is lost meanwhile."""
        done: list[_T] = []

        async def run() -> None:
            done.append(await work())

        lost = self.job.journal.lost()
        order = await run_unless_commanded(self._orders.interrupting(), run(), lost, late=self._orders.give)
        return done[0] if order is None else order

    async def _next(self) -> StateResult:
        """Begin the next job, or go on with the job that held the cell."""
        found = await self._unless_interrupted(self._go_on if isinstance(self.job, Job) else self._begin)
        return self._interrupted(found) if isinstance(found, OperatorCommand) else found

    async def _go_on(self) -> StateResult:
        """Go on with the job under way, unless the shop has assigned its part to another cell."""
        if lost := await self._queued().claims.settled(self.jobs.entry):
            return await self._ended(JobResult("set aside", lost, ""))
        return StateResult(StateEvent.NEXT, self._to_change())

    async def _begin(self) -> StateResult:
        jobs = self._queued()
        entry = await jobs.next(until_empty=self._until_empty)
        if entry is None:
            return StateResult(StateEvent.EMPTY, outcome=Outcome.IN_TOLERANCE)
        try:
            await jobs.begin(entry)
        except PolishdError as error:
            if not jobs.queue.holds(entry):
                return StateResult(StateEvent.ENDED)  # it was removed meanwhile
            verdict = jobs.judge(error)
            if verdict is None:
                raise
            return self._refused(entry, verdict, StateResult(StateEvent.ERROR, error=error))
        return StateResult(StateEvent.NEXT, self._to_change())

    def _queued(self) -> QueuedJobs:
        """Return the queue, in states that a single job skips."""
        return cast(QueuedJobs, self.jobs)

    def _refused(self, entry: QueueEntry, verdict: JobResult, result: StateResult = ENDED) -> StateResult:
        """End a job that could not begin."""
        self._queued().refuse(entry, verdict)
        return _after(verdict, entry.name, result)

    async def _change(self) -> StateResult:
        """Put in the job's part. The loader moves only after every device has confirmed that it is safe."""
        if self.jobs.entry is None:
            raise RuntimeError("a fault of polishd: no job is under way. Please report it")
        part, port = self.jobs.entry.part_id, self._cell.used.get("loader")
        if port is None:
            return await self._changed_by_person(self.jobs.entry.name, part)
        if self._in_the_way():
            raise DeviceRefused(IN_THE_WAY)
        await make_safe(self._cell)
        if self._cell.unsafe:
            error = DeviceFault(f"not confirmed to be safe: {'; '.join(self._cell.unsafe)}")
            return self._failed(error, StateEvent.UNSAFE)
        loader = cast(PartLoader, self._cell.devices[port])
        try:
            order = await self._unless_interrupted(partial(self._load, loader, part))
        except WrongPart as error:
            return await self._over(error, StateResult(StateEvent.MENDABLE, error=error))
        except PolishdError:
            await make_safe(self._cell)
            raise
        if order is None:
            return StateResult(StateEvent.CHANGED)
        await make_safe(self._cell)
        return self._interrupted(order)

    async def _changed_by_person(self, job: str, part: str) -> StateResult:
        if not self._holds:
            raise DeviceRefused(
                f"an operator has to put part {part!r} in, but --no-hold waits for none; see docs/how-to/queue.md"
            )
        self._part_in = ""
        standing = self._standing(DaemonState.CHANGING, "").standing
        self.bus.publish(events.PartRequested(job=job, part_id=part, standing=standing))
        order = await self._orders.next()
        if order.verb is not StateEvent.RESUME:
            return self._interrupted(order)
        try:
            await require_clear(self._cell)
        except SignalFault:
            order.refused = True
            raise
        self._is_in(part, "a person")
        return StateResult(StateEvent.RESUME)

    async def _load(self, loader: PartLoader, part: str) -> None:
        """Load a part and read back which one is on the seat; the next map verifies it."""
        if await loader.loaded() not in {None, part}:
            await loader.unload()
        await loader.load(part)
        if (found := await loader.loaded()) != part:
            raise WrongPart(f"{self._cell.used['loader']}: {found or 'nothing'!r} is on the seat instead of {part!r}")
        if part != self._part_in:
            self._is_in(part, "loader")

    async def _polish(self) -> StateResult:
        result = await self._cycles()
        ended = result.trigger in {StateEvent.DONE, StateEvent.MENDABLE, StateEvent.ERROR}
        end = result.outcome if result.trigger is StateEvent.DONE else result.error
        if not self.jobs.of_queue or not ended or not isinstance(end, Outcome | PolishdError):
            return result
        torn = self.job.journal.unfinished() is not None
        if torn:
            await make_safe(self._cell)
            if self._cell.unsafe:
                return result  # it ends the daemon, and the job stays open: an operator has to check first
            await settle_interrupted_pass(self._cell, self.job.journal)
        return await self._over(end, result, torn=torn)

    async def _cycles(self) -> StateResult:
        """Polish until the job has its outcome, or an error or a command ends it."""
        self._cell.emergency, self._unfit = False, None
        journal = self.job.journal
        try:
            order = await self._unless_interrupted(partial(polish, self._cell, cast(Job, self.job), journal))
        except PolishdError as error:
            result = self._failed(error)
            if result.trigger is StateEvent.MENDABLE:
                await make_safe(self._cell)
            return result
        if isinstance(order, Outcome):
            return StateResult(StateEvent.DONE, outcome=order)
        if order.verb is StateEvent.STOP:
            return StateResult(StateEvent.STOP, self._stopped_by(order))
        if order.verb is StateEvent.UNFIT and not order.error.mendable:
            return self._failed(order.error(order.reason))
        await make_safe(self._cell)
        settled = "" if self._cell.unsafe else await settle_interrupted_pass(self._cell, journal)
        if order.verb is StateEvent.UNFIT:
            unfit = order.error("; ".join(filter(None, (order.reason, settled))))
            return StateResult(StateEvent.UNFIT, f"{type(unfit).__name__}: {unfit}", error=unfit)
        return StateResult(order.verb, self._held_by(order, settled))

    async def _over(self, end: Outcome | PolishdError, result: StateResult, *, torn: bool = False) -> StateResult:
        """End the job with its verdict; return the result unchanged if the job goes on."""
        verdict = self._queued().judge(end, torn=torn)
        return result if verdict is None else await self._ended(verdict, result)

    async def _ended(self, verdict: JobResult, result: StateResult = ENDED) -> StateResult:
        entry, failure = self.jobs.entry, result.error
        if failure is not None:
            self.bus.publish(events.CellHeld(error=str(failure), kind=type(failure).__name__))
            self._error = failure  # published while the job is still under way
        if verdict.how == "set aside":
            self._part_in = ""  # it may be another part or be mounted wrongly: an operator puts it in again
        last = self.exit_facts(result.outcome, failure)
        name = entry.name if entry else ""
        facts = {"job": name, "verdict": verdict.how, "reason": verdict.reason, "next": verdict.stops}
        outcome = "failed" if failure else "set aside" if verdict.how == "set aside" else result.outcome.value
        notes = [*last["notes"], *([verdict.reason] if verdict.how == "set aside" else [])]
        await self._queued().end(verdict, {**last, **figures(self.job), **facts, "outcome": outcome, "notes": notes})
        gc.collect()  # its passes froze their garbage, such as maps and plans
        return _after(verdict, name, result)

    async def _wait(self) -> StateResult:
        """Wait until a command succeeds or is refused, or the job that holds the cell is set aside."""
        done: list[StateResult] = []

        async def obey() -> None:
            done.append(await self._obey())

        aside = await run_unless_commanded(self._next_aside(), obey())
        if aside is not None:
            kind = type(self._error).__name__ if self._error else ""
            reason = aside.reason or f"{BY_A_PERSON}, held over: {self.reason}"
            verdict = JobResult("set aside", reason, kind)
            if self.jobs.entry is None and (begun := self.jobs.queue.under_way()) is not None:
                return self._refused(begun, verdict)
            return await self._ended(verdict)
        if done[0].trigger is StateEvent.RESUME and self.jobs.of_queue:
            self._seen = self.job.journal.cut_off()  # the reason of the hold named it
        return done[0]

    async def _obey(self) -> StateResult:
        """The next command while the cell is held."""
        order = cast(OperatorCommand, await run_unless_commanded(self._orders.next(), self._cell.listen()))
        if order.verb is StateEvent.STOP:
            return StateResult(order.verb, self._stopped_by(order), error=self._error)
        if order.verb is not StateEvent.RESUME:
            reason = f"{self.reason}; {order.describe(ORDERED)}" if order.reason else self.reason
            return StateResult(order.verb, reason, error=self._error)
        try:
            if (
                stop := await run_unless_commanded(self._orders.stop_command(), self._cell.restore_links())
            ) is not None:
                return StateResult(StateEvent.STOP, self._stopped_by(stop), error=self._error)
            refused = await self._made_safe()
            await require_clear(self._cell)
        except PolishdError:
            order.refused = True
            raise
        order.refused, order.taken = refused is not None, refused is None
        return refused or StateResult(StateEvent.RESUME)

    async def _made_safe(self) -> StateResult | None:
        """Make the cell safe. None if every device confirmed and no pass was left open; nothing moves before."""
        await make_safe(self._cell)
        if self._cell.unsafe:
            error = DeviceFault(f"not confirmed to be safe: {'; '.join(self._cell.unsafe)}")
            return self._failed(error, StateEvent.UNSAFE)
        if settled := await settle_interrupted_pass(self._cell, self.job.journal):
            return StateResult(StateEvent.INTERRUPTED, settled)
        await self._health.look()
        unfit = self._health.wrong(in_contact=False)
        return self._failed(HostFault(unfit), StateEvent.UNFIT) if unfit else None

    def _failed(self, error: Exception, mended: StateEvent = StateEvent.MENDABLE) -> StateResult:
        """Return the transition after an error: held for an operator, or the end if it interrupted a pass."""
        error = named(error)
        waits = isinstance(error, PolishdError) and error.mendable and bool(self._cell.identities)
        if self.state is DaemonState.POLISHING:
            waits = waits and all(record.ended_s is not None for record in self.job.journal.passes)
        return StateResult(mended if waits else StateEvent.ERROR, f"{type(error).__name__}: {error}", error=error)

    # orders

    def _endangered(self, what: str, error: type[PolishdError] = HostFault) -> None:
        """Leave contact while that is possible. An error that an operator cannot mend replaces one that he can."""
        if self.state is DaemonState.POLISHING and self._unfit is None:
            self._unfit = OperatorCommand(StateEvent.UNFIT, what, error)
            self._orders.give(self._unfit)
        elif self.state is DaemonState.POLISHING and self._unfit is not None:
            self._unfit.worsen(what, error)

    def _wrong(self, limits: SignalLimits, what: str) -> None:
        """Handle a signal outside its limits in contact, by the action of its limits."""
        self.bus.publish(events.SignalOutOfRange(signal=limits.name, what=what, action=limits.action))
        if limits.action != "notify":
            self._endangered(what, SafetyStop if limits.action == "lift" else SignalFault)

    def _held_by(self, order: OperatorCommand, settled: str) -> str:
        """Return the reason of the hold: the command, if it has a reason or closed no pass, and the closed pass."""
        parts = [EMERGENCY] if self._cell.emergency else []
        parts += [order.describe(ORDERED)] if order.reason or not settled else []
        return "; ".join([*parts, settled] if settled else parts)

    def _stopped_by(self, order: OperatorCommand) -> str:
        """Return the reason at the end, with the reason of the command to stop."""
        return f"{order.describe(STOPPED)}; {self.reason}".removesuffix("; ") if order.reason else self.reason

    async def become(self, state: DaemonState, reason: str) -> None:
        """Change and publish the state, and wake the handlers that wait for a command to be obeyed or refused."""
        if state is DaemonState.HELD and IN_THE_WAY not in reason and self._in_the_way():
            reason = f"{reason}; {IN_THE_WAY}"
        async with self._changed:
            self.state, self.reason = state, reason
            self._changed.notify_all()
        self.bus.publish(self._standing(state, reason, killed=state not in {DaemonState.HELD, DaemonState.FINISHED}))

    async def _order(self, verb: StateEvent, reason: str = "", by: str = "") -> Mapping[str, Any]:
        """Give a command and answer when it is obeyed. DeviceRefused with the reason if the cell stays held."""
        order = OperatorCommand(verb, " ".join(reason.split()))
        self._cell.emergency = self._cell.emergency or verb is StateEvent.ESTOP
        self._orders.give(order)
        with suppress(PolishdError):  # a lost journal ends polishing, and the command is obeyed
            self.bus.publish(events.CommandReceived(order=verb, reason=order.reason, by=by))
        async with self._changed:
            await self._changed.wait_for(lambda: order.refused or order.taken or self.state in obeyed(verb))
        if order.refused and self.state is DaemonState.HELD:
            raise DeviceRefused(f"{verb} is refused, the cell stays held: {self.reason}")
        return {"state": self.state, "reason": self.reason, "next": next_action(self.state, queue=self.jobs.of_queue)}

    async def _remove(self, job: str, reason: str = "", by: str = "") -> Mapping[str, Any]:
        """Remove a waiting job, or set aside the job that holds the cell."""
        entry = self._under_way()
        if entry is None or entry.name != job:
            return await self._requests.remove_waiting(job, reason, by)
        if self.state is not DaemonState.HELD or self._cell.unsafe:
            why = "a device is not confirmed to be safe" if self._cell.unsafe else f"the cell is {self.state}"
            raise DeviceRefused(f"{job!r} is under way, and {why}. Hold the cell first (polishd hold)")
        aside = OperatorCommand(StateEvent.ENDED, " ".join(reason.split()))
        self.bus.publish(
            events.CommandReceived(order="queue_remove", reason=": ".join(filter(None, (job, aside.reason))), by=by)
        )
        self._asides.put_nowait((entry, aside))
        async with self._changed:
            await self._changed.wait_for(lambda: not self._goes_on(entry) or self.state is not DaemonState.HELD)
        if self._goes_on(entry):
            raise DeviceRefused(f"{job!r} goes on: another command came first")
        return await self._requests.list()

    async def _next_aside(self) -> OperatorCommand:
        while not self._goes_on((aside := await self._asides.get())[0]):
            pass
        return aside[1]

    def _under_way(self) -> QueueEntry | None:
        """Return the job that is under way or being prepared."""
        return self.jobs.entry or self.jobs.queue.under_way()

    def _goes_on(self, entry: QueueEntry) -> bool:
        now = self._under_way()
        return now is not None and now.id == entry.id

    def _interrupted(self, order: OperatorCommand) -> StateResult:
        if order.verb is StateEvent.UNFIT:  # while the end of the last job was written, for example
            return self._failed(order.error(order.reason))
        if order.verb is StateEvent.STOP:
            return StateResult(StateEvent.STOP, self._stopped_by(order))
        return StateResult(order.verb, self._held_by(order, ""))

    def _in_the_way(self) -> bool:
        """Return whether the robot may stand over the part, where the loader moves."""
        left = self.job.journal.cut_off() if self.jobs.of_queue and "loader" in self._cell.used else None
        return left is not None and left != self._seen

    def _is_in(self, part: str, by: str) -> None:
        self._part_in = part
        self.bus.publish(events.PartChanged(part_id=part, by=by))

    def _to_change(self) -> str:
        """Return the reason in ``status`` while the part is changed."""
        entry = self.jobs.entry
        if entry is None or self._is_part_in():
            return ""
        who = "the loader puts" if "loader" in self._cell.used else "an operator has to put"
        return f"{entry.name}: {who} part {entry.part_id!r} in"

    def _is_part_in(self) -> bool:
        """Return whether the part is in; for a single job an operator put it in before the start."""
        entry = self.jobs.entry
        return entry is None or ("loader" not in self._cell.used and entry.part_id == self._part_in)


def _after(verdict: JobResult, name: str, result: StateResult) -> StateResult:
    if not verdict.stops:
        return StateResult(StateEvent.ENDED)
    reason = f"the queue stopped: {verdict.stops}; {name} was {verdict.how}: {verdict.reason}"
    error = result.error or (ToolStop(reason) if verdict.how == "accepted" else None)
    return replace(result, trigger=StateEvent.STOPS, reason=reason, error=error)


def _publish_abort(bus: EventBus, error: BaseException) -> None:
    """Publish at once that contact is left, because the devices take seconds to confirm."""
    with suppress(PolishdError):  # a lost journal ends polishing
        bus.publish(events.ContactAborted(error=str(error), kind=type(error).__name__))


async def run_until_finished(daemon: JobRunner) -> tuple[Outcome, Exception | None]:
    """Run the daemon; log, publish and return an error that ends it."""
    try:
        await daemon.become(DaemonState.STARTING, "")
        return await daemon.run(), None
    except Exception as raised:
        error = named(raised)
        log.exception("the daemon ends")
        with suppress(PolishdError):  # a lost journal may have ended it
            daemon.bus.publish(daemon.failure(error))
        return Outcome.STOPPED, error
