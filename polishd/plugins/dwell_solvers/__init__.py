"""polishd's own dwell solvers: ``newton_cg`` (the default) and ``qp`` (an independent cross-check)."""

from __future__ import annotations

from collections.abc import Sequence

from polishd.api import DwellSolver, hookimpl
from polishd.plugins.dwell_solvers import qp
from polishd.process.dwell import newton_cg

POLISHD_API = 1


@hookimpl
def polishd_dwell_solvers() -> Sequence[DwellSolver]:
    """The default solver first."""
    return [DwellSolver(newton_cg.NAME, newton_cg.solve), DwellSolver(qp.NAME, qp.solve)]
