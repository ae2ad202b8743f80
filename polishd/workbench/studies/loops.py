"""Many jobs in a closed loop: each scenario and loop on the same plants, side by side, and a row of each."""

from __future__ import annotations

import atexit
import multiprocessing
import os
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from copy import deepcopy
from dataclasses import asdict, dataclass
from itertools import groupby
from statistics import median
from typing import Any

from polishd.config.cell import lay_over
from polishd.config.document import parse_toml
from polishd.config.loop_study import AS_IT_IS, LoopStudy, Scenario
from polishd.workbench.studies.kept import Case, Kept, made_of
from polishd.workbench.studies.loop import ClosedLoop, Run
from polishd.workbench.studies.plant_process import PlantProcess

Plants = Mapping[str, Mapping[str, Any]]
"""By scenario, SIM.toml's sections."""


@dataclass(frozen=True, slots=True)
class LoopRow:
    """What a loop came to in a scenario."""

    scenario: str
    loop: str
    runs: int
    accepted: int
    passes_median: float | None
    """To tolerance; None where half of the runs or more did not come so far."""
    true_rms_nm_median: float | None
    """At the end, whatever the end; None where half of the runs or more never polished the part."""
    first_pass_nm_median: float | None
    """As measured after the first pass."""
    false_accepts: int
    named_rightly: int
    """Runs that said of the machine what is wrong with it, and nothing else; nothing, where nothing is."""
    named: Mapping[str, int]
    """How many said what, but for what they need not say: names joined by "+", or "nothing"."""
    forecasts: int
    """Passes of which a map told, ..."""
    held: int
    """... and of these, those that left what was expected with a chance of nine in ten."""
    first_forecasts: int
    """The same of first passes alone, ..."""
    first_held: int
    """... which are expected from what was known before the part."""
    ended: Mapping[str, int]
    """How many ended in which way."""
    cpu_s_median: float


@dataclass(frozen=True, slots=True)
class Looped:
    """All runs, and the row of each scenario and loop."""

    runs: tuple[Run, ...]
    rows: tuple[LoopRow, ...]

    def as_json(self) -> list[dict[str, Any]]:
        """The rows."""
        return [asdict(row) for row in self.rows]


def run_loops(
    study: LoopStudy, tell: Callable[[str], None], *, seeds: int | None, jobs: int | None, kept: Kept | None = None
) -> Looped:
    """All cases of a study on ``jobs`` processes (None: one a core), but those kept. ConfigError, ProgramError.

    A case is drawn from its seed alone: the order of the cases, and who works them, changes nothing but the times.
    """
    scenarios, kept = study.all_scenarios(), kept or Kept(None)
    beliefs = {}
    for name in study.loops:  # before anything is computed
        with study.blame(f"loops.{name}"):
            beliefs[name] = _loop(study, name).config.model_dump(mode="json")
    plant, _ = parse_toml(study.resolve(study.plant))
    lay_over(plant, {name: dict(keys) for name, keys in study.plant_with.items()})
    plants = {name: laid_over(plant, scenario) for name, scenario in scenarios.items()}
    numbers = range(study.first_seed, study.first_seed + (seeds or study.seeds))
    cases = [(scenario, loop, seed) for seed in numbers for scenario in scenarios for loop in study.loops]
    of = {(scenario, loop): _made_of(study, beliefs[loop], loop, plants[scenario]) for scenario, loop, _ in cases}
    known = {case: kept.find(case, of[case[:2]]) for case in cases}
    runs = [run for run in known.values() if run is not None]
    tell(f"{len(runs)} of {len(cases)} jobs")
    for run in _worked(study, plants, [case for case in cases if known[case] is None], jobs or os.cpu_count() or 1):
        kept.add(run, of[run.scenario, run.loop])
        runs.append(run)
        tell(f"{len(runs)} of {len(cases)} jobs")
    place = {case: number for number, case in enumerate(cases)}
    runs.sort(key=lambda run: place[run.scenario, run.loop, run.seed])
    return Looped(tuple(runs), tuple(_rows(runs, scenarios)))


def _made_of(study: LoopStudy, belief: Mapping[str, Any], loop: str, plant: Mapping[str, Any]) -> str:
    cell, sim = study.resolve(study.cell), study.resolve(study.plant)
    _, witness, poses = study.loop(loop)
    own = {"passes": study.passes, "raster": study.raster, "witness": witness, "poses": poses}
    return made_of((belief, cell.parent), (own, cell.parent), (plant, sim.parent))


def laid_over(plant: Mapping[str, Any], scenario: Scenario) -> dict[str, Any]:
    """SIM.toml's sections with a scenario's laid over them; what a plant without wires has no use for is left out."""
    whole = deepcopy(dict(plant))
    whole.pop("fault", None)
    lay_over(whole, {name: dict(keys) for name, keys in scenario.plant.items()})
    return whole


def _loop(study: LoopStudy, name: str) -> ClosedLoop:
    keys, witness, poses = study.loop(name)
    cell = study.resolve(study.cell)
    return ClosedLoop(cell, keys, study.passes, raster=study.raster, witness=witness, poses=poses)


def _worked(study: LoopStudy, plants: Plants, cases: Sequence[Case], jobs: int) -> Iterator[Run]:
    """Each as it ends."""
    if jobs == 1:
        with PlantProcess() as plant:
            yield from map(_Worker(study, plants, plant).run, cases)
        return
    context = multiprocessing.get_context("forkserver")
    with ProcessPoolExecutor(jobs, mp_context=context, initializer=_begin, initargs=(study, plants)) as pool:
        waiting: set[Future[Run]] = {pool.submit(_run, case) for case in cases}
        try:
            while waiting:
                done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                for future in done:
                    yield future.result()
        finally:
            pool.shutdown(cancel_futures=True)


class _Worker:
    """One process's plant, and the loops of the study."""

    def __init__(self, study: LoopStudy, plants: Plants, plant: PlantProcess) -> None:
        self._plants, self._plant = plants, plant
        self._loops = {name: _loop(study, name) for name in study.loops}

    def run(self, case: Case) -> Run:
        scenario, loop, seed = case
        return self._loops[loop].run(self._plant, self._plants[scenario], scenario, loop, seed)


_worker: _Worker | None = None


def _begin(study: LoopStudy, plants: Plants) -> None:
    global _worker  # noqa: PLW0603  (a process of the pool has one)
    plant = PlantProcess()
    atexit.register(plant.__exit__)
    _worker = _Worker(study, plants, plant)


def _run(case: Case) -> Run:
    if _worker is None:
        raise RuntimeError("the worker has not begun")
    return _worker.run(case)


def _rows(runs: Sequence[Run], scenarios: Mapping[str, Scenario]) -> Iterator[LoopRow]:
    """In the scenarios' order."""
    order = {name: number for number, name in enumerate(scenarios)}
    ordered = sorted(runs, key=lambda run: order[run.scenario])  # stable: loops stay in theirs
    for scenario, some in groupby(ordered, key=lambda run: run.scenario):
        mine = list(some)
        for loop in dict.fromkeys(run.loop for run in mine):
            yield _row(scenarios[scenario], [run for run in mine if run.loop == loop])


def _row(scenario: Scenario, runs: Sequence[Run]) -> LoopRow:
    never = float("inf")
    passes = median(run.passes if run.accepted else never for run in runs)
    true_nm = median(run.true_rms_nm[-1] if run.true_rms_nm else never for run in runs)
    first = [run.rms_nm[1] for run in runs if len(run.rms_nm) > 1]
    came, began = [one for run in runs for one in run.came_nm], [run.came_nm[0] for run in runs if run.came_nm]
    said = [tuple(sorted(set(run.named) - set(scenario.also))) for run in runs]
    right = [set(names) <= set(scenario.named) and bool(names) == bool(scenario.named) for names in said]
    return LoopRow(
        scenario=runs[0].scenario,
        loop=runs[0].loop,
        runs=len(runs),
        accepted=sum(run.accepted for run in runs),
        passes_median=None if passes == never else passes,
        true_rms_nm_median=None if true_nm == never else true_nm,
        first_pass_nm_median=median(first) if first else None,
        false_accepts=sum(run.falsely_accepted for run in runs),
        named_rightly=sum(right),
        named=dict(Counter("+".join(names) or AS_IT_IS for names in said)),
        forecasts=len(came),
        held=_held(came),
        first_forecasts=len(began),
        first_held=_held(began),
        ended={how: sum(run.ended == how for run in runs) for how in dict.fromkeys(run.ended for run in runs)},
        cpu_s_median=median(run.cpu_s for run in runs),
    )


def _held(came: Sequence[tuple[float, float, float]]) -> int:
    return sum(low <= left <= high for low, high, left in came)
