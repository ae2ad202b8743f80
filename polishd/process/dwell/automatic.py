"""The default dwell solver: the fastest of polishd's own for the effect at hand."""

from __future__ import annotations

from polishd.model.dwell import DwellSolution
from polishd.process.convolution import ConvolutionEffect
from polishd.process.dwell import douglas_rachford, newton_cg
from polishd.process.dwell.problem import DwellProblem

NAME = "auto"


def solve(problem: DwellProblem, within_s: float) -> DwellSolution:
    """Douglas-Rachford splitting for a sum of convolutions, projected Newton-CG for any other effect.

    Arguments, result and errors as those solvers'; the certificate names the one that was taken.
    """
    if isinstance(problem.effect, ConvolutionEffect):
        return douglas_rachford.solve(problem, within_s)
    return newton_cg.solve(problem, within_s)
