"""The default dwell solver: the fastest of polishd's own for the effect at hand."""

from __future__ import annotations

from polishd.model.dwell import DwellSolution
from polishd.process.convolution import ConvolutionEffect
from polishd.process.dwell import douglas_rachford, interior_point, newton_cg
from polishd.process.dwell.problem import DwellProblem
from polishd.process.dwell.setup import condition
from polishd.process.dwell.validation import check
from polishd.process.effect import SparseEffect

NAME = "auto"
ILL = 1e5
"""Condition number above which factorising beats conjugate gradients (rho of about 1e-5)."""
FEW = 5_800
"""Points whose factor the interior point takes, however wide its band."""


def solve(problem: DwellProblem, within_s: float) -> DwellSolution:
    """Douglas-Rachford splitting for a sum of convolutions; for a matrix projected Newton-CG, or an interior point.

    Conjugate gradients win where P conditions the problem, a factor where it does not, while that is small.
    Arguments, result and errors as those solvers'; the certificate names the one that was taken.
    """
    if isinstance(problem.effect, ConvolutionEffect):
        return douglas_rachford.solve(problem, within_s)
    check(problem)
    if problem.effect.n <= FEW and isinstance(problem.effect, SparseEffect) and condition(problem) > ILL:
        return interior_point.solve(problem, within_s)
    return newton_cg.solve(problem, within_s)
