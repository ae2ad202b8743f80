"""From a recipe to a job that can be worked, with its run folder. Opens no device."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from polishd.config.cell import CellConfig
from polishd.daemon.assembly import contact_limits
from polishd.daemon.compute import Compute
from polishd.daemon.job import Job
from polishd.daemon.journal import Journal
from polishd.hooks.loader import Hooks
from polishd.model.events import Event
from polishd.model.program import Program
from polishd.recipe.folder import RunFolder
from polishd.recipe.recipe import Recipe


@dataclass(frozen=True, slots=True)
class NoJob:
    """What a daemon has between jobs: the journal of its cell."""

    journal: Journal

    def names(self) -> dict[str, str]:
        """Of job and part: there are none."""
        return {"job": "", "part": ""}

    def cycles(self) -> list[dict[str, Any]]:
        """Nothing was measured."""
        return []

    def summary(self) -> dict[str, Any]:
        """Nothing is known."""
        return {"cycles": []}


def make_job(
    config: CellConfig,
    hooks: Hooks,
    recipe: Recipe,
    program: Program,
    *,
    journal: Journal,
    folder: RunFolder,
    compute: Compute,
    publish: Callable[[Event], None],
) -> Job:
    """The job of that config; ``Job.load`` takes up what an earlier run knew."""
    return Job(
        recipe,
        program,
        journal=journal,
        folder=folder,
        compute=compute,
        publish=publish,
        check_plan=hooks.check_plan,
        contact=contact_limits(config),
        max_cycles=config.job.max_cycles,
        lookahead_s=config.job.lookahead_s,
    )


def run_folder(config: CellConfig, journal: Journal, job_text: str | None = None) -> RunFolder:
    """The folder of the job that goes on, or a new one; of a job of the queue one of its own, with its file's text."""
    if journal.begun and journal.run_dir:
        path = config.resolve(journal.run_dir)
    else:
        name = f"{config.job.id}-{datetime.now(UTC):%Y%m%dT%H%M%S}"
        if job_text is None:
            path = config.run_dir or config.state_dir / "runs" / name
        else:
            path = (config.run_dir or config.state_dir / "runs") / name
        journal.record_run_dir(path)
    folder = RunFolder(path)
    folder.bytes("cell.toml", config.path.read_bytes())
    if job_text is not None:
        folder.bytes("job.toml", job_text.encode())
    if config.profile_path is not None:
        folder.bytes("instrument.toml", config.profile_path.read_bytes())
    return folder
