"""Write run folders as the daemon does, with its journal, records and steps, without a cell."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles, with_values, write_demo
from polishd.daemon.job.job import cycle_entries
from polishd.daemon.job.resume_checks import terms_of
from polishd.daemon.journal.journal import Journal
from polishd.daemon.journal.records import BlockRecord
from polishd.model import events
from polishd.model.devices import ExecutedBlock
from polishd.model.dwell import OptimalityCertificate
from polishd.model.states import Outcome
from polishd.model.surface import FloatArray
from polishd.pipeline import steps
from polishd.pipeline.build_recipe import make_recipe
from polishd.pipeline.recipe import Recipe
from polishd.pipeline.records import MeasureResult, as_json, facts_of, made_ripple
from polishd.pipeline.run_folder import RunFolder, read_map
from polishd.plugin_loader import load_cell
from tests.commissioned import forged
from tests.system.cell_rig import with_keys
from tests.unit.maps.maps import PITCH_MM, dat

APERTURE_MM = 30.0
BLOCKS = 40
CUTOFF_MM = 2.4
BETTER = 8.0
"""Factor by which each complete pass reduces the error."""


def heights(seed: int, size: float) -> FloatArray:
    """Return heights (64, 64) in nm: tilt, astigmatism, a bump and noise over the part."""
    axis = (np.arange(64) - 31.5) * PITCH_MM
    x, y = np.meshgrid(axis / 15.0, -axis / 15.0)
    noise = np.random.default_rng(seed).normal(0.0, 0.02, x.shape)
    figure = x**2 - y**2 + 0.8 * np.exp(-((x - 0.3) ** 2 + y**2) / 0.05) + noise
    return np.where(np.hypot(x, y) <= 1.02, size * figure + 5.0 * x, np.nan)


@dataclass
class Making:
    """Writer of a run."""

    files: DemoFiles
    recipe: Recipe
    journal: Journal
    folder: RunFolder
    last: MeasureResult | None = None
    size_nm: float = 20.0
    readers: Sequence[Any] = field(default_factory=list)
    ripple: Sequence[dict[str, Any]] = ()
    """Ripple lines that each pass adds."""

    def measure(self, cycle: int) -> None:
        """Condition a map, record it in the journal and save it."""
        self.folder.cycle(cycle).create()
        path = dat(self.folder.path / f"cycle-{cycle:02d}" / "map.dat", heights(cycle, self.size_nm), part="DEMO-100")
        surface = read_map(path, self.readers)
        last = self.last
        known = (None, None) if last is None else (last.masks, last.registration)
        ripple = made_ripple([record.facts for record in self.journal.passes])
        measured = steps.condition(self.recipe, surface, *known, ripple)
        self.last = self.last or measured
        self.journal.record_map(cycle, surface.sha256, path, measured.facts(), "")
        self.folder.cycle(cycle).write(measured.files())
        facts = measured.facts()
        values = {"stats": measured.stats, "judged": facts["judged"], "spikes": 0, "notes": list(measured.notes)}
        self.journal.record_event(events.MapMeasured(cycle=cycle, run_dir=str(self.folder.path), **values))

    def polish(self, cycle: int, *, share: float = 1.0) -> None:
        """Record a pass; below a share of 1 it is interrupted with three uncertain blocks."""
        program = b"G1 X%d\n" % cycle
        self.folder.cycle(cycle).bytes("program.rnc", program)
        certificate = facts_of(
            OptimalityCertificate("newton_cg", 1.0, 1e-6, 0.0, 0.5, 3.0, 40.0, 50.0, 1, 0, 9, 0.1, "converged")
        )
        certificate["cutoff_period_mm"] = CUTOFF_MM
        facts = {"certificate": certificate, "predicted_rms_nm": 0.5, "dwell_s": 1.0 * BLOCKS, "rate": 1.0}
        facts["forecast"] = {"low_nm": 0.5, "median_nm": 1.5, "high_nm": 4.0, "ripple": {"lines": self.ripple}}
        digest = hashlib.sha256(program).hexdigest()
        self.journal.begin_pass(cycle, digest, "boot", BLOCKS, facts=facts)
        done = int(share * BLOCKS)
        blocks = [
            BlockRecord(ExecutedBlock(k, float(k), k + 1.0), True, 12.0 + 0.1 * (k % 2), 1000.0) for k in range(done)
        ]
        self.journal.record_executed(cycle, blocks)
        if share < 1:
            self.journal.mark_uncertain(cycle, done, done + 3)
            self.journal.end_pass(cycle, "interrupted")
            return
        self.journal.end_pass(cycle, "done")
        shown = {"rate": {"value": 1.02, "sigma": 0.01}, "expected_nm": [0.5, 4.0], "seen_nm": 2.0}
        self.journal.add_facts(cycle, {"shown": shown, "findings": []})
        self.size_nm /= BETTER

    def held(self, error: str) -> None:
        """Record an error that holds the cell and the operator's ``resume``."""
        self.journal.record_event(events.CellHeld(error=error, kind="LinkError"))
        self.journal.record_event(events.CommandReceived(order="resume", reason="cable put back"))

    def end(self, outcome: Outcome = Outcome.IN_TOLERANCE, *, over: bool = True, **summary: Any) -> Path:
        """Write the summary and the copy of the journal."""
        if over:
            self.journal.record_outcome(outcome)
        entries = cycle_entries(self.journal, several_tools=False)
        ending = {
            "outcome": outcome.value,
            "job": "demo",
            "run_dir": str(self.folder.path),
            "notes": [],
            "version": "0.1.0",
        }
        content = json.loads(as_json({**self.recipe.facts(), "cycles": entries, **ending, **summary}))
        self.folder.json("summary.json", content)
        self.journal.copy_to(self.folder.path / "journal.sqlite")
        return self.folder.path


def begin(
    out: Path,
    prepare: Callable[[DemoFiles], object] = lambda files: None,
    *,
    repeatability_nm: float | None = 0.2,
    **sections: dict[str, Any],
) -> Making:
    """Begin the job of a small part in the demo's cell; ``prepare`` is called before any file is read."""
    files = write_demo(out, None, 2.0, 4, None)
    part = {"part": {"aperture_mm": APERTURE_MM}}
    files.cell.write_text(with_keys(with_values(files.cell.read_text(), part), sections))
    if repeatability_nm is not None:
        files.profile.write_text(
            with_values(files.profile.read_text(), {"repeatability": {"rms_nm": repeatability_nm}})
        )
    forged(files.profile)
    prepare(files)
    config, hooks = load_cell(files.cell)
    files.state_dir.mkdir()
    folder = RunFolder(files.run_dir)
    folder.create()
    for path, name in ((files.cell, "cell.toml"), (files.profile, "instrument.toml")):
        shutil.copyfile(path, files.run_dir / name)
    terms = terms_of(config, {}, "ab" * 32)
    journal = Journal.open(files.state_dir, job=config.job.id, part_id=config.part.id, terms=terms)
    journal.record_run_dir(files.run_dir)
    readers = list(hooks.surface_readers().values())
    return Making(files, make_recipe(config, hooks), journal, folder, readers=readers)


def whole_run(out: Path, **sections: Any) -> DemoFiles:
    """Write a run of two passes without an error, the last of which reaches the tolerance."""
    made = begin(out, **sections)
    with closing(made.journal):
        for cycle in (0, 1):
            made.measure(cycle)
            made.polish(cycle)
        made.measure(2)
        made.end()
    return made.files


def torn_run(out: Path) -> DemoFiles:
    """Write a run with a pass that a lost link interrupted at a third, and a complete one; not in tolerance."""
    made = begin(out)
    with closing(made.journal):
        made.size_nm = 60.0
        made.measure(0)
        made.polish(0, share=0.33)
        made.held("robot: the link is silent")
        made.measure(1)
        made.polish(1)
        made.measure(2)
        made.end(Outcome.CYCLES_USED)
    return made.files
