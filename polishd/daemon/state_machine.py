"""The daemon of one cell: one job, and the person who may hold, resume or stop it.

It goes from state to state by the table in ``states``. Hold, stop, SIGTERM and every error leave contact in the same
order (``safety.make_safe``). After an interruption nothing moves until ``resume``. An error that a person can mend
holds, any other one ends the daemon (docs/cycle.md).
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Awaitable, Callable, Coroutine, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, cast

from polishd.daemon.assembly import NoJob
from polishd.daemon.cell.cell import Cell
from polishd.daemon.cell.device_polling import root_cause
from polishd.daemon.cell.readiness import monitoring_signals
from polishd.daemon.contact.interruption import settle_interrupted_pass
from polishd.daemon.contact.safety import make_safe
from polishd.daemon.cycle import polish
from polishd.daemon.health import Health, health_snapshot, status_snapshot
from polishd.daemon.job.job import Job
from polishd.daemon.job.part_handling import require_clear
from polishd.daemon.runtime.events import EventBus, causes, killed_safety, safety_of
from polishd.daemon.runtime.exit_record import next_action
from polishd.daemon.runtime.memory import named
from polishd.daemon.socket.server import Handler
from polishd.model import events
from polishd.model.devices import SignalLimits
from polishd.model.errors import DeviceFault, DeviceRefused, HostFault, PolishdError, SafetyStop, SignalFault
from polishd.model.states import (
    EXIT_CODES,
    ORDERS,
    CellSafety,
    DaemonState,
    Outcome,
    StateEvent,
    accepting_states,
    next_state,
)
from polishd.pipeline.run_folder import RunFolder

# What a person wants: orders that were given and are not taken yet, and work that they end.


@dataclass(slots=True)
class OperatorCommand:
    """One of ``states.ORDERS``, and why; or ``UNFIT``, which the computer or a signal gives."""

    verb: StateEvent
    reason: str = ""
    error: type[PolishdError] = HostFault
    """Of ``UNFIT``: what the cell is held over, or its daemon ends with."""
    refused: bool = False
    """It was tried, and the cell did not come to it."""
    taken: bool = False
    """It was tried, and the cell goes on by it: with a queue through states that nobody may see."""

    def worsen(self, reason: str, error: type[PolishdError]) -> None:
        """Of ``UNFIT``, also once it is taken: what nobody should go on from counts more than what can be mended."""
        if self.error.mendable and not error.mendable:
            self.error, self.reason = error, f"{reason}; {self.reason}"

    def said(self, word: str) -> str:
        """With the reason that was given."""
        return f"{word}: {self.reason}" if self.reason else word


class OperatorCommandQueue:
    """In the order in which they came."""

    def __init__(self) -> None:
        self._waiting: asyncio.Queue[OperatorCommand] = asyncio.Queue()

    def give(self, order: OperatorCommand) -> None:
        """It is taken as soon as what happens now can be ended."""
        self._waiting.put_nowait(order)

    async def next(self) -> OperatorCommand:
        """Any of a person's."""
        return await self._but(StateEvent.UNFIT)

    async def interrupting(self) -> OperatorCommand:
        """The next one that ends work: any but to go on."""
        return await self._but(StateEvent.RESUME)

    async def _but(self, passed: StateEvent) -> OperatorCommand:
        while (order := await self._waiting.get()).verb is passed:
            pass
        return order

    async def asked_to_stop(self) -> OperatorCommand:
        """While the cell is opened. All orders stay where they are: should it be open just now, they come next."""
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
    """The order that ended the work, or None where the work, the first of them, came to its end.

    An order that comes just then, or over which the work fails, is given to ``late``: it is for whatever comes next.
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


log = logging.getLogger(__name__)

ORDERED, STOPPED, BEGUN = "held by order", "stopped by order", "this job was begun earlier"
EMERGENCY = "motion was stopped at once, by order"


@dataclass(frozen=True, slots=True)
class StateResult:
    """What ended a state's work, and what is known of it."""

    trigger: StateEvent
    reason: str = ""
    outcome: Outcome = Outcome.STOPPED
    error: Exception | None = None


class Daemon:
    """Runs a job on a cell that it opens and closes, and obeys orders at once."""

    def __init__(self, cell: Cell, job: Job | NoJob, bus: EventBus, *, holds: bool = True) -> None:
        self.job = job
        """The one under way, with the journal that knows it."""
        self.bus = bus
        self._cell = cell
        cell.on_broken = partial(_tell_broken, bus)
        self._of_queue = False  # what a person is told to run depends on it
        self._holds = holds
        """Wait for a person where one can mend the cause; else end with it."""
        self._error: Exception | None = None  # what it is held over
        self._orders = OperatorCommandQueue()
        self._unfit: OperatorCommand | None = None  # given over the computer or a signal, since polishing began
        self._changed = asyncio.Condition()
        self._does: Mapping[DaemonState, Callable[[], Awaitable[StateResult]]] = {
            DaemonState.STARTING: self._start,
            DaemonState.POLISHING: self._polish,
            DaemonState.HELD: self._wait,
        }
        self._health = Health(cell, lambda: self.job)
        self.state, self.reason = DaemonState.STARTING, ""

    @property
    def handlers(self) -> dict[str, Handler]:
        """Who obeys the verbs of the socket."""
        found = status_snapshot(self._cell, self._health, self.bus, self._now)
        return {"status": self.status, **found, **{verb.value: partial(self._order, verb) for verb in ORDERS}}

    async def status(self) -> Mapping[str, Any]:
        """State, why, and what was measured so far."""
        return {
            **self._now(),
            "cycles": self.job.cycles(),
            **health_snapshot(self._cell, self._health),
            "tasks": len(asyncio.all_tasks()),
            "devices": {name: self._health.device(name) for name in self._cell.devices},
        }

    def _now(self) -> dict[str, Any]:
        state = {"state": self.state, "reason": self.reason, "next": next_action(self.state, queue=self._of_queue)}
        return state | self.job.names() | dict(zip(("cycle", "phase"), self.job.journal.phase_now, strict=True))

    def stop(self) -> None:
        """As SIGTERM does."""
        self._orders.give(OperatorCommand(StateEvent.STOP))

    async def run(self) -> Outcome:
        """From state to state until the job ends, or a person ends it; the cell is safe and closed then.

        Raises what ended it otherwise.
        """
        try:
            async with self._health.watching(self._endangered), monitoring_signals(self._cell, self._wrong):
                outcome = await self._until_finished()
        except BaseException as error:
            try:
                await self._leave()
            except (PolishdError, OSError) as late:
                error.add_note(f"and then: {late}")  # what ended it is told first
            raise
        await self._leave()
        return outcome

    async def _until_finished(self) -> Outcome:
        while True:
            try:
                turn = await self._does[self.state]()
            except Exception as error:  # noqa: BLE001 - it is raised below, or a person is asked to mend it
                turn = self._failed(error)
            state = next_state(self.state, turn.trigger, unattended=not self._holds)
            if state is DaemonState.FINISHED:
                if turn.error is not None:
                    raise turn.error
                self.reason = turn.reason or self.reason
                return turn.outcome
            if turn.error is not None and turn.error is not self._error:
                self.bus.publish(events.CellHeld(error=str(turn.error), kind=type(turn.error).__name__))
            self._error = turn.error
            await self.become(state, turn.reason)

    async def _leave(self) -> None:
        if self._cell.identities:
            await make_safe(self._cell)
            await self._cell.close()

    def _standing(self, state: str, reason: str, *, killed: bool = False) -> events.StateChanged:
        """By what the devices confirmed; or as it is to be told should the daemon be killed meanwhile."""
        unsafe = killed_safety(self._cell.acting) if killed else self._cell.unsafe if self._cell.identities else None
        return safety_of(state, reason, unsafe, queue=self._of_queue)

    async def finish(self, outcome: Outcome, folder: RunFolder, summary: Mapping[str, Any]) -> None:
        """Leave journal and summary in the run folder, and tell whoever reports."""
        try:
            if summary["outcome"] == outcome.value and outcome is not Outcome.STOPPED:
                self.job.journal.record_outcome(outcome)
            folder.json("summary.json", summary)
            copy = self.job.journal.copy_to
            await asyncio.to_thread(copy, folder.path / "journal.sqlite")  # others may be in contact
        finally:
            self.bus.publish(
                events.RunFolderCompleted(
                    run_dir=str(folder.path),
                    outcome=summary["outcome"],
                    reason=summary["reason"],
                    standing=CellSafety.of(summary),
                )
            )

    def failure(self, error: Exception) -> events.DaemonFailed:
        """It ends the daemon, which leaves the cell as it stands now."""
        kind = type(error).__name__
        return events.DaemonFailed(error=str(error), kind=kind, standing=self._standing("failed", "").standing)

    def last_words(self, outcome: Outcome, failure: Exception | None) -> dict[str, Any]:
        """The end as ``status`` tells it when no daemon runs: how, why, how the cell stands, and what to do."""
        found = causes(self.job.journal, failure)
        reason = f"{type(failure).__name__}: {failure}" if failure else self.reason
        return {
            **self._standing("failed" if failure else outcome.value, reason).data,
            "exit_code": getattr(failure, "exit_code", 1) if failure else EXIT_CODES[outcome],
            "causes": [asdict(cause) for cause in found],
            "notes": [str(cause) for cause in found],
        }

    # what happens in each state

    async def _start(self) -> StateResult:
        stop = await run_unless_commanded(self._orders.asked_to_stop(), self._cell.open(self._busy))
        if stop is not None:
            return StateResult(StateEvent.STOP, self._stopped_by(stop))
        self.bus.publish(events.CellOpened(devices=self._cell.identities))
        if (found := await self._made_safe()) is not None:
            return found
        return StateResult(StateEvent.INTERRUPTED, BEGUN) if self.job.journal.resumed else StateResult(StateEvent.READY)

    async def _busy(self, what: str) -> None:
        await self.become(next_state(self.state, StateEvent.BUSY), what)

    async def _polish(self) -> StateResult:
        self._cell.emergency, self._unfit = False, None
        job, journal = cast(Job, self.job), self.job.journal  # between jobs nobody polishes
        done: list[Outcome] = []

        async def work() -> None:
            done.append(await polish(self._cell, job, journal))

        try:
            order = await run_unless_commanded(
                self._orders.interrupting(), work(), journal.lost(), late=self._orders.give
            )
        except PolishdError as error:
            turn = self._failed(error)
            if turn.trigger is StateEvent.MENDABLE:
                await make_safe(self._cell)
            return turn
        if order is None:
            return StateResult(StateEvent.DONE, outcome=done[0])
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

    async def _wait(self) -> StateResult:
        """Until an order changes something, or is refused."""
        order = cast(OperatorCommand, await run_unless_commanded(self._orders.next(), self._cell.listen()))
        if order.verb is StateEvent.STOP:
            return StateResult(order.verb, self._stopped_by(order), error=self._error)
        if order.verb is not StateEvent.RESUME:
            said = f"{self.reason}; {order.said(ORDERED)}" if order.reason else self.reason
            return StateResult(order.verb, said, error=self._error)
        try:
            if (
                stop := await run_unless_commanded(self._orders.asked_to_stop(), self._cell.restore_links())
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
        """None where every device confirmed, and no pass was left open; nothing is measured or moved before."""
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
        """A person is asked to mend what can be while the daemon waits; not where it cut off a pass."""
        error = named(error)
        waits = isinstance(error, PolishdError) and error.mendable and bool(self._cell.identities)
        if self.state is DaemonState.POLISHING:
            waits = waits and all(record.ended_s is not None for record in self.job.journal.passes)
        return StateResult(mended if waits else StateEvent.ERROR, f"{type(error).__name__}: {error}", error=error)

    # orders

    def _endangered(self, what: str, error: type[PolishdError] = HostFault) -> None:
        """Contact is left while it still can be; what nobody should go on from counts more, also if it comes later."""
        if self.state is DaemonState.POLISHING and self._unfit is None:
            self._unfit = OperatorCommand(StateEvent.UNFIT, what, error)
            self._orders.give(self._unfit)
        elif self.state is DaemonState.POLISHING and self._unfit is not None:
            self._unfit.worsen(what, error)

    def _wrong(self, limits: SignalLimits, what: str) -> None:
        """A signal is not as it must be in contact: what follows is what its limits say."""
        self.bus.publish(events.SignalOutOfRange(signal=limits.name, what=what, action=limits.action))
        if limits.action != "notify":
            self._endangered(what, SafetyStop if limits.action == "lift" else SignalFault)

    def _held_by(self, order: OperatorCommand, settled: str) -> str:
        """The order, where it says more than what it interrupted."""
        said = [EMERGENCY] if self._cell.emergency else []
        said += [order.said(ORDERED)] if order.reason or not settled else []
        return "; ".join([*said, settled] if settled else said)

    def _stopped_by(self, order: OperatorCommand) -> str:
        """What was said with the order to stop is told at the end."""
        return f"{order.said(STOPPED)}; {self.reason}".removesuffix("; ") if order.reason else self.reason

    async def become(self, state: DaemonState, reason: str) -> None:
        """Change state; whoever waits for an order to be obeyed, or refused, is told."""
        async with self._changed:
            self.state, self.reason = state, reason
            self._changed.notify_all()
        self.bus.publish(self._standing(state, reason, killed=state not in {DaemonState.HELD, DaemonState.FINISHED}))

    async def _order(self, verb: StateEvent, reason: str = "", by: str = "") -> Mapping[str, Any]:
        """Give an order and answer when it is obeyed; DeviceRefused with the reason why the cell stays held."""
        order = OperatorCommand(verb, " ".join(reason.split()))
        self._cell.emergency = self._cell.emergency or verb is StateEvent.ESTOP
        self._orders.give(order)
        with suppress(PolishdError):  # a lost journal: polishing ends over it, and the order is obeyed all the same
            self.bus.publish(events.CommandReceived(order=verb, reason=order.reason, by=by))
        async with self._changed:
            await self._changed.wait_for(lambda: order.refused or order.taken or self.state in accepting_states(verb))
        if order.refused and self.state is DaemonState.HELD:
            raise DeviceRefused(f"{verb} is refused, the cell stays held: {self.reason}")
        return {"state": self.state, "reason": self.reason, "next": next_action(self.state, queue=self._of_queue)}


def _tell_broken(bus: EventBus, error: BaseException) -> None:
    """At once: until every device has confirmed, or is given up, seconds pass."""
    with suppress(PolishdError):  # a lost journal: polishing ends over it
        bus.publish(events.ContactAborted(error=str(error), kind=type(error).__name__))


async def run_until_finished(daemon: Daemon) -> tuple[Outcome, Exception | None]:
    """Run it; what ended it otherwise than by its outcome is logged and told, and not raised."""
    try:
        await daemon.become(DaemonState.STARTING, "")
        return await daemon.run(), None
    except Exception as raised:
        error = named(raised)
        log.exception("the daemon ends")
        with suppress(PolishdError):  # a lost journal: that is what ended it
            daemon.bus.publish(daemon.failure(error))
        return Outcome.STOPPED, error
