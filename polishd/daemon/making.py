"""From a recipe to a job that can be worked, with its run folder. Opens no device."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import chain, count
from pathlib import Path
from typing import Any

from polishd import __version__
from polishd.config.cell import CellConfig
from polishd.daemon.assembly import contact_limits
from polishd.daemon.compute import Compute
from polishd.daemon.job import Job
from polishd.daemon.journal import Journal
from polishd.daemon.same_job import terms_of
from polishd.daemon.turns import ToolSequence, ToolStepState
from polishd.hooks.loader import Hooks
from polishd.model.errors import ConfigError, PolishdError
from polishd.model.events import Event
from polishd.model.finding import Finding
from polishd.model.program import Program
from polishd.recipe.folder import RunFolder
from polishd.recipe.making import make_recipes
from polishd.recipe.recipe import Recipe

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class NoJob:
    """What a daemon has between jobs: the journal of its cell."""

    journal: Journal
    findings: tuple[Finding, ...] = ()

    def names(self) -> dict[str, str]:
        """Of job and part: there are none."""
        return {"job": "", "part": ""}

    def cycles(self) -> list[dict[str, Any]]:
        """Nothing was measured."""
        return []

    def summary(self) -> dict[str, Any]:
        """Nothing is known."""
        return {"cycles": []}


def read_recipes(config: CellConfig, hooks: Hooks) -> tuple[Recipe, ...]:
    """Of each tool, in the order in which they polish; ConfigError where nothing would prove that one is mounted."""
    if config.tools and config.touch_off is None:
        raise config.error(
            "tools", "a wrong tool is found by where it meets the part: several tools need [touch_off]; add it"
        )
    return make_recipes(config, hooks)


def turns_of(config: CellConfig, recipes: Sequence[Recipe], programs: Sequence[Program]) -> tuple[ToolStepState, ...]:
    """The turn of each tool. Reads the files that the keys of several name."""
    return tuple(
        ToolStepState(recipe, program, contact_limits(own), terms_of(own, program.sha256) if config.tools else None)
        for own, recipe, program in zip(config.turns, recipes, programs, strict=True)
    )


def make_job(
    config: CellConfig,
    hooks: Hooks,
    recipes: Sequence[Recipe],
    programs: Sequence[Program],
    *,
    journal: Journal,
    folder: RunFolder,
    compute: Compute,
    publish: Callable[[Event], None],
) -> Job:
    """The job of that config; ``Job.load`` takes up what an earlier run knew."""
    return Job(
        ToolSequence(turns_of(config, recipes, programs), journal),
        journal=journal,
        folder=folder,
        compute=compute,
        publish=publish,
        check_plan=hooks.check_plan,
        max_cycles=config.job.max_cycles,
        lookahead_s=config.job.lookahead_s,
    )


def figures(job: Job | NoJob) -> dict[str, Any]:
    """What was measured and done, for a summary; nothing where the journal is lost."""
    try:
        found = job.summary()
    except PolishdError as lost:
        log.error("the journal cannot be asked any more: %s", lost)
        return {"cycles": []}
    for cycle in found["cycles"]:
        if cycle["how"] == "begun":
            cycle["how"] = "interrupted"  # it is over now; the next start settles it in the journal
    return {**found, "version": __version__}


def run_folder(config: CellConfig, journal: Journal, job_text: str | None = None) -> RunFolder:
    """The folder of the job that goes on, or a new one; of a job of the queue one of its own, with its file's text."""
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
            raise ConfigError(f"{why}; mend it, or name another") from error
        log.error("%s; the job goes on without", why)
    return folder


def _new_folder(among: Path, job: str) -> Path:
    """Named by job and time; a clock that was set back leads to no folder of an earlier job."""
    path = among / f"{job}-{datetime.now(UTC):%Y%m%dT%H%M%S}"
    others = (path.with_name(f"{path.name}-{number}") for number in count(2))
    return next(one for one in chain([path], others) if not one.exists())
