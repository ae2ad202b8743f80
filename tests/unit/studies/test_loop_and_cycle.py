"""The daemon's cycle and a study's closed loop make the same decisions on the same simulated plants."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from polishd.daemon.cycle import polish
from polishd.daemon.job import job as job_module
from polishd.model.errors import PolishdError, RemovalCheckStop, ToolStop
from polishd.model.program import Plan, Program
from polishd.model.surface import FloatArray
from polishd.pipeline import decisions, steps
from polishd.pipeline.decisions import Accept, AnotherPass, Decision, Diverge, PassesUsed, Stalled
from polishd.pipeline.recipe import Recipe
from polishd.plugins.rnc_robot.formats import path_program
from polishd.process.toolpath.apertures import circle
from polishd.process.toolpath.paths import raster
from polishd.studies import closed_loop
from polishd.studies.closed_loop import GATE, TOOL, _Account, _Job
from tests.rs274 import RS274
from tests.unit.daemon.small_job import (
    APERTURE_MM,
    LIMITS,
    Bench,
    as_map,
    at_rate,
    open_journal,
    small_map,
    small_program,
    small_recipe,
)
from tests.unit.process.gaussian import rough


@dataclass
class Plant:
    """A part that a tool polishes, with the requests of the simulator's plant (`PlantProcess`)."""

    seed: int
    rates: Callable[[int], float] = lambda _: 1.0
    """True removal rate of each pass, relative to the model's."""
    damage_nm: Callable[[int], float] = lambda _: 0.0
    """RMS of the error that each pass adds, in periods that the tool corrects."""
    scratches_nm: Callable[[int], float] = lambda _: 0.0
    """RMS of the roughness that each pass adds, in all periods."""
    passes: int = 0
    height_nm: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        self.height_nm = small_map(seed=self.seed).height_nm

    def measure(self, wait_s: float = 0.0) -> tuple[FloatArray, float]:
        return self.height_nm, 0.5

    def truth(self, *, held: bool = False) -> tuple[dict[str, Any], FloatArray]:
        robot = small_recipe().envelope
        machines = {"accel_mm_s2": robot.accel_mm_s2, "overhead_s": robot.block_overhead_s}
        return {"pitch_mm": 0.5, "machines": machines}, self.height_nm

    def polish(self, program: Program, seconds: FloatArray, force_n: float, rpm: float) -> dict[str, FloatArray]:
        grid = as_map(self.height_nm).grid
        answer = steps.effect_of(small_recipe(), program, grid, at_rate(self.rates(self.passes)))
        draw = 100 * self.seed + self.passes + 1
        damage = self.damage_nm(self.passes) * rough(grid, 1.0, draw)
        damage += self.scratches_nm(self.passes) * np.random.default_rng(draw).standard_normal(grid.shape)
        self.height_nm = self.height_nm - answer.effect.removal_nm(seconds) + damage
        self.passes += 1
        ones = np.ones(program.n)
        return {"contact_s": seconds, "force_n": ones * force_n, "rpm": ones * rpm}


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[Decision]:
    """All decisions, as they are made by either."""
    found: list[Decision] = []

    def decide(*arguments: Any) -> Decision:
        found.append(decisions.decide(*arguments))
        return found[-1]

    for module in (job_module, closed_loop):
        monkeypatch.setattr(module, "decide", decide)
    return found


async def by_daemon(folder: Path, plant: Plant, recipe: Recipe, passes: int) -> str:
    """End of the daemon's cycle on that plant, with fake devices; the robot needs the time that the plan expects."""
    block_s: dict[int, float] = {}

    def check_plan(plan: Plan, _: Any) -> list[str]:
        block_s.update(zip(plan.program.block.tolist(), plan.expected_time_s.tolist(), strict=True))
        return []

    with open_journal(folder) as journal:
        bench = Bench(folder, journal)
        bench.fake.robot.block_s = lambda block: block_s.get(block.seq, 0.0)
        job = bench.job(recipe=recipe, max_cycles=passes, check_plan=check_plan, contact=CONTACT)

        def measure() -> Any:
            if len(journal.passes) > plant.passes:
                program, blocks = small_program(), journal.executed(journal.passes[-1].cycle)
                lasted = dict(zip(blocks.seq.tolist(), blocks.duration_s.tolist(), strict=True))
                plant.polish(program, np.array([lasted[int(block)] for block in program.block]), 12.0, 1000.0)
            return as_map(plant.height_nm)

        bench.fake.metrology.measure = measure
        try:
            return (await polish(bench.fake.cell, job, journal)).value
        except PolishdError as error:
            return {ToolStop: TOOL, RemovalCheckStop: GATE}.get(type(error), repr(error))


def by_study(plant: Plant, recipe: Recipe, passes: int) -> str:
    """End of a study's closed loop on that plant."""
    hooks: Any = SimpleNamespace(check_plan=lambda *_: [])
    loop = _Job(recipe, (small_program(),), hooks, "P-1", passes, True, plant, _Account())  # type: ignore[arg-type]
    return loop.polish(steps.initial_estimates(recipe)).how


NEVER_NM = 1e-6
CONTACT = replace(LIMITS, excess_nm=1e6)
"""No limit of excess removal: the fake robot takes the times that the plan expects, not those of the program."""


ACCEPTED, NOT_YET = (Accept, 1.5, 3, {}), (AnotherPass, NEVER_NM, 9, {})
USED = (PassesUsed, NEVER_NM, 1, {"rates": lambda _: 0.9})
STALLED = (Stalled, NEVER_NM, 3, {"damage_nm": lambda _: 4.0})
DIVERGED = (Diverge, NEVER_NM, 3, {"scratches_nm": lambda number: 20.0 * (number == 1)})
GAINED_ONCE, WORSE = (PassesUsed, *STALLED[1:]), (Diverge, *STALLED[1:])


@pytest.mark.full
@pytest.mark.parametrize(
    ("seed", "last", "tolerance_nm", "passes", "plant"),
    [
        pytest.param(0, *ACCEPTED, id="accepted"),
        pytest.param(1, *ACCEPTED, id="accepted 1", marks=pytest.mark.full),
        pytest.param(2, *ACCEPTED, id="accepted 2", marks=pytest.mark.full),
        pytest.param(0, *USED, id="passes used"),
        pytest.param(0, *NOT_YET, id="the next pass is not made", marks=pytest.mark.full),
        pytest.param(1, *NOT_YET, id="the next pass is not made 1", marks=pytest.mark.full),
        pytest.param(0, *GAINED_ONCE, id="passes used after one that gained little", marks=pytest.mark.full),
        pytest.param(1, *STALLED, id="stalled on the last pass"),
        pytest.param(2, *WORSE, id="diverged where a stall is found too", marks=pytest.mark.full),
        pytest.param(0, *DIVERGED, id="diverged"),
        pytest.param(1, *DIVERGED, id="diverged 1", marks=pytest.mark.full),
    ],
)
async def test_both_decide_alike(
    tmp_path: Path,
    made: list[Decision],
    seed: int,
    last: type[Decision],
    tolerance_nm: float,
    passes: int,
    plant: dict[str, Any],
) -> None:
    recipe = small_recipe(tolerance_nm=tolerance_nm)
    daemon = await by_daemon(tmp_path, Plant(seed, **plant), recipe, passes)
    by_cycle = list(made)
    made.clear()
    study = by_study(Plant(seed, **plant), recipe, passes)
    assert (study, made) == (daemon, by_cycle)
    assert isinstance(made[-1], last)


def shifted() -> Program:
    points = raster(circle(APERTURE_MM + 2), 1.5, 1.5, phase=0.5)
    axes = np.tile([0.0, 0.0, 1.0], (len(points), 1))
    return RS274.read(path_program(points, axes, 900.0, "small"), "between.rnc")


def test_programs_of_a_study_take_turns_and_each_pass_is_learned_along_its_own() -> None:
    polished: list[str] = []

    class Watched(Plant):
        def polish(self, program: Program, seconds: FloatArray, force_n: float, rpm: float) -> dict[str, FloatArray]:
            polished.append(program.name)
            return super().polish(program, seconds, force_n, rpm)

    plant = Watched(0, rates=lambda _: 0.8)
    hooks: Any = SimpleNamespace(check_plan=lambda *_: [])
    recipe = small_recipe(tolerance_nm=NEVER_NM)
    account = _Account()
    loop = _Job(recipe, (small_program(), shifted()), hooks, "P-1", 2, True, plant, account)  # type: ignore[arg-type]
    assert loop.polish(steps.initial_estimates(recipe)).how == "cycles_used"
    assert polished == ["small.rnc", "between.rnc"]
    assert account.rms_nm[2] < account.rms_nm[1] < account.rms_nm[0]
