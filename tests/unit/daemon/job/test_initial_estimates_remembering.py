"""Initial estimates of a job from earlier jobs."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from polishd.daemon.job import initial_estimates
from polishd.daemon.job.job import Job
from polishd.daemon.journal.journal import JOURNAL_NAME, Journal
from polishd.daemon.journal.store import Store
from polishd.model.errors import ComputeError
from polishd.model.estimates import Estimate, Estimates
from polishd.pipeline.recipe import Recipe
from polishd.pipeline.records import EstimatesInUse
from tests.unit.daemon.job.test_job import whole_cycle
from tests.unit.daemon.small_job import small_job, small_map, small_recipe

TERMS = {
    "process.force_n": 12.0,
    "process.estimates": "rate",
    "estimates.tool": None,
    "part.id": "P-1",
    "part.aperture_mm": 24.0,
    "job.tolerance_nm": 2.0,
    "machine.accel_mm_s2": 500.0,
}
RATE = 0.8
REMEMBERS = small_recipe(remembers=True)


def journal_of(state_dir: Path, job: str, terms: Mapping[str, Any] = TERMS) -> Journal:
    return Journal.open(state_dir, job=job, part_id="P-1", terms=terms)


async def taught(state_dir: Path, name: str = "first", rate: float = RATE, terms: Mapping[str, Any] = TERMS) -> float:
    """Run a job whose second map shows that rate; return its estimate."""
    with journal_of(state_dir, name, terms) as journal:
        job = small_job(state_dir / name, journal, recipe=REMEMBERS)
        await job.load()
        surface = await whole_cycle(job, 0, small_map(), rate=rate)
        await job.learn(1, await job.measured(1, surface))
        assert job.tools.estimates.rate == pytest.approx(rate, rel=0.05)
        return job.tools.estimates.rate


async def begun(
    state_dir: Path, name: str = "second", terms: Mapping[str, Any] = TERMS, recipe: Recipe = REMEMBERS
) -> Job:
    with journal_of(state_dir, name, terms) as journal:
        job = small_job(state_dir / name, journal, recipe=recipe)
        await job.load()
        await job.measured(0, small_map())
        return job


def notes(job: Job) -> list[str]:
    return list(job.published[-1].data["notes"])  # type: ignore[attr-defined]


async def test_a_job_begins_with_the_rate_of_the_last_one_and_says_so(tmp_path: Path) -> None:
    rate = await taught(tmp_path)
    job = await begun(tmp_path)
    assert job.tools.estimates.rate == rate
    (note,) = [one for one in notes(job) if "estimates after" in one]
    assert note.startswith("starts with the estimates after pass 1 of job 'first' (20")
    assert re.search(rf"rate {rate:.2f}\d* \+- ", note)
    with closing(Store.open(tmp_path / JOURNAL_NAME)) as store:
        (stats,) = store.read("SELECT stats FROM map WHERE job = 2")[0]
    assert note in json.loads(stats)["notes"], "in the journal, too"


@pytest.mark.full
async def test_its_plan_counts_with_it_and_its_pass_keeps_it(
    tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    without = tmp_path_factory.mktemp("alone")
    rate = await taught(tmp_path)
    with journal_of(tmp_path, "second") as journal:
        job = small_job(tmp_path / "second", journal, recipe=REMEMBERS)
        await job.load()
        surface = await whole_cycle(job, 0, small_map(seed=5), rate=RATE)
        assert journal.passes[0].facts["rate"] == rate
        measured = await job.measured(1, surface)
        alone = await first_pass_nm(without)
        assert measured.stats.rms_nm < alone / 2, "the error without the estimate"
        assert not [one for one in notes(job) if "estimates after" in one], "the note is given once"


async def first_pass_nm(state_dir: Path) -> float:
    with journal_of(state_dir, "alone") as journal:
        job = small_job(state_dir / "alone", journal, recipe=REMEMBERS)
        await job.load()
        return (await job.measured(1, await whole_cycle(job, 0, small_map(seed=5), rate=RATE))).stats.rms_nm


@pytest.mark.full
async def test_the_last_lesson_counts(tmp_path: Path) -> None:
    await taught(tmp_path)
    last = await taught(tmp_path, "next", 0.95)
    assert (await begun(tmp_path, "third")).tools.estimates.rate == last


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    ("key", "value", "remembers"),
    [
        ("process.force_n", 15.0, False),
        ("process.force_max_n", 15.0, True),
        ("estimates.tool", "bonnet 8", False),
        ("instrument.profile", "other.toml", False),
        ("kinematics.tool_length_mm", 400.0, False),
        ("part.id", "P-2", True),
        ("part.aperture_mm", 50.0, True),
        ("job.tolerance_nm", 1.0, True),
    ],
)
async def test_only_a_job_of_the_same_series_remembers(
    tmp_path: Path, key: str, value: object, remembers: bool
) -> None:
    await taught(tmp_path)
    job = await begun(tmp_path, terms={**TERMS, key: value})
    assert (job.tools.estimates.rate != 1.0) is remembers


def test_what_is_learned_over_the_part_belongs_to_its_form() -> None:
    rate, machine = ({**TERMS, "process.estimates": learns} for learns in ("rate", "machine"))
    for key, rate_alone, more in (("part.id", True, True), ("part.aperture_mm", True, False)):
        other = {key: "other"}
        assert (initial_estimates.series_of(rate | other) == initial_estimates.series_of(rate)) is rate_alone
        assert (initial_estimates.series_of(machine | other) == initial_estimates.series_of(machine)) is more


async def test_the_time_of_a_block_goes_with_the_machine(tmp_path: Path) -> None:
    with journal_of(tmp_path, "first") as journal:
        await whole_cycle(small_job(tmp_path / "first", journal), 0, small_map())
        journal.add_facts(0, initial_estimates.facts(TERMS, EstimatesInUse(Estimates(Estimate(0.9)), 0.007)))
    assert (await begun(tmp_path)).tools.estimates == EstimatesInUse(Estimates(Estimate(0.9)), 0.007)
    other = await begun(tmp_path, "third", {**TERMS, "machine.accel_mm_s2": 900.0})
    assert other.tools.estimates == EstimatesInUse(Estimates(Estimate(0.9)), REMEMBERS.envelope.block_overhead_s)


@pytest.mark.one_of_each
@pytest.mark.parametrize("why", ["off", "narrowed", "tool", "forgotten", "of no use"])
async def test_nothing_is_remembered(tmp_path: Path, why: str, caplog: pytest.LogCaptureFixture) -> None:
    await taught(tmp_path)
    recipe = REMEMBERS
    match why:
        case "off":
            recipe = small_recipe(remembers=False)
        case "narrowed":
            recipe = replace(REMEMBERS, max_rate_change=0.1)
        case "tool":
            with Journal.open(tmp_path, job="first", part_id="P-1", terms=TERMS) as journal:
                journal.add_facts(0, {"findings": [{"kind": "drift", "what": "x", "stops": "cell"}]})
        case "forgotten":
            initial_estimates.forget_estimates(tmp_path, "another pad")
        case _:

            def later(beliefs: Estimates, days: float) -> Estimates:
                raise ComputeError("other parameters")

            recipe = replace(REMEMBERS, model=replace(REMEMBERS.model, later=later))
    job = await begun(tmp_path, recipe=recipe)
    assert job.tools.estimates.rate == 1.0
    assert not [one for one in notes(job) if "estimates after" in one]
    assert ("are not used: other parameters" in caplog.text) is (why == "of no use")


@pytest.mark.full
async def test_what_is_learned_after_forgetting_is_remembered(tmp_path: Path) -> None:
    await taught(tmp_path)
    initial_estimates.forget_estimates(tmp_path, "")
    last = await taught(tmp_path, "next", 0.95)
    assert (await begun(tmp_path, "third")).tools.estimates.rate == last


def test_forgetting_in_a_cell_that_has_done_nothing(tmp_path: Path) -> None:
    initial_estimates.forget_estimates(tmp_path, "")
    with closing(Store.open(tmp_path / JOURNAL_NAME)) as store:
        assert list(initial_estimates.journalled_estimates(store.read)) == []


async def test_a_job_under_way_goes_on_with_its_own(tmp_path: Path) -> None:
    own = await taught(tmp_path)
    with journal_of(tmp_path, "first") as journal:
        assert journal.resumed
        job = small_job(tmp_path / "first", journal, recipe=REMEMBERS)
        await job.load()
        assert job.tools.estimates.rate == 1.0, "of its last plan, as before; the map that follows teaches it again"
        assert own != 1.0


async def test_one_that_was_interrupted_before_its_first_pass_remembers_again(tmp_path: Path) -> None:
    rate = await taught(tmp_path)
    await begun(tmp_path)
    job = await begun(tmp_path)
    assert job.tools.estimates.rate == rate


async def test_it_is_less_certain_after_a_rest(tmp_path: Path) -> None:
    await taught(tmp_path)
    with closing(Store.open(tmp_path / JOURNAL_NAME)) as store:
        store.write(("UPDATE pass SET ended = ended - 4 * 86400", ()))
        (lesson,) = initial_estimates.journalled_estimates(store.read)
    sigma = lesson.believed["removal"]["rate"]["sigma"]
    job = await begun(tmp_path)
    after = job.tools.estimates.removal.rate.sigma
    assert after is not None
    assert after**2 - sigma**2 == pytest.approx((RATE * 0.03) ** 2 * 4, rel=0.15)
