"""The solve step has one limit of time, which its solves share."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import pytest

from polishd.hookspecs import DwellSolver
from polishd.model.dwell import DwellSolution
from polishd.model.errors import ComputeError
from polishd.pipeline import dwell_step, steps
from polishd.pipeline.dwell_step import require_certificate
from polishd.pipeline.recipe import Recipe
from polishd.pipeline.records import MeasureResult, SolveResult
from polishd.process.dwell import newton_cg
from polishd.process.dwell.problem import DwellProblem
from tests.unit.daemon.small_job import small_map, small_program, small_recipe


class Costly:
    """Solver that needs a given CPU time for each problem, on a machine that takes twice as much wall time."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, needs_s: float) -> None:
        self.needs_s = needs_s
        self.given: list[float] = []
        self.used_s = 0.0
        monkeypatch.setattr(time, "thread_time", lambda: self.used_s)
        monkeypatch.setattr(time, "monotonic", lambda: 2 * self.used_s)

    def solve(self, problem: DwellProblem, within_s: float) -> DwellSolution:
        self.given.append(within_s)
        self.used_s += min(self.needs_s, within_s)
        found = newton_cg.solve(problem, 1.0)
        if within_s >= self.needs_s:
            return found
        cut_short = replace(found.certificate, stopped="deadline", kkt_residual=9.8e-3, iterations=7)
        return replace(found, certificate=replace(cut_short, objective=1.5 * cut_short.objective))

    def recipe(self, **changes: Any) -> Recipe:
        return small_recipe(**({"solver": DwellSolver("costly", self.solve)} | changes))


def solved(recipe: Recipe) -> SolveResult:
    measured: MeasureResult = steps.condition(recipe, small_map())
    return dwell_step.solve(recipe, small_program(), measured)


def total_s() -> float:
    return solved(small_recipe()).dwell.certificate.dwell_total_s


@pytest.mark.full
def test_what_is_left_is_what_each_solve_gets(monkeypatch: pytest.MonkeyPatch) -> None:
    budget = 0.8 * total_s()
    costly = Costly(monkeypatch, 1.0)
    other = DwellSolver("other", costly.solve)
    solved(
        costly.recipe(
            cpu_limit_s=500.0, objective="budget", budget_s=budget, curve=True, cross_check=other, cross_check_above=0.0
        )
    )
    assert len(costly.given) > 20, "search, cross-check and curve"
    assert costly.given == [500.0 - done for done in range(len(costly.given))]


def test_the_last_solve_has_its_share(monkeypatch: pytest.MonkeyPatch) -> None:
    costly = Costly(monkeypatch, 100.0)
    certificate = solved(costly.recipe(cpu_limit_s=40.0)).dwell.certificate
    assert costly.given[0] == pytest.approx(30.0)
    assert costly.given[-1] == pytest.approx(10.0)
    assert sum(costly.given) == pytest.approx(40.0)
    with pytest.raises(ComputeError) as caught:
        require_certificate(certificate, small_recipe())
    for words in (
        "KKT residual 9.80e-03 is above 1.00e-04",
        "deadline after 7 iterations, 40.0 s of CPU time and 80.0 s of wall time for the whole solve step",
        "dwell.cpu_limit_s",
    ):
        assert words in str(caught.value)


def test_the_last_solve_ends_what_the_rounds_began(monkeypatch: pytest.MonkeyPatch) -> None:
    costly = Costly(monkeypatch, 35.0)

    def goes_on(problem: DwellProblem, within_s: float) -> DwellSolution:
        """From where it was before."""
        found = costly.solve(problem, within_s)
        costly.needs_s -= within_s
        return found

    certificate = solved(costly.recipe(solver=DwellSolver("goes_on", goes_on), cpu_limit_s=40.0)).dwell.certificate
    require_certificate(certificate, small_recipe())


@pytest.mark.parametrize("choose", [{"objective": "target", "target_nm": 1.0}, {"objective": "knee"}])
def test_a_search_that_is_cut_short_is_refused(choose: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    costly = Costly(monkeypatch, 2.0)
    with pytest.raises(ComputeError) as caught:
        solved(costly.recipe(cpu_limit_s=3.0, **choose))
    for words in (
        f'objective = "{choose["objective"]}" takes many solves, and its time was over after 1:',
        "3.0 s of CPU time and 6.0 s of wall time were used, and the next solve's KKT residual was 9.80e-03 after 7",
        "dwell.cpu_limit_s is 3 s",
    ):
        assert words in str(caught.value)


def test_a_plan_is_not_refused_for_want_of_its_curve(monkeypatch: pytest.MonkeyPatch) -> None:
    costly = Costly(monkeypatch, 1.0)
    found = solved(costly.recipe(cpu_limit_s=8.0, curve=True))
    assert found.curve == ()
    assert found.dwell.certificate.stopped == "converged"
    assert found.dwell.certificate.notes[-1].startswith("no curve of residual against time: curve takes many solves")


def test_a_cross_check_that_is_cut_short_says_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    slow = DwellSolver("slow", Costly(monkeypatch, 100.0).solve)
    certificate = solved(small_recipe(cpu_limit_s=10.0, cross_check=slow, cross_check_above=0.0)).dwell.certificate
    assert (certificate.cross_check, certificate.cross_check_gap) == (None, None)
    assert certificate.notes[-1] == "cross-check by slow was not done in what was left of dwell.cpu_limit_s"


def test_the_workers_limit_follows_from_the_same_key() -> None:
    limit = dwell_step.limit(small_recipe(cpu_limit_s=30.0))
    assert limit.within_s == 120.0
    assert limit.key == "dwell.cpu_limit_s (30 s)"
