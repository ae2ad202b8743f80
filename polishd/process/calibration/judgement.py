"""Whether loading tests say what a fit makes of them, or would be explained as well by nothing."""

from __future__ import annotations

from typing import Any

import numpy as np

from polishd.process.calibration.loading import LoadingTests, PercentErrors, percent_errors
from polishd.process.calibration.stiffness import StiffnessFit

MOST_PERCENT = 10.0
"""Mean error beyond which these are no loading tests: the paper states 4.19 %, and noise of 5 % leaves 4 to 5 %."""
NOISE_PERCENT = 6.0
"""Mean error that noise alone may leave: tests at poses that are alike are explained as well by one number."""
INFORMATIVE = 0.9
"""Share of the error of one number for all tests that a fit must be below, where there is more than noise."""


def doubts(fit: StiffnessFit[Any], tests: LoadingTests) -> tuple[str, ...]:
    """Why a fit should not be believed; empty where it may be.

    It is judged by what it predicts of tests that it has not seen, or, where they are too few for that, by its own
    error with as much added as so many stiffnesses can hide.
    """
    own, one = _unseen_percent(fit), one_number(tests).mean_percent
    found = []
    judged = {"the fit is off by": own}
    if fit.held_out is not None:
        judged["the held-out tests are off by"] = fit.held_out.mean_percent
    for what, percent in judged.items():
        if not percent <= MOST_PERCENT:
            found.append(
                f"{what} {percent:.1f} % in the mean, and loading tests of a robot like this by 3 to 5 (at most "
                f"{MOST_PERCENT:g} is believed): wrong poses, directions or units, another robot, or noise"
            )
    if own > NOISE_PERCENT and own > INFORMATIVE * one:
        found.append(
            f"one number for all tests is off by {one:.1f} %, the fit by {own:.1f}: the tests say nothing of the robot"
        )
    return tuple(found)


def one_number(tests: LoadingTests) -> PercentErrors:
    """Of each test as predicted by the geometric mean of the others: what can be said without a robot."""
    log = np.log(tests.compliance_um_per_n)
    others = (log.sum() - log) / (len(log) - 1)
    return percent_errors(np.expm1(others - log))


def _unseen_percent(fit: StiffnessFit[Any]) -> float:
    if fit.cross_validated is not None:
        return fit.cross_validated.mean_percent
    free = fit.fitted.tests - sum(stiffness.determined for stiffness in fit.stiffnesses)
    return float(fit.fitted.mean_percent * np.sqrt(fit.fitted.tests / free))
