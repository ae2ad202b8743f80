"""A job that goes on in another run of the daemon: from journal and store, whatever became of the run folder."""

from __future__ import annotations

import asyncio
import os
import shutil
import signal
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polishd.daemon.cell.cell import Cell
from polishd.daemon.journal.store import connect
from polishd.daemon.socket.client import request
from polishd.model.errors import ConfigError
from polishd.model.surface import SurfaceMap
from polishd.pipeline.run_folder import RunFolder
from tests.unit.daemon.small_job import as_map, record_warm_starts, run_cell
from tests.unit.daemon.test_app import Site

RATE = 0.8
"""What the tool of these tests really removes, of what its model says."""


class Rerun(Site):
    """A site whose tool removes less than its model says, and whose later maps have a hole."""

    def __init__(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        super().__init__(tmp_path, monkeypatch)
        self.maps = 0
        self.stop_at: int | None = None
        """Number of maps after which SIGTERM comes."""
        self.measure = self.take

    def build(self, config: Any, hooks: Any) -> Cell:
        cell = super().build(config, hooks)
        assert self.bench is not None
        self.bench.rate = RATE
        return cell

    def take(self) -> SurfaceMap:
        assert self.bench is not None
        self.maps += 1
        if self.maps == self.stop_at:
            os.kill(os.getpid(), signal.SIGTERM)
        surface = self.bench.measure()
        if self.maps == 1:
            return surface
        height = surface.height_nm.copy()
        height[24:27, 24:27] = np.nan
        return as_map(height)

    def learned(self) -> list[tuple[int | None, float]]:
        return [(event.cycle, event.data["rate"]) for event in self.published if event.name == "estimates_updated"]

    def arrays(self, table: str, column: str) -> list[str]:
        """Names in the store, in the order of the cycles."""
        with sqlite3.connect(self.config.state_dir / "journal.sqlite") as journal:
            return [name for (name,) in journal.execute(f"SELECT {column} FROM {table} ORDER BY cycle")]

    def masks(self) -> list[np.ndarray[Any, Any]]:
        files = [self.config.state_dir / "store" / f"{name}.npz" for name in self.arrays("map", "arrays")]
        return [np.load(file)["solve_mask"] for file in files]


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Rerun:
    return Rerun(tmp_path, monkeypatch)


async def until_held(site: Rerun) -> None:
    """pytest's timeout is the limit."""
    while not any(event.name == "state_changed" and event.data["state"] == "held" for event in site.published):  # noqa: ASYNC110
        await asyncio.sleep(0.01)


async def resumed(site: Rerun, meanwhile: Any = lambda: None) -> dict[str, Any]:
    """The daemon comes up held, something happens, and a person resumes."""
    site.published.clear()
    async with asyncio.TaskGroup() as group:
        task = group.create_task(run_cell(site.config, site.hooks))
        await until_held(site)
        meanwhile()
        await asyncio.to_thread(request, site.config.state_dir, "resume")
    return task.result()


async def stopped_after_a_pass(site: Rerun) -> None:
    site.stop_at = 2
    assert (await run_cell(site.config, site.hooks))["outcome"] == "stopped"
    site.stop_at = None


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize("when", ["between the runs", "while held"])
async def test_a_deleted_run_folder_costs_nothing_but_what_it_showed(site: Rerun, when: str) -> None:
    await stopped_after_a_pass(site)

    def delete() -> None:
        shutil.rmtree(site.config.run_dir)

    if when == "between the runs":
        delete()
    summary = await resumed(site, delete if when == "while held" else lambda: None)
    assert summary["outcome"] == "in_tolerance"
    cycle, rate = site.learned()[0]
    assert cycle == 1, "from the pass before the restart"
    assert rate == pytest.approx(RATE, rel=0.05)
    first, *others = site.masks()
    assert others
    assert all(np.array_equal(first, other) for other in others), "frozen with the first map"
    folder = site.config.run_dir
    assert site.summary()["outcome"] == "in_tolerance"
    for name in ("surface.npz", "plan.npz", "certificate.json", "executed.csv"):
        assert (folder / "cycle-00" / name).stat().st_size > 0, "made anew"
    store = site.config.state_dir / "store"
    assert (folder / "cycle-00/plan.npz").read_bytes() == (store / f"{site.arrays('pass', 'plan')[0]}.npz").read_bytes()


@pytest.mark.full
async def test_the_next_solve_starts_from_the_last_one_across_a_restart(
    site: Rerun, monkeypatch: pytest.MonkeyPatch
) -> None:
    starts = record_warm_starts(monkeypatch, {"multipliers": np.arange(3.0)})
    await stopped_after_a_pass(site)
    shutil.rmtree(site.config.run_dir)
    await resumed(site)
    assert starts[0] is None
    assert starts[1] is not None
    with np.load(site.config.state_dir / "store" / f"{site.arrays('pass', 'plan')[0]}.npz") as plan:
        assert np.array_equal(starts[1].time_s, plan["time_s"])
    assert np.array_equal(starts[1].state["multipliers"], np.arange(3.0)), "what its solver can start from, too"


@pytest.mark.full
async def test_a_job_that_an_earlier_polishd_began_goes_on(site: Rerun) -> None:
    """It kept where the part lay as an array, and of what it believed two numbers."""
    await stopped_after_a_pass(site)
    with connect(site.config.state_dir / "journal.sqlite") as journal:
        journal.execute("UPDATE map SET stats = json_remove(stats, '$.registration', '$.sha256')")
        journal.execute("UPDATE pass SET facts = json_remove(facts, '$.removal')")
        assert journal.execute("SELECT json_type(facts, '$.removal') FROM pass").fetchone()[0] is None
    assert (await resumed(site))["outcome"] == "in_tolerance"
    cycle, rate = site.learned()[0]
    assert (cycle, rate) == (1, pytest.approx(RATE, rel=0.05))


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize("what", ["arrays", "plan", "start"])
async def test_a_store_that_lost_what_the_journal_names_is_reported_before_anything_is_opened(
    site: Rerun, what: str
) -> None:
    await stopped_after_a_pass(site)
    name = site.arrays("map" if what == "arrays" else "pass", what)[0]
    path = site.config.state_dir / "store" / f"{name}.npz"
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(ConfigError, match=rf"{name}\.npz: the content has another hash"):
        await run_cell(site.config, site.hooks)
    assert site.bench is not None
    assert site.bench.fake.events == []


async def test_another_edge_is_refused_before_anything_is_opened(site: Rerun) -> None:
    await stopped_after_a_pass(site)
    site.part["edge_mm"] = 3.5
    with pytest.raises(ConfigError, match=r"part.edge_mm: is 3.5, the job 'small' began with 2.0\n"):
        await run_cell(site.config, site.hooks)
    assert site.bench is not None
    assert site.bench.fake.events == []


@pytest.mark.full
async def test_another_program_is_refused_and_the_old_one_goes_on(site: Rerun) -> None:
    from tests.unit.daemon.small_job import small_program

    await stopped_after_a_pass(site)
    ours, site.program = site.program, small_program(14.5)
    with pytest.raises(ConfigError, match=r"program.path: is program.rnc \(sha256 "):
        await run_cell(site.config, site.hooks)
    site.program = ours
    assert (await resumed(site))["outcome"] == "in_tolerance"


@pytest.mark.full
async def test_a_run_folder_that_cannot_be_written_ends_no_job(site: Rerun, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*arguments: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(RunFolder, "write", full)
    assert (await run_cell(site.config, site.hooks))["outcome"] == "in_tolerance"
