"""``polishd plan``: everything short of motion, for a map and a program given by hand. Opens no device."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from polishd.config.cell import CellConfig
from polishd.files import require_new, require_writable, unwritable
from polishd.hooks.loader import Hooks
from polishd.model.errors import PlanRefused, WrongPart
from polishd.model.events import PlanWritten
from polishd.model.surface import FloatArray, SurfaceMap
from polishd.process.instrument import as_profiled
from polishd.recipe import dwell_step, steps
from polishd.recipe.accepting import why_never
from polishd.recipe.dwell_step import require_certificate
from polishd.recipe.files import read_map
from polishd.recipe.folder import RunFolder
from polishd.recipe.forecasting import forecast_of
from polishd.recipe.making import make_recipe
from polishd.recipe.program_fit import judged
from polishd.recipe.recipe import Recipe
from polishd.recipe.records import Measured, Planned, figures


def plan_part(config: CellConfig, hooks: Hooks, map_path: Path, program_path: Path, out: Path) -> dict[str, Any]:
    """Map figures, corrected dwell, rewritten program, certificate and pictures in ``out``; the summary.

    ``out`` appears whole or not at all. Raises ConfigError where it exists and is not empty, or cannot be written,
    SurfaceError, ProgramError, ComputeError, or PlanRefused with every violation.
    """
    require_new(out)
    require_writable(out.parent)
    recipe = make_recipe(config, hooks)
    surface = read_map(map_path, hooks.surface_readers().values())
    notes = _require_part(surface, config.part.id, map_path)
    program = steps.read_program(recipe, program_path)
    measured = steps.condition(recipe, surface)
    solved = dwell_step.solve(recipe, program, measured)
    require_certificate(solved.dwell.certificate, recipe)
    plan = steps.rewrite(recipe, program, solved, program_path.name)
    vetoes = hooks.check_plan(plan, recipe.envelope)
    if vetoes:
        raise PlanRefused("the plan was refused, nothing was written:\n" + "\n".join(f"  {v}" for v in vetoes))
    expected = forecast_of(recipe, measured, plan, solved.believed)
    planned = Planned.of(plan, solved, steps.in_part_frame(recipe, plan.program), expected)
    if recipe.instrument is None or recipe.instrument.commissioned is None:
        notes.append("run will refuse: the cell has no commissioned instrument's profile (polishd check says more)")
    notes += [f"run will refuse: {never}"] if (never := why_never(recipe)) else []
    said, misfit = judged(recipe, program, config.program.covers)
    notes += [f"check will refuse: {said}{misfit}"] if misfit else []
    notes += [*as_profiled(surface, recipe.instrument).warnings, *measured.notes, *program.warnings]
    notes += [*steps.violations(recipe, plan), *solved.answer.notes, *planned.certificate.notes]
    summary = {**_summary(recipe, measured, planned), "job": config.job.id, "run_dir": str(out), "notes": notes}
    with _appearing(out) as folder:
        folder.map_file(surface)
        program_file = {"program.rnc": plan.program.text}
        folder.write({**measured.files(), **solved.files(), **program_file, **planned.files()})
        folder.json("summary.json", summary)
        hooks.on_event(PlanWritten(run_dir=str(folder.path)))
    return summary


@contextmanager
def _appearing(out: Path) -> Iterator[RunFolder]:
    """A folder to write, which becomes ``out`` at the end; ConfigError where that cannot be."""
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{out.name}.", dir=out.parent) as scratch:
            folder = RunFolder(Path(scratch) / "plan")
            folder.create()
            yield folder
            if out.exists():
                out.rmdir()
            shutil.move(str(folder.path), out)
    except OSError as error:
        raise unwritable(out, error) from error


def _require_part(surface: SurfaceMap, part_id: str, path: Path) -> list[str]:
    if surface.part_id and surface.part_id != part_id:
        raise WrongPart(f"{path}: shows part {surface.part_id!r}, not {part_id!r} (part.id); name the right map")
    return [] if surface.part_id else [f"{path.name} names no part; taken for {part_id!r} on your word"]


def _summary(recipe: Recipe, measured: Measured, planned: Planned) -> dict[str, Any]:
    now = datetime.now(UTC).isoformat(timespec="seconds")
    return {
        "outcome": "planned",
        **recipe.facts(),
        "cycles": [{**figures(measured.facts(), planned.facts()), "executed_s": None}],
        "certificate": asdict(planned.certificate),
        "gamma": _range(planned.gamma),
        "compliance_um_per_n": _range(planned.compliance_um_per_n),
        "points": planned.block.size,
        "started": now,
        "ended": now,
    }


def _range(values: FloatArray) -> list[float]:
    return [float(values.min()), float(values.max())]
