"""Several tools in one problem: against each alone, and against the same problem written out."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
from scipy import ndimage

from polishd.model.errors import ComputeError
from polishd.model.surface import FloatArray
from polishd.process.dwell.from_arrays import (
    ArrayTool,
    DwellCase,
    ToolsDwell,
    array_problem,
    dwell_from_arrays,
    dwell_of_tools,
)
from polishd.process.dwell.interior_point import solve as interior_point
from polishd.process.dwell.newton_cg import solve as newton_cg
from polishd.process.metrology.statistics import slope
from polishd.process.removal.combined_effect import CombinedEffect, combine_effects

X = np.arange(-20, 20.1, 1.0)
MASK = np.hypot(X, X[:, None]) < 18


def gauss(sigma_mm: float, peak_nm_s: float) -> FloatArray:
    """(k, k) at 0.5 mm."""
    at = np.arange(-round(8 * sigma_mm), round(8 * sigma_mm) + 1) * 0.5
    return np.asarray(peak_nm_s * np.exp(-(at**2 + at[:, None] ** 2) / (2 * sigma_mm**2)))


def figure() -> FloatArray:
    rng = np.random.default_rng(5)
    rough = sum(a * s * ndimage.gaussian_filter(rng.standard_normal(MASK.shape), s) for a, s in ((3, 8), (1, 2)))
    return np.asarray(np.where(MASK, 40 * rough / np.std(rough) - (40 * rough / np.std(rough))[MASK].min(), np.nan))


LARGE = ArrayTool("large", gauss(3.0, 60.0), 0.5, step_mm=2.5, change_s=60.0)
SMALL = ArrayTool("small", gauss(1.0, 15.0), 0.5, step_mm=1.5, change_s=60.0)
CASE = DwellCase(X, X[::-1], figure(), SMALL.tif_nm_s, 0.5, rho=1e-4)
QUICK = partial(newton_cg, within_s=60.0)


@cache
def both(target_nm: float | None = None) -> ToolsDwell:
    return dwell_of_tools(CASE, [LARGE, SMALL], target_rms_nm=target_nm, solve=QUICK)


def alone(tool: ArrayTool) -> DwellCase:
    return replace(CASE, tif_nm_s=tool.tif_nm_s, points_mm=tool.points_mm, step_mm=tool.step_mm)


def test_the_removals_of_the_passes_make_up_the_one_that_is_certified() -> None:
    found = both()
    assert [one.tool.name for one in found.passes] == ["large", "small"]
    total = sum(one.removal_nm for one in found.passes)
    left = np.where(MASK, CASE.height_nm - total, np.nan)
    assert np.nanstd(left[MASK]) == pytest.approx(found.certificate.predicted_rms_nm, rel=1e-9)
    assert found.certificate.kkt_residual < 1e-5
    times = np.concatenate([one.time_s for one in found.passes])
    assert found.total_s == pytest.approx(times.sum() + 120.0)


@pytest.mark.full
def test_in_the_same_time_both_leave_less_than_each_alone() -> None:
    budget_s = dwell_from_arrays(alone(SMALL), target_rms_nm=2.0, solve=QUICK).certificate.dwell_total_s
    joint = dwell_of_tools(
        CASE, [replace(LARGE, change_s=0.0), replace(SMALL, change_s=0.0)], budget_s=budget_s, solve=QUICK
    )
    assert joint.certificate.predicted_rms_nm < 2.0
    assert joint.total_s <= budget_s
    rows = {tuple(row["tools"]): row for row in joint.tried}  # type: ignore[arg-type]
    assert rows[("large",)]["rms_nm"] > rows[("large", "small")]["rms_nm"]  # type: ignore[operator]


@pytest.mark.full
def test_a_change_that_costs_more_than_it_saves_is_not_made() -> None:
    """A rough target is the large tool's; a fine one needs both, or the small one for long."""
    names = {target: [one.tool.name for one in both(target).passes] for target in (20.0, 1.2)}
    assert names[20.0] == ["large"]
    assert "small" in names[1.2]
    dear = dwell_of_tools(CASE, [replace(LARGE, change_s=1e6), SMALL], target_rms_nm=1.2, solve=QUICK)
    assert [one.tool.name for one in dear.passes] == ["small"]
    least = min(row["total_s"] for row in dear.tried if "total_s" in row)  # type: ignore[type-var]
    assert dear.total_s == least


@pytest.mark.full
def test_the_slope_can_be_asked_for_and_is_met() -> None:
    plain = both(6.0)
    was = slope(np.nan_to_num(plain.residual_nm), MASK, 1.0).rms_urad
    found = dwell_of_tools(CASE, [LARGE, SMALL], target_rms_nm=6.0, target_slope_urad=0.7 * was, solve=QUICK)
    now = slope(np.nan_to_num(found.residual_nm), MASK, 1.0).rms_urad
    assert 0.69 * was < now <= 0.7 * was
    assert found.certificate.predicted_rms_nm <= 6.0
    assert found.total_s > plain.total_s


@pytest.mark.full
def test_a_goal_that_none_reaches_is_refused_with_what_each_came_to() -> None:
    with pytest.raises(
        ComputeError, match=r"no choice of tools reaches the target:\n  large: 0\.0001 nm RMS is out of reach"
    ):
        both(1e-4)
    with pytest.raises(ComputeError, match="two ways"):
        dwell_of_tools(CASE, [LARGE], budget_s=10.0, target_slope_urad=1.0)
    with pytest.raises(ComputeError, match="0 tools: give one to 5"):
        dwell_of_tools(CASE, [])
    with pytest.raises(ComputeError, match="small: tif_nm_s is negative"):
        dwell_of_tools(CASE, [replace(SMALL, tif_nm_s=-SMALL.tif_nm_s)])


def test_effects_of_several_are_their_sum_and_transposed_right() -> None:
    parts = [array_problem(alone(tool))[0].effect for tool in (LARGE, SMALL)]
    written, summed = combine_effects(parts), CombinedEffect(tuple(parts))
    rng = np.random.default_rng(2)
    time, weight = rng.uniform(0, 1, written.n), rng.standard_normal(MASK.shape)
    np.testing.assert_allclose(summed.removal_nm(time), written.removal_nm(time), rtol=1e-12)
    np.testing.assert_allclose(summed.adjoint(weight), written.adjoint(weight), rtol=1e-12, atol=1e-9)
    assert float((summed.removal_nm(time) * weight).sum()) == pytest.approx(float(time @ summed.adjoint(weight)))


@pytest.mark.full
def test_it_is_the_optimum_of_the_matrix_written_out() -> None:
    """The interior point and Newton-CG share no step; the sum of effects goes the way of one without a matrix."""
    found = dwell_of_tools(CASE, [LARGE, SMALL])
    exact = interior_point(found.problem, 600.0)
    parts = tuple(array_problem(alone(tool))[0].effect for tool in (LARGE, SMALL))
    summed = newton_cg(replace(found.problem, effect=CombinedEffect(parts)), 600.0, 1e-7)
    assert found.certificate.objective == pytest.approx(exact.certificate.objective, rel=1e-5)
    assert summed.certificate.objective == pytest.approx(exact.certificate.objective, rel=1e-5)
