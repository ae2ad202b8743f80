"""What a worker does: the rows of a case, with what it keeps from one case to the next."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

from polishd.config.loop_study import LoopStudy
from polishd.config.study import CorrectionsStudy, PassesStudy, Study
from polishd.config.sweep_points import read_swept
from polishd.hooks.loader import load_own
from polishd.model.errors import ComputeError, ConfigError
from polishd.model.surface import SurfaceMap
from polishd.recipe.encoding import facts_of
from polishd.recipe.files import read_map
from polishd.workbench.studies.case import Case
from polishd.workbench.studies.cases import UNHURRIED, CaseFactory
from polishd.workbench.studies.corrections import compare_corrections
from polishd.workbench.studies.loop import ERROR, ClosedLoop, ClosedLoopResult
from polishd.workbench.studies.passes import polish_evenly
from polishd.workbench.studies.plant_process import PlantProcess
from polishd.workbench.studies.spots import compute_spots

Rows = list[dict[str, Any]]
MOST_LOOPS = 32
"""That are kept ready: each holds a program and what was computed of it."""
UNHURRIED_S = 3600.0
"""Of a solve: iterations end it."""


class CaseRunner:
    """A worker's: one study, the loops that it has made ready, and one plant."""

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
        """ConfigError where versions or files are no longer those that the case was made of."""
        study = self._making.swept.at(case.at)
        if self._making.of(study, case.scenario, case.loop, case.seed) != case.of:
            raise ConfigError(
                f"{self._making.swept.path}: the study or a file that it names is another here, or was changed since "
                "the study began; let all workers see the same files, and begin again"
            )

    def rows(self, case: Case) -> Rows:
        """What it comes to: a row of it, or one for each plant and correction, or spot. PolishdError."""
        study = self._making.swept.at(case.at)
        if isinstance(study, LoopStudy):
            return [self._job(study, case)]
        return list(_computed(study))

    def _job(self, study: LoopStudy, case: Case) -> dict[str, Any]:
        if case.scenario is None or case.loop is None or case.seed is None:
            raise ConfigError(f"case {case.number}: names no scenario, loop and seed; make it anew")
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
    """That loop of the study. ConfigError, ProgramError."""
    keys, witness, poses, learns = study.loop(name)
    cell, keys = study.resolve(study.cell), {**UNHURRIED, **keys}
    return ClosedLoop(cell, keys, study.passes, raster=study.raster, witness=witness, poses=poses, learns=learns)


def row_of(run: ClosedLoopResult) -> dict[str, Any]:
    """A job's figures, and what all rows are looked at by."""
    own = {field.name: getattr(run, field.name) for field in fields(run)}
    for name in ("scenario", "loop", "seed"):  # which the case has
        del own[name]
    end_nm = run.true_rms_nm[-1] if run.true_rms_nm else None
    return {**own, "accepted": run.accepted, "falsely_accepted": run.falsely_accepted, "true_rms_end_nm": end_nm}


def run_of(row: dict[str, Any]) -> ClosedLoopResult:
    """The job of a row; of a case that failed, one that never began."""
    if row["error"]:
        return ClosedLoopResult(
            row["scenario"], row["loop"], row["seed"], ERROR, row["error"], (), 0, (), (), (), (), False, 0.0
        )
    return ClosedLoopResult(**{field.name: _frozen(row[field.name]) for field in fields(ClosedLoopResult)})


def _computed(study: Study) -> Iterator[dict[str, Any]]:
    """Figures alone: maps and profiles are computed again where they are wanted."""
    if isinstance(study, CorrectionsStudy):
        solve = study.solve.model_copy(update={"within_s": UNHURRIED_S})
        unhurried = study.model_copy(update={"solve": solve})
        yield from (facts_of(row) for row in compare_corrections(unhurried, read, _silent).rows)
    elif isinstance(study, PassesStudy):
        yield polish_evenly(study, _silent).as_json()
    elif not isinstance(study, LoopStudy):
        for spot in compute_spots(study, _silent):
            yield {name: value for name, value in spot.as_json().items() if not name.startswith("profile")}


def read(path: Path) -> SurfaceMap:
    """A map, by the readers of a cell. SurfaceError."""
    return read_map(path, load_own().surface_readers().values())


def _silent(words: str) -> None:
    """A worker's progress is its cases."""


def _frozen(value: Any) -> Any:
    return tuple(map(_frozen, value)) if isinstance(value, list | tuple) else value
