"""On a busy machine a solver comes as far as on an idle one, in the same limit."""

from __future__ import annotations

import time
from types import ModuleType

import pytest

from polishd.process.dwell import douglas_rachford, interior_point, lucy_richardson, newton_cg
from tests.unit.process.gaussian import dwell_problem
from tests.unit.process.lattices import lattice_problem

SOLVERS = [newton_cg, interior_point, lucy_richardson, douglas_rachford]


def slow_machine(monkeypatch: pytest.MonkeyPatch, slowness: float) -> None:
    """Wall clocks that go so much faster than this thread computes."""
    for clock in ("perf_counter", "monotonic"):
        monkeypatch.setattr(time, clock, lambda: slowness * time.thread_time())


@pytest.mark.parametrize("solver", SOLVERS, ids=lambda solver: solver.NAME)
def test_a_solver_on_a_busy_machine_comes_as_far(solver: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    problem = lattice_problem(radius_mm=12.0) if solver is douglas_rachford else dwell_problem(radius_mm=20)
    begin = time.thread_time()
    alone = solver.solve(problem, 100.0).certificate
    enough_s = max(5 * (time.thread_time() - begin), 0.5)
    slow_machine(monkeypatch, 200.0 / enough_s)  # 40 s where it takes a fifth of the limit; the backstop is above 60
    busy = solver.solve(problem, enough_s).certificate
    assert (busy.stopped, busy.iterations) == (alone.stopped, alone.iterations)
    assert busy.kkt_residual == pytest.approx(alone.kkt_residual, rel=1e-3)
