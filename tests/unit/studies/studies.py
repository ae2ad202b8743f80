"""The shipped studies, and small variants of them for speed."""

from __future__ import annotations

from pathlib import Path

from polishd.config.study import LoopStudy
from polishd.config.sweep import SweepStudy
from polishd.studies.case_runner import closed_loop
from polishd.studies.cases import CaseFactory
from polishd.studies.closed_loop import ClosedLoopResult
from polishd.studies.plant_client import PlantProcess

EXAMPLES = Path(__file__).parents[3] / "examples"
TABLE_IV, TABLE_III, FIG_12 = (EXAMPLES / f"{name}.toml" for name in ("table_iv", "table_iii", "fig_12"))


def variant(folder: Path, shipped: Path, *changes: tuple[str, str]) -> Path:
    """Write a copy of a shipped study with replaced pieces of text; each of them must exist."""
    text = shipped.read_text(encoding="utf-8")
    for old, new in changes:
        assert old in text, f"{shipped.name} has no {old!r}"
        text = text.replace(old, new, 1)
    path = folder / shipped.name
    path.write_text(text, encoding="utf-8")
    return path


SMALL = (
    ("aperture_mm = 60.0", "aperture_mm = 24.0"),
    ("period_mm = [33.0, 120.0]", "period_mm = [14.0, 40.0]"),
    ("kkt_tolerance = 1e-6 ", "kkt_tolerance = 1e-4 "),
)


def small(folder: Path, *changes: tuple[str, str]) -> Path:
    """Write Table IV on 24 mm: a sixth of the points, with a limited number of iterations."""
    return variant(folder, TABLE_IV, *SMALL, *changes)


def line_of(path: Path, start: str) -> int:
    """Return the 1-based number of the first line with that start."""
    lines = path.read_text(encoding="utf-8").splitlines()
    return next(number for number, line in enumerate(lines, 1) if line.startswith(start))


def runs_here(study: LoopStudy) -> list[ClosedLoopResult]:
    """Run all jobs of a study in this process as a worker does. The study needs no file."""
    making = CaseFactory(SweepStudy(study.base_dir, {}, study.source, ({},), is_sweep=False))
    with PlantProcess() as plant:
        return [
            closed_loop(study, loop).run(plant, making.plant(study, scenario), scenario, loop, seed)
            for seed in range(study.first_seed, study.first_seed + study.seeds)
            for scenario in making.scenarios(study)
            for loop in study.controllers
        ]
