"""The default dwell solver: the fastest of polishd's own for the effect at hand."""

from __future__ import annotations

from polishd.model.dwell import DwellSolution
from polishd.process.dwell import alternating_directions, douglas_rachford, interior_point, newton_cg
from polishd.process.dwell.problem import DwellProblem, check
from polishd.process.dwell.quadratic import condition
from polishd.process.removal.convolution import ConvolutionEffect
from polishd.process.removal.effect import SparseEffect
from polishd.process.removal.spread_effect import SpreadEffect

NAME = "auto"
ILL = 1e5
"""Condition number above which factorising beats conjugate gradients (rho of about 1e-5)."""
FEW = 5_800
"""Points whose factor the interior point takes, however wide its band."""


def solve(problem: DwellProblem, within_s: float) -> DwellSolution:
    """Splitting for a sum of convolutions, alternating directions where there is no matrix; else Newton-CG or a factor.

    Conjugate gradients win where regularisation conditions the problem, a factor where it does not and is small.
    Arguments, result and errors as those solvers'; the certificate names the one that was taken.
    """
    if isinstance(problem.effect, ConvolutionEffect):
        return douglas_rachford.solve(problem, within_s)
    check(problem)
    if isinstance(problem.effect, SpreadEffect):
        return alternating_directions.solve(problem, within_s)
    if problem.effect.n <= FEW and isinstance(problem.effect, SparseEffect) and condition(problem) > ILL:
        return interior_point.solve(problem, within_s)
    return newton_cg.solve(problem, within_s)
