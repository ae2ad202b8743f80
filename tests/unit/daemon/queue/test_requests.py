"""Parts from a shop: in the cell's queue, begun after the shop confirms, and returned."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from polishd.config.job_file import JobFile
from polishd.daemon import job_runner as daemon_module
from polishd.daemon.journal.journal import Journal
from polishd.daemon.queue.queue import NewJob, Queue
from polishd.daemon.queue.requests import BACK, LOST
from polishd.model.errors import ConfigError
from polishd.model.events import ShopRateReceived
from polishd.model.states import Outcome
from tests.unit.daemon.test_job_runner import End, Hall

OFFER = {
    "recipe": "r1", "cell": "north", "job": "lens", "of_cycle": 0, "at_s": 5.0, "rate": 0.9, "sigma": 0.01,
}  # fmt: skip


@pytest.fixture
def hall(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Hall]]:
    """Each call is another run of the daemon, on the journal of the one before it."""
    journals: list[Journal] = []

    def make(ends: dict[str, list[End]] | None = None) -> Hall:
        journals.append(Journal.of_cell(tmp_path))
        made = Hall(tmp_path, journals[-1], ends or {})
        monkeypatch.setattr(daemon_module, "polish", made.polish)
        return made

    yield make
    for journal in journals:
        journal.close()


def given(queue: Queue, name: str, claim: str) -> None:
    queue.add([NewJob(name, f"P-{name}", JobFile(Path(f"/{name}.toml"), ""), {}, claim)])


def verdicts(queue: Queue) -> dict[str, str]:
    return {entry.name: entry.state for entry in queue.entries()}


async def stopped(cell: Hall) -> None:
    """Stop as an operator. The answer comes at the very end, after this test."""
    asked = asyncio.ensure_future(cell.order("stop"))
    await cell.task
    asked.cancel()


async def turns() -> None:
    for _ in range(100):
        await asyncio.sleep(0)


async def test_a_part_of_the_shop_begins_once_the_shop_has_said_that_it_may(hall: Callable[..., Hall]) -> None:
    cell = hall()
    given(cell.queue, "lens", "c1")
    await cell.start(until_empty=True)
    await turns()
    assert not cell.task.done(), "the queue is not empty: it waits for the shop's word"
    assert cell.polished == []
    assert "not confirmed since this start: lens" in (await cell.daemon.status())["shop"]
    await cell.daemon.handlers["shop_assignments"](stands=["c1"])
    await cell.until("changing")
    await cell.order("resume")
    assert await cell.task is Outcome.IN_TOLERANCE
    assert verdicts(cell.queue) == {"lens": "accepted"}


async def test_the_cells_own_jobs_do_not_wait_for_it(hall: Callable[..., Hall]) -> None:
    cell = hall()
    given(cell.queue, "lens", "c1")
    cell.add("own")
    await cell.start()
    await cell.until("changing")
    await cell.order("resume")
    await cell.wait(lambda: verdicts(cell.queue)["own"] == "accepted")
    assert verdicts(cell.queue) == {"own": "accepted", "lens": "waiting"}
    await stopped(cell)


async def test_what_the_shop_wants_back_or_has_given_away_is_taken_out_while_it_waits(
    hall: Callable[..., Hall],
) -> None:
    cell = hall()
    for name in ("a", "b", "c"):
        given(cell.queue, name, f"claim {name}")
    await cell.start(until_empty=True)
    await cell.daemon.handlers["shop_assignments"](back=["claim a"], lost=["claim b", "of no job"])
    assert verdicts(cell.queue) == {"a": "removed", "b": "removed", "c": "waiting"}
    assert [entry.reason for entry in cell.queue.entries()][:2] == [BACK, LOST]
    await cell.daemon.handlers["shop_assignments"](stands=["claim b"], lost=["claim c"])
    assert await cell.task is Outcome.IN_TOLERANCE
    assert cell.polished == []


async def test_after_a_restart_a_job_under_way_waits_for_the_shops_word(hall: Callable[..., Hall]) -> None:
    first = hall()
    given(first.queue, "lens", "c1")
    await first.start()
    await first.daemon.handlers["shop_assignments"](stands=["c1"])
    await first.until("changing")
    await stopped(first)
    first.journal.close()

    again = hall()
    await again.start(until_empty=True)
    await again.until("held")
    resumed = asyncio.ensure_future(again.order("resume"))
    await turns()
    assert again.polished == []
    await again.daemon.handlers["shop_assignments"](stands=["c1"])
    await resumed
    await again.until("changing")
    await again.order("resume")
    assert await again.task is Outcome.IN_TOLERANCE
    assert verdicts(again.queue) == {"lens": "accepted"}


async def test_a_cell_that_was_given_up_learns_before_contact_that_it_has_lost_its_part(
    hall: Callable[..., Hall],
) -> None:
    first = hall()
    given(first.queue, "lens", "c1")
    await first.start()
    await first.daemon.handlers["shop_assignments"](stands=["c1"])
    await first.until("changing")
    await stopped(first)
    first.journal.close()

    again = hall()
    await again.start(until_empty=True)
    await again.until("held")
    await again.daemon.handlers["shop_assignments"](lost=["c1"])
    resumed = asyncio.ensure_future(again.order("resume"))
    assert await again.task is Outcome.IN_TOLERANCE
    resumed.cancel()
    assert again.polished == []
    assert verdicts(again.queue) == {"lens": "set aside"}
    assert again.queue.entries()[0].reason == LOST


async def test_what_came_by_the_same_claim_is_added_once(hall: Callable[..., Hall]) -> None:
    cell = hall()
    given(cell.queue, "lens", "c1")
    given(cell.queue, "lens", "c1")
    assert [entry.name for entry in cell.queue.entries()] == ["lens"]
    cell.queue.remove_waiting("lens")
    given(cell.queue, "lens", "c1")
    assert verdicts(cell.queue) == {"lens": "removed"}, "its claim is over"
    given(cell.queue, "lens", "c2")
    assert [entry.claim for entry in cell.queue.waiting()] == ["c2"]


async def test_what_is_offered_is_an_event_of_the_journal(hall: Callable[..., Hall]) -> None:
    cell = hall()
    await cell.start()
    assert await cell.daemon.handlers["shop_rates"](offers=[OFFER]) == {"offers": 1}
    assert cell.published[-1] == ShopRateReceived(**OFFER)  # type: ignore[arg-type]
    rows = cell.journal.store.read("SELECT data FROM event WHERE name = 'shop_rate_received'")
    assert [json.loads(data) for (data,) in rows] == [OFFER]
    wrong: list[Any] = [{}, {**OFFER, "rate": "1"}, {**OFFER, "more": 1}, "x"]
    for one in wrong:
        with pytest.raises(ConfigError, match="an offer must have the fields recipe, cell"):
            await cell.daemon.handlers["shop_rates"](offers=[one])
    await stopped(cell)
