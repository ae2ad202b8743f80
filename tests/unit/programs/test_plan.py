"""``polishd plan``: the folder appears whole or not at all, whatever is wrong."""

from __future__ import annotations

import errno
import json
import re
import time
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from polishd.hookspecs import DwellSolver, SurfaceReader
from polishd.model.dwell import DwellSolution
from polishd.model.errors import ComputeError, ConfigError, MapError, PlanRefused, PolishdError, ProgramError, WrongPart
from polishd.model.events import Event
from polishd.model.instrument import CommissioningRecord, Instrument
from polishd.model.program import Plan
from polishd.model.surface import MapStep, SurfaceMap
from polishd.model.tolerance import ToleranceLine
from polishd.pipeline import disk_space
from polishd.pipeline.run_folder import RunFolder
from polishd.process.dwell.problem import DwellProblem
from polishd.programs import plan as planning
from polishd.programs.plan import plan_part
from tests.unit.daemon.small_job import CERTIFICATE, small_map, small_recipe, small_text


class Desk:
    """A map, a program, and all that planning asks."""

    def __init__(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.map = tmp_path / "scan.map"
        self.map.write_bytes(b"MAP")
        self.program = tmp_path / "small.rnc"
        self.program.write_bytes(small_text())
        self.out = tmp_path / "plans" / "one"
        self.surface = small_map()
        self.recipe = small_recipe()
        self.violations: list[str] = []
        self.events: list[Event] = []
        self.at_event: list[str] = []
        self.config: Any = SimpleNamespace(
            part=SimpleNamespace(id="P-1"),
            job=SimpleNamespace(id="by-hand"),
            program=SimpleNamespace(coverage="aperture"),
            turns=(SimpleNamespace(program_of_pass=lambda number: self.program),),
            state_dir=self.program.parent / "state",
            run_dir=None,
        )
        reader = SurfaceReader("test", lambda head, path: head == b"MAP", self.read)
        self.hooks: Any = SimpleNamespace(
            surface_readers=lambda: {"test": reader}, check_plan=self.check, on_event=self.on_event
        )
        monkeypatch.setattr(planning, "make_recipes", lambda config, hooks: (self.recipe,))

    def read(self, path: Path) -> SurfaceMap:
        return replace(self.surface, path=path)

    def check(self, plan: Plan, envelope: object) -> Sequence[str]:
        return self.violations

    def on_event(self, event: Event) -> None:
        self.events.append(event)
        self.at_event = sorted(path.name for path in Path(event.data["run_dir"]).iterdir())
        Path(event.data["run_dir"], "report.html").write_text("a report")

    def plan(self) -> dict[str, Any]:
        return plan_part(self.config, self.hooks, self.map, self.program, self.out)

    def refused(self, kind: type[PolishdError], match: str) -> None:
        """That error, and nothing is left anywhere."""
        before = sorted(self.map.parent.rglob("*"))
        with pytest.raises(kind, match=match):
            self.plan()
        assert sorted(self.map.parent.rglob("*")) == before


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Desk:
    return Desk(tmp_path, monkeypatch)


UNPROVED = "run will refuse: the cell has no commissioned instrument's profile (polishd check says more)"
FILES = ["certificate.json", "dwell.csv", "map.map", "plan.npz", "program.rnc"]
FILES += ["registration.json", "summary.json", "surface.npz"]


def test_the_folder_is_whole(desk: Desk) -> None:
    summary = desk.plan()
    assert sorted(path.name for path in desk.out.iterdir()) == sorted([*FILES, "report.html"])
    assert desk.at_event == FILES, "all files are there at the event"
    assert [path.name for path in desk.out.parent.iterdir()] == ["one"], "no scratch is left"
    kept = json.loads((desk.out / "summary.json").read_text())
    assert kept == json.loads(json.dumps(summary))
    assert (kept["outcome"], kept["job"], kept["run_dir"]) == ("planned", "by-hand", str(desk.out))
    (cycle,) = kept["cycles"]
    assert cycle["rms_nm"] > 10 > cycle["predicted_rms_nm"]
    assert cycle["executed_s"] is None
    assert kept["certificate"]["kkt_residual"] <= 1e-4
    assert kept["notes"] == [UNPROVED, "a spot for tests"]


def test_the_first_note_says_that_no_pass_is_needed(desk: Desk) -> None:
    desk.recipe = small_recipe(tolerance_nm=1000.0, tolerance=(ToleranceLine("rms", 1000.0),))
    first, second, *_ = desk.plan()["notes"]
    assert first.startswith("already in tolerance (RMS ")
    assert second == UNPROVED


def test_the_program_in_the_folder_is_the_one_that_was_planned(desk: Desk) -> None:
    desk.plan()
    text = (desk.out / "program.rnc").read_bytes()
    assert text != desk.program.read_bytes()
    with np.load(desk.out / "plan.npz") as arrays:
        read = desk.recipe.format.read(text, "again")
        assert read.n == arrays["asked_s"].size
        assert read.time_s == pytest.approx(arrays["asked_s"], rel=0.02, abs=0.01)


def test_an_empty_folder_may_be_there(desk: Desk) -> None:
    desk.out.mkdir(parents=True)
    desk.plan()
    assert (desk.out / "summary.json").exists()


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_what_is_there_is_not_touched(desk: Desk, kind: str) -> None:
    desk.out.parent.mkdir()
    taken = desk.out if kind == "file" else desk.out / "mine.txt"
    taken.parent.mkdir(exist_ok=True)
    taken.write_text("mine")
    desk.refused(ConfigError, "exists already")
    assert taken.read_text() == "mine"


# nothing is written


def test_a_folder_that_cannot_be_written_is_reported_before_anything_is_computed(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    def computed(*arguments: object) -> None:
        raise AssertionError("computed")

    monkeypatch.setattr(planning, "make_recipes", computed)
    desk.out = desk.map / "plan"
    desk.refused(ConfigError, r"scan\.map: cannot be written: Not a directory; name another with --out")


def test_no_map(desk: Desk) -> None:
    desk.map.unlink()
    desk.refused(MapError, "cannot be read")


def test_a_map_that_no_reader_knows(desk: Desk) -> None:
    desk.map.write_bytes(b"JPEG")
    desk.refused(MapError, r"no loaded reader knows this file \(tried: test\)")


def test_a_map_full_of_holes(desk: Desk) -> None:
    desk.surface.height_nm[:30] = np.nan
    desk.refused(MapError, "aperture")


def test_a_map_whose_heights_are_all_equal_is_refused_as_by_a_cell(desk: Desk) -> None:
    desk.surface = desk.surface.with_height(np.where(desk.surface.valid, 25.0, np.nan))
    desk.refused(MapError, "all its heights are equal: nothing was measured")


def test_another_parts_map(desk: Desk) -> None:
    desk.surface = replace(desk.surface, part_id="P-2")
    desk.refused(WrongPart, r"shows part 'P-2', not 'P-1' \(part\.id\)")


def test_no_program(desk: Desk) -> None:
    desk.program.unlink()
    desk.refused(ProgramError, "cannot be read")


def test_a_program_that_is_none(desk: Desk) -> None:
    desk.program.write_text("Dear Sir or Madam\n")
    desk.refused(ProgramError, r"small\.rnc, line 1")


def test_another_parts_program(desk: Desk) -> None:
    desk.program.write_bytes(small_text(3.0))
    desk.refused(ProgramError, "reaches .* of the clear aperture")


def test_a_solver_that_fails(desk: Desk) -> None:
    def fails(problem: DwellProblem, within_s: float) -> DwellSolution:
        raise ComputeError("singular")

    desk.recipe = small_recipe(solver=DwellSolver("fails", fails))
    desk.refused(ComputeError, "singular")


def test_a_dwell_without_a_certificate(desk: Desk) -> None:
    solve = desk.recipe.solver.solve

    def bad(problem: DwellProblem, within_s: float) -> DwellSolution:
        return replace(solve(problem, within_s), certificate=replace(CERTIFICATE, kkt_residual=1.0))

    desk.recipe = small_recipe(solver=DwellSolver("bad", bad))
    desk.refused(ComputeError, "no valid certificate")


def test_a_busy_machine_is_no_reason_to_refuse(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    begin = time.thread_time()
    desk.plan()
    enough_s = 3 * (time.thread_time() - begin)
    desk.recipe = small_recipe(cpu_limit_s=enough_s, kkt_tolerance=2e-5)
    desk.out = desk.out.with_name("two")
    slowness = 50.0 / enough_s  # 17 s for all of it on the wall; the backstop is above 60
    for clock in ("perf_counter", "monotonic"):
        monkeypatch.setattr(time, clock, lambda: slowness * time.thread_time())
    assert desk.plan()["certificate"]["stopped"] == "converged"


def test_a_veto(desk: Desk) -> None:
    desk.violations = ["guard: too deep", "guard: too fast"]
    desk.refused(PlanRefused, "nothing was written:\n  guard: too deep\n  guard: too fast")
    assert desk.events == []


def test_a_refused_map_of_another_unit_leads_to_its_unit_first(desk: Desk) -> None:
    """A map in um that was read as mm takes decades: a larger limits.max_pass_s is not the cure."""
    desk.recipe = replace(desk.recipe, envelope=replace(desk.recipe.envelope, max_pass_s=3600.0))
    desk.surface = replace(desk.surface, height_nm=1e5 * desk.surface.height_nm)
    found = (
        r"the map has an RMS of [\d.e+]+ nm and a PV of [\d.e+]+ nm in the clear aperture, but .* may remove \d+ nm .*"
    )
    desk.refused(
        PlanRefused, found + r"Check the unit and the sign .* takes at least \d+ s, more than limits.max_pass_s"
    )


def test_a_refused_map_of_plausible_heights_is_not_doubted(desk: Desk) -> None:
    desk.recipe = replace(desk.recipe, envelope=replace(desk.recipe.envelope, max_pass_s=15.0))
    desk.surface = small_map(rms_nm=200.0)
    desk.refused(PlanRefused, r"^(?!.*Check the unit).* more than limits.max_pass_s")


def test_a_disk_that_fills_while_it_writes(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*arguments: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(RunFolder, "write", full)
    desk.out.parent.mkdir()
    desk.refused(ConfigError, r"one: cannot be written: No space left on device; make room, or name another with --out")


# notes


def test_a_map_that_names_no_part_is_taken_on_your_word(desk: Desk) -> None:
    desk.surface = replace(desk.surface, part_id="")
    assert desk.plan()["notes"][0] == "scan.map names no part; taken for 'P-1' on your word"


def test_a_program_of_another_part_is_noted(desk: Desk) -> None:
    desk.program.write_bytes(small_text(6.0))
    notes = desk.plan()["notes"]
    assert any(note.startswith("check will refuse: small.rnc reaches ") for note in notes)
    desk.config.program.coverage, desk.out = "zone", desk.out.with_name("two")
    assert not any("reaches" in note for note in desk.plan()["notes"])


def test_what_would_forbid_to_run_is_noted(desk: Desk) -> None:
    """A program without an axis can be planned, not run."""
    desk.recipe = small_recipe(process=replace(desk.recipe.process, dip_deg=15.0))
    notes = desk.plan()["notes"]
    assert any("states no tool axis" in note for note in notes)


@pytest.mark.full
def test_what_the_pass_would_write_is_reported_and_a_disk_that_it_would_fill(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    summary = desk.plan()
    blocks = summary["blocks"]
    assert blocks == (desk.out / "program.rnc").read_bytes().count(b"\n") + 1
    assert summary["writes"] == {"state_mb": blocks * 1e-4, "run_mb": pytest.approx(blocks * 1.8e-4)}
    assert not any("blocks needs" in note for note in summary["notes"])
    desk.out = desk.out.parent / "two"
    monkeypatch.setattr(disk_space, "SPARE_MB", 1e15)
    assert any(note.startswith("run will refuse: a pass of") for note in desk.plan()["notes"])


def test_warnings_of_the_map_are_noted(desk: Desk) -> None:
    desk.surface = replace(desk.surface, warnings=("the clock was wrong",))
    assert "the clock was wrong" in desk.plan()["notes"]


@pytest.mark.full
def test_a_tilt_is_not_polished_and_a_large_one_is_noted(desk: Desk) -> None:
    plain = desk.plan()
    desk.out = desk.out.parent / "two"
    desk.surface = desk.surface.with_height(desk.surface.height_nm + 150.0 / 20.0 * desk.surface.grid.x_mm)
    tilted = desk.plan()
    assert tilted["cycles"][0]["dwell_s"] == pytest.approx(plain["cycles"][0]["dwell_s"], rel=1e-3)
    (note,) = [note for note in tilted["notes"] if "alignment" in note]
    assert re.match(r"tilt of 1\d\d\.?\d* nm PV in the clear aperture taken off as alignment \(part.alignment\)", note)
    assert not any("alignment" in note for note in plain["notes"])


def test_a_tilt_that_is_polished_is_said(desk: Desk) -> None:
    """If tilt counts as figure, the plan states its share of the work."""
    desk.recipe = small_recipe(alignment="piston")
    desk.surface = desk.surface.with_height(desk.surface.height_nm + 150.0 / 20.0 * desk.surface.grid.x_mm)
    (note,) = [note for note in desk.plan()["notes"] if "part.alignment" in note]
    assert "nm RMS a tilt makes" in note
    assert "it is polished away" in note


def test_a_map_that_leaves_something_unsaid_needs_a_profile_that_gives_it(desk: Desk) -> None:
    doubt = "how its rows lie is left open"
    desk.surface = replace(
        desk.surface, unsaid=frozenset({"orientation"}), doubts={"orientation": doubt}, warnings=(doubt, "cut")
    )
    desk.refused(MapError, "orientation")
    desk.recipe = small_recipe(instrument=Instrument("bench", gives=frozenset({"orientation"})))
    assert desk.plan()["notes"][:2] == [UNPROVED, "cut"], "what the profile gives is no longer called open"


def test_a_map_with_the_profile_in_it_is_not_turned_again(desk: Desk) -> None:
    desk.surface = replace(desk.surface, history=MapStep("average", "1", {"profile": "bench"}, ()))
    desk.recipe = small_recipe(instrument=Instrument("bench"))
    desk.refused(MapError, "had the profile applied before")


def test_a_commissioned_profile_needs_no_note(desk: Desk) -> None:
    proof = CommissioningRecord(datetime(2026, 1, 1, tzinfo=UTC), "bumps", "0" * 64, 0.99, 0.4, "1" * 64)
    desk.recipe = small_recipe(instrument=Instrument("bench", commissioned=proof))
    assert desk.plan()["notes"] == ["a spot for tests"]


@pytest.mark.full
def test_the_program_is_that_of_the_pass(desk: Desk) -> None:
    """Where several take turns; another one of the command line is that of any pass."""
    other = desk.program.with_name("between.rnc")
    other.write_bytes(small_text().replace(b"Y", b"(between)\nY", 1))
    desk.config.turns = (SimpleNamespace(program_of_pass=lambda number: (desk.program, other)[(number - 1) % 2]),)
    for of_pass, path in ((1, desk.program), (2, other), (3, desk.program)):
        out = desk.out.with_name(f"pass-{of_pass}")
        plan_part(desk.config, desk.hooks, desk.map, None, out, of_pass=of_pass)
        assert (b"(between)" in (out / "program.rnc").read_bytes()) == (path is other)
