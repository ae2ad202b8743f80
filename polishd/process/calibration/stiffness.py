"""A robot's stiffnesses from static loading tests: bounded least squares, and how far each of them can be trusted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
import scipy

from polishd.model.errors import ComputeError
from polishd.model.process import Projection
from polishd.model.robot import HybridRobot, SerialRobot
from polishd.model.surface import BoolArray, FloatArray
from polishd.process.calibration.loading import LoadingTests, PercentErrors, percent_errors, require_tests
from polishd.process.compliance import equivalent_compliance
from polishd.process.robot.compliance import hybrid_compliance_at
from polishd.process.robot.serial import serial_inverse_kinematics, serial_joint_compliance_mm_per_n
from polishd.process.robot.stiffness import ELASTIC, limb_key

Elastic = TypeVar("Elastic", HybridRobot, SerialRobot)
"""Robots that have stiffnesses to fit."""

BOUND = 100.0
"""A stiffness is looked for between the given one over this and times this."""
UNDETERMINED = 0.5
"""Relative 1-sigma uncertainty above which the tests do not determine a stiffness."""
FOLDS = 5
"""The tests are cut into this many parts, each predicted from the others."""
BEST_TEST = 1e-3
"""No loading test is taken to be better than this (relative), however well the fit goes through the points."""
PULL = 0.03
"""Relative residual that a factor of e from the given stiffness counts as, until it is known which are determined."""
NOTHING = 1e-9
"""What a factor of e in a stiffness changes in all tests together (relative), to be told from rounding errors."""
STARTS = 4
"""Fits, each from other stiffnesses: those given, all of them at the level of the tests, and others about that."""
SPREAD = 10.0
"""Each stiffness of the other starts differs from that level by up to this factor either way."""
SAME = 0.01
"""Answers that differ by less (relative) are one."""
CONTRADICTED = 16.0
"""Rise of chi squared (4 sigma) at which the tests speak against a stiffness, even if they do not determine it."""


@dataclass(frozen=True, slots=True)
class Stiffness:
    """One of the robot's elastic numbers, as given and as found."""

    name: str
    unit: str
    given: float
    value: float
    sigma: float
    """Relative 1-sigma uncertainty; of a stiffness that is not determined: when it was given up, inf at a bound."""
    determined: bool
    """False: the tests do not say what it is, and ``value`` is held while the others were fitted."""
    low: float = 0.0
    """Least answer of all starts that explain the tests as well; ``value`` where there is but one."""
    high: float = 0.0
    """Largest of them."""

    @property
    def note(self) -> str:
        """What a user should know of it, if anything."""
        return "; ".join(filter(None, (self._held, self._range)))

    @property
    def _range(self) -> str:
        open_by = np.log(self.high / self.low) if self.low else 0.0
        if open_by <= max(SAME, 2.0 * self.sigma if self.determined else 0.0):
            return ""
        return (
            f"{self.name}: fits from {STARTS} starts explain the tests equally well with {self.low:.4g} to "
            f"{self.high:.4g} {self.unit}"
        )

    @property
    def _held(self) -> str:
        if self.determined:
            return ""
        why = f"1-sigma {100 * self.sigma:.0f} %" if self.sigma < 10 else "1-sigma over 1000 %"
        what = "kept as given" if self.value == self.given else f"held, as the tests speak against {self.given:.4g}"
        return f"the tests do not determine {self.name} ({why}): {self.value:.4g} {self.unit} is {what}"


@dataclass(frozen=True, slots=True)
class StiffnessFit(Generic[Elastic]):
    """The robot that the tests are best explained by, and what to think of it."""

    robot: Elastic
    stiffnesses: tuple[Stiffness, ...]
    fitted: PercentErrors
    """Of the fitted robot on the tests that it was fitted to."""
    cross_validated: PercentErrors | None
    """Of each test as predicted from the other folds; None with too few tests for that."""
    held_out: PercentErrors | None
    """On tests that the fit has not seen; None without any."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What a user should know of the fit."""
        return tuple(stiffness.note for stiffness in self.stiffnesses if stiffness.note)


@dataclass(frozen=True, slots=True)
class _Found:
    """Stiffnesses as natural logarithms over the given ones."""

    log: FloatArray
    """(p,)."""
    sigma: FloatArray
    """(p,) 1-sigma uncertainty; inf at a bound."""
    free: BoolArray
    """(p,) True where fitted, False where held."""
    chi2: float
    """Sum of the squared relative residuals."""
    variance: float
    """Of a relative residual."""


Relative = Callable[[FloatArray], FloatArray]
"""From stiffnesses (p,), as logarithms over the given ones, to those of model over measured compliance, (n,)."""


def fit_stiffness(
    robot: Elastic,
    tests: LoadingTests,
    *,
    projection: Projection = "normal",
    hold_out: LoadingTests | None = None,
) -> StiffnessFit[Elastic]:
    """Fit a robot's stiffnesses to static loading tests, as the paper checks its model (section IV-A, fig. 10).

    Relative residuals (logarithms of model over measured) are least in the mean square. A stiffness that the tests do
    not determine is kept as given and the others are fitted again; where the given one contradicts the tests, it is
    held where the fit had it.

    Args:
        robot: geometry, and stiffnesses to begin with. Other starts are tried, too, so that an invented level does
            no harm; of answers that explain the tests equally well the one from these is taken.
        tests: more tests than stiffnesses, at poses and along directions in which every member gives way.
        projection: what a test measures: "normal" is ``b' C b`` along its direction b, which is what a force and a
            displacement sensor see; "linear" and "quadratic" are the paper's (see `equivalent_compliance`).
        hold_out: tests that the fit must not see, to judge it by.

    Raises:
        ComputeError: names the row of a test that is none, or whose pose the robot cannot take; too few tests; tests
            that determine nothing.
    """
    tests = require_tests(tests, "loading test")
    given = elastic_numbers(robot)
    if len(tests) <= len(given):
        raise ComputeError(f"{len(tests)} loading tests are too few for {len(given)} stiffnesses and their uncertainty")
    start, predict = np.array([number.value for number in given]), compliance_of(robot, tests, projection)

    def relative(log: FloatArray) -> FloatArray:
        return np.log(predict(start * np.exp(log)) / tests.compliance_um_per_n)

    at, found, alike = _best(relative, len(given))
    if not found.free.any():
        raise ComputeError(f"the {len(tests)} loading tests determine none of the {len(given)} stiffnesses")
    values = np.where(found.log == 0, start, start * np.exp(found.log))
    low, high = start * np.exp(alike.min(axis=0)), start * np.exp(alike.max(axis=0))
    rows = zip(given, values, found.sigma, found.free, zip(low, high, strict=True), strict=True)
    unseen = None
    if hold_out is not None:
        hold_out = require_tests(hold_out, "held-out loading test")
        predicted = compliance_of(robot, hold_out, projection)(values)
        unseen = percent_errors(predicted / hold_out.compliance_um_per_n - 1)
    return StiffnessFit(
        robot=with_elastic(robot, values),
        stiffnesses=tuple(
            Stiffness(*number, float(v), float(s), bool(free), *map(float, ends)) for number, v, s, free, ends in rows
        ),
        fitted=percent_errors(np.expm1(relative(found.log))),
        cross_validated=_cross_validated(lambda log: relative(log + at), len(tests), len(given)),
        held_out=unseen,
    )


def _best(relative: Relative, unknowns: int) -> tuple[FloatArray, _Found, FloatArray]:
    """Fit from several starts: (p,) the one taken, what was found from there, and (m, p) all answers as good."""
    nothing = np.zeros(unknowns)
    level = float(np.mean(relative(nothing)))  # compliances go as one over the stiffnesses
    rng, spread = np.random.default_rng(0), np.log(SPREAD)
    others = [level + rng.uniform(-spread, spread, unknowns) for _ in range(STARTS - 2)]
    starts = [nothing, np.full(unknowns, level), *others]
    found = [_fit_from(relative, start) for start in starts]
    best = min(found, key=lambda one: one.chi2)
    alike = [k for k, one in enumerate(found) if one.chi2 <= best.chi2 + CONTRADICTED * best.variance]
    answers = np.array([found[k].log for k in alike])
    if alike[0] == 0:
        return nothing, found[0], answers
    # What the tests do not determine is kept as given, or said to contradict the given one: so from there, once more.
    again = _fit(relative, unknowns, best.log)
    if again.chi2 <= best.chi2 + CONTRADICTED * best.variance:
        return nothing, again, np.vstack([again.log, answers])
    return starts[alike[0]], found[alike[0]], answers


def _fit_from(relative: Relative, start: FloatArray) -> _Found:
    """Fit from a start (p,), a logarithm over the given stiffnesses as the answer is."""
    found = _fit(lambda log: relative(log + start), len(start))
    return replace(found, log=found.log + start)


def _cross_validated(relative: Relative, tests: int, unknowns: int) -> PercentErrors | None:
    """Errors of each fold's tests as predicted from the others, with the choice of what to fit made anew."""
    if tests - -(-tests // FOLDS) <= unknowns:
        return None
    fold = np.random.default_rng(0).permutation(tests) % FOLDS
    off = np.empty(tests)
    for k in range(FOLDS):
        unseen = fold == k

        def seen(log: FloatArray, rows: BoolArray = ~unseen) -> FloatArray:
            return relative(log)[rows]

        off[unseen] = relative(_fit(seen, unknowns).log)[unseen]
    return percent_errors(np.expm1(off))


def _fit(relative: Relative, unknowns: int, begin: FloatArray | None = None) -> _Found:
    """Fit, and hold the stiffness that is determined least, until all that are free are determined; then fit these.

    While it is not settled which are determined, all are pulled to the given ones a little: else two of which the
    tests see but the sum would go to opposite bounds.
    """
    log = np.zeros(unknowns) if begin is None else begin
    edge = max(float(np.log(BOUND)), float(np.abs(log).max()))
    sigma, free = np.zeros(unknowns), np.ones(unknowns, dtype=np.bool_)
    found = _optimum(relative, log, sigma, free, PULL, edge=edge)
    while free.any() and (found.sigma[free] > UNDETERMINED).any():
        worst = int(np.where(free, found.sigma, -1.0).argmax())
        log, sigma, free = found.log.copy(), found.sigma.copy(), free.copy()
        log[worst], free[worst] = 0.0, False
        kept = _optimum(relative, log, sigma, free, PULL, edge=edge)
        if kept.chi2 > found.chi2 + CONTRADICTED * found.variance:
            log[worst] = found.log[worst]
            kept = _optimum(relative, log, sigma, free, PULL, edge=edge)
        found = kept
    last = _optimum(relative, found.log, found.sigma, free, 0.0, edge=edge)
    return replace(last, free=free & np.isfinite(last.sigma))  # at its bound it is held, not determined


def _optimum(
    relative: Relative, log: FloatArray, sigma: FloatArray, free: BoolArray, pull: float, *, edge: float
) -> _Found:
    """Least squares over the free ones; (p,) ``log`` starts them, and holds the others with their ``sigma``.

    No answer is farther than ``edge`` from the given ones.
    """

    def full(some: FloatArray) -> FloatArray:
        whole = log.copy()
        whole[free] = some
        return whole

    def residual(some: FloatArray) -> FloatArray:
        return np.concatenate([relative(full(some)), pull * some])

    if not free.any():
        return _Found(log, sigma, free, float(relative(log) @ relative(log)), 0.0)
    result = scipy.optimize.least_squares(
        residual, np.clip(log[free], -edge, edge), bounds=(-edge, edge), xtol=1e-9, ftol=1e-9
    )
    tests = len(result.fun) - len(result.x)
    chi2 = float(result.fun[:tests] @ result.fun[:tests])
    variance = max(chi2 / (tests - len(result.x)), BEST_TEST**2)
    _, singular, turns = np.linalg.svd(result.jac[:tests], full_matrices=False)
    spread = turns.T / np.maximum(singular, NOTHING)
    uncertain = sigma.copy()
    uncertain[free] = np.sqrt(variance * (spread**2).sum(axis=1))
    uncertain[free] = np.where(np.abs(result.x) > 0.99 * edge, np.inf, uncertain[free])
    return _Found(full(result.x), uncertain, free, chi2, variance)


class Number(NamedTuple):
    """One elastic number."""

    name: str
    unit: str
    value: float


def elastic_numbers(robot: HybridRobot | SerialRobot) -> tuple[Number, ...]:
    """The numbers that a fit may change, in the order that `with_elastic` takes them."""
    if isinstance(robot, SerialRobot):
        stiffness = robot.joint_stiffness_n_mm_per_rad
        return tuple(Number(f"stiffness of joint {j}", "N mm/rad", float(k)) for j, k in enumerate(stiffness, 1))
    names = (limb_key(robot), *ELASTIC)
    return tuple(Number(name, unit, float(getattr(robot, name))) for name, unit in names)


def with_elastic(robot: Elastic, values: FloatArray) -> Elastic:
    """The robot with these (p,) numbers instead of its own."""
    numbers = [float(value) for value in values]
    if isinstance(robot, SerialRobot):
        return replace(robot, joint_stiffness_n_mm_per_rad=tuple(numbers))
    names = [number.name for number in elastic_numbers(robot)]
    changed: dict[str, Any] = dict(zip(names, numbers, strict=True))
    return replace(robot, **changed)


def compliance_of(
    robot: HybridRobot | SerialRobot, tests: LoadingTests, projection: Projection
) -> Callable[[FloatArray], FloatArray]:
    """The function from (p,) elastic numbers to the (n,) compliances, um/N, that the tests should have found.

    The poses are solved once: they do not depend on the stiffnesses. Raises ComputeError for one out of reach.
    """
    matrix = _serial_matrix(robot, tests) if isinstance(robot, SerialRobot) else _hybrid_matrix(robot, tests)

    def compliance(values: FloatArray) -> FloatArray:
        return 1e3 * equivalent_compliance(matrix(values), tests.axis, tests.direction, projection)

    return compliance


def _serial_matrix(robot: SerialRobot, tests: LoadingTests) -> Callable[[FloatArray], FloatArray]:
    joints = serial_inverse_kinematics(robot, tests.tip_mm, tests.axis)
    return lambda values: serial_joint_compliance_mm_per_n(with_elastic(robot, values), joints)


def _hybrid_matrix(robot: HybridRobot, tests: LoadingTests) -> Callable[[FloatArray], FloatArray]:
    matrix = hybrid_compliance_at(robot, tests.tip_mm, tests.axis)
    return lambda values: matrix(with_elastic(robot, values))
