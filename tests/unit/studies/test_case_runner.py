"""Whole jobs in a closed loop against the simulator's plant, in processes of their own."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import pytest
import typer

from polishd.config.simulator import load_plant
from polishd.config.study import LoopStudy, load_study
from polishd.config.sweep import load_swept
from polishd.model.errors import ComputeError, ConfigError, PolishdError
from polishd.studies import case_runner, plant_client
from polishd.studies.case_runner import CaseRunner, LoopRows, run_of
from polishd.studies.cases import cases_of, laid_over
from polishd.studies.options import StudyOptions
from polishd.studies.plant_client import PlantProcess
from polishd.studies.run import run_cases, study_verb
from tests.unit.studies.studies import TABLE_III, runs_here

EXAMPLES = TABLE_III.parent
SCENARIO = """
what = "{what}"
named = {named}
[plant.plant]
aperture_mm = 30.0
pv_nm = 100.0
[plant.hidden_truth]
rate = [{rate}, {rate}]
"""
LOOPS = """
[controllers.exact]
"part.aperture_mm" = 30.0
"job.tolerance_nm" = 2.5
"""
NONE = """
[controllers.none]
"part.aperture_mm" = 30.0
"process.correction" = "none"
"job.tolerance_nm" = 2.5
"""


def study_file(folder: Path, loops: str = LOOPS, more: str = "raster = true", **rates: float) -> Path:
    """A study of a small part with a scenario for each rate that the plant's is off by."""
    (folder / "wrong").mkdir()
    for name, rate in rates.items():
        (folder / "wrong" / f"{name}.toml").write_text(SCENARIO.format(what=name, named=[], rate=rate))
    path = folder / "study.toml"
    head = f'kind = "loop"\ntitle = "t"\ncell = "{EXAMPLES / "cell.toml"}"\nplant = "{EXAMPLES / "sim.toml"}"\n'
    path.write_text(f'{head}scenarios = ["wrong"]\nseeds = 1\npasses = 3\n{more}\n{loops}')
    return path


def looped(path: Path, workers: int = 1) -> LoopRows:
    """Run the study with the engine, in processes."""
    swept = load_swept(path)
    rows = run_cases(swept, StudyOptions(workers=workers)).rows
    return case_runner.looped([run_of(row) for row in rows], swept.at({}).all_scenarios())  # type: ignore[union-attr]


def timeless(found: LoopRows) -> list[object]:
    return [replace(run, cpu_s=0.0) for run in found.runs]


@pytest.mark.full
def test_a_job_comes_into_tolerance_and_the_part_itself_too(tmp_path: Path) -> None:
    (row,) = looped(study_file(tmp_path, near=-0.1), 1).rows
    assert (row.scenario, row.loop, row.runs, row.accepted, row.false_accepts) == ("near", "exact", 1, 1, 0)
    assert row.passes_median in {1, 2}
    assert row.true_rms_nm_median is not None
    assert row.true_rms_nm_median < 2.5
    assert row.named_rightly == 1, "nothing was to be named, and nothing was"


@pytest.mark.full
def test_who_works_the_cases_changes_nothing(tmp_path: Path) -> None:
    path = study_file(tmp_path, LOOPS + NONE, near=-0.1, far=-0.3)
    one, two = looped(path, 1), looped(path, 2)
    assert timeless(one) == timeless(two)
    assert [(row.scenario, row.loop) for row in one.rows] == [
        ("far", "exact"), ("far", "none"), ("near", "exact"), ("near", "none"),
    ]  # fmt: skip
    first = {(row.scenario, row.loop): row.first_pass_nm_median or 0.0 for row in one.rows}
    assert first["far", "exact"] > first["near", "exact"], "a wrong rate shows in the first pass"


@pytest.mark.full
def test_a_rate_beyond_what_may_be_learned_stops_the_loop_and_is_named(tmp_path: Path) -> None:
    found = looped(study_file(tmp_path, half=-0.6), 1)
    (run,) = found.runs
    assert (run.ended, run.named) == ("gate", ("rate",))
    assert "times the predicted one" in run.why
    assert found.rows[0].passes_median is None
    assert found.rows[0].named_rightly == 0, "the scenario's file does not say that it may be named"


@pytest.mark.full
def test_a_loop_that_does_not_learn_makes_the_same_mistake_again(tmp_path: Path) -> None:
    blind = LOOPS.replace("[controllers.exact]", "[controllers.blind]\nlearns = false").replace("2.5", "0.8")
    study = load_study(study_file(tmp_path, f"{LOOPS.replace('2.5', '0.8')}{blind}", far=-0.25))
    assert isinstance(study, LoopStudy)
    learned, not_learned = runs_here(study)
    assert learned.rms_nm[:2] == not_learned.rms_nm[:2], "before it has learned anything it is the same"
    assert learned.true_rms_nm[2] < not_learned.true_rms_nm[2]


@pytest.mark.full
def test_a_plant_that_died_is_no_end_of_a_job(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = study_file(tmp_path, near=-0.1)
    (case,) = cases_of(load_swept(path))
    bench = CaseRunner(path)
    monkeypatch.setattr(plant_client, "TARGET", "tests.unit.util.worker_targets:start_in_vain")
    with pytest.raises(ComputeError, match=r"the plant did not start: .*out of luck"):
        bench.rows(case)
    monkeypatch.undo()
    (row,) = bench.rows(case)
    bench.close()
    assert row["ended"] == "in_tolerance", "another plant took its place"


@pytest.mark.full
def test_tables_pictures_and_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = study_file(tmp_path, near=0.0), tmp_path / "out"
    study_verb(path, StudyOptions(out=out, workers=1), as_json=True)
    (row,) = json.loads(capsys.readouterr().out)
    assert row["loop"] == "exact"
    assert json.loads((out / "table.json").read_text()) == [row]
    assert (out / "controllers.png").read_bytes().startswith(b"\x89PNG")
    study_verb(path, StudyOptions(workers=1), as_json=False)
    assert "true RMS nm" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("loops", "more", "said"),
    [
        ('[controllers.odd]\n"process.corection" = "none"\n', "raster = true", "process.corection"),
        (LOOPS, "", "program.rnc: no such file"),
        (LOOPS, 'raster = "yes"', "study.toml:8: raster"),
        ("", "raster = true", "controllers"),
    ],
)
def test_an_invalid_study_is_refused_before_anything_is_computed(
    tmp_path: Path, loops: str, more: str, said: str
) -> None:
    path = study_file(tmp_path, loops, more, near=0.0)
    with pytest.raises(PolishdError, match=re.escape(said)):
        looped(path, 1)


def test_a_folder_without_scenarios_and_an_unknown_section_of_the_plant(tmp_path: Path) -> None:
    path = study_file(tmp_path)
    with pytest.raises(ConfigError, match=r"no \.toml file"):
        looped(path, 1)
    (tmp_path / "wrong" / "odd.toml").write_text('what = "x"\n[plan.hidden_truth]\nrate = [0.0, 0.0]\n')
    with pytest.raises(ConfigError, match=r"odd\.toml:2: plan.*plant"):
        looped(path, 1)


@pytest.mark.full
def test_every_shipped_scenario_is_another_plant() -> None:
    study = load_study(EXAMPLES / "scenarios.toml")
    assert isinstance(study, LoopStudy)
    sections, _ = load_plant(EXAMPLES / "sim.toml")
    drawn: dict[str, str] = {}
    with PlantProcess() as plant:
        for name, scenario in study.all_scenarios().items():
            plant.new(laid_over(sections, scenario), 1)
            reported, _ = plant.truth()
            own = [
                {k: v for k, v in scenario.plant.get("hidden_truth", {}).items() if k in {"tool_wear", "thermal_nm"}}
            ]
            undrawn = [scenario.plant.get(section) for section in ("interferometer", "process")]
            drawn[name] = json.dumps([reported["machines"], reported["effects"], own, undrawn])
    assert "nothing" in drawn
    assert len(drawn) == len(set(drawn.values())) > 15


def test_limit_and_workers_go_with_many_cases_only() -> None:
    with pytest.raises(typer.BadParameter, match="--limit"):
        study_verb(TABLE_III, StudyOptions(limit=2), as_json=True)


@pytest.mark.full
def test_a_plant_that_refuses_and_one_that_dies(monkeypatch: pytest.MonkeyPatch) -> None:
    with PlantProcess() as plant:
        with pytest.raises(ComputeError, match=r"refuses 'new'.*colour"):
            plant.new({"plant": {"colour": 1}}, 1)
        plant.new({}, 1)
        assert plant.truth()[0]["rms_nm"] > 1.0
        plant._worker.kill()
        with pytest.raises(ComputeError, match="the plant was ended by SIGKILL"):
            plant.measure()
    monkeypatch.setattr(plant_client, "TARGET", "tests.unit.util.worker_targets:start_in_vain")
    with PlantProcess() as plant, pytest.raises(ComputeError, match=r"the plant did not start: .*out of luck"):
        plant.truth()
