"""Make jobs and their run folders from a config and its plugins."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import chain, count
from pathlib import Path
from typing import Any

from polishd import __version__
from polishd.config.cell import CellConfig
from polishd.daemon.assembly import bind_part_to_devices, contact_limits, require_accepted_by_robot, require_time_limits
from polishd.daemon.cell.cell import Cell
from polishd.daemon.contact.stall_removal import require_stall_depth
from polishd.daemon.job.job import Job
from polishd.daemon.job.resume_checks import require_same, terms_of
from polishd.daemon.job.tool_sequence import ToolSequence, ToolStepState
from polishd.daemon.journal.journal import Journal
from polishd.daemon.queue.queue import Queue, QueueEntry
from polishd.daemon.queue.requests import require_unchanged
from polishd.daemon.runtime.compute import Compute
from polishd.model.errors import ConfigError, PolishdError
from polishd.model.estimates import Finding
from polishd.model.events import Event
from polishd.model.program import Program
from polishd.pipeline.acceptance import require_acceptable
from polishd.pipeline.build_recipe import make_recipes, require_commissioned
from polishd.pipeline.precheck import read_programs, require_fit
from polishd.pipeline.recipe import Recipe
from polishd.pipeline.run_folder import RunFolder
from polishd.plugin_loader import Hooks, hooks_of_job

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class NoJob:
    """State of a daemon between jobs: the journal of its cell."""

    journal: Journal
    findings: tuple[Finding, ...] = ()

    def names(self) -> dict[str, str]:
        """Return empty names of job and part."""
        return {"job": "", "part": ""}

    def cycles(self) -> list[dict[str, Any]]:
        """Return no cycles."""
        return []

    def summary(self) -> dict[str, Any]:
        """Return an empty summary."""
        return {"cycles": []}


def read_recipes(config: CellConfig, hooks: Hooks) -> tuple[Recipe, ...]:
    """Return the recipe of each tool in polishing order; ConfigError for several tools without [touch_off]."""
    if config.tools and config.touch_off is None:
        raise config.error(
            "tools",
            "several tools need [touch_off], which detects a wrong tool by its contact position. Add [touch_off]",
        )
    return make_recipes(config, hooks)


def turns_of(
    config: CellConfig, hooks: Hooks, recipes: Sequence[Recipe], programs: Sequence[Sequence[Program]]
) -> tuple[ToolStepState, ...]:
    """Return the step of each tool; with several tools it reads the files that their keys name."""
    formats = hooks.program_formats()
    return tuple(
        ToolStepState(
            recipe,
            tuple(each),
            contact_limits(own),
            terms_of(own, formats, *(program.sha256 for program in each)) if config.tools else None,
        )
        for own, recipe, each in zip(config.turns, recipes, programs, strict=True)
    )


def make_job(
    config: CellConfig,
    hooks: Hooks,
    recipes: Sequence[Recipe],
    programs: Sequence[Sequence[Program]],
    *,
    journal: Journal,
    folder: RunFolder,
    compute: Compute,
    publish: Callable[[Event], None],
) -> Job:
    """Make the job of that config; ``Job.load`` then restores the state of an earlier run.

    ``programs``: of each tool, in the order in which they take turns.
    """
    return Job(
        ToolSequence(turns_of(config, hooks, recipes, programs), journal),
        journal=journal,
        folder=folder,
        compute=compute,
        publish=publish,
        check_plan=hooks.check_plan,
        max_cycles=config.job.max_cycles,
        stream_ahead_s=config.job.stream_ahead_s,
    )


def figures(job: Job | NoJob) -> dict[str, Any]:
    """Return the measurements and passes for a summary; empty if the journal is lost."""
    try:
        found = job.summary()
    except PolishdError as lost:
        log.error("the journal cannot be read: %s", lost)
        return {"cycles": []}
    for cycle in found["cycles"]:
        if cycle["how"] == "begun":
            cycle["how"] = "interrupted"  # the pass has ended; the next start closes it in the journal
    return {**found, "version": __version__}


def run_folder(config: CellConfig, journal: Journal, job_text: str | None = None) -> RunFolder:
    """Return the folder of the job that goes on, or a new one; a job of the queue gets a copy of its file."""
    if journal.begun and journal.run_dir:
        path = config.resolve(journal.run_dir)
    else:
        several = config.state_dir / "runs" if config.run_dir is None or job_text is None else config.run_dir
        path = config.run_dir if config.run_dir and job_text is None else _new_folder(several, config.job.id)
        journal.record_run_dir(path)
    folder = RunFolder(path)
    try:
        folder.bytes("cell.toml", config.path.read_bytes())
        if job_text is not None:
            folder.bytes("job.toml", job_text.encode())
        if config.profile_path is not None:
            folder.bytes("instrument.toml", config.profile_path.read_bytes())
    except OSError as error:
        why = f"{folder.path}: the run folder cannot be written: {error.strerror}"
        if not journal.begun:
            raise ConfigError(f"{why}. Correct its permissions or name another folder") from error
        log.error("%s; the job goes on without it", why)
    return folder


def _new_folder(among: Path, job: str) -> Path:
    """Return a new folder named by job and time, which differs from all existing ones."""
    path = among / f"{job}-{datetime.now(UTC):%Y%m%dT%H%M%S}"
    others = (path.with_name(f"{path.name}-{number}") for number in count(2))
    return next(one for one in chain([path], others) if not one.exists())


# From an entry of the queue to a job on a cell that may be open.


@dataclass(frozen=True, slots=True)
class JobMaker:
    """Makes the jobs of one cell. Its devices stay, except those that depend on the part."""

    config: CellConfig
    hooks: Hooks
    cell: Cell
    compute: Compute

    async def __call__(
        self, entry: QueueEntry, queue: Queue, journal: Journal, publish: Callable[[Event], None]
    ) -> tuple[Job, RunFolder]:
        """Make the job and journal it as under way; restore the state of an earlier run that began it.

        PolishdError if anything in it is wrong; nothing has moved then. Numerical work runs in the compute worker and
        files are read in threads, because other cells of this process may be in contact.
        """
        lay = require_unchanged if entry.begun_s is None else _laid_over
        config = await asyncio.to_thread(lay, self.config, self.hooks, entry)
        hooks = await asyncio.to_thread(hooks_of_job, self.config, self.hooks, config)
        recipes = await asyncio.to_thread(read_recipes, config, hooks)
        require_commissioned(config, recipes[0].instrument)
        require_acceptable(recipes[0])
        programs = []
        for tool, recipe in zip(config.turns, recipes, strict=True):
            programs.append(await self.compute(read_programs, tool, recipe))
            for program in programs[-1]:
                await asyncio.to_thread(require_accepted_by_robot, tool, hooks, program)
                await self.compute(require_fit, tool, recipe, program)
            require_stall_depth(tool, self.cell, recipe)
        require_time_limits(config, self.cell)
        terms = await asyncio.to_thread(terms_of, config, hooks.program_formats(), *(one.sha256 for one in programs[0]))
        queue.require_held(entry)  # otherwise the shop could assign this job to another cell
        own = journal.of_job(entry.name, entry.part_id, terms, queue.begin_row(entry))
        require_same(config, terms, own)
        queue.begin(entry, own.number)
        await bind_part_to_devices(self.cell, config, hooks)
        folder = run_folder(config, own, entry.content)
        job = make_job(
            config, hooks, recipes, programs, journal=own, folder=folder, compute=self.compute, publish=publish
        )
        await job.load()
        return job, folder


def _laid_over(cell: CellConfig, hooks: Hooks, entry: QueueEntry) -> CellConfig:
    """Return the config of a job under way; ``require_same`` checks what may have changed since."""
    del hooks
    return entry.file.laid_over(cell)
