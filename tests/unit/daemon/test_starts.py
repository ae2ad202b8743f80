"""Disks and clocks that are not as they were: one clear line, nothing moved, nothing lost."""

from __future__ import annotations

import errno
import os
import shutil
import sqlite3
import time
from itertools import cycle
from pathlib import Path
from typing import Any

import pytest

from polishd.daemon import app
from polishd.daemon.journal.journal import Journal
from polishd.daemon.runtime.exit_record import locked
from polishd.model.errors import ConfigError
from polishd.model.states import Outcome
from tests.unit.daemon.small_job import Bench, open_journal, run_cell
from tests.unit.daemon.test_app import Running, Site
from tests.unit.daemon.test_restart import Rerun, resumed, stopped_after_a_pass

YEAR_S = 365.25 * 86400


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Rerun:
    return Rerun(tmp_path, monkeypatch)


def moved_nothing(site: Site) -> bool:
    return site.bench is None or site.bench.fake.events == []


def test_a_lock_that_has_no_room_for_its_pid(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "pwrite", full)
    with pytest.raises(ConfigError, match=r"the state folder cannot be used: No space left on device\. Repair it, or"):
        locked(tmp_path).__enter__()
    monkeypatch.undo()
    with locked(tmp_path):
        pass


async def test_a_log_that_cannot_be_written(site: Rerun) -> None:
    (site.config.state_dir / "polishd.log").mkdir(parents=True)
    with pytest.raises(ConfigError, match=r"polishd\.log: the state folder cannot be used: Is a directory"):
        await run_cell(site.config, site.hooks)
    assert moved_nothing(site)


async def test_a_run_folder_that_cannot_be_written_refuses_a_new_job(site: Rerun) -> None:
    site.config.run_dir.write_text("a file")
    with pytest.raises(ConfigError, match=r"the run folder cannot be written: .*\. Correct its permissions"):
        await run_cell(site.config, site.hooks)
    assert moved_nothing(site)


@pytest.mark.full
async def test_a_run_folder_that_cannot_be_written_does_not_end_a_job_that_was_begun(site: Rerun) -> None:
    folder = site.config.run_dir
    await stopped_after_a_pass(site)
    shutil.rmtree(folder)
    folder.write_text("a file")
    summary = await resumed(site)
    assert summary["outcome"] == "in_tolerance", "what people cannot be left does not end a job"
    assert any("is not complete" in note for note in summary["notes"])


@pytest.mark.parametrize(
    ("code", "advice"),
    [("SQLITE_FULL", "Leave the file"), ("SQLITE_IOERR_WRITE", "Leave the file"), ("SQLITE_CORRUPT", "Move the file")],
)
def test_a_journal_is_moved_aside_only_where_it_is_none(tmp_path: Path, code: str, advice: str) -> None:
    class Broken:
        def create_function(self, *_: object, **__: object) -> None:
            """Taken, and not used."""

        def execute(self, *_: object) -> Any:
            error = sqlite3.OperationalError("what sqlite says")
            error.sqlite_errorname = code
            raise error

        def close(self) -> None:
            pass

    with pytest.raises(ConfigError, match=f"the journal cannot be used: what sqlite says. {advice}"):
        Journal.open(tmp_path, job="small", part_id="P-1", connect=lambda _: Broken())  # type: ignore[arg-type,return-value]


@pytest.mark.full
async def test_a_clock_that_jumps_by_a_year_while_it_runs_changes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    jumps, true_s = cycle([0.0, YEAR_S, -YEAR_S]), time.time
    monkeypatch.setattr(time, "time", lambda: true_s() + next(jumps))
    with open_journal(tmp_path) as journal:
        bench = Bench(tmp_path, journal)
        async with Running(bench) as running:
            await running.in_contact()
            await running.daemon.handlers["hold"]()
            await running.daemon.handlers["resume"]()
            assert await running.outcome() is Outcome.IN_TOLERANCE
        assert journal.passes[0].how == "interrupted"


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize("years", [-1.0, 1.0])
async def test_a_clock_that_jumped_between_two_runs_changes_nothing(
    site: Rerun, monkeypatch: pytest.MonkeyPatch, years: float
) -> None:
    await stopped_after_a_pass(site)
    true_s = time.time
    monkeypatch.setattr(time, "time", lambda: true_s() + years * YEAR_S)
    assert (await resumed(site))["outcome"] == "in_tolerance"
    assert site.learned()[0][0] == 1, "the pass before the jump was learned from"


def test_two_jobs_of_one_second_have_two_folders(site: Rerun) -> None:
    site.config.run_dir = None
    site.config.state_dir.mkdir()
    with Journal.open(site.config.state_dir, job="small", part_id="P-1") as journal:
        first, second = (app.run_folder(site.config, journal).path for _ in range(2))
    assert first != second
    assert second.parent == first.parent
