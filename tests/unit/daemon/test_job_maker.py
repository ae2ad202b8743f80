"""A job that is taken out of the queue while it is made ready leaves nothing in the journal."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from polishd.config.job_file import JobFile
from polishd.daemon import job_maker
from polishd.daemon.journal import Journal
from polishd.daemon.queue import NewJob, Queue
from polishd.model.errors import ConfigError

CHECKS = ("require_commissioned", "require_acceptable", "require_shallow", "require_time_limits")


async def test_one_that_is_given_back_while_its_program_is_read_is_no_job_of_this_cell(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its part may be another cell's by then: the shop would know of two cells that have begun it."""
    with Journal.of_cell(tmp_path) as journal:
        await given_back_meanwhile(journal, monkeypatch)


async def given_back_meanwhile(journal: Journal, monkeypatch: pytest.MonkeyPatch) -> None:
    queue = Queue(journal.store)
    queue.add([NewJob("a", "P-a", JobFile(Path("/a.toml"), ""), {})])
    (entry,) = queue.to_do()
    config = SimpleNamespace(turns=(SimpleNamespace(program_path=Path("/a.rnc")),))

    async def compute(*_: Any) -> Any:
        return SimpleNamespace(sha256="0")

    def terms_of(*_: Any) -> dict[str, Any]:
        queue.remove("a", "given back to the shop, where it was released")
        return {}

    for name in CHECKS:
        monkeypatch.setattr(job_maker, name, lambda *_: None)
    monkeypatch.setattr(job_maker, "require_unchanged", lambda *_: config)
    monkeypatch.setattr(job_maker, "hooks_of_job", lambda *_: None)
    monkeypatch.setattr(job_maker, "read_recipes", lambda *_: [SimpleNamespace(instrument=None)])
    monkeypatch.setattr(job_maker, "terms_of", terms_of)
    odd: Any = compute
    before = journal.store.read("SELECT count(*) FROM job")
    make = job_maker.JobMaker(config, None, None, odd)  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="'a' was taken out of the queue"):
        await make(entry, queue, journal, lambda _: None)
    assert journal.store.read("SELECT count(*) FROM job") == before
