"""True causes against diagnoses, and a small study of them from its file to its page."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from polishd.config.study import LoopStudy, Scenario, load_study
from polishd.studies.case_runner import LoopRows, looped
from polishd.studies.closed_loop import ClosedLoopResult
from polishd.studies.options import StudyOptions
from polishd.studies.result_store import read_table
from polishd.studies.run import study_verb
from polishd.studies.summary_output import FILE, confusion_page
from tests.unit.studies.studies import TABLE_III

EXAMPLES = TABLE_III.parent
RUN = ClosedLoopResult("warm", "rate", 1, "cycles_used", "", (), 1, (18.0, 2.0), (1.0,), (18.0, 2.0), (), False, 1.0)


def rows(scenario: Scenario, *named: tuple[str, ...]) -> LoopRows:
    runs = tuple(replace(RUN, seed=seed, named=names) for seed, names in enumerate(named))
    return looped(runs, {"warm": scenario})


def test_a_row_counts_what_was_said() -> None:
    warm = Scenario(what="warm", named=("settling",), also=("rate",))
    found = rows(warm, ("settling",), ("settling", "rate"), ("shift", "settling"), (), ("rate",))
    (row,) = found.rows
    assert row.named == {"settling": 2, "settling+shift": 1, "nothing": 2}
    assert row.named_rightly == 2, "what it may say besides says nothing of what is wrong"
    assert json.loads(json.dumps(found.as_json()))[0]["named"] == row.named
    assert confusion_page(found) == (
        "| wrong is | loop | settling | nothing | settling+shift | rightly | share |\n"
        "| --- | --- | --- | --- | --- | --- | --- |\n"
        "| warm | rate | 2 | 2 | 1 | 2 of 5 | 40.0 % |\n"
    )


def test_where_nothing_is_wrong_nothing_is_to_be_said() -> None:
    (row,) = rows(Scenario(what="nothing", also=("rate",)), (), ("rate",), ("mount",)).rows
    assert (row.named_rightly, row.runs) == (2, 3)


def test_the_shipped_study_has_a_cause_a_file() -> None:
    study = load_study(EXAMPLES / "naming.toml")
    assert isinstance(study, LoopStudy)
    named = {name: one.named for name, one in study.all_scenarios().items()}
    assert sorted(named.values()) == [(), ("map",), ("mount",), ("rate",), ("settling",), ("shift",)]
    assert study.seeds == 200


@pytest.mark.full
@pytest.mark.parametrize("cause", ["settling", "bad_mount", "seat_off"])
def test_a_job_of_the_shipped_study_names_its_cause(tmp_path: Path, cause: str) -> None:
    text = (EXAMPLES / "naming.toml").read_text()
    for name in ("cell.toml", "sim.toml"):
        text = text.replace(f'"{name}"', f'"{EXAMPLES / name}"')
    path, out = tmp_path / "study.toml", tmp_path / "out"
    text = text.replace("seeds = 200", "seeds = 1")
    path.write_text(text.replace('["naming"]', f'["{EXAMPLES / "naming" / cause}.toml"]'))
    study_verb(path, StudyOptions(out=out, workers=1), as_json=True)
    assert "1 of 1 | 100.0 %" in (out / FILE).read_text()
    ((run,), _) = read_table(out)
    assert len(run["rms_nm"]) == len(run["true_rms_nm"]) == 2, "of a measurement the last map counts"
    if cause == "settling":
        assert run["rms_nm"][1] == pytest.approx(run["true_rms_nm"][1], abs=0.15), "what settles is not in the last map"
