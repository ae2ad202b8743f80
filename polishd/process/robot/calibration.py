"""A robot's stiffnesses from static loading tests: bounded least squares, and how far each of them can be trusted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np
import scipy

from polishd.model.errors import ComputeError
from polishd.model.process import HybridRobot, Projection, SerialRobot
from polishd.model.surface import BoolArray, FloatArray
from polishd.process.checks import refuse_where, require_unit_vectors, require_vectors
from polishd.process.robot.compliance import equivalent_compliance
from polishd.process.robot.hybrid import ELASTIC, hybrid_compliance_at, limb_key
from polishd.process.robot.serial import serial_inverse_kinematics, serial_joint_compliance_mm_per_n

# Static loading tests: the tool is pushed along a direction, and gives way.


@dataclass(frozen=True, slots=True)
class LoadingTests:
    """n tests, one a row; base frame."""

    tip_mm: FloatArray
    """(n, 3) tool tips."""
    axis: FloatArray
    """(n, 3) unit tool axes, from the tip into the spindle."""
    direction: FloatArray
    """(n, 3) unit, along which the tip was loaded and its way measured: the surface normal, or any other."""
    compliance_um_per_n: FloatArray
    """(n,) way per force."""

    def __len__(self) -> int:
        return len(self.tip_mm)


@dataclass(frozen=True, slots=True)
class PercentErrors:
    """Absolute percentage errors, of the measured value, as the paper quotes them (fig. 10)."""

    tests: int
    mean_percent: float
    max_percent: float


def require_tests(tests: LoadingTests, what: str) -> LoadingTests:
    """The tests as float64 arrays; ComputeError names the first that is none (``point`` is the row, from 0)."""
    tip = require_vectors(f"tool tip of {what}", tests.tip_mm, "mm")
    axis = require_unit_vectors(f"tool axis of {what}", tests.axis)
    direction = require_unit_vectors(f"direction of {what}", tests.direction)
    measured = np.asarray(tests.compliance_um_per_n, dtype=np.float64)
    if not len(tip) == len(axis) == len(direction) or measured.shape != (len(tip),):
        raise ComputeError(
            f"{what}: {len(tip)} tool tips, {len(axis)} axes, {len(direction)} directions and compliances of the shape "
            f"{measured.shape} do not go together"
        )
    wrong = ~(np.isfinite(measured) & (measured > 0))
    refuse_where(wrong, measured, f"the compliance of {what}", "um/N", "it must be finite and above 0")
    return LoadingTests(tip, axis, direction, measured)


def percent_errors(relative: FloatArray) -> PercentErrors:
    """Statistics of the relative errors of the model, (n,), n above 0."""
    error = 100 * np.abs(relative)
    return PercentErrors(len(error), float(error.mean()), float(error.max()))


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
"""Least relative change of all tests together by a factor of e in a stiffness: less is rounding."""
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
        """Note for the user, if any."""
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
    """Errors of the fitted robot on the tests of the fit."""
    cross_validated: PercentErrors | None
    """Errors on each test, predicted from the other folds; None with too few tests."""
    held_out: PercentErrors | None
    """On tests that the fit has not seen; None without any."""

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user."""
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
    """Scale of a relative residual."""


Relative = Callable[[FloatArray], FloatArray]
"""Function of log stiffness ratios (p,) to log ratios of model over measured compliance, (n,)."""


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
        robot=replace_elastic_numbers(robot, values),
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
    """The numbers that a fit may change, in the order that `replace_elastic_numbers` takes them."""
    if isinstance(robot, SerialRobot):
        stiffness = robot.joint_stiffness_n_mm_per_rad
        return tuple(Number(f"stiffness of joint {j}", "N mm/rad", float(k)) for j, k in enumerate(stiffness, 1))
    names = (limb_key(robot), *ELASTIC)
    return tuple(Number(name, unit, float(getattr(robot, name))) for name, unit in names)


def replace_elastic_numbers(robot: Elastic, values: FloatArray) -> Elastic:
    """Return the robot with these (p,) elastic numbers in place of its present ones."""
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
    return lambda values: serial_joint_compliance_mm_per_n(replace_elastic_numbers(robot, values), joints)


def _hybrid_matrix(robot: HybridRobot, tests: LoadingTests) -> Callable[[FloatArray], FloatArray]:
    matrix = hybrid_compliance_at(robot, tests.tip_mm, tests.axis)
    return lambda values: matrix(replace_elastic_numbers(robot, values))


# Whether loading tests say what a fit makes of them, or would be explained as well by nothing.

MOST_PERCENT = 10.0
"""Mean error beyond which these are no loading tests: the paper states 4.19 %, and noise of 5 % leaves 4 to 5 %."""
NOISE_PERCENT = 6.0
"""Mean error that noise alone may leave: tests at poses that are alike are explained as well by one number."""
INFORMATIVE = 0.9
"""Share of the error of one number for all tests that a fit must be below, where there is more than noise."""


def fit_doubts(fit: StiffnessFit[Any], tests: LoadingTests) -> tuple[str, ...]:
    """Return the reasons to doubt a fit; empty where it is good.

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
                f"{MOST_PERCENT:g} is allowed): wrong poses, directions or units, another robot, or noise"
            )
    if own > NOISE_PERCENT and own > INFORMATIVE * one:
        found.append(
            f"one number for all tests is off by {one:.1f} %, the fit by {own:.1f}: the tests say nothing of the robot"
        )
    return tuple(found)


def one_number(tests: LoadingTests) -> PercentErrors:
    """Predict each test by the geometric mean of the others, as the baseline without a robot model."""
    log = np.log(tests.compliance_um_per_n)
    others = (log.sum() - log) / (len(log) - 1)
    return percent_errors(np.expm1(others - log))


def _unseen_percent(fit: StiffnessFit[Any]) -> float:
    if fit.cross_validated is not None:
        return fit.cross_validated.mean_percent
    free = fit.fitted.tests - sum(stiffness.determined for stiffness in fit.stiffnesses)
    return float(fit.fitted.mean_percent * np.sqrt(fit.fitted.tests / free))


# How removal goes with the depth that the robot leaves to the contact: the exponent of the correction "power".

TOO_UNCERTAIN = 0.5
"""Uncertainty at which the exponent says nothing: Hertz (1.5) and the paper's linear mode (1) differ by as much."""
BEST_SPOT = 1e-3
"""No spot's volume is taken to be better known than this (relative), however well they lie on the line."""


@dataclass(frozen=True, slots=True)
class ExponentFit:
    """``volume = scale * gamma ** exponent``."""

    exponent: float
    """1.5 for a Hertz contact (volume), 1 for the paper's linear mode (eq. 49)."""
    uncertainty: float
    """1 sigma of the exponent."""
    scale: float
    """Volume, or rate, at gamma = 1: that of a rigid robot; in the unit given."""
    errors: PercentErrors
    """Errors of the fit on the spots."""


def fit_exponent(gamma: FloatArray, volume: FloatArray) -> ExponentFit:
    """Fit the exponent of the depth ratio (paper eq. 48) to spots: least squares of the logarithms.

    Args:
        gamma: (n,) depth ratios at which the spots were taken, above 0; n at least 3.
        volume: (n,) volume rates, or peak rates, of the spots, above 0, one unit for all.

    Raises:
        ComputeError: names the first spot that is none; too few spots; a span of gamma too small to tell.
    """
    gamma, volume = _positive("depth ratio gamma", gamma), _positive("spot volume", volume)
    if len(gamma) != len(volume):
        raise ComputeError(f"{len(gamma)} depth ratios, {len(volume)} volumes")
    if len(gamma) < 3:
        raise ComputeError(f"{len(gamma)} spots are too few for an exponent and its uncertainty: at least 3 are needed")
    x, y = np.log(gamma), np.log(volume)
    spread = float(((x - x.mean()) ** 2).sum())
    span = f"gamma from {gamma.min():.4g} to {gamma.max():.4g}"
    if spread == 0:
        raise ComputeError(f"{span} is no span: an exponent needs spots at several depth ratios")
    exponent, level = (float(value) for value in np.polyfit(x, y, 1))
    variance = max(float(((y - level - exponent * x) ** 2).sum()) / (len(x) - 2), BEST_SPOT**2)
    uncertainty = float(np.sqrt(variance / spread))
    if uncertainty > TOO_UNCERTAIN:
        says = f"the exponent would be {exponent:.2f} +- {uncertainty:.2g}, it must be known to {TOO_UNCERTAIN:g}"
        raise ComputeError(f"{span} is too small a span for spots of this scatter: {says}")
    scale = float(np.exp(level))
    return ExponentFit(exponent, uncertainty, scale, percent_errors(scale * gamma**exponent / volume - 1))


def _positive(what: str, value: FloatArray) -> FloatArray:
    array = np.asarray(value, dtype=np.float64)
    if array.ndim != 1:
        raise ComputeError(f"{what} has the shape {array.shape}, it must be (n,)")
    refuse_where(~(np.isfinite(array) & (array > 0)), array, what, "", "it must be finite and above 0")
    return array
