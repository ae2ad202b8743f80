"""The daemon of a queue: job after job on a cell that is opened once, by the same table of states."""

from __future__ import annotations

import asyncio
import gc
import logging
from collections import Counter
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import replace
from typing import Any

from polishd.daemon.assembly import NoJob, figures
from polishd.daemon.cell.cell import Cell
from polishd.daemon.contact.interruption import settle_interrupted_pass
from polishd.daemon.contact.safety import make_safe
from polishd.daemon.job.job import Job
from polishd.daemon.job.part_handling import require_clear
from polishd.daemon.journal.journal import Journal, over_row
from polishd.daemon.queue.queue import BY_A_PERSON, JobResult, Queue, QueueEntry, judge
from polishd.daemon.queue.requests import QueueRequests, ShopAssignments
from polishd.daemon.runtime.events import EventBus, utc_now
from polishd.daemon.socket.server import Handler
from polishd.daemon.state_machine import Daemon, OperatorCommand, StateResult, run_unless_commanded
from polishd.interfaces import PartLoader
from polishd.model import events
from polishd.model.errors import DeviceFault, DeviceRefused, PolishdError, SignalFault, ToolStop, WrongPart
from polishd.model.events import Event
from polishd.model.states import DaemonState, Outcome, StateEvent
from polishd.pipeline.run_folder import RunFolder

# The jobs of a queue on one cell, one at a time: begun, and ended with their verdict.

log = logging.getLogger(__name__)

Begin = Callable[[QueueEntry, Queue, Journal, Callable[[Event], None]], Awaitable[tuple[Job, RunFolder]]]
"""Makes an entry's job ready, journals it as under way, and makes its run folder; see ``job_maker.JobMaker``."""


class QueueRunner:
    """What the daemon of a queue knows of its jobs; nothing in it grows with their number."""

    def __init__(self, journal: Journal, make: Begin) -> None:
        """``journal`` is that of the cell, between jobs."""
        self.queue = Queue(journal.store)
        self.claims = ShopAssignments(self.queue, self.added)
        """What a shop has said of the parts that it gave to this cell."""
        self.ended: Counter[str] = Counter()
        """How many jobs ended so, in this run of the daemon."""
        self.entry: QueueEntry | None = None
        """The job that is under way in this run."""
        self.job: Job | NoJob = NoJob(journal)
        self.folder: RunFolder | None = None
        self.bus: EventBus | None = None
        """Who is told; made with this shift as one that hears."""
        self._of_cell, self._make = journal, make
        self._began = ""
        self._news = asyncio.Event()

    def record(self, event: Event) -> None:
        """Keep it with the job under way, or with none."""
        self.job.journal.record_event(event)

    def tell(self, event: Event) -> None:
        """Publish an event."""
        if self.bus is not None:
            self.bus.publish(event)

    def added(self) -> None:
        """Something was added to the queue, or taken out, or may begin now."""
        self._news.set()

    async def next(self, *, until_empty: bool = False) -> QueueEntry | None:
        """The job that was begun by an earlier run, or the first that waits and may begin, as soon as there is one.

        None with ``until_empty``, where nothing waits at all.
        """
        while (entry := self.queue.under_way() or self.claims.first()) is None:
            if until_empty and self.first() is None:
                break
            self._news.clear()
            await self._news.wait()
        return entry

    def first(self) -> QueueEntry | None:
        """The one under way, or the first that waits, whether it may begin or not; None where the queue is empty."""
        return next(iter(self.queue.to_do()), None)

    async def begin(self, entry: QueueEntry) -> Job:
        """Its job is under way; PolishdError where anything of it is wrong: nothing has moved then."""
        job, self.folder = await self._make(entry, self.queue, self._of_cell, self.tell)
        self.job, self.entry, self._began = job, entry, utc_now()
        self.tell(events.JobStarted(job=entry.name, part_id=entry.part_id, run_dir=str(self.folder.path)))
        return job

    async def end(self, verdict: JobResult, summary: Mapping[str, Any]) -> None:
        """The job under way is over: first in the journal, then in its run folder, then told."""
        entry, job, folder = self.entry, self.job, self.folder
        if entry is None or folder is None:
            raise RuntimeError("a fault of polishd: no job is under way; please report it")
        self.queue.end(entry, verdict, over_row(job.journal.number, _outcome(verdict), verdict.reason))
        await self.leave(summary)
        self._told_end(entry, verdict, str(folder.path))
        self.job, self.entry, self.folder = NoJob(self._of_cell), None, None

    async def leave(self, summary: Mapping[str, Any]) -> None:
        """What is known of the job under way is left in its run folder, and told; nothing where there is none.

        ``summary`` has ``outcome`` and ``reason``.
        """
        folder = self.folder
        if folder is None:
            return
        told = {**summary, "run_dir": str(folder.path), "started": self._began, "ended": utc_now()}
        try:
            await asyncio.to_thread(folder.json, "summary.json", told)
            await asyncio.to_thread(self.job.journal.copy_to, folder.path / "journal.sqlite")
        except (OSError, PolishdError) as error:
            log.error("%s is not whole: %s; the journal has it all", folder.path, error)
        outcome, reason = str(summary["outcome"]), str(summary["reason"])
        self.tell(events.RunFolderCompleted(run_dir=str(folder.path), outcome=outcome, reason=reason))

    def refuse(self, entry: QueueEntry, verdict: JobResult) -> None:
        """A job that could not begin is over."""
        entry = next((one for one in self.queue.to_do() if one.id == entry.id), entry)
        also = [over_row(entry.job, _outcome(verdict), verdict.reason)] if entry.job else []
        self.queue.end(entry, verdict, *also)
        self._told_end(entry, verdict, "")

    def _told_end(self, entry: QueueEntry, verdict: JobResult, run_dir: str) -> None:
        self.ended[verdict.how] += 1
        said: dict[str, Any] = {"verdict": verdict.how, "reason": verdict.reason, "stops": verdict.stops}
        self.tell(events.QueueJobEnded(job=entry.name, part_id=entry.part_id, run_dir=run_dir, **said))


def _outcome(verdict: JobResult) -> str:
    """As the journal's jobs have it."""
    return {"accepted": "in_tolerance", "put aside": "put aside"}.get(verdict.how, verdict.fault)


async def resume_open_job(shift: QueueRunner) -> None:
    """Make the job ready that an earlier run left under way; before any device is opened.

    Raises PolishdError where it cannot go on like this.
    """
    entry = shift.queue.under_way()
    if entry is None:
        return
    try:
        await shift.begin(entry)
    except PolishdError as error:
        aside = f"or put it aside: polishd job remove CELL.toml {entry.name}"
        raise type(error)(f"{error}\nthe job {entry.name!r} of the queue is under way; mend that, {aside}") from error


IN_THE_WAY = (
    "the robot stands where its last pass or touch-off was cut off, and the loader must not move under it; drive the "
    "robot away at its own controller, then resume"
)
ENDED = StateResult(StateEvent.ENDED)


class QueueDaemon(Daemon):
    """Works the queue until it is stopped, or until it is empty."""

    def __init__(
        self,
        cell: Cell,
        shift: QueueRunner,
        desk: QueueRequests,
        bus: EventBus,
        *,
        holds: bool = True,
        until_empty: bool = False,
    ) -> None:
        super().__init__(cell, shift.job, bus, holds=holds)
        self._of_queue = True
        self._shift, self._desk, self._until_empty = shift, desk, until_empty
        self._does = {**self._does, DaemonState.IDLE: self._next, DaemonState.CHANGING: self._change}
        self._asides: asyncio.Queue[tuple[QueueEntry, OperatorCommand]] = asyncio.Queue()
        begun = shift.entry is not None and shift.job.journal.begun
        self._part_in = shift.entry.part_id if begun and shift.entry else ""
        """The part in the cell, as far as is known; a map proves it."""
        self._seen: int | None = None
        """What was cut off (``Journal.cut_off``), and a person said since that it may go on."""

    @property
    def handlers(self) -> dict[str, Handler]:
        """Who obeys the verbs of the socket; of the queue's, taking out a job that is under way is ours."""
        of_shop = self._shift.claims.handlers(self.bus.publish)
        return {**super().handlers, **self._desk.handlers, **of_shop, "job_remove": self._remove}

    async def status(self) -> Mapping[str, Any]:
        """Of the cell, and of the queue."""
        waiting = self._shift.queue.waiting()
        next_job = f"{waiting[0].name} (part {waiting[0].part_id})" if waiting else ""
        shop = self._shift.claims.facts()
        return {**await super().status(), "waiting": len(waiting), "next_job": next_job, **shop}

    # what happens in each state

    async def _start(self) -> StateResult:
        before = self.job.journal.held_last()
        turn = await super()._start()
        if turn.trigger is StateEvent.READY and before:
            return StateResult(StateEvent.INTERRUPTED, before)  # nobody has said since that it may go on
        return _between(turn, StateEvent.READY)

    async def _wait(self) -> StateResult:
        turns: list[StateResult] = []

        async def work() -> None:
            turns.append(await Daemon._wait(self))

        aside = await run_unless_commanded(self._asked_aside(), work())
        if aside is not None:
            kind = type(self._error).__name__ if self._error else ""
            reason = aside.reason or f"{BY_A_PERSON}, held over: {self.reason}"
            verdict = JobResult("put aside", reason, kind)
            if self._shift.entry is None and (begun := self._shift.queue.under_way()) is not None:
                return self._refused(begun, verdict)
            return await self._ended(verdict)
        if turns[0].trigger is StateEvent.RESUME:
            self._seen = self.job.journal.cut_off()  # a person has looked, and was told what at
        return _between(turns[0], StateEvent.RESUME)

    async def _next(self) -> StateResult:
        """Between jobs, or back in one over which the cell was held."""
        turns: list[StateResult] = []

        async def work() -> None:
            turns.append(await (self._go_on() if isinstance(self.job, Job) else self._begin()))

        order = await run_unless_commanded(
            self._orders.interrupting(), work(), self.job.journal.lost(), late=self._orders.give
        )
        return turns[0] if order is None else self._interrupted(order)

    async def _go_on(self) -> StateResult:
        """With the job that is under way, once it is sure that no other cell has its part meanwhile."""
        lost = await self._shift.claims.settled(self._shift.entry)
        return (
            await self._ended(JobResult("put aside", lost, ""))
            if lost
            else StateResult(StateEvent.NEXT, self._to_change())
        )

    async def _begin(self) -> StateResult:
        entry = await self._shift.next(until_empty=self._until_empty)
        if entry is None:
            return StateResult(StateEvent.EMPTY, outcome=Outcome.IN_TOLERANCE)
        try:
            self.job = await self._shift.begin(entry)
        except PolishdError as error:
            if not self._shift.queue.holds(entry):
                return StateResult(StateEvent.ENDED)  # somebody took it out meanwhile
            verdict = self._judged(error)
            if verdict is None:
                raise
            return self._refused(entry, verdict, StateResult(StateEvent.ERROR, error=error))
        return StateResult(StateEvent.NEXT, self._to_change())

    def _refused(self, entry: QueueEntry, verdict: JobResult, turn: StateResult = ENDED) -> StateResult:
        """A job that could not begin has its verdict."""
        self._shift.refuse(entry, verdict)
        return _after(verdict, entry.name, turn)

    async def _change(self) -> StateResult:
        """Put the job's part in. No loader moves before every device has confirmed that it is safe."""
        if self._shift.entry is None:
            raise RuntimeError("a fault of polishd: no job is under way; please report it")
        part, port = self._shift.entry.part_id, self._cell.used.get("loader")
        if port is None:
            return await self._changed_by_person(self._shift.entry.name, part)
        if self._in_the_way():
            raise DeviceRefused(IN_THE_WAY)
        await make_safe(self._cell)
        if self._cell.unsafe:
            error = DeviceFault(f"not confirmed to be safe: {'; '.join(self._cell.unsafe)}")
            return self._failed(error, StateEvent.UNSAFE)
        loader: Any = self._cell.devices[port]
        try:
            order = await run_unless_commanded(
                self._orders.interrupting(), self._load(loader, part), self.job.journal.lost(), late=self._orders.give
            )
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
        if part == self._part_in:
            return StateResult(StateEvent.CHANGED)
        if not self._holds:
            raise DeviceRefused(f"a person is to put part {part!r} in, and --no-hold waits for none; see docs/queue.md")
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
        """By the loader's own word; the next map has to prove it, too."""
        if await loader.loaded() not in {None, part}:
            await loader.unload()
        await loader.load(part)
        if (found := await loader.loaded()) != part:
            raise WrongPart(f"{self._cell.used['loader']}: {found or 'nothing'!r} is on the seat instead of {part!r}")
        if part != self._part_in:
            self._is_in(part, "loader")

    async def _polish(self) -> StateResult:
        turn = await super()._polish()
        ended = turn.trigger in {StateEvent.DONE, StateEvent.MENDABLE, StateEvent.ERROR}
        if not ended or not (turn.trigger is StateEvent.DONE or isinstance(turn.error, PolishdError)):
            return turn
        torn = self.job.journal.unfinished() is not None
        if torn:
            await make_safe(self._cell)
            if self._cell.unsafe:
                return turn  # it ends the daemon, and the job stays open: a person has to look first
            await settle_interrupted_pass(self._cell, self.job.journal)
        end = turn.error if isinstance(turn.error, PolishdError) else turn.outcome
        return await self._over(end, turn, torn=torn)

    async def _over(self, end: Outcome | PolishdError, turn: StateResult, *, torn: bool = False) -> StateResult:
        """After the verdict on that end; the turn itself where the job is not over."""
        verdict = self._judged(end, torn=torn)
        return turn if verdict is None else await self._ended(verdict, turn)

    def _judged(self, end: Outcome | PolishdError, *, torn: bool = False) -> JobResult | None:
        before = self._shift.queue.last_ended()
        tool = "; ".join(found.what for found in self.job.findings if found.stops == "cell")
        return judge(end, torn=torn, previous=before.fault if before else "", tool=tool)

    async def _ended(self, verdict: JobResult, turn: StateResult = ENDED) -> StateResult:
        entry, failure = self._shift.entry, turn.error
        if failure is not None:
            self.bus.publish(events.CellHeld(error=str(failure), kind=type(failure).__name__))
            self._error = failure  # it is told: with the job, while that is still under way
        if verdict.how == "put aside":
            self._part_in = ""  # it may be another part, or sit wrong: a person is asked for it again
        last = self.last_words(turn.outcome, failure)
        name = entry.name if entry else ""
        told = {"job": name, "verdict": verdict.how, "reason": verdict.reason, "next": verdict.stops}
        outcome = "failed" if failure else "put aside" if verdict.how == "put aside" else turn.outcome.value
        notes = [*last["notes"], *([verdict.reason] if verdict.how == "put aside" else [])]
        await self._shift.end(verdict, {**last, **figures(self.job), **told, "outcome": outcome, "notes": notes})
        self.job = self._shift.job
        gc.collect()  # its passes froze their garbage: the maps and plans of hundreds of parts would stay
        return _after(verdict, name, turn)

    # orders

    async def _remove(self, job: str, reason: str = "", by: str = "") -> Mapping[str, Any]:
        """Take one out that waits, or put the one aside over which the cell is held."""
        entry = self._under_way()
        if entry is None or entry.name != job:
            return await self._desk.remove_waiting(job, reason, by)
        if self.state is not DaemonState.HELD or self._cell.unsafe:
            why = "a device is not confirmed to be safe" if self._cell.unsafe else f"the cell is {self.state}"
            raise DeviceRefused(f"{job!r} is under way, and {why}: hold the cell first (polishd hold)")
        aside = OperatorCommand(StateEvent.ENDED, " ".join(reason.split()))
        self.bus.publish(
            events.CommandReceived(order="job_remove", reason=": ".join(filter(None, (job, aside.reason))), by=by)
        )
        self._asides.put_nowait((entry, aside))
        async with self._changed:
            await self._changed.wait_for(lambda: not self._goes_on(entry) or self.state is not DaemonState.HELD)
        if self._goes_on(entry):
            raise DeviceRefused(f"{job!r} goes on: somebody was faster")
        return await self._desk.list()

    async def _asked_aside(self) -> OperatorCommand:
        while not self._goes_on((asked := await self._asides.get())[0]):
            pass
        return asked[1]

    def _under_way(self) -> QueueEntry | None:
        """The job that is under way, or being made ready."""
        return self._shift.entry or self._shift.queue.under_way()

    def _goes_on(self, entry: QueueEntry) -> bool:
        now = self._under_way()
        return now is not None and now.id == entry.id

    def _interrupted(self, order: OperatorCommand) -> StateResult:
        if order.verb is StateEvent.UNFIT:  # said while the last job's end was written, say
            return self._failed(order.error(order.reason))
        if order.verb is StateEvent.STOP:
            return StateResult(StateEvent.STOP, self._stopped_by(order))
        return StateResult(order.verb, self._held_by(order, ""))

    def _in_the_way(self) -> bool:
        """The robot may stand over the part, and a loader is to move there."""
        left = self.job.journal.cut_off() if "loader" in self._cell.used else None
        return left is not None and left != self._seen

    async def become(self, state: DaemonState, reason: str) -> None:
        """Whoever is to resume is told that a loader moves then."""
        if state is DaemonState.HELD and IN_THE_WAY not in reason and self._in_the_way():
            reason = f"{reason}; {IN_THE_WAY}"
        await super().become(state, reason)

    def _is_in(self, part: str, by: str) -> None:
        self._part_in = part
        self.bus.publish(events.PartChanged(part_id=part, by=by))

    def _to_change(self) -> str:
        """What a person reads while the part is changed."""
        entry = self._shift.entry
        if entry is None or (entry.part_id == self._part_in and "loader" not in self._cell.used):
            return ""
        who = "the loader puts" if "loader" in self._cell.used else "a person is to put"
        return f"{entry.name}: {who} part {entry.part_id!r} in"


def _between(turn: StateResult, trigger: StateEvent) -> StateResult:
    """Where one job would be polished, a queue is looked at."""
    return replace(turn, trigger=StateEvent.BETWEEN) if turn.trigger is trigger else turn


def _after(verdict: JobResult, name: str, turn: StateResult) -> StateResult:
    if not verdict.stops:
        return StateResult(StateEvent.ENDED)
    reason = f"the queue stopped: {verdict.stops}; {name} was {verdict.how}: {verdict.reason}"
    error = turn.error or (ToolStop(reason) if verdict.how == "accepted" else None)
    return replace(turn, trigger=StateEvent.STOPS, reason=reason, error=error)
