"""``polishd plan``: compute a pass from a given map and program, without motion. It opens no device."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from polishd.config.cell import CellConfig
from polishd.model.errors import MapError, PlanRefused, WrongPart
from polishd.model.events import PlanWritten
from polishd.model.program import Plan, Program
from polishd.model.surface import FloatArray, SurfaceMap
from polishd.pipeline import disk_space, dwell_step, precheck, steps
from polishd.pipeline.acceptance import forecast_of, reason_never_acceptable, ripple_notes
from polishd.pipeline.build_recipe import make_recipes
from polishd.pipeline.decisions import purpose_notes
from polishd.pipeline.dwell_step import ToolProblem, require_certificate
from polishd.pipeline.precheck import Covers, judged
from polishd.pipeline.recipe import Recipe
from polishd.pipeline.records import MeasureResult, PlanResult, SolveResult, figures
from polishd.pipeline.run_folder import RunFolder, read_map
from polishd.plugin_loader import Hooks
from polishd.plugins.interferometer.formats.common import is_level
from polishd.process.metrology.instrument import apply_profile
from polishd.util.files import require_new, require_writable, unwritable_message


@dataclass(frozen=True, slots=True)
class _Pass:
    """Task of one tool."""

    recipe: Recipe
    program: Program
    measured: MeasureResult
    """Surface before the tool: for the second tool, the expected result of the first."""
    solved: SolveResult
    plan: Plan
    planned: PlanResult

    def files(self) -> dict[str, bytes]:
        """Files of the plan's folder."""
        program_file = {"program.rnc": self.plan.program.text}
        return {**self.measured.files(), **self.solved.files(), **program_file, **self.planned.files()}

    def notes(self, covers: Covers) -> list[str]:
        """Notes for people."""
        described, misfit = judged(self.recipe, self.program, covers)
        found = [f"check will refuse: {described}{misfit}"] if misfit else []
        found += [*self.program.warnings, *steps.violations(self.recipe, self.plan), *self.solved.answer.notes]
        side_mm = max(self.measured.grid.shape) * self.measured.grid.pitch_mm
        found += ripple_notes(self.recipe.lines, self.planned.ripple, side_mm, self.solved.answer.acting)
        return list(dict.fromkeys([*found, *self.planned.certificate.notes]))  # the effect has its own note in both

    def row(self) -> dict[str, Any]:
        """Entry in the summary."""
        turn = {} if self.recipe.turn is None else {"tool": self.recipe.turn.tool}
        return {**turn, **figures(self.measured.facts(), self.planned.facts()), "executed_s": None}


def plan_part(
    config: CellConfig, hooks: Hooks, map_path: Path, program_path: Path | None, out: Path, *, of_pass: int = 1
) -> dict[str, Any]:
    """Write map figures, corrected dwell, rewritten program, certificate and pictures to ``out``; return the summary.

    With several tools, each has a subfolder. ``program_path``: another program than the cell's. ``of_pass``: with the
    program of that pass of each tool, where several take turns.
    ``out`` appears complete or not at all. Raises ConfigError where it exists and is not empty, or cannot be written,
    SurfaceError, ProgramError, ComputeError, or PlanRefused with every violation.
    """
    require_new(out)
    require_writable(out.parent)
    recipes = make_recipes(config, hooks)
    if len(recipes) > 1 and program_path is not None:
        raise config.error("tools", "each tool has its own program: remove the program from the command line")
    paths = [own.program_of_pass(of_pass) if program_path is None else program_path for own in config.turns]
    surface = read_map(map_path, hooks.surface_readers().values())
    if surface.valid.any() and is_level(surface.height_nm):  # as a cell refuses it
        raise MapError(f"{map_path}: all its heights are equal: nothing was measured. Measure or export the map again")
    about_map = _require_part(surface, config.part.id, map_path)
    recipe = recipes[0]
    turns = [ToolProblem(one, steps.read_program(one, path)) for one, path in zip(recipes, paths, strict=True)]
    measured = steps.condition(recipe, surface)
    legs = [(own, one.recipe, one.program) for own, one in zip(config.turns, turns, strict=True)]
    with precheck.blame_path(*legs):
        passes = _passes(turns, measured, hooks)
    notes = [*purpose_notes(recipe, measured, passes[-1].planned.forecast), *about_map]
    if recipe.instrument is None or recipe.instrument.commissioned is None:
        notes.append("run will refuse: the cell has no commissioned instrument's profile (polishd check says more)")
    notes += [f"run will refuse: {never}"] if (never := reason_never_acceptable(recipe)) else []
    notes += [*apply_profile(surface, recipe.instrument).warnings, *measured.notes]
    notes += [note for one in passes for note in one.notes(config.program.coverage)]
    blocks = max(len(one.plan.segments) for one in passes)
    run_dir = config.run_dir or config.state_dir
    notes += (
        [f"run will refuse: {full}"] if (full := disk_space.disk_full_reason(config.state_dir, run_dir, blocks)) else []
    )
    summary = {**_summary(recipe, passes), "job": config.job.id, "run_dir": str(out), "notes": notes, **_writes(blocks)}
    with _appearing(out) as folder:
        for number, one in enumerate(passes):
            own = folder if len(passes) == 1 else folder.cycle(number)
            own.create()
            own.write(one.files())
        folder.map_file(surface)
        folder.json("summary.json", summary)
        hooks.on_event(PlanWritten(run_dir=str(folder.path)))
    return summary


def _passes(turns: Sequence[ToolProblem], measured: MeasureResult, hooks: Hooks) -> list[_Pass]:
    found, vetoes, finds = list[_Pass](), list[str](), measured
    for turn, solved in zip(turns, dwell_step.solve_tools(turns, measured), strict=True):
        recipe, program, _ = turn
        require_certificate(solved.dwell.certificate, recipe)
        plan = steps.rewrite(recipe, program, solved, program.name)
        vetoes += [f"  {_of_tool(recipe)}{veto}" for veto in hooks.check_plan(plan, recipe.envelope)]
        expected = forecast_of(recipe, finds, plan, solved.believed, solved.answer.acting)
        planned = PlanResult.of(plan, solved, steps.in_part_frame(recipe, plan.program), expected)
        found.append(_Pass(recipe, program, finds, solved, plan, planned))
        finds = steps.expected_removal(recipe, finds, solved.dwell.residual_nm)
    if vetoes:
        doubt = precheck.doubt_of_heights(measured, turns[0].recipe)
        raise PlanRefused(doubt + "\n".join(["the plan was refused, nothing was written:", *vetoes]))
    return found


def _of_tool(recipe: Recipe) -> str:
    return "" if recipe.turn is None else f"{recipe.turn.tool}: "


@contextmanager
def _appearing(out: Path) -> Iterator[RunFolder]:
    """A folder to write, which becomes ``out`` at the end; ConfigError where that is impossible."""
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
        raise unwritable_message(out, error) from error


def _require_part(surface: SurfaceMap, part_id: str, path: Path) -> list[str]:
    if surface.part_id and surface.part_id != part_id:
        raise WrongPart(f"{path}: shows part {surface.part_id!r}, not {part_id!r} (part.id); name the right map")
    return [] if surface.part_id else [f"{path.name} names no part; taken for {part_id!r} on your word"]


def _summary(recipe: Recipe, passes: Sequence[_Pass]) -> dict[str, Any]:
    now = datetime.now(UTC).isoformat(timespec="seconds")
    changes_s = sum(one.recipe.turn.change_s for one in passes if one.recipe.turn is not None)
    several = {} if len(passes) == 1 else {"total_s": changes_s + sum(_dwell_s(one) for one in passes)}
    return {
        "outcome": "planned",
        **recipe.facts(),
        **several,
        "cycles": [one.row() for one in passes],
        "certificate": asdict(passes[-1].planned.certificate),
        "ripple": passes[-1].planned.ripple.facts(),
        "gamma": _range(np.concatenate([one.planned.gamma for one in passes])),
        "compliance_um_per_n": _range(np.concatenate([one.planned.compliance_um_per_n for one in passes])),
        "points": sum(one.planned.block.size for one in passes),
        "started": now,
        "ended": now,
    }


def _dwell_s(one: _Pass) -> float:
    return float(one.planned.expected_s.sum())


def _writes(blocks: int) -> dict[str, Any]:
    """Data that the pass would write, MB: rows of the journal; table and copy in the run folder."""
    journal_mb, table_mb = blocks * disk_space.ROW_BYTES / disk_space.MB, blocks * disk_space.CSV_BYTES / disk_space.MB
    return {"blocks": blocks, "writes": {"state_mb": journal_mb, "run_mb": table_mb + journal_mb}}


def _range(values: FloatArray) -> list[float]:
    return [float(values.min()), float(values.max())]
