"""The choice of the mean removal and of the regularisation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polishd.model.errors import ComputeError
from polishd.process.dwell.newton_cg import solve
from polishd.process.dwell.quadratic import (
    choose_piston_nm,
    condition,
    conditioning_note,
    regularisation_from_rho,
    sigma_max,
)
from tests.unit.process.gaussian import dwell_problem, rough, scaled

PROBLEM = dwell_problem(radius_mm=10)
EFFECT, MASK = PROBLEM.effect, PROBLEM.solve_mask
ZERO = np.zeros(MASK.shape)


def test_by_hand() -> None:
    height = np.array([[-5.0, -1.0, 0.0, 2.0]])
    least = np.array([[1.0, 1.0, 3.0, 1.0]])
    mask = np.ones((1, 4), dtype=bool)
    # wanted at least: 6, 2, 3, -1
    assert choose_piston_nm(height, mask, least, 0.0) == 6
    assert choose_piston_nm(height, mask, least, 0.25) == 3
    assert choose_piston_nm(height, mask, least, 0.3) == 3
    assert choose_piston_nm(height, mask, least, 0.5) == 2
    mask[0, 0] = False
    assert choose_piston_nm(height, mask, least, 0.0) == 3


@settings(max_examples=40)
@given(st.integers(0, 1000), st.floats(0, 0.9), st.floats(-100, 100))
def test_it_is_the_smallest_that_reaches_all_but_the_fraction(seed: int, unreachable: float, shift: float) -> None:
    height = rough(EFFECT.grid, seed=seed) + shift
    least = EFFECT.removal_nm(PROBLEM.lower_s)
    piston = choose_piston_nm(height, MASK, least, unreachable)
    count = np.count_nonzero(MASK)

    def short(p: float) -> int:
        return int(np.count_nonzero((height + p - least)[MASK] < -1e-9))

    assert short(piston) <= unreachable * count + 1e-6
    assert short(piston - 1e-6) > unreachable * count - 1


def test_less_piston_costs_residual_and_more_costs_time() -> None:
    height = rough(EFFECT.grid)
    least = EFFECT.removal_nm(PROBLEM.lower_s)
    chosen_nm = choose_piston_nm(height, MASK, least)
    too_little, chosen, too_much = (
        solve(replace(PROBLEM, target_nm=height + chosen_nm + more), 10).certificate for more in (-15.0, 0.0, 15.0)
    )
    assert too_little.predicted_rms_nm > 3 * chosen.predicted_rms_nm
    assert too_much.dwell_total_s > 1.1 * chosen.dwell_total_s


@pytest.mark.parametrize("unreachable", [-0.1, 1.0, float("nan")])
def test_fractions_out_of_range(unreachable: float) -> None:
    with pytest.raises(ComputeError, match="at least 0 and below 1"):
        choose_piston_nm(ZERO, MASK, ZERO, unreachable)


def test_surfaces_that_cannot_be_used() -> None:
    with pytest.raises(ComputeError, match="solve_mask is empty"):
        choose_piston_nm(ZERO, ~MASK & MASK, ZERO)
    with pytest.raises(ComputeError, match="not finite everywhere"):
        choose_piston_nm(np.where(MASK, np.nan, 0.0), MASK, ZERO)
    assert choose_piston_nm(np.where(MASK, 0.0, np.nan), MASK, ZERO) == 0


def test_sigma_max_is_the_largest_singular_value() -> None:
    rows = EFFECT.matrix.toarray()[MASK.ravel()]
    assert sigma_max(EFFECT, MASK, tolerance=1e-10) == pytest.approx(np.linalg.norm(rows, 2), rel=1e-6)
    assert sigma_max(EFFECT, MASK) == pytest.approx(np.linalg.norm(rows, 2), rel=1e-2)


def test_rho_is_dimensionless() -> None:
    p = regularisation_from_rho(EFFECT, MASK, 1e-4)
    assert p * np.count_nonzero(MASK) / sigma_max(EFFECT, MASK) ** 2 == pytest.approx(1e-4)
    assert regularisation_from_rho(scaled(EFFECT, 3.0), MASK, 1e-4) == pytest.approx(9 * p)
    assert regularisation_from_rho(EFFECT, MASK, 0.0) == 0


@pytest.mark.parametrize("rho", [-1e-4, float("nan"), float("inf")])
def test_rho_out_of_range(rho: float) -> None:
    with pytest.raises(ComputeError, match="rho must be finite and not negative"):
        regularisation_from_rho(EFFECT, MASK, rho)


def test_effects_without_effect() -> None:
    with pytest.raises(ComputeError, match="zero or not finite"):
        regularisation_from_rho(scaled(EFFECT, 0.0), MASK, 1e-4)
    with pytest.raises(ComputeError, match="zero or not finite"):
        regularisation_from_rho(scaled(EFFECT, float("nan")), MASK, 1e-4)
    with pytest.raises(ComputeError, match="solve_mask is empty"):
        regularisation_from_rho(EFFECT, MASK & ~MASK, 1e-4)


def test_the_condition_number_is_never_understated() -> None:
    rows = EFFECT.matrix.toarray()[MASK.ravel()]
    hessian = rows.T @ rows / len(rows) + PROBLEM.regularisation * np.eye(EFFECT.n)
    exact = np.linalg.cond(hessian)
    assert exact <= condition(PROBLEM) < 1.5 * exact
    assert condition(replace(PROBLEM, regularisation=0.0)) == np.inf


def test_an_ill_conditioned_p_is_noted_with_the_number() -> None:
    assert conditioning_note(PROBLEM) is None
    small = replace(PROBLEM, regularisation=regularisation_from_rho(EFFECT, MASK, 1e-13))
    note = conditioning_note(small)
    assert note is not None
    assert f"condition number of {condition(small):.3g}" in note
    assert f"regularisation of {small.regularisation:.3g}" in note
    assert "inf" in str(conditioning_note(replace(PROBLEM, regularisation=0.0)))
