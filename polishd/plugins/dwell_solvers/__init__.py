"""polishd's own dwell solvers.

``auto`` takes the fastest for the effect at hand: ``douglas_rachford`` for sums of convolutions, ``newton_cg``
for a matrix, or ``interior_point`` where that is ill-conditioned and not too large.
``qp`` is an independent cross-check, with ``qp:clarabel`` and so on for each backend of qpsolvers that is installed;
``lucy_richardson`` is the literature's baseline.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

from polishd.api import DwellSolver, hookimpl
from polishd.plugins.dwell_solvers import qp
from polishd.process.dwell import automatic, douglas_rachford, interior_point, lucy_richardson, newton_cg

POLISHD_API = 1

OWN = (automatic, newton_cg, douglas_rachford, interior_point, lucy_richardson)


@hookimpl
def polishd_dwell_solvers() -> Sequence[DwellSolver]:
    """The default solver first."""
    return [
        *(DwellSolver(own.NAME, own.solve) for own in OWN),
        DwellSolver(qp.QP_NAME, qp.solve_qp),
        *(DwellSolver(f"{qp.QP_NAME}:{name}", partial(qp.solve_qp, backend=name)) for name in qp.installed()),
    ]
