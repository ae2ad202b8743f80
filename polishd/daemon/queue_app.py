"""``polishd run --queue``: the daemon of one cell's queue, from the journal's word to its summary."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, suppress
from typing import Any

from polishd.config.cell import CellConfig
from polishd.daemon.cell import Cell
from polishd.daemon.compute import Compute
from polishd.daemon.courier import Notifier
from polishd.daemon.daemon import Daemon, run_until_finished
from polishd.daemon.desk import QueueRequests
from polishd.daemon.endings import record_exit, recording_exit, utc_now
from polishd.daemon.job_maker import JobMaker
from polishd.daemon.journal import Journal
from polishd.daemon.making import figures
from polishd.daemon.notifications import notifying
from polishd.daemon.queue_daemon import QueueDaemon
from polishd.daemon.service import serving
from polishd.daemon.shift import QueueRunner, resume_open_job
from polishd.daemon.states import DaemonState
from polishd.hooks.loader import Hooks
from polishd.model.concern import CellSafety
from polishd.model.cycle import Outcome
from polishd.model.errors import PolishdError
from polishd.model.events import Event, QueueStopped

log = logging.getLogger(__name__)

Telling = Callable[[Daemon], AbstractContextManager[None]]


async def run_queue(
    config: CellConfig,
    hooks: Hooks,
    cell: Cell,
    notifiers: Sequence[Notifier],
    journal: Journal,
    *,
    show: Callable[[Event], None],
    hears: Callable[[Event], None],
    telling: Telling,
    holds: bool,
    until_empty: bool,
) -> dict[str, Any]:
    """Work the queue; its summary. PolishdError where the job that is under way cannot go on: nothing was opened."""
    async with Compute() as compute:
        shift = QueueRunner(journal, JobMaker(config, hooks, cell, compute))
        keep = recording_exit(config.state_dir, lambda: shift.folder.path if shift.folder else None, queue=True)
        sinks, nothing = (shift.record, keep, hears), {"job": "", "part": "", "run_dir": ""}
        async with notifying(config, notifiers, nothing, (hooks.on_event, show), sinks) as bus:
            shift.bus = bus
            await resume_open_job(shift)
            desk = QueueRequests(config, shift.queue, shift.added, bus.publish)
            daemon = QueueDaemon(cell, shift, desk, bus, holds=holds, until_empty=until_empty)
            with telling(daemon):
                return await _serve_queue(config, daemon, shift)


async def _serve_queue(config: CellConfig, daemon: QueueDaemon, shift: QueueRunner) -> dict[str, Any]:
    """Answer the socket until the queue is left; the cell is safe then."""
    started = utc_now()
    async with serving(config.state_dir, daemon.handlers, daemon.bus):
        outcome, failure = await run_until_finished(daemon)
        last = _last_words(daemon, shift, outcome, failure)
        record_exit(config.state_dir, last)
        with suppress(PolishdError):  # of a lost journal, which has been told
            await _leave(daemon, shift, last, failed=failure is not None)
            await daemon.become(DaemonState.FINISHED, last["state"])
            daemon.job.journal.flush()
    outcome_word = last.pop("state")
    return {"outcome": outcome_word, "jobs": dict(shift.ended), "started": started, "ended": utc_now(), **last}


async def _leave(daemon: QueueDaemon, shift: QueueRunner, last: Mapping[str, Any], *, failed: bool) -> None:
    """A job that stays open has a summary and a report all the same; who ended the queue, or that it is empty, is told.

    Of a failure that was done already.
    """
    if shift.entry is not None:
        await shift.leave({**last, **figures(shift.job), "outcome": last["state"], "job": shift.entry.name})
    if not failed:
        jobs = ", ".join(f"{count} {how}" for how, count in shift.ended.items())
        outcome, reason, standing = str(last["state"]), str(last["reason"]), CellSafety.of(last)
        daemon.bus.publish(QueueStopped(outcome=outcome, reason=reason, jobs=jobs or "none", standing=standing))


def _last_words(daemon: QueueDaemon, shift: QueueRunner, outcome: Outcome, failure: Exception | None) -> dict[str, Any]:
    """As of one job; one that ended between jobs is no failure, unless a part was not accepted."""
    last: dict[str, Any] = daemon.last_words(outcome, failure)
    folder: Mapping[str, Any] = {"run_dir": str(shift.folder.path)} if shift.folder else {}
    stopped = outcome is Outcome.STOPPED
    if failure is None and shift.entry is None and (stopped or shift.first() is None):
        last |= {"next": GOES_ON if stopped else EMPTY, "exit_code": int(set(shift.ended) - {"accepted"} != set())}
        last |= {} if stopped else {"state": "empty"}
    return {**last, **folder}


EMPTY = "the queue is empty: polishd job add CELL.toml JOB.toml adds to it, polishd run CELL.toml --queue goes on"
GOES_ON = "no job was under way: polishd run CELL.toml --queue goes on with those that wait; held, if it was held"
