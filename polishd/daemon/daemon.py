"""The daemon of one cell: one job, and the person who may hold, resume or stop it.

States: ``starting``, ``polishing``, ``held`` (safe, waits for a person) and ``finished``. Hold, stop, SIGTERM and every
error leave contact in the same order (``safety.make_safe``). After an interruption nothing moves until ``resume``. An
error that a person can mend holds, any other one ends the daemon (docs/cycle.md).
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, Literal

from polishd.daemon.cell import Cell
from polishd.daemon.cycle import polish
from polishd.daemon.endings import NEXT, causes, gone, standing
from polishd.daemon.events import EventBus
from polishd.daemon.interruption import settle
from polishd.daemon.job import Job
from polishd.daemon.journal import Journal
from polishd.daemon.safety import make_safe, most_telling
from polishd.daemon.service import Handler
from polishd.model import events
from polishd.model.concern import Standing
from polishd.model.cycle import EXIT_CODES, Outcome
from polishd.model.errors import PolishdError
from polishd.recipe.folder import RunFolder

log = logging.getLogger(__name__)

State = Literal["starting", "polishing", "held", "finished"]
ORDERS: Mapping[str, tuple[State, ...]] = {
    "hold": ("held", "finished"),
    "resume": ("polishing", "finished"),
    "stop": ("finished",),
    "estop": ("held", "finished"),
}
"""Verbs that change something, and the states in which they are obeyed."""
ORDERED, STOPPED, BEGUN = "held by order", "stopped by order", "this job was begun earlier"
EMERGENCY = "motion was stopped at once, by order"


@dataclass(frozen=True, slots=True)
class Order:
    """What somebody wants."""

    verb: str
    reason: str = ""

    def said(self, word: str) -> str:
        """With the reason that was given."""
        return f"{word}: {self.reason}" if self.reason else word


class Daemon:
    """Runs a job, and obeys orders at once."""

    def __init__(self, cell: Cell, job: Job, journal: Journal, bus: EventBus, *, holds: bool = True) -> None:
        self.job = job
        self.bus = bus
        self._cell = cell
        self._journal = journal
        self._holds = holds
        """Wait for a person where one can mend the cause; else end with it."""
        self._last = Order("resume")
        """The last order: one that came with an error is not forgotten over it."""
        self._orders: asyncio.Queue[Order] = asyncio.Queue()
        self._changed = asyncio.Condition()
        self.state: State = "starting"
        self.reason = ""

    @property
    def handlers(self) -> dict[str, Handler]:
        """Who obeys the verbs of the socket."""
        return {"status": self.status, **{verb: partial(self._order, verb) for verb in ORDERS}}

    async def status(self) -> Mapping[str, Any]:
        """State, why, and what was measured so far."""
        cycle, phase = self._journal.phase_now
        return {
            "state": self.state,
            "reason": self.reason,
            "next": NEXT.get(self.state, ""),
            "phase": phase,
            "cycle": cycle,
            "cycles": self.job.cycles(),
            "unsafe": list(self._cell.unsafe),
            "devices": {name: self._told(name) for name in self._cell.devices},
        }

    def _told(self, name: str) -> dict[str, Any]:
        """Who it said it is, and whether the job uses it."""
        found = self._cell.identities.get(name)
        return {**(asdict(found) if found else {}), "used": name in self._cell.used.values()}

    def stop(self) -> None:
        """As SIGTERM does."""
        self._orders.put_nowait(Order("stop"))

    async def run(self) -> Outcome:
        """Until the job ends, or a person ends it. Raises what ended it otherwise; the cell is safe and closed then."""
        await self._cell.open()
        self.bus.publish(events.Opened(devices=self._cell.identities))
        try:
            outcome = await self._until_done()
        except BaseException as error:
            try:
                await self._leave()
            except (PolishdError, OSError) as late:
                error.add_note(f"and then: {late}")  # what ended it is told first
            raise
        await self._leave()
        return outcome

    async def _leave(self) -> None:
        await make_safe(self._cell)
        await self._cell.close()

    def _standing(self, state: str, reason: str) -> events.StateChanged:
        """By what the devices confirmed."""
        return standing(state, reason, self._cell.unsafe if self._cell.identities else None)

    async def finish(self, outcome: Outcome, folder: RunFolder, summary: Mapping[str, Any]) -> None:
        """Leave journal and summary in the run folder, and tell whoever reports."""
        try:
            if summary["outcome"] == outcome.value and outcome is not Outcome.STOPPED:
                self._journal.record_outcome(outcome)
            folder.json("summary.json", summary)
            await asyncio.to_thread(self._journal.copy_to, folder.path / "journal.sqlite")  # others may be in contact
        finally:
            self.bus.publish(
                events.JobFinished(
                    run_dir=str(folder.path),
                    outcome=summary["outcome"],
                    reason=summary["reason"],
                    standing=Standing.of(summary),
                )
            )

    def failure(self, error: Exception) -> events.Failed:
        """It ends the daemon, which leaves the cell as it stands now."""
        kind = type(error).__name__
        return events.Failed(error=str(error), kind=kind, standing=self._standing("failed", "").standing)

    def flush(self) -> None:
        """Make durable what the journal still buffers."""
        self._journal.flush()

    def last_words(self, outcome: Outcome, failure: Exception | None) -> dict[str, Any]:
        """The end as ``status`` tells it when no daemon runs: how, why, how the cell stands, and what to do."""
        found = causes(self._journal, failure)
        reason = f"{type(failure).__name__}: {failure}" if failure else self.reason
        return {
            **self._standing("failed" if failure else outcome.value, reason).data,
            "exit_code": getattr(failure, "exit_code", 1) if failure else EXIT_CODES[outcome],
            "causes": [asdict(cause) for cause in found],
            "notes": [str(cause) for cause in found],
        }

    def figures(self) -> dict[str, Any]:
        """What was measured and done, for the summary; nothing where the journal is lost."""
        try:
            found = self.job.summary()
        except PolishdError as lost:
            log.error("the journal cannot be asked any more: %s", lost)
            return {"cycles": []}
        for cycle in found["cycles"]:
            if cycle["how"] == "begun":
                cycle["how"] = "interrupted"  # it is over now; the next start settles it in the journal
        return found

    async def _until_done(self) -> Outcome:
        await make_safe(self._cell)
        held = await settle(self._cell, self._journal) or (BEGUN if self._journal.resumed else "")
        if held and not self._holds:
            self.reason = held
            return Outcome.STOPPED
        error: PolishdError | None = None
        while True:
            if held and not await self._wait_for_resume(held):
                if error is not None:
                    raise error  # nobody has mended it
                return Outcome.STOPPED
            self._cell.emergency = False
            await self.become("polishing", "")
            try:
                outcome = await self._polish(mended=error is not None)
            except PolishdError as failure:
                if not self._can_wait_for(failure):
                    raise
                error, held = failure, self._held_over(failure)
                continue
            if outcome is not None:
                return outcome
            error, held = None, self._held_by(self._last, await settle(self._cell, self._journal))

    def _can_wait_for(self, failure: PolishdError) -> bool:
        """Whether a person can mend it while the daemon waits; not where it cut off a pass."""
        return self._holds and failure.mendable and all(record.ended_s is not None for record in self._journal.passes)

    def _held_over(self, failure: PolishdError) -> str:
        kind = type(failure).__name__
        self.bus.publish(events.Held(error=str(failure), kind=kind))
        return f"{kind}: {failure}"

    def _held_by(self, order: Order, settled: str) -> str:
        """The order, where it says more than what it interrupted."""
        said = [EMERGENCY] if self._cell.emergency else []
        said += [order.said(ORDERED)] if order.reason or not settled else []
        return "; ".join([*said, settled] if settled else said)

    async def _polish(self, *, mended: bool) -> Outcome | None:
        """The outcome of the job, or None when it was held."""
        try:
            async with asyncio.TaskGroup() as group:
                work = group.create_task(self._work(mended=mended), name="polish")
                order = group.create_task(self._interrupting(), name="orders")
                journal = group.create_task(self._journal.lost(), name="journal")
                await asyncio.wait({work, order, journal}, return_when=asyncio.FIRST_COMPLETED)
                for task in (work, order, journal):
                    task.cancel()
        except BaseExceptionGroup as errors:
            raise most_telling(errors) from errors
        if not work.cancelled():
            return work.result()
        return Outcome.STOPPED if order.result().verb == "stop" else None

    async def _work(self, *, mended: bool) -> Outcome:
        if mended:  # out of contact: what was lost meanwhile is opened again before anybody measures
            await self._cell.restore_links()
            await make_safe(self._cell)
        return await polish(self._cell, self.job, self._journal)

    async def _interrupting(self) -> Order:
        """The next order that ends polishing."""
        while (order := await self._orders.get()).verb == "resume":
            pass
        self._last = order
        self._stopped_by(order)
        return order

    async def _wait_for_resume(self, reason: str) -> bool:
        await make_safe(self._cell)
        if self._last.verb == "stop":
            return False
        await self.become("held", reason)
        while (order := await self._orders.get()).verb in {"hold", "estop"}:
            if order.reason:
                await self.become("held", f"{self.reason}; {order.said(ORDERED)}")
        self._stopped_by(order)
        return order.verb == "resume"

    def _stopped_by(self, order: Order) -> None:
        """What was said with the order to stop is told at the end."""
        if order.verb == "stop" and order.reason:
            self.reason = f"{order.said(STOPPED)}; {self.reason}".removesuffix("; ")

    async def become(self, state: State, reason: str) -> None:
        """Change state; whoever waits for an order to be obeyed is told."""
        async with self._changed:
            self.state, self.reason = state, reason
            self._changed.notify_all()
        known = state in {"held", "finished"}  # meanwhile it may be killed
        self.bus.publish(self._standing(state, reason) if known else standing(state, reason, gone(self._cell.acting)))

    async def _order(self, verb: str, reason: str = "") -> Mapping[str, Any]:
        """Give an order and answer when it is obeyed."""
        order = Order(verb, " ".join(reason.split()))
        self._cell.emergency = self._cell.emergency or verb == "estop"
        self._orders.put_nowait(order)
        with suppress(PolishdError):  # a lost journal: polishing ends over it, and the order is obeyed all the same
            self.bus.publish(events.Ordered(order=verb, reason=order.reason))
        async with self._changed:
            await self._changed.wait_for(lambda: self.state in ORDERS[verb])
        return {"state": self.state, "reason": self.reason, "next": NEXT.get(self.state, "")}
