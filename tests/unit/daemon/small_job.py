"""Small job that is computed in milliseconds: a part of 24 mm, a Gaussian spot, a raster of 1.5 mm."""

from __future__ import annotations

import asyncio
import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polishd.config.cell_sections import DwellSection, JobSection, PartSection, ProgramSection
from polishd.daemon import app
from polishd.daemon.contact.safety import ContactLimits
from polishd.daemon.cycle import polish
from polishd.daemon.job.job import Job
from polishd.daemon.job.tool_sequence import ToolSequence, ToolStepState
from polishd.daemon.journal.journal import Journal
from polishd.daemon.journal.records import PassRecord
from polishd.hookspecs import DwellSolver, RemovalAnswer, RemovalModel, RemovalRequest
from polishd.model.dwell import OptimalityCertificate, WarmStart
from polishd.model.estimates import Estimate, Estimates
from polishd.model.events import Event
from polishd.model.outline import Circle
from polishd.model.process import FLAT, SHIPPED_OPTIONS, HybridRobot, Placement, ToolProcess
from polishd.model.program import Envelope, Plan, Program, Segment
from polishd.model.states import Outcome
from polishd.model.surface import FloatArray, Grid, SurfaceMap
from polishd.pipeline import dwell_step, steps
from polishd.pipeline.recipe import Recipe
from polishd.pipeline.records import EstimatesInUse
from polishd.pipeline.run_folder import RunFolder
from polishd.plugins.rnc_robot.formats import path_program
from polishd.process.dwell import newton_cg
from polishd.process.metrology.statistics import fit_terms
from polishd.process.toolpath.apertures import circle
from polishd.process.toolpath.paths import raster
from tests.fakes.devices import FakeCell
from tests.rs274 import RS274
from tests.unit.process.gaussian import envelope, rough, spot_effect

APERTURE_MM = 24.0
CERTIFICATE = OptimalityCertificate(
    "newton_cg", 1.0, 1e-6, 0.0, 0.5, 3.0, 60.0, 50.0, at_lower=1, at_upper=0, iterations=9, seconds=0.1, stopped="x"
)
MOVES = ("robot.prepare", "robot.send", "robot.resume", "actuator.set_force", "spindle.set_speed")
LIMITS = ContactLimits(force_n=12.0, rpm=1000.0, force_band=0.25, alarm_delay_s=0.3)


def record_warm_starts(
    monkeypatch: pytest.MonkeyPatch, state: Mapping[str, FloatArray] | None = None
) -> list[WarmStart | None]:
    """Record the warm start of each later solve of a job. ``state`` replaces the state that its solver keeps."""
    starts: list[WarmStart | None] = []
    solve = dwell_step.solve_first

    def solve_recorded(turns: Any, measured: Any, warm: WarmStart | None = None) -> Any:
        starts.append(warm)
        solved = solve(turns, measured, warm)
        return solved if state is None else replace(solved, dwell=replace(solved.dwell, state=state))

    monkeypatch.setattr(dwell_step, "solve_first", solve_recorded)
    return starts


def gaussian_effect(request: RemovalRequest) -> RemovalAnswer:
    """Return a spot of 20 nm/s at the middle of each block."""
    program = request.program
    middle = (program.start_mm + program.end_mm) / 2
    effect = spot_effect(request.grid, middle, sigma_mm=1.5, rate_nm_s=20.0 * request.rate)
    return RemovalAnswer(effect, np.full(program.n, 1.3), np.full(program.n, 0.9), ("a spot for tests",))


def at_rate(rate: float) -> EstimatesInUse:
    """Return the estimates for a tool that removes this share of its model's removal."""
    return EstimatesInUse(Estimates(Estimate(rate)))


def pointwise_effect(request: RemovalRequest) -> RemovalAnswer:
    """Return a static Gaussian spot with a gamma that falls along x: the dwell is divided by it."""
    answer = gaussian_effect(request)
    gamma = 0.8 + 0.1 * request.program.end_mm[:, 0] / APERTURE_MM
    return replace(answer, gamma=gamma, divide_by=gamma)


PART = PartSection(id="P-1", aperture_mm=APERTURE_MM, edge_mm=2.0, origin_mm=(0, 0, 0), rotation_rpy_deg=(0, 0, 0))
DWELL = DwellSection(extension="none", cpu_limit_s=30.0)
JOB = JobSection(id="small", tolerance_nm=0.5, lsf_period_mm=10.0)


def small_recipe(**changes: Any) -> Recipe:
    """Return the recipe with changed fields or keys of its sections."""
    recipe = Recipe(
        part=PART,
        outline=Circle(APERTURE_MM / 2),
        program=ProgramSection(path="small.rnc"),
        dwell=DWELL,
        job=JOB,
        instrument=None,
        spike_threshold_mad=0.0,
        nominal=None,
        grid_mm=1.0,
        process=ToolProcess(dip_deg=0.0),
        robot=HybridRobot(),
        placement=Placement((300.0, 220.0, 2315.0), np.diag([1.0, -1.0, -1.0])),
        options=SHIPPED_OPTIONS,
        optic=FLAT,
        tif=None,
        correction="none",
        envelope=envelope(),
        max_rate_change=0.4,
        format=RS274,
        model=RemovalModel("gaussian", gaussian_effect),
        solver=DwellSolver(newton_cg.NAME, newton_cg.solve),
        cross_check=None,
    )
    own = {name: changes.pop(name) for name in list(changes) if name in Recipe.__slots__}
    for name in ("part", "program", "dwell", "job"):
        section = getattr(recipe, name)
        keys = {key: changes.pop(key) for key in list(changes) if key in type(section).model_fields}
        recipe = replace(recipe, **{name: section.model_copy(update=keys)})
    assert not changes, f"a recipe has no {changes}"
    return replace(recipe, **{"outline": recipe.part.outline, **own})


def small_text(radius_mm: float = APERTURE_MM / 2 + 1) -> bytes:
    """Return a raster over the part and its surroundings, as RNC text."""
    points = raster(circle(2 * radius_mm), 1.5, 1.5)
    return path_program(points, np.tile([0.0, 0.0, 1.0], (len(points), 1)), 900.0, "small")


@cache
def small_program(radius_mm: float = APERTURE_MM / 2 + 1) -> Program:
    """Return the program of that raster."""
    return RS274.read(small_text(radius_mm), "small.rnc")


def small_map(rms_nm: float = 20.0, seed: int = 0, part_id: str = "P-1") -> SurfaceMap:
    """Return the map of a round part at a pitch of 0.5 mm without tilt."""
    n = int(APERTURE_MM / 0.5) + 4
    grid = Grid(n, n, 0.5)
    height = rough(grid, rms_nm, seed)
    part = grid.radius_mm() <= APERTURE_MM / 2 + 0.5
    height -= fit_terms(height, part, "tilt")
    return as_map(np.where(part, height * rms_nm / height[part].std(), np.nan), part_id)


def as_map(height_nm: FloatArray, part_id: str = "P-1") -> SurfaceMap:
    """Return a new map of these heights at a pitch of 0.5 mm."""
    return SurfaceMap(height_nm, 0.5, part_id, sha256=hashlib.sha256(height_nm.tobytes()).hexdigest())


async def compute(function: Callable[..., Any], *arguments: Any, within_s: float = 600.0) -> Any:
    """Replace the compute worker: run the function in this process, where monkeypatched steps apply."""
    await asyncio.sleep(0)
    return function(*arguments)


def accept(plan: Plan, limits: Envelope) -> Sequence[str]:
    """Accept every plan."""
    return []


def small_job(
    tmp_path: Path, journal: Journal, *, recipe: Recipe | None = None, program: Program | None = None, **changes: Any
) -> Job:
    """Return a job of that recipe; ``job.published`` has its events."""
    folder = RunFolder(tmp_path / "run")
    folder.create()
    published: list[Event] = []
    values: dict[str, Any] = {
        "journal": journal,
        "folder": folder,
        "compute": compute,
        "publish": published.append,
        "check_plan": accept,
        "max_cycles": 3,
        "stream_ahead_s": 8.0,
    }
    contact = changes.pop("contact", LIMITS)
    one = (ToolStepState(recipe or small_recipe(), (program or small_program(),), contact),)
    job = Job(ToolSequence(changes.pop("turns", one), journal), **(values | changes))
    job.published = published  # type: ignore[attr-defined]
    return job


def open_journal(tmp_path: Path) -> Journal:
    """Open the journal of this job."""
    return Journal.open(tmp_path, job="small", part_id="P-1")


def recorded_phases(journal: Journal) -> list[tuple[Any, ...]]:
    """Return cycle, phase, outcome and error of the open journal's job, in time order."""
    sql = "SELECT cycle, phase, outcome, error FROM phase WHERE job = ? ORDER BY id"
    return journal._store.read(sql, (journal._job,))


@cache
def written_s(text: bytes) -> float:
    """Return the seconds of 1.5 mm at the feed of the block, 0 without a feed."""
    feed = next((float(word[1:]) for word in text.split() if word.startswith(b"F")), None)
    return 0.0 if feed is None else 1.5 / (feed / 60)


class Bench:
    """Simulated part: each map is the one before less the removal of the last pass's blocks."""

    def __init__(self, tmp_path: Path, journal: Journal, rate: float = 1.0) -> None:
        self.fake = FakeCell()
        self.journal = journal
        self.tmp_path = tmp_path
        self.rate = rate
        self.surface = small_map()
        self.fake.robot.block_s = self.block_s
        self.fake.metrology.measure = self.measure
        self._cycle = -1

    def job(self, **changes: Any) -> Any:
        return small_job(self.tmp_path, self.journal, **changes)

    async def polish(self, job: Any = None) -> Outcome:
        return await polish(self.fake.cell, job or self.job(), self.journal)

    def block_s(self, block: Segment) -> float:
        """Return the time of a block: about 1.5 mm at its feed."""
        return written_s(block.text)

    def measure(self) -> SurfaceMap:
        """Return the map after the passes so far."""
        passes = self.journal.passes
        if passes and passes[-1].cycle != self._cycle:
            self._cycle = passes[-1].cycle
            program, blocks = self.program_of(passes[-1]), self.journal.executed(self._cycle)
            time_s = np.zeros(program.n)
            index = {int(block): k for k, block in enumerate(program.block)}
            for seq, seconds in zip(blocks.seq, blocks.duration_s, strict=True):
                if int(seq) in index:
                    time_s[index[int(seq)]] = seconds
            recipe = self.truth_of(passes[-1])
            answer = steps.effect_of(recipe, program, self.surface.grid, at_rate(self.rate))
            self.surface = as_map(self.surface.height_nm - answer.effect.removal_nm(time_s))
        return self.surface

    def program_of(self, record: PassRecord) -> Program:
        """Return the program of that pass."""
        return small_program()

    def truth_of(self, record: PassRecord) -> Recipe:
        """Return the recipe with the true tool of that pass."""
        return small_recipe()

    def phases(self) -> list[str]:
        return [f"{cycle} {phase} {outcome}" for cycle, phase, outcome, _ in recorded_phases(self.journal)]

    def moved(self) -> list[str]:
        return self.fake.of(*MOVES)


async def run_cell(config: Any, hooks: Any, *, holds: bool = True) -> dict[str, Any]:
    """Run the daemon of one cell and return its summary. An error before the devices are opened is raised."""
    (found,) = await app.run_cells([app.CellRun(config, hooks)], holds=holds)
    if isinstance(found, Exception):
        raise found
    return found
