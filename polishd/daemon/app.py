"""The daemon: one cell, one job, and the person who may hold, resume or stop it.

States: ``starting``, ``polishing``, ``held`` (safe, waits for a person) and ``finished``. Hold, stop, SIGTERM and every
error leave contact in the same order (``safety.make_safe``). After an interruption nothing moves until ``resume``.
"""

from __future__ import annotations

import asyncio
import signal
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Any, Literal

from polishd.daemon.assembly import build_cell, contact_limits, make_recipe, require_commissioned
from polishd.daemon.cell import Cell
from polishd.daemon.compute import Compute
from polishd.daemon.config import CellConfig
from polishd.daemon.cycle import polish
from polishd.daemon.events import EventBus
from polishd.daemon.interruption import settle
from polishd.daemon.job import Job
from polishd.daemon.journal import Journal
from polishd.daemon.lock import StateLock
from polishd.daemon.log import logging_to
from polishd.daemon.plugins import Hooks
from polishd.daemon.run_folder import RunFolder
from polishd.daemon.safety import make_safe, most_telling
from polishd.daemon.service import serving
from polishd.daemon.steps import read_program
from polishd.model.cycle import Event, Outcome
from polishd.model.errors import PolishdError

Order = Literal["hold", "resume", "stop"]
State = Literal["starting", "polishing", "held", "finished"]


class Daemon:
    """Runs a job, and obeys orders at once."""

    def __init__(self, cell: Cell, job: Job, journal: Journal, bus: EventBus) -> None:
        self.job = job
        self.bus = bus
        self._cell = cell
        self._journal = journal
        self._orders: asyncio.Queue[Order] = asyncio.Queue()
        self._changed = asyncio.Condition()
        self.state: State = "starting"
        self.reason = ""

    @property
    def verbs(self) -> dict[str, Callable[[], Any]]:
        """What the socket offers."""
        return {
            "status": self.status,
            "hold": lambda: self._order("hold", "held", "finished"),
            "resume": lambda: self._order("resume", "polishing", "finished"),
            "stop": lambda: self._order("stop", "finished"),
        }

    async def status(self) -> Mapping[str, Any]:
        """State, why, and what was measured so far."""
        phases = self._journal.phases
        return {
            "state": self.state,
            "reason": self.reason,
            "phase": phases[-1].phase if phases else None,
            "cycle": phases[-1].cycle if phases else None,
            "cycles": self.job.cycles(),
            "unsafe": list(self._cell.unsafe),
        }

    def stop(self) -> None:
        """As SIGTERM does."""
        self._orders.put_nowait("stop")

    async def run(self) -> Outcome:
        """Until the job ends, or a person ends it. Raises what ended it otherwise; the cell is safe and closed then."""
        identities = await self._cell.open()
        self.bus.publish(Event("opened", None, {name: asdict(found) for name, found in identities.items()}))
        try:
            return await self._until_done()
        finally:
            await make_safe(self._cell)
            await self._cell.close()

    def finish(self, outcome: Outcome, folder: RunFolder, summary: Mapping[str, Any]) -> None:
        """Leave journal and summary in the run folder, and tell whoever reports."""
        if summary["outcome"] == outcome.value and outcome is not Outcome.STOPPED:
            self._journal.record_outcome(outcome)
        self._journal.copy_to(folder.path / "journal.sqlite")
        folder.json("summary.json", summary)
        self.bus.publish(Event("job_finished", None, {"run_dir": str(folder.path), "outcome": summary["outcome"]}))

    async def _until_done(self) -> Outcome:
        await make_safe(self._cell)
        held = await settle(self._cell, self._journal) or (
            "this job was begun earlier; resume starts with a new measurement" if self._journal.resumed else ""
        )
        while True:
            if held and not await self._wait_for_resume(held):
                return Outcome.STOPPED
            await self.become("polishing", "")
            outcome = await self._polish()
            if outcome is not None:
                return outcome
            held = await settle(self._cell, self._journal) or "held by order; resume starts with a new measurement"

    async def _polish(self) -> Outcome | None:
        """The outcome of the job, or None when it was held."""
        try:
            async with asyncio.TaskGroup() as group:
                work = group.create_task(polish(self._cell, self.job, self._journal), name="polish")
                order = group.create_task(self._interrupting(), name="orders")
                journal = group.create_task(self._journal.lost(), name="journal")
                await asyncio.wait({work, order, journal}, return_when=asyncio.FIRST_COMPLETED)
                for task in (work, order, journal):
                    task.cancel()
        except BaseExceptionGroup as errors:
            raise most_telling(errors) from errors
        if not work.cancelled():
            return work.result()
        return Outcome.STOPPED if order.result() == "stop" else None

    async def _interrupting(self) -> Order:
        """The next order that ends polishing."""
        while (order := await self._orders.get()) == "resume":
            pass
        return order

    async def _wait_for_resume(self, reason: str) -> bool:
        await make_safe(self._cell)
        await self.become("held", reason)
        while (order := await self._orders.get()) == "hold":
            pass
        return order == "resume"

    async def become(self, state: State, reason: str) -> None:
        """Change state; whoever waits for an order to be obeyed is told."""
        async with self._changed:
            self.state, self.reason = state, reason
            self._changed.notify_all()
        self.bus.publish(Event("state", None, {"state": state, "reason": reason}))

    async def _order(self, order: Order, *until: State) -> Mapping[str, Any]:
        """Give an order and answer when it is obeyed."""
        self._orders.put_nowait(order)
        async with self._changed:
            await self._changed.wait_for(lambda: self.state in until)
        return {"state": self.state, "reason": self.reason}


async def run_cell(config: CellConfig, hooks: Hooks, show: Callable[[Event], None] = lambda _: None) -> dict[str, Any]:
    """Run the daemon of a cell to the end of its job; the summary as it is written to the run folder.

    ``show`` is told each event, for a person who watches.

    Raises PolishdError for what ended it otherwise; the summary and the report are written then too.
    """
    recipe = make_recipe(config, hooks)
    require_commissioned(config, recipe)
    program = read_program(recipe, config.program_path)
    cell = build_cell(config, hooks)
    with StateLock(config.state_dir), logging_to(config.state_dir), _journal(config) as journal:
        folder = run_folder(config, journal)
        bus = EventBus(hooks.on_event, sinks=(journal.record_event, show))
        try:
            async with Compute() as compute:
                job = Job(
                    recipe,
                    program,
                    journal=journal,
                    folder=folder,
                    compute=compute,
                    publish=bus.publish,
                    check_plan=hooks.check_plan,
                    contact=contact_limits(config),
                    max_cycles=config.job.max_cycles,
                    lookahead_s=config.job.lookahead_s,
                )
                return await _serve(config, Daemon(cell, job, journal, bus), folder)
        finally:
            await bus.close()


async def _serve(config: CellConfig, daemon: Daemon, folder: RunFolder) -> dict[str, Any]:
    """Answer the socket and obey signals until the job ends; leave the cell safe, and a summary in the run folder."""
    started = datetime.now(UTC).isoformat(timespec="seconds")
    failure: PolishdError | None = None
    outcome = Outcome.STOPPED
    async with serving(config.state_dir, daemon.verbs, daemon.bus), _signals(daemon.stop):
        try:
            outcome = await daemon.run()
        except PolishdError as error:
            failure = error
            daemon.bus.publish(Event("failed", None, {"error": str(error), "kind": type(error).__name__}))
        summary = {
            "outcome": "failed" if failure else outcome.value,
            "job": config.job.id,
            **daemon.job.summary(),
            "run_dir": str(folder.path),
            "started": started,
            "ended": datetime.now(UTC).isoformat(timespec="seconds"),
            "notes": [f"{type(failure).__name__}: {failure}"] if failure else [],
        }
        daemon.finish(outcome, folder, summary)
        await daemon.become("finished", summary["outcome"])
    if failure is not None:
        raise failure
    return summary


def run_folder(config: CellConfig, journal: Journal) -> RunFolder:
    """The folder of the job that goes on, or a new one."""
    if journal.resumed and journal.history:
        path = config.resolve(str(journal.history[-1].stats["run_dir"]))
    else:
        stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%S")
        path = config.run_dir or config.state_dir / "runs" / f"{config.job.id}-{stamp}"
    folder = RunFolder(path)
    folder.create()
    folder.bytes("cell.toml", config.path.read_bytes())
    if config.profile_path is not None:
        folder.bytes("instrument.toml", config.profile_path.read_bytes())
    return folder


def _journal(config: CellConfig) -> Journal:
    return Journal(config.state_dir, job=config.job.id, part_id=config.part.id, config_sha256=config.sha256)


@asynccontextmanager
async def _signals(stop: Callable[[], None]) -> AsyncIterator[None]:
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, stop)
    try:
        yield
    finally:
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.remove_signal_handler(number)
