"""Summaries of many cases: medians and intervals, pairs, sensitivity, where it fails, causes against diagnoses."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polishd.config.study import LoopStudy, Scenario, load_study
from polishd.studies.case_runner import LoopRows, looped
from polishd.studies.closed_loop import ClosedLoopResult
from polishd.studies.options import StudyOptions
from polishd.studies.output import FILE, confusion_page, summary_pictures, summary_tables
from polishd.studies.result_store import read_table
from polishd.studies.run import study_verb
from polishd.studies.summary import middle, share, summarise
from tests.unit.studies.studies import TABLE_III

EXAMPLES = TABLE_III.parent
RUN = ClosedLoopResult("warm", "rate", 1, "cycles_used", "", (), 1, (18.0, 2.0), (1.0,), (18.0, 2.0), (), False, 1.0)

POINTS = 30


def loop_rows(scenario: Scenario, *named: tuple[str, ...]) -> LoopRows:
    runs = tuple(replace(RUN, seed=seed, named=names) for seed, names in enumerate(named))
    return looped(runs, {"warm": scenario})


def test_a_row_counts_what_was_said() -> None:
    warm = Scenario(what="warm", named=("settling",), also=("rate",))
    found = loop_rows(warm, ("settling",), ("settling", "rate"), ("shift", "settling"), (), ("rate",))
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
    (row,) = loop_rows(Scenario(what="nothing", also=("rate",)), (), ("rate",), ("mount",)).rows
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


def row(point: int, loop: str, rms_nm: float, passes: int, **more: Any) -> dict[str, Any]:
    return {
        "case": point,
        "point": point,
        "over.first_seed": point,
        "over.plant_with.hidden_truth.rate": point / POINTS,
        "over.passes": 2 + point % 2,
        "scenario": "nothing",
        "loop": loop,
        "seed": 1,
        "error": None,
        "accepted": rms_nm < 20.0,
        "passes": passes,
        "true_rms_end_nm": rms_nm,
        **more,
    }


@pytest.fixture
def rows() -> list[dict[str, Any]]:
    """Loop b is 1 nm worse than a everywhere, and both are worse the higher the rate."""
    return [row(k, loop, k + extra, 1 + k // 10) for k in range(POINTS) for loop, extra in (("a", 0.0), ("b", 1.0))]


@pytest.mark.full
def test_medians_have_intervals_by_ranks() -> None:
    found = middle([float(k) for k in range(1, 101)])
    assert (found.median, found.low, found.high) == (50.5, 40.0, 61.0)
    assert middle([1.0, 2.0, 3.0]).low is None, "three values give no interval"
    assert middle([]).median is None
    assert middle([1.0, math.inf, math.inf]).median is None, "half of them never came"


def test_intervals_hold_the_median_as_often_as_they_say() -> None:
    rng = np.random.default_rng(2)
    held = 0
    for _ in range(400):
        one = middle(rng.lognormal(0.0, 1.0, 40).tolist())
        held += one.low is not None and one.high is not None and one.low <= 1.0 <= one.high
    assert 0.93 < held / 400 < 0.995


def test_shares_are_wilsons() -> None:
    assert share(0, 10) == (0.0, pytest.approx(0.0), pytest.approx(0.2775, abs=1e-3))


def test_groups_pairs_and_what_goes_with_what(rows: list[dict[str, Any]]) -> None:
    found = summarise(rows)
    assert found.kind == "loop"
    assert [dict(group.label) for group in found.groups] == [{"loop": "a"}, {"loop": "b"}], "one scenario is no label"
    assert [group.failed for group in found.groups] == [10, 11]
    assert found.groups[0].figures["true_rms_end_nm"].median == 14.5
    (rms, passes) = found.paired
    assert (rms.against, rms.pairs, rms.lower, rms.same, rms.higher) == ("a", 30, 0, 0, 30)
    assert rms.difference.median == pytest.approx(1.0)
    assert (passes.figure, passes.pairs, passes.higher) == ("passes_to_tolerance", 30, 1), "one is accepted no more"
    by = {one.key: one for one in found.sensitivity if one.label == {"loop": "a"}}
    assert set(by) == {"plant_with.hidden_truth.rate", "passes"}, "nothing goes with a seed"
    assert by["plant_with.hidden_truth.rate"].figure == pytest.approx(1.0)
    rate = [
        one.share[0] for one in found.fails if one.label == {"loop": "a"} and one.key == "plant_with.hidden_truth.rate"
    ]
    assert rate == [0.0, 0.0, 1.0]
    assert {one.where for one in found.fails if one.key == "passes"} == {"2", "3"}, "few values are listed singly"


def test_a_case_with_an_error_fails_and_has_no_figures(rows: list[dict[str, Any]]) -> None:
    bad = row(30, "a", 0.0, 0, error="killed its worker: signal 9", accepted=None, true_rms_end_nm=None)
    (first, _) = summarise([*rows, bad]).groups
    assert (first.cases, first.failed, first.errors) == (31, 11, 1)
    assert first.figures["true_rms_end_nm"].median == 14.5


def test_jobs_of_which_none_came_so_far_as_a_figure_are_jobs_still() -> None:
    none = {"rms_nm": [], "true_rms_end_nm": None, "ended": "error"}
    rows = [{**row(k, "a", 30.0, 0), **none} for k in range(3)]
    found = summarise(rows)
    assert found.kind == "loop"
    assert found.groups[0].figures["true_rms_end_nm"].median is None
    assert found.groups[0].share[0] == 1.0
    assert summary_tables("t", found)
    assert all(draw() for draw in summary_pictures(found).values())


@pytest.mark.full
def test_tables_and_pictures_are_of_all_of_it(rows: list[dict[str, Any]]) -> None:
    found = summarise(rows)
    titles = [str(table.title) for table in summary_tables("t", found)]
    assert [title.partition(": ")[2].split(",")[0] for title in titles] == [
        "medians", "on the same draws", "rank correlation of true_rms_end_nm with", "share that fails",
    ]  # fmt: skip
    pictures = summary_pictures(found)
    assert set(pictures) == {"medians.png", "sensitivity.png", "fails.png"}
    assert all(draw().startswith(b"\x89PNG") for draw in pictures.values())


def test_other_kinds_are_known_by_their_figures() -> None:
    one = {"case": 0, "point": 0, "seed": None, "error": None, "plant": "depth", "rms_nm": 2.0, "pv_nm": 9.0}
    found = summarise([{**one, "correction": "none", "dwell_s": 1.0}, {**one, "correction": "exact", "dwell_s": 2.0}])
    assert found.kind == "corrections"
    assert [dict(group.label) for group in found.groups] == [{"correction": "none"}, {"correction": "exact"}]
    assert [one.figure for one in found.paired] == ["rms_nm", "pv_nm", "dwell_s"]
