"""Held or ended: a correctable error waits for an operator, and each record agrees with the end."""

from __future__ import annotations

import asyncio
import json
import os
import re
import signal
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from polishd.daemon import app
from polishd.daemon.job_assembly import figures as figures_of
from polishd.daemon.journal.journal import Journal
from polishd.daemon.runtime.exit_record import RECORD_NAME, last_ending
from polishd.daemon.socket.client import request
from polishd.model import errors as model_errors
from polishd.model.devices import ForceSample
from polishd.model.errors import (
    ComputeError,
    DeviceFault,
    DeviceRefused,
    LinkError,
    PlanRefused,
    PolishdError,
    RemovalCheckStop,
    SafetyStop,
    StaleMap,
    SurfaceError,
)
from polishd.model.states import Outcome
from polishd.model.surface import SurfaceMap
from tests.unit.daemon.small_job import Bench, open_journal, run_cell, small_recipe
from tests.unit.daemon.test_app import SAFE, Running, Site


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with open_journal(tmp_path) as journal:
        yield Bench(tmp_path, journal)


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Site:
    return Site(tmp_path, monkeypatch)


def failing(bench: Bench, *errors: PolishdError) -> Callable[[], SurfaceMap]:
    """Maps of that bench, after these errors."""
    waiting = list(errors)

    def measure() -> SurfaceMap:
        if waiting:
            raise waiting.pop(0)
        return bench.measure()

    return measure


def force_that_fails(bench: Bench, after: int = 120) -> None:
    """A safety stop in the first pass."""

    def reads(sample: ForceSample) -> ForceSample:
        return replace(sample, force_n=3.0) if bench.fake.robot.done > after and sample.force_n else sample

    bench.fake.actuator.reads = reads


# held


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    "error",
    [
        SurfaceError("no map came"),
        StaleMap("an old one"),
        LinkError("cut"),
        DeviceFault("hot"),
        RemovalCheckStop("flipped"),
    ],
)
async def test_what_a_person_can_mend_holds_and_resume_goes_on(bench: Bench, error: PolishdError) -> None:
    bench.fake.metrology.measure = failing(bench, error)
    async with Running(bench) as running:
        await running.held()
        status = await running.daemon.status()
        assert status["reason"] == f"{type(error).__name__}: {error}"
        assert "polishd resume CELL.toml" in status["next"]
        assert bench.fake.events[-3:] == SAFE
        assert bench.moved() == []
        assert (await running.daemon.handlers["resume"]())["state"] == "polishing"
        assert await running.outcome() is Outcome.IN_TOLERANCE
    held = next(event for event in running.published if event.name == "cell_held")
    assert held.data == {"error": str(error), "kind": type(error).__name__}
    state = next(event for event in running.published if event.data.get("state") == "held")
    assert (state.data["tool_off"], state.data["robot_at_rest"]) == ("yes", "yes")
    assert "polishd resume CELL.toml" in state.data["next"]


@pytest.mark.full
async def test_a_map_that_is_late_again_holds_again(bench: Bench) -> None:
    bench.fake.metrology.measure = failing(bench, StaleMap("late"), StaleMap("late"))
    async with Running(bench) as running:
        for _ in range(2):
            await running.held()
            await running.daemon.handlers["resume"]()
        assert await running.outcome() is Outcome.IN_TOLERANCE
    assert running.states() == ["polishing", "held", "polishing", "held", "polishing"]


@pytest.mark.full
async def test_a_lost_link_is_opened_again_before_a_measurement(bench: Bench) -> None:
    """The spindle is gone when the pass should begin; it holds until the spindle is back."""
    spindle = bench.fake.spindle.acts
    bench.fake.metrology.acts.before["next_map"] = lambda: spindle.fails.update(
        {call: LinkError("spindle: gone") for call in ("status", "open")}
    )
    async with Running(bench) as running:
        await running.held()
        assert "LinkError: spindle: gone" in running.daemon.reason
        maps = len(bench.fake.of("next_map"))
        with pytest.raises(DeviceRefused, match="resume is refused, the cell stays held: LinkError: spindle: gone"):
            await running.daemon.handlers["resume"]()
        assert len(bench.fake.of("next_map")) == maps, "no measurement for a cell that cannot polish"
        bench.fake.metrology.acts.before.clear()
        spindle.fails.clear()
        await running.daemon.handlers["resume"]()
        assert await running.outcome() is Outcome.IN_TOLERANCE
    assert bench.fake.cell.unsafe == ()


async def test_a_robot_that_refuses_the_program_holds_before_anything_moved(bench: Bench) -> None:
    bench.fake.robot.acts.fails["prepare"] = DeviceRefused("robot: not homed")
    async with Running(bench) as running:
        await running.held()
        assert "robot: not homed" in running.daemon.reason
        assert bench.journal.passes == ()


async def test_stopped_while_held_over_an_error_it_ends_with_that_error(bench: Bench) -> None:
    bench.fake.metrology.measure = failing(bench, StaleMap("late"))
    async with Running(bench) as running:
        await running.held()
        running.daemon.stop()
        with pytest.raises(StaleMap, match="late"):
            await running.outcome()


async def test_stopped_after_it_was_mended_it_is_stopped(bench: Bench) -> None:
    bench.fake.metrology.measure = failing(bench, StaleMap("late"))
    async with Running(bench) as running:
        await running.held()
        await running.daemon.handlers["resume"]()
        await running.in_contact()
        await running.daemon.handlers["hold"]()
        running.daemon.stop()
        assert await running.outcome() is Outcome.STOPPED


async def test_a_stop_in_the_moment_of_an_error_is_not_forgotten(bench: Bench) -> None:
    async with Running(bench) as running:
        bench.fake.metrology.acts.before["next_map"] = running.daemon.stop
        bench.fake.metrology.acts.fails["next_map"] = StaleMap("late")
        with pytest.raises(StaleMap, match="late"):
            await running.outcome()


# ended


@pytest.mark.parametrize(
    "error", [PlanRefused("vetoed"), ComputeError("no certificate"), SafetyStop("journal lost"), PolishdError("?")]
)
async def test_an_error_without_a_remedy_ends_the_daemon(bench: Bench, error: PolishdError) -> None:
    bench.fake.metrology.measure = failing(bench, error)
    async with Running(bench) as running:
        with pytest.raises(type(error)):
            await running.outcome()
    assert running.states() == ["polishing"]


async def test_a_device_that_fails_in_a_pass_ends(bench: Bench) -> None:
    def cut() -> None:
        if bench.fake.robot.done > 5:
            bench.fake.robot.acts.fails["send"] = LinkError("cut")

    bench.fake.robot.acts.before["send"] = cut
    async with Running(bench) as running:
        with pytest.raises(LinkError, match="cut"):
            await running.outcome()
    assert "held" not in running.states()


async def test_a_device_that_will_not_close_does_not_hide_what_ended_it(bench: Bench) -> None:
    force_that_fails(bench)
    bench.fake.actuator.acts.fails["close"] = OSError("stuck")
    async with Running(bench) as running:
        with pytest.raises(SafetyStop, match="force"):
            await running.outcome()


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    ("error", "code"), [(StaleMap("late"), 8), (LinkError("cut"), 5), (RemovalCheckStop("turned"), 10)]
)
async def test_no_hold_ends_with_the_causes_own_code(site: Site, error: PolishdError, code: int) -> None:
    def refuse() -> SurfaceMap:
        raise error

    site.measure = refuse
    summary = await run_cell(site.config, site.hooks, holds=False)
    assert (summary["outcome"], summary["exit_code"]) == ("failed", code)
    assert "the daemon has ended" in summary["next"]


@pytest.mark.full
async def test_no_hold_does_not_wait_for_a_person_after_an_interruption(site: Site) -> None:
    await stopped_in_a_pass(site)
    summary = await run_cell(site.config, site.hooks, holds=False)
    assert (summary["outcome"], summary["exit_code"]) == ("stopped", 1)
    assert "pass 0 was interrupted" in summary["reason"]
    assert "resume" not in summary["reason"]
    assert site.bench is not None
    assert site.bench.moved() == []


def test_the_table_of_what_holds_and_what_ends_is_the_code() -> None:
    """docs/reference/errors.md beside the tree of errors: each one has its line, and no other."""
    page = (Path(__file__).parents[4] / "docs" / "reference" / "errors.md").read_text()
    rows = re.findall(r"^\| (`\w+.*?) \| (\d+) \| (held|ended) \|", page, re.MULTILINE)
    documented = {name: (int(code), end) for names, code, end in rows for name in re.findall(r"`(\w+)`", names)}
    tree = {
        name: (error.exit_code, "held" if error.mendable else "ended")
        for name, error in vars(model_errors).items()
        if isinstance(error, type) and issubclass(error, PolishdError)
    }
    assert documented == tree


# words


async def stopped_in_a_pass(site: Site) -> dict[str, Any]:
    async with asyncio.TaskGroup() as group:
        task = group.create_task(run_cell(site.config, site.hooks))
        await site.in_contact()
        os.kill(os.getpid(), signal.SIGTERM)
    return task.result()


async def waits(site: Site) -> dict[str, Any]:
    """The status of the site's daemon once it is held."""
    while not (site.config.state_dir / RECORD_NAME).exists() or last_record(site)["state"] != "held":  # noqa: ASYNC110
        await asyncio.sleep(0)
    return await asyncio.to_thread(request, site.config.state_dir, "status")


def last_record(site: Site) -> dict[str, Any]:
    return dict(json.loads((site.config.state_dir / RECORD_NAME).read_text()))


@pytest.mark.full
async def test_each_end_says_how_the_cell_stands(site: Site) -> None:
    done = await run_cell(site.config, site.hooks)
    assert (done["tool_off"], done["robot_at_rest"], done["unsafe"], done["exit_code"]) == ("yes", "yes", [], 0)
    assert "report.html" in done["next"]
    assert last_ending(site.config.state_dir)["state"] == "in_tolerance"


@pytest.mark.full
async def test_a_device_that_did_not_confirm_is_named_when_no_daemon_runs_any_more(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    build = site.build

    def deaf(config: Any, hooks: Any) -> Any:
        found = build(config, hooks)
        assert site.bench is not None
        actuator = site.bench.fake.actuator.acts
        actuator.before["set_force"] = lambda: actuator.fails.update({"make_safe": LinkError("no answer")})
        return found

    monkeypatch.setattr(app, "build_cell", deaf)
    summary = await stopped_in_a_pass(site)
    left = last_ending(site.config.state_dir)
    for record in (summary, left):
        assert (record["tool_off"], record["robot_at_rest"]) == ("not confirmed", "yes")
        assert record["unsafe"] == ["actuator: no answer"]
        assert record["run_dir"] == str(site.config.run_dir)
    assert (left["state"], left["exit_code"]) == ("stopped", 1)


@pytest.mark.full
async def test_a_daemon_that_was_killed_left_word_of_what_it_was_doing(site: Site) -> None:
    async with asyncio.TaskGroup() as group:
        task = group.create_task(run_cell(site.config, site.hooks))
        await site.in_contact()
        killed = last_ending(site.config.state_dir)  # as it would be found now
        os.kill(os.getpid(), signal.SIGTERM)
    assert task.result()["outcome"] == "stopped"
    assert killed["state"] == "killed"
    assert "while polishing" in killed["reason"]
    assert (killed["tool_off"], killed["robot_at_rest"]) == ("not confirmed", "not confirmed")


async def test_held_over_an_error_and_stopped_is_one_cause_and_its_code(site: Site) -> None:
    def refuse() -> SurfaceMap:
        raise StaleMap("late")

    site.measure = refuse
    async with asyncio.TaskGroup() as group:
        task = group.create_task(run_cell(site.config, site.hooks))
        assert "StaleMap: late" in (await waits(site))["reason"]
        assert (await asyncio.to_thread(request, site.config.state_dir, "stop"))["state"] == "finished"
    summary = task.result()
    assert (summary["outcome"], summary["exit_code"]) == ("failed", 8)
    assert [(cause["kind"], cause["ended"]) for cause in summary["causes"]] == [("StaleMap", True)]


@pytest.mark.full
async def test_the_first_cause_survives_a_second_failed_start(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    build = site.build
    breaks: list[Callable[[Bench], None]] = [force_that_fails, no_spindle]

    def broken(config: Any, hooks: Any) -> Any:
        found = build(config, hooks)
        assert site.bench is not None
        breaks.pop(0)(site.bench)
        return found

    monkeypatch.setattr(app, "build_cell", broken)
    first = await run_cell(site.config, site.hooks)
    second = await run_cell(site.config, site.hooks)
    assert (first["exit_code"], second["exit_code"]) == (7, 5)
    assert [cause["kind"] for cause in second["causes"]] == ["SafetyStop", "LinkError"]
    assert second["causes"][0] == first["causes"][0]
    assert [cause["kind"] for cause in site.summary()["causes"]] == ["SafetyStop", "LinkError"]
    assert [note.split(": ")[1] for note in site.summary()["notes"]] == ["SafetyStop", "LinkError"]
    assert (second["tool_off"], second["robot_at_rest"]) == ("not asked", "not asked")
    assert last_ending(site.config.state_dir)["causes"] == second["causes"]


def no_spindle(bench: Bench) -> None:
    bench.fake.spindle.acts.fails["open"] = LinkError("spindle: no answer")


@pytest.mark.full
async def test_a_lost_journal_still_has_last_words(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    async with asyncio.TaskGroup() as group:
        task = group.create_task(run_cell(site.config, site.hooks))
        await site.in_contact()
        assert site.bench is not None
        lose(site.bench.journal)
    summary = task.result()
    assert (summary["outcome"], summary["exit_code"], summary["tool_off"]) == ("failed", 7, "yes")
    assert "journal lost" in summary["notes"][0]
    assert last_ending(site.config.state_dir)["causes"][0]["kind"] == summary["causes"][0]["kind"]


def lose(journal: Journal) -> None:
    """Make the journal refuse records, as on a full disk."""
    with journal._store._use:
        journal._store._connection.execute("PRAGMA query_only=ON")


async def test_an_unexpected_error_is_reported_too(site: Site) -> None:
    def bug() -> SurfaceMap:
        raise RuntimeError("a bug")

    site.measure = bug
    summary = await run_cell(site.config, site.hooks)
    assert (summary["outcome"], summary["exit_code"], summary["tool_off"]) == ("failed", 1, "yes")
    assert summary["notes"][0].endswith("RuntimeError: a bug")


# interrupted passes


@pytest.mark.full
async def test_an_interrupted_pass_costs_none_of_max_cycles_and_is_marked(tmp_path: Path) -> None:
    changes: dict[str, Any] = {"max_cycles": 2, "recipe": small_recipe(tolerance_nm=1e-6)}
    with open_journal(tmp_path) as journal:
        bench = Bench(tmp_path, journal)
        force_that_fails(bench)
        async with Running(bench, **changes) as running:
            with pytest.raises(SafetyStop):
                await running.outcome()
            (begun,) = figures_of(running.daemon.job)["cycles"]
            assert begun["how"] == "interrupted", "though its end is not recorded yet"
    with open_journal(tmp_path) as journal:
        again = Bench(tmp_path, journal)
        again.surface = bench.surface
        async with Running(again, **changes) as running:
            await running.held()
            await running.daemon.handlers["resume"]()
            assert await running.outcome() is Outcome.CYCLES_USED
        cycles = figures_of(running.daemon.job)["cycles"]
    assert [cycle["how"] for cycle in cycles] == ["interrupted", "done", "done", None]
    assert 0.2 < cycles[0]["executed_s"] / cycles[0]["dwell_s"] < 0.8
