"""What the journal has of a job that is taken out of the queue, or cut off by a kill, while it is made ready."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from polishd.config.job_file import JobFile
from polishd.daemon import job_assembly
from polishd.daemon.journal.journal import Journal
from polishd.daemon.queue.queue import NewJob, Queue
from polishd.model.errors import ConfigError

CHECKS = (
    "require_commissioned",
    "require_acceptable",
    "require_stall_depth",
    "require_time_limits",
)


class Killed(BaseException):
    """The process ends here."""


async def test_one_that_is_given_back_while_its_program_is_read_is_no_job_of_this_cell(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its part may be another cell's by then: the shop would know of two cells that have begun it."""
    with Journal.of_cell(tmp_path) as journal:
        queue = queue_of(journal)
        with pytest.raises(ConfigError, match="'a' was removed from the queue"):
            await made(journal, queue, monkeypatch, lambda: queue.remove("a", "given back to the shop"))
        assert journal.store.read("SELECT count(*) FROM job") == [(0,)]


async def test_a_program_that_the_robot_does_not_take_begins_no_job(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A job that a shop gave, or another robot in the cell's file since the job was added."""

    def refused(*_: Any) -> None:
        raise ConfigError("the robot does not take it")

    with Journal.of_cell(tmp_path) as journal:
        queue = queue_of(journal)
        with pytest.raises(ConfigError, match="does not take it"):
            await made(journal, queue, monkeypatch, accepted=refused)
        assert journal.store.read("SELECT count(*) FROM job") == [(0,)]
        assert [one.name for one in queue.waiting()] == ["a"]


async def test_a_kill_leaves_no_job_in_the_journal_that_the_queue_has_not_begun(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A part that only waits may be given to another cell, and is one of this cell's jobs by then."""

    def killed(*_: Any) -> None:
        raise Killed

    monkeypatch.setattr(job_assembly, "require_same", killed)
    with Journal.of_cell(tmp_path) as journal, pytest.raises(Killed):
        await made(journal, queue_of(journal), monkeypatch)
    with Journal.of_cell(tmp_path) as journal:
        assert (begun := Queue(journal.store).under_way()) is not None
        assert [(begun.job, begun.name)] == journal.store.read("SELECT id, name FROM job")


def queue_of(journal: Journal) -> Queue:
    queue = Queue(journal.store)
    queue.add([NewJob("a", "P-a", JobFile(Path("/a.toml"), ""), {})])
    return queue


async def made(
    journal: Journal,
    queue: Queue,
    monkeypatch: pytest.MonkeyPatch,
    meanwhile: Callable[[], None] = lambda: None,
    accepted: Callable[..., None] = lambda *_: None,
) -> None:
    (entry,) = queue.to_do()
    config = SimpleNamespace(turns=(SimpleNamespace(),))

    async def compute(*_: Any) -> Any:
        return [SimpleNamespace(sha256="0")]

    def terms_of(*_: Any) -> dict[str, Any]:
        meanwhile()
        return {}

    for name in CHECKS:
        monkeypatch.setattr(job_assembly, name, lambda *_: None)
    monkeypatch.setattr(job_assembly, "require_accepted_by_robot", accepted)
    monkeypatch.setattr(job_assembly, "require_unchanged", lambda *_: config)
    monkeypatch.setattr(job_assembly, "hooks_of_job", lambda *_: SimpleNamespace(program_formats=dict))
    monkeypatch.setattr(job_assembly, "read_recipes", lambda *_: [SimpleNamespace(instrument=None)])
    monkeypatch.setattr(job_assembly, "terms_of", terms_of)
    odd: Any = compute
    make = job_assembly.JobMaker(config, None, None, odd)  # type: ignore[arg-type]
    await make(entry, queue, journal, lambda _: None)
