"""What a cycle leaves behind is the same after it was saved: as it is kept today, and as earlier jobs kept it.

Records taken apart and put together again, and the bytes of their files.
"""

from __future__ import annotations

import io
import json
import pickle
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import pytest

from polishd.hookspecs import RemovalModel
from polishd.model.errors import ComputeError, ConfigError
from polishd.model.estimates import Estimate, Estimates, MachineEstimates, MapPixels
from polishd.model.program import Program
from polishd.model.surface import Grid
from polishd.pipeline import dwell_step, steps
from polishd.pipeline.records import (
    EstimatesInUse,
    ExecutedPass,
    LearnResult,
    MeasureResult,
    PlanResult,
    SolveResult,
    arrays_of,
    as_json,
    facts_of,
    figures,
    npz,
    record_of,
    table,
)
from polishd.pipeline.steps import CachedEffect
from polishd.process.identification.findings import Forecast
from polishd.process.metrology.resampling import Registration
from tests.unit.daemon.small_job import at_rate, gaussian_effect, small_map, small_program, small_recipe

LIES = Registration(0.1, (0.3, -0.2), residual_mm=0.01, used=7, by="fiducials", scale=1.001)


EXPECTED = Forecast(0.5, 0.8, 1.4, 0.9, 0.99)


@pytest.fixture(scope="module")
def program() -> Program:
    return small_program()


@pytest.fixture(scope="module")
def measured() -> MeasureResult:
    plain = steps.condition(small_recipe(tolerance_period_mm=12.0), small_map())
    return replace(plain, registration=LIES, spikes=3, notes=("a tilt",))


@pytest.fixture(scope="module")
def solved(program: Program, measured: MeasureResult) -> SolveResult:
    return dwell_step.solve(small_recipe(curve=True), program, measured, at_rate(0.9))


@pytest.fixture(scope="module")
def planned(program: Program, solved: SolveResult) -> PlanResult:
    plan = steps.rewrite(small_recipe(), program, solved, "small.rnc")
    kept = PlanResult.of(plan, solved, steps.in_part_frame(small_recipe(), plan.program), EXPECTED)
    return replace(kept, state={"multipliers": np.arange(3.0)})


def stored(content: bytes) -> dict[str, Any]:
    with np.load(io.BytesIO(content), allow_pickle=False) as archive:
        return dict(archive)


def journalled(facts: Mapping[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(json.dumps(facts))
    return found


def assert_same(one: Any, other: Any) -> None:
    """Field by field: arrays to the last bit, with their kind."""
    assert type(one) is type(other)
    for field in fields(one):
        mine, theirs = getattr(one, field.name), getattr(other, field.name)
        if isinstance(mine, np.ndarray):
            assert mine.dtype == theirs.dtype, field.name
            np.testing.assert_array_equal(mine, theirs, field.name)
        elif field.name == "state":
            assert {k: v.tolist() for k, v in mine.items()} == {k: v.tolist() for k, v in theirs.items()}
        else:
            assert mine == theirs, field.name


def test_a_measurement(measured: MeasureResult) -> None:
    again = MeasureResult.load(stored(measured.files()["surface.npz"]), journalled(measured.facts()), "none")
    assert_same(again, measured)


def test_a_measurement_of_an_earlier_job_knows_where_the_part_lay(measured: MeasureResult) -> None:
    facts = {"sha256": "abc", **{key: measured.facts()[key] for key in ("rms_nm", "pv_nm", "lsf_rms_nm")}}
    arrays = stored(measured.files()["surface.npz"])
    again = MeasureResult.load(arrays, facts, "aperture")
    assert again.registration == Registration(0.1, (0.3, -0.2), by="aperture")
    assert (again.sha256, again.spikes, again.notes) == ("abc", 0, ())
    assert again.map_grid == measured.map_grid
    del arrays["lies"], arrays["map_grid"]
    assert MeasureResult.load(arrays, facts, "none").registration == Registration()
    assert MeasureResult.load(arrays, facts, "none").map_grid is None


@pytest.mark.full
def test_a_plan(planned: PlanResult) -> None:
    files = planned.files()
    start = stored(npz(planned.start()))
    again = PlanResult.load(stored(files["plan.npz"]), start, journalled(planned.facts()), Estimates())
    assert_same(again, planned)
    assert np.array_equal(again.kept.time_s, planned.time_s)
    assert files["dwell.csv"].splitlines()[0] == b"point,line,x_mm,y_mm,dwell_s,asked_s,expected_s"


def test_a_plan_of_an_earlier_job_believes_the_rate(planned: PlanResult) -> None:
    facts = journalled(planned.facts())
    del facts["removal"]
    again = PlanResult.load(stored(planned.files()["plan.npz"]), npz_start(planned), facts, Estimates())
    assert again.believed == EstimatesInUse(Estimates(Estimate(0.9)), 0.0)


def npz_start(planned: PlanResult) -> dict[str, Any]:
    return stored(npz(planned.start()))


UNWORN = Estimate(0.0, unit="1/h")


@dataclass(frozen=True, slots=True)
class Worn(Estimates):
    """A third-party model, which also estimates wear."""

    wear: Estimate = UNWORN


def test_the_estimates_of_a_plugins_model_are_kept_in_its_own_record() -> None:
    believed = EstimatesInUse(Worn(Estimate(0.9, 0.01), Estimate(0.5, 0.1, "1/h")), 0.004)
    assert EstimatesInUse.load(journalled(believed.facts()), Worn()) == believed
    newer = EstimatesInUse.load(journalled(at_rate(0.9).facts()), Worn(wear=Estimate(0.1)))
    assert newer.removal == Worn(Estimate(0.9), Estimate(0.1)), "what it did not know before is as at first"
    old = {"rate": 0.9, "block_overhead_s": 0.004}
    assert EstimatesInUse.load(old, Worn()) == EstimatesInUse(Worn(Estimate(0.9)), 0.004)


def test_a_model_of_a_plugin_is_asked_with_its_own_estimates_and_learns(
    program: Program, measured: MeasureResult, solved: SolveResult
) -> None:
    from polishd.api import EstimateUpdate, PassEvidence, RemovalAnswer, RemovalRequest, learn_rate

    asked: list[Estimates] = []

    def effect(request: RemovalRequest) -> RemovalAnswer:
        asked.append(request.beliefs)
        return gaussian_effect(request)

    def learn(request: RemovalRequest, evidence: PassEvidence) -> EstimateUpdate:
        lesson = learn_rate(request, evidence)
        assert isinstance(lesson.beliefs, Worn)
        return replace(lesson, beliefs=replace(lesson.beliefs, wear=Estimate(evidence.executed_s.sum(), None, "s")))

    recipe = small_recipe(model=RemovalModel("worn", effect, beliefs=Worn(), learn=learn))
    believed = steps.initial_estimates(recipe)
    removal = steps.effect_of(recipe, program, measured.grid).removal_nm(solved.expected_s)
    after = replace(measured, height_nm=measured.height_nm - 0.9 * removal)
    taught = steps.learn(recipe, program, ExecutedPass(measured, after, solved.asked_s, solved.expected_s), believed)
    assert set(asked) == {Worn()}
    assert taught.believed.rate == pytest.approx(0.9, rel=1e-3)
    assert taught.believed.facts()["removal"]["wear"]["value"] == pytest.approx(solved.expected_s.sum())


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    ("then", "alike"),
    [
        ({}, True),
        ({"registration": replace(LIES, shift_mm=(0.305, -0.2))}, True),
        ({"registration": replace(LIES, shift_mm=(0.9, -0.2))}, False),
        ({"registration": replace(LIES, rotation_deg=2.0)}, False),
        ({"map_grid": None}, False),
        ({"map_grid": Grid(70, 70, 0.9)}, False),
    ],
)
def test_a_model_gets_the_samples_of_the_maps(
    program: Program, measured: MeasureResult, solved: SolveResult, then: dict[str, Any], alike: bool
) -> None:
    from polishd.api import EstimateUpdate, PassEvidence, RemovalRequest, learn_rate

    received: list[PassEvidence] = []

    def learn(request: RemovalRequest, evidence: PassEvidence) -> EstimateUpdate:
        received.append(evidence)
        return learn_rate(request, evidence)

    recipe = small_recipe(model=RemovalModel("learner", gaussian_effect, learn=learn))
    removal = steps.effect_of(recipe, program, measured.grid).removal_nm(solved.expected_s)
    after = replace(measured, height_nm=measured.height_nm - removal, **then)
    done = ExecutedPass(measured, after, solved.asked_s, solved.expected_s)
    steps.learn(recipe, program, done, steps.initial_estimates(recipe))
    grid = small_map().grid
    lies = after.registration
    assert received[0].pixels == (MapPixels(grid, lies.rotation_deg, lies.shift_mm) if alike else None)


def test_what_a_model_will_not_go_on_after_stops_and_teaches_nothing(
    program: Program, measured: MeasureResult, solved: SolveResult
) -> None:
    from polishd.api import EstimateUpdate, PassEvidence, RemovalRequest, learn_rate

    def learn(request: RemovalRequest, evidence: PassEvidence) -> EstimateUpdate:
        return replace(learn_rate(request, evidence), stop="the spot is 3 mm off", notes=("look at the tool",))

    recipe = small_recipe(model=RemovalModel("stops", gaussian_effect, learn=learn))
    removal = steps.effect_of(recipe, program, measured.grid).removal_nm(solved.expected_s)
    after = replace(measured, height_nm=measured.height_nm - 0.9 * removal)
    believed = steps.initial_estimates(recipe)
    taught = steps.learn(recipe, program, ExecutedPass(measured, after, solved.asked_s, solved.expected_s), believed)
    assert taught.verdict.stop == "the spot is 3 mm off"
    assert taught.believed == believed
    assert taught.notes == ("look at the tool",)


def test_what_is_known_of_a_machine_is_kept() -> None:
    removal = MachineEstimates(
        Estimate(0.93, 0.02),
        applied={"width": 0.03},
        mean={"rate": -0.07, "width": 0.03},
        covariance=((4e-4, 1e-5), (1e-5, 1e-6)),
        odds={"believed": 0.0},
        pass_h=0.2,
    )
    assert EstimatesInUse.load(journalled(EstimatesInUse(removal).facts()), MachineEstimates()) == EstimatesInUse(
        removal
    )


def test_a_summary_says_what_was_measured_and_planned(measured: MeasureResult, planned: PlanResult) -> None:
    entry = figures(measured.facts(), planned.facts())
    assert entry["band_rms_nm"] == measured.figure_nm == measured.stats.band_rms_nm
    assert entry["dwell_s"] == pytest.approx(planned.expected_s.sum())
    assert figures(measured.facts(), None)["rate"] is None


# what a pass taught


@pytest.mark.parametrize("turned", [False, True])
def test_what_a_pass_taught_leaves(
    program: Program, measured: MeasureResult, solved: SolveResult, turned: bool
) -> None:
    removal = steps.effect_of(small_recipe(), program, measured.grid).removal_nm(solved.expected_s)
    after = replace(measured, height_nm=measured.height_nm - 0.9 * (removal[:, ::-1] if turned else removal))
    done = ExecutedPass(measured, after, solved.asked_s, solved.expected_s)
    taught: LearnResult = steps.learn(small_recipe(), program, done, EstimatesInUse())
    files = taught.files()
    gate = json.loads(files["gate.json"])
    assert bool(gate["stop"]) is turned
    assert gate["best"]["name"] == taught.verdict.best.name
    if turned:
        maps = stored(files["gate.npz"])
        assert set(files) == {"gate.json", "gate.npz"}
        assert np.array_equal(maps["metric_mask"], measured.metric_mask)
        assert float(maps["pitch_mm"]) == measured.grid.pitch_mm
        return
    learned = json.loads(files["learned.json"])
    assert set(learned["beliefs"]) == {"rate", "block_overhead_s", "unexplained", "ripple", "removal", "notes"}
    assert learned["beliefs"]["removal"]["rate"]["sigma"] == learned["rate_sigma"]
    keys = {"beliefs", "rate", "measured_rate", "rate_sigma", "correlation", "explained", "named", "shown", "notes"}
    assert set(learned) == keys


# the effect stays


def sent(solved: SolveResult) -> SolveResult:
    found: SolveResult = pickle.loads(pickle.dumps(solved))
    return found


def test_an_effect_is_found_again_where_it_was_made(program: Program, solved: SolveResult) -> None:
    content = pickle.dumps(solved)
    assert len(content) < 0.2 * len(pickle.dumps(gaussian_effect_of(program, solved)))
    back = pickle.loads(content)
    assert isinstance(back.answer.effect, CachedEffect)
    assert back.answer.effect.here
    assert back.answer.effect.n == program.n


def gaussian_effect_of(program: Program, solved: SolveResult) -> Any:
    return steps.effect_of(small_recipe(), program, solved.answer.effect.grid).effect


def test_elsewhere_it_is_a_name_and_a_new_worker_makes_it_again(program: Program, solved: SolveResult) -> None:
    here = steps.rewrite(small_recipe(), program, solved, "small.rnc")
    content = pickle.dumps(solved)
    pickle.loads(content)  # found once, and no more
    away = pickle.loads(content)
    with pytest.raises(ComputeError, match="in the process that solved with it"):
        away.answer.removal_nm(solved.expected_s)
    assert not sent(away).answer.effect.here, "sent on, it is still elsewhere"
    again = steps.rewrite(small_recipe(), program, away, "small.rnc")
    np.testing.assert_array_equal(again.predicted_removal_nm, here.predicted_removal_nm)


LEVEL = Estimate(0.0, unit="1/mm")


@dataclass(frozen=True)
class Field(Estimates):
    """Estimates of a third-party model."""

    tilt: Estimate = LEVEL
    modes: tuple[tuple[str, float], ...] = ()
    map_nm: np.ndarray | None = None


FIELD = Field(Estimate(0.9, 0.01), Estimate(1e-3, 2e-4, "1/mm"), (("coma", 0.5), ("trefoil", float("inf"))), np.eye(2))


def test_a_record_is_made_again_from_its_facts_as_json_and_its_arrays() -> None:
    again = record_of(Field, json.loads(as_json(facts_of(FIELD))), arrays_of(FIELD))
    assert facts_of(again) == facts_of(FIELD)
    assert np.array_equal(again.map_nm, FIELD.map_nm)
    assert isinstance(again.rate, Estimate)


def test_what_it_has_no_field_for_is_left_and_what_is_missing_is_the_default() -> None:
    assert record_of(Field, {"rate": {"value": 0.8}, "wear": 3}) == Field(Estimate(0.8))


def test_a_fact_of_another_kind_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"what was kept as Estimates cannot be read: .*value.*; finish the job with"):
        record_of(Estimates, {"rate": {"value": "fast"}})
    with pytest.raises(ConfigError, match=r"Estimate cannot be read: .*missing .* 'value'"):
        record_of(Estimate, {"sigma": 1.0})


def test_arrays() -> None:
    height = np.array([[1.5, np.nan], [-0.0, 1e300]])
    content = npz({"height": height, "mask": np.isfinite(height), "pitch": 0.5})
    with np.load(io.BytesIO(content)) as archive:
        back = dict(archive)
    assert set(back) == {"height", "mask", "pitch"}
    assert np.array_equal(back["height"], height, equal_nan=True)
    assert back["mask"].dtype == np.bool_
    assert float(back["pitch"]) == 0.5


def test_a_table() -> None:
    content = table({"seq": np.arange(2), "t_s": np.array([0.1, 123456.789]), "on": np.array([True, False])})
    assert content == b"seq,t_s,on\n0,0.1,1\n1,123456.789,0\n"


def test_a_table_of_nothing_has_its_header() -> None:
    assert table({"seq": np.zeros(0), "t_s": np.zeros(0)}).split() == [b"seq,t_s"]
