"""Rate of another cell: a job starts with it, less certain, where this cell has no estimates of the series."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from polishd.daemon.job.initial_estimates import ShopRate, forget_estimates, recipe_of
from polishd.daemon.journal.journal import Journal
from polishd.model.events import ShopRateReceived
from tests.unit.daemon.job.test_initial_estimates_remembering import REMEMBERS, TERMS, begun, notes, taught

OFFER = ShopRateReceived(
    recipe=recipe_of(TERMS), cell="north", job="lens", of_cycle=1, at_s=time.time(), rate=0.9, sigma=0.01
)


def offer(state_dir: Path, event: ShopRateReceived = OFFER) -> None:
    with Journal.of_cell(state_dir) as journal:
        journal.record_event(event)


async def test_a_cell_without_a_lesson_begins_with_what_another_one_has_learned_and_says_whose(tmp_path: Path) -> None:
    offer(tmp_path)
    job = await begun(tmp_path)
    rate = job.tools.estimates.removal.rate
    assert rate.value == 0.9
    assert rate.sigma == pytest.approx((0.01**2 + (REMEMBERS.max_rate_change / 6) ** 2) ** 0.5, rel=1e-3)
    (note,) = [one for one in notes(job) if "estimates after" in one]
    assert note.startswith("starts with the estimates after pass 2 of job 'lens' of the cell 'north' (20")
    assert "another machine, offered by the shop" in note


async def test_its_own_lesson_counts_more_than_any_offer(tmp_path: Path) -> None:
    rate = await taught(tmp_path)
    offer(tmp_path)
    job = await begun(tmp_path)
    assert job.tools.estimates.rate == rate


async def test_the_last_offer_counts(tmp_path: Path) -> None:
    offer(tmp_path)
    offer(tmp_path, replace(OFFER, rate=0.95))
    assert (await begun(tmp_path)).tools.estimates.rate == 0.95


@pytest.mark.parametrize(
    "terms",
    [{"process.force_n": 8.0}, {"estimates.tool": "bonnet 8"}, {"process.estimates": "machine"}],
)
async def test_it_is_of_that_process_and_tool_alone(tmp_path: Path, terms: dict[str, Any]) -> None:
    offer(tmp_path)
    assert (await begun(tmp_path, terms={**TERMS, **terms})).tools.estimates.rate == 1.0


async def test_what_is_forgotten_is_not_begun_with_and_what_is_too_far_off_neither(tmp_path: Path) -> None:
    offer(tmp_path)
    forget_estimates(tmp_path, "a new pad")
    assert (await begun(tmp_path)).tools.estimates.rate == 1.0
    offer(tmp_path, replace(OFFER, rate=1 + 1.01 * REMEMBERS.max_rate_change))
    assert (await begun(tmp_path, "third")).tools.estimates.rate == 1.0


def test_a_recipe_is_the_same_wherever_its_files_lie_and_whatever_the_machine() -> None:
    spot = {"process.tif": {"file": "/a/tif.npz", "sha256": "ab"}}
    elsewhere = {"process.tif": {"file": "b/tif.npz", "sha256": "ab"}}
    assert recipe_of({**TERMS, **spot}) == recipe_of(
        {**TERMS, **elsewhere, "kinematics.kind": "hybrid", "part.id": "X"}
    )
    assert recipe_of({**TERMS, **spot}) != recipe_of({**TERMS, "process.tif": {"file": "b", "sha256": "cd"}})
    assert recipe_of({**TERMS, "process.estimates": "machine"}) == ""
    assert recipe_of({**TERMS, "process.force_max_n": 15.0}) == recipe_of(TERMS), "a limit"


def test_of_another_machine_no_rate_is_surer_than_of_none() -> None:
    vague = ShopRate("north", "lens", 0, 0.0, 0.9, sigma=5.0)
    assert vague.on_another_machine(0.3).sigma == pytest.approx(0.1)
