"""Compute the rows of a case in a worker, which keeps loops and the plant from case to case."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from itertools import groupby
from pathlib import Path
from statistics import median
from typing import Any

from polishd.config.study import AS_IT_IS, CorrectionsStudy, LoopStudy, PassesStudy, PathsStudy, Scenario, Study
from polishd.config.sweep import read_swept
from polishd.model.errors import ComputeError, ConfigError
from polishd.model.surface import SurfaceMap
from polishd.pipeline.records import facts_of
from polishd.pipeline.run_folder import read_map
from polishd.plugin_loader import load_own
from polishd.studies.cases import UNHURRIED, Case, CaseFactory
from polishd.studies.closed_loop import ERROR, ClosedLoop, ClosedLoopResult
from polishd.studies.corrections import compare_corrections
from polishd.studies.path_families import compare_paths
from polishd.studies.plant_client import PlantProcess
from polishd.studies.spots import compute_spots, polish_evenly

Rows = list[dict[str, Any]]
MOST_LOOPS = 32
"""Loops that are kept ready: each holds a program and the results computed from it."""
UNHURRIED_S = 3600.0
"""Time limit of a solve, s: iterations end it, not the clock."""


class CaseRunner:
    """Computes the cases of one study in a worker, with its loops and one plant."""

    def __init__(self, study: Path) -> None:
        """Read the study's file. ConfigError."""
        self._making = CaseFactory(read_swept(study))
        self._loops: dict[str, ClosedLoop] = {}
        self._plant: PlantProcess | None = None

    def close(self) -> None:
        """End the plant."""
        if self._plant is not None:
            self._plant.__exit__()
            self._plant = None

    def require_same(self, case: Case) -> None:
        """ConfigError where versions or files differ from those of the case."""
        study = self._making.swept.at(case.at)
        if self._making.of(study, case.scenario, case.loop, case.seed) != case.of:
            raise ConfigError(
                f"{self._making.swept.path}: the study or a file that it names differs here, or has changed since "
                "the study began. Give all workers the same files, and start the study again"
            )

    def rows(self, case: Case) -> Rows:
        """Return the rows of the case: one, or one for each plant and correction, or for each spot. PolishdError."""
        study = self._making.swept.at(case.at)
        if isinstance(study, LoopStudy):
            return [self._job(study, case)]
        return list(_computed(study))

    def _job(self, study: LoopStudy, case: Case) -> dict[str, Any]:
        if case.scenario is None or case.loop is None or case.seed is None:
            raise ConfigError(f"case {case.number}: no scenario, loop and seed. Start the study again")
        loop = self._loop(study, case.loop)
        if self._plant is None:
            self._plant = PlantProcess()
        machine = self._plant
        plant = self._making.plant(study, case.scenario)
        try:
            run = loop.run(machine, plant, case.scenario, case.loop, case.seed)
        finally:
            if not machine.alive:
                self.close()
        if not machine.alive:
            raise ComputeError(run.why)
        return row_of(run)

    def _loop(self, study: LoopStudy, name: str) -> ClosedLoop:
        keys, *how = study.loop(name)
        key = json.dumps([name, keys, how, study.cell, study.passes, study.raster], sort_keys=True, default=str)
        if key not in self._loops:
            if len(self._loops) == MOST_LOOPS:
                del self._loops[next(iter(self._loops))]
            self._loops[key] = closed_loop(study, name)
        return self._loops[key]


def closed_loop(study: LoopStudy, name: str) -> ClosedLoop:
    """Return that loop of the study. ConfigError, ProgramError."""
    keys, witness, poses, learns = study.loop(name)
    cell, keys = study.resolve(study.cell), {**UNHURRIED, **keys}
    return ClosedLoop(cell, keys, study.passes, raster=study.raster, witness=witness, poses=poses, learns=learns)


def row_of(run: ClosedLoopResult) -> dict[str, Any]:
    """The figures of a job, and the columns common to all rows."""
    own = {field.name: getattr(run, field.name) for field in fields(run)}
    for name in ("scenario", "loop", "seed"):  # which the case has
        del own[name]
    end_nm = run.true_rms_nm[-1] if run.true_rms_nm else None
    return {**own, "accepted": run.accepted, "falsely_accepted": run.falsely_accepted, "true_rms_end_nm": end_nm}


def run_of(row: dict[str, Any]) -> ClosedLoopResult:
    """Return the job of a row; for a failed case, a job that never began."""
    if row["error"]:
        return ClosedLoopResult(
            row["scenario"], row["loop"], row["seed"], ERROR, row["error"], (), 0, (), (), (), (), False, 0.0
        )
    known = (field.name for field in fields(ClosedLoopResult) if field.name in row)  # earlier rows have no ripple
    return ClosedLoopResult(**{name: _frozen(row[name]) for name in known})


def _computed(study: Study) -> Iterator[dict[str, Any]]:
    """Figures only: maps and profiles are computed again on demand."""
    if isinstance(study, CorrectionsStudy):
        solve = study.solve.model_copy(update={"cpu_limit_s": UNHURRIED_S})
        corrections = study.model_copy(update={"solve": solve})
        yield from (facts_of(row) for row in compare_corrections(corrections, read, _silent).rows)
    elif isinstance(study, PathsStudy):
        solve = study.solve.model_copy(update={"cpu_limit_s": UNHURRIED_S})
        paths = study.model_copy(update={"solve": solve})
        yield from (facts_of(row) for row in compare_paths(paths, read, _silent).rows)
    elif isinstance(study, PassesStudy):
        yield polish_evenly(study, _silent).as_json()
    elif not isinstance(study, LoopStudy):
        for spot in compute_spots(study, _silent):
            yield {name: value for name, value in spot.as_json().items() if not name.startswith("profile")}


def read(path: Path) -> SurfaceMap:
    """Read a map with the readers of a cell. SurfaceError."""
    return read_map(path, load_own().surface_readers().values())


def _silent(words: str) -> None:
    """Progress of a worker: it reports cases only."""


def _frozen(value: Any) -> Any:
    return tuple(map(_frozen, value)) if isinstance(value, list | tuple) else value


# Many jobs in a closed loop: one row for each scenario and loop.


@dataclass(frozen=True, slots=True)
class LoopRow:
    """Results of a loop in a scenario."""

    scenario: str
    loop: str
    runs: int
    accepted: int
    passes_median: float | None
    """Passes to tolerance; None where half of the runs or more did not reach it."""
    true_rms_nm_median: float | None
    """RMS at the end, for every outcome; None where half of the runs or more never polished the part."""
    first_pass_nm_median: float | None
    """As measured after the first pass."""
    false_accepts: int
    named_rightly: int
    """Runs that diagnosed exactly the true causes; with no cause, runs without a diagnosis."""
    named: Mapping[str, int]
    """Runs by diagnosis, without the causes that they need not name: names joined by "+", or "nothing"."""
    forecasts: int
    """Passes whose result a map measured, ..."""
    held: int
    """... and of these, those whose result lay in the 90 % interval of the prediction."""
    first_forecasts: int
    """The same for first passes alone, ..."""
    first_held: int
    """... whose prediction uses only data from before the part."""
    ended: Mapping[str, int]
    """Runs by outcome."""
    cpu_s_median: float


@dataclass(frozen=True, slots=True)
class LoopRows:
    """All runs, and one row for each scenario and loop."""

    runs: tuple[ClosedLoopResult, ...]
    rows: tuple[LoopRow, ...]

    def as_json(self) -> list[dict[str, Any]]:
        """The rows."""
        return [asdict(row) for row in self.rows]


def looped(runs: Sequence[ClosedLoopResult], scenarios: Mapping[str, Scenario]) -> LoopRows:
    """Summarize these jobs, in the order of the scenarios."""
    return LoopRows(tuple(runs), tuple(_rows(runs, scenarios)))


def _rows(runs: Sequence[ClosedLoopResult], scenarios: Mapping[str, Scenario]) -> Iterator[LoopRow]:
    """Sort by the scenarios' order."""
    order = {name: number for number, name in enumerate(scenarios)}
    ordered = sorted(runs, key=lambda run: order[run.scenario])  # stable: loops keep their order
    for scenario, some in groupby(ordered, key=lambda run: run.scenario):
        mine = list(some)
        for loop in dict.fromkeys(run.loop for run in mine):
            yield _row(scenarios[scenario], [run for run in mine if run.loop == loop])


def _row(scenario: Scenario, runs: Sequence[ClosedLoopResult]) -> LoopRow:
    never = float("inf")
    passes = median(run.passes if run.accepted else never for run in runs)
    true_nm = median(run.true_rms_nm[-1] if run.true_rms_nm else never for run in runs)
    first = [run.rms_nm[1] for run in runs if len(run.rms_nm) > 1]
    came, began = [one for run in runs for one in run.came_nm], [run.came_nm[0] for run in runs if run.came_nm]
    named = [tuple(sorted(set(run.named) - set(scenario.also))) for run in runs]
    right = [set(names) <= set(scenario.named) and bool(names) == bool(scenario.named) for names in named]
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
        named=dict(Counter("+".join(names) or AS_IT_IS for names in named)),
        forecasts=len(came),
        held=_held(came),
        first_forecasts=len(began),
        first_held=_held(began),
        ended={how: sum(run.ended == how for run in runs) for how in dict.fromkeys(run.ended for run in runs)},
        cpu_s_median=median(run.cpu_s for run in runs),
    )


def _held(came: Sequence[tuple[float, float, float]]) -> int:
    return sum(low <= left <= high for low, high, left in came)
