"""First row of the benchmark of dynamic plans: the exact plan reaches the required residual."""

from __future__ import annotations

import pytest

from benchmarks.bench_dynamic import CLASS_NM, Part, left


@pytest.mark.full
def test_an_exact_plan_predicts_what_ion_beams_reach_and_a_static_one_does_not() -> None:
    part = Part()
    height = part.height_nm(part.grid)
    assert height[part.clear].std() == pytest.approx(200.0)
    assert (part.gamma.min(), part.gamma.max()) == pytest.approx((0.70, 0.95), abs=0.002)
    plan = part.plan(height)
    assert left(part.model, plan)[part.clear].std() <= CLASS_NM["ion beam, published"]
    softer = left(part.exact(part.softer(0.9)), plan)[part.clear]
    assert softer.std() > 10
