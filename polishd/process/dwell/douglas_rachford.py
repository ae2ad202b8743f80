"""The dwell solver for points at rest on the grid's nodes: Douglas-Rachford splitting on transforms, in float32.

It needs an effect that is a sum of convolutions, and takes an eighth of the time of scipy's L-BFGS-B or less; see
benchmarks/bench_dwell_large.py. The last digits, where float32 has none, are found in float64.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
import scipy

from polishd.model.dwell import DwellSolution, Start
from polishd.model.errors import ComputeError
from polishd.model.surface import FloatArray
from polishd.process.dwell.certificate import certify_dwell
from polishd.process.dwell.problem import DwellProblem, TimeLimit, check, require_no_feed_change
from polishd.process.dwell.quadratic import projected_gradient, quadratic, warm_start_s
from polishd.process.dwell.splitting_iteration import Array, Iteration, NumpyIteration, SplitProblem
from polishd.process.removal.convolution import ConvolutionEffect
from polishd.util.jit import has_compiler

# Over-relaxed Douglas-Rachford splitting of the dwell problem on Fourier transforms.

COMPILED_NODES = 60_000
"""Nodes of a domain from which on compiled code, loaded in half a second, is the quicker way."""
MISFIT_STEP = 0.06
"""Step parameter of y over the misfit's curvature; flat between 0.05 and 0.1."""
LEAST_REGULARISATION = 1e-5
"""Regularisation below this share of the misfit's curvature is taken for this, in the step parameter only."""
ADAPT_AT = (20, 40)
"""Iterations between which the dual and the primal variables' changes are compared, to mend the step of w."""
ADAPT_POWER = 0.25
"""Strength of the balance, measured on spots of 1.7 to 20 mm, where the best step varies by 2 and the ratio by 60."""


@dataclass(slots=True)
class SplittingState:
    """The iteration's state, and what it is to know beside it; made by `start_splitting`."""

    effect: ConvolutionEffect
    iteration: Iteration
    split: SplitProblem
    balance: FloatArray
    """(k,) by which the effect's kernels are multiplied, and its coefficients divided."""
    iterations: int = 0
    changed: bool = True
    """Return whether arrays or step parameters differ from those of the last iteration."""
    _seen: tuple[Array, Array] | None = None

    @property
    def time_s(self) -> FloatArray:
        """(n,) dwell of each point, float64, within the bounds."""
        return np.asarray(self.iteration.shown(self.split.dwell)[self.where()], dtype=np.float64)

    @property
    def state(self) -> Mapping[str, Array]:
        """Return the state from which a later problem on the same domain can start."""
        y, w = (self.iteration.shown(each) for each in (self.split.y, self.split.w))
        return {"y": y, "w": w, "balance": self.balance, "steps": np.array([self.split.rho, self.split.mu])}

    def go_on_from(self, y: Array, w: Array, rho: float, mu: float) -> None:
        """The iterate, (ny, nx) and (k, ny, nx), and step parameters."""
        split = self.split
        split.y, split.w = (self.iteration.kept(each.astype(split.y.dtype)) for each in (y, w))
        split.rho, split.mu, self.changed = rho, mu, True

    def where(self) -> tuple[Array, Array]:
        """Row and column of each point."""
        return np.divmod(self.effect.node, self.effect.lattice[1])

    def iterate(self) -> None:
        """One iteration."""
        if self.changed:
            self.iteration.begin(self.split)
            self.changed = False
        self.iterations += 1
        self.iteration.advance(self.split)
        if self.iterations in ADAPT_AT:
            self._adapt()

    def _adapt(self) -> None:
        """Mend w's step by how much the dual variable moved for what the primal moved."""
        primal = self.split.coefficient * self.split.dwell
        dual = self.split.w - primal
        if self._seen is not None:
            moved = float(np.linalg.norm(primal - self._seen[0]))
            ratio = float(np.linalg.norm(dual - self._seen[1])) / moved if moved > 0 else 1.0
            self._rescale(float(np.clip(ratio**ADAPT_POWER, 0.5, 3.0)))
        self._seen = (primal, dual)

    def _rescale(self, factor: float) -> None:
        """Another step parameter of w; the scaled dual variable goes with it."""
        split = self.split
        primal = split.coefficient * split.dwell
        split.w = (primal + (split.w - primal) / factor).astype(split.w.dtype)
        split.mu *= factor
        self.changed = True


def start_splitting(problem: DwellProblem, effect: ConvolutionEffect, real: type = np.float32) -> SplittingState:
    """The iteration for a problem with that effect (its own), from its warm start if it has one."""
    size, samples = effect.size, int(np.count_nonzero(problem.solve_mask))
    pull, target = np.zeros(size), np.zeros(size)
    weight = problem.solve_mask.astype(np.float64) if problem.weight is None else problem.weight * problem.solve_mask
    pull[effect.on_grid] = 2 / samples * weight
    target[effect.on_grid] = np.where(problem.solve_mask, problem.target_nm, 0.0)
    where = np.divmod(effect.node, effect.lattice[1])
    coefficient = np.zeros((effect.rank, *size))
    coefficient[(slice(None), *where)] = effect.coefficients.T
    lower, upper = np.zeros(size), np.zeros(size)
    lower[where], upper[where] = problem.lower_s, problem.upper_s
    balance = _balance(effect)
    coefficient /= balance[:, None, None]
    spectra = effect.spectra * balance[:, None, None]
    strength = (np.abs(spectra) ** 2).sum(axis=0)
    square = float(((effect.coefficients / balance) ** 2).sum(axis=1).mean())  # it is of t, and so weighs on w
    scale = float(pull.max())
    held = max(2 * problem.regularisation, LEAST_REGULARISATION * scale * float(strength.max()) * square)
    rho, mu = MISFIT_STEP * scale, float(np.sqrt(held / square * scale * strength.max()))
    complex_type = np.complex64 if real is np.float32 else np.complex128
    iteration = _iteration(size, real)

    def kept(field: Array) -> Array:
        return iteration.kept(field.astype(real))

    split = SplitProblem(
        spectra=spectra.astype(complex_type),
        coefficient=kept(coefficient),
        pull=kept(pull),
        target=kept(target),
        bounds=(kept(lower), kept(upper)),
        regularisation=problem.regularisation,
        price=problem.price_nm2_per_s,
        rho=rho,
        mu=mu,
        y=kept(target),
        w=kept(np.zeros((effect.rank, *size))),
        dwell=kept(np.zeros(size)),
    )
    found = SplittingState(effect, iteration, split, balance)
    start = warm_start_s(problem, quadratic(problem))
    if problem.warm is not None and start is not None:
        _start_warm(found, problem.warm, start)
    return found


def _iteration(size: tuple[int, int], real: type) -> Iteration:
    if real is np.float32 and size[0] * size[1] >= COMPILED_NODES and has_compiler():
        from polishd.process.dwell.douglas_rachford_compiled import compiled_iteration

        return compiled_iteration(size)
    return NumpyIteration(size)


def continue_iteration(last: SplittingState, anew: SplittingState) -> SplittingState:
    """``anew``, which has the same domain, from where ``last`` has come to: how float64 takes over from float32."""
    anew.go_on_from(last.state["y"], last.state["w"], last.split.rho, last.split.mu)
    anew.iterations = last.iterations
    return anew


def _balance(effect: ConvolutionEffect) -> FloatArray:
    """(k,) square roots of the coefficients' sizes over the first's: kernel and coefficient of each share alike.

    A family's kernels come with coefficients that fall by an order of magnitude each. Left so, three convolutions take
    a third more iterations than one; so balanced they take as many.
    """
    size = np.sqrt((effect.coefficients**2).mean(axis=0))
    return np.asarray(np.sqrt(np.maximum(size, 1e-12 * size.max()) / size.max()), dtype=np.float64)


def _start_warm(found: SplittingState, warm: Start, time_s: FloatArray) -> None:
    """Start from the state of a solution where it fits, else from its dwell, (n,) within the bounds."""
    state, split, size = warm.state, found.split, found.effect.size
    if "w" in state and state["w"].shape == (split.rank, *size):
        w = state["w"] * (state["balance"] / found.balance)[:, None, None]
        found.go_on_from(state["y"], w, *(float(value) for value in state["steps"]))
        return
    dwell = np.zeros(size)
    dwell[found.where()] = time_s
    w = found.iteration.shown(split.coefficient) * dwell
    total = sum(kernel * scipy.fft.rfft2(each) for kernel, each in zip(split.spectra, w, strict=True))
    found.go_on_from(np.asarray(scipy.fft.irfft2(total, size)), w, split.rho, split.mu)


NAME = "douglas_rachford"
MAX_ITERATIONS = 5000
ASK_EVERY = 40
"""Iterations between two looks at the KKT residual, which cost as much as four of them."""
ASK_FIRST = 20
"""And the first look: a warm start may be there."""
STALLED = 0.9
"""A residual above this share of what it was three looks ago has met float32's floor."""

Stop = Callable[[FloatArray], str | None]
"""(n,) dwell -> why to stop, or None to go on."""


def solve(problem: DwellProblem, within_s: float, kkt_tolerance: float = 1e-6) -> DwellSolution:
    """Solve the dwell problem, or come as far as the time allows.

    Args:
        problem: what to solve; its effect must be a ConvolutionEffect. Its warm start's ``state`` is taken where it
            fits, else its dwell.
        within_s: CPU seconds for the whole call (see TimeLimit); when they are over, the best dwell so far is
            returned, within the bounds, and its certificate says ``deadline`` and how far from the minimum it is.
        kkt_tolerance: the KKT residual (see Certificate) to stop at.

    Returns:
        The dwell with its certificate; its ``state`` starts the next problem.

    Raises:
        ComputeError: the problem is malformed, or its effect is no sum of convolutions.
    """
    limit = TimeLimit(within_s)
    check(problem)
    require_no_feed_change(problem, NAME)
    effect = problem.effect
    if not isinstance(effect, ConvolutionEffect):
        raise ComputeError(
            f"{NAME} needs dwell points at rest on the grid's nodes (a sum of convolutions): use newton_cg"
        )
    judge = _Judge(problem, kkt_tolerance)
    work = start_splitting(problem, effect)
    stopped = minimise(work, judge.stop, limit.expired)
    if stopped == "stalled":
        work = continue_iteration(work, start_splitting(replace(problem, warm=None), effect, np.float64))
        judge.can_stall = False
        stopped = minimise(work, judge.stop, limit.expired)
    if stopped != "converged":
        judge.stop(work.time_s)
    found = certify_dwell(
        problem,
        judge.best_s,
        solver=NAME,
        iterations=work.iterations,
        seconds=limit.cpu_s,
        stopped=stopped,
    )
    return replace(found, state=work.state)


def minimise(work: SplittingState, stop: Stop, expired: Callable[[], bool], ask_every: int = ASK_EVERY) -> str:
    """Iterate until ``stop``, asked every so many iterations, says why to, or time is up, or for `MAX_ITERATIONS`."""
    for count in range(1, MAX_ITERATIONS + 1):
        work.iterate()
        if (count % ask_every == 0 or count == ASK_FIRST) and (reason := stop(work.time_s)) is not None:
            return reason
        if expired():
            return "deadline"
    return "iterations"


class _Judge:
    """Looks at a dwell in float64: the best so far, and whether it is good enough."""

    def __init__(self, problem: DwellProblem, kkt_tolerance: float) -> None:
        self.can_stall = True
        self.best_s: FloatArray = problem.lower_s
        self._lower, self._upper = problem.lower_s, problem.upper_s
        self._f = quadratic(problem)
        self._step = self._f.safe_step
        self._at_lower = self._f.gradient(self._lower)
        self._enough = kkt_tolerance * float(np.abs(self._at_lower).max())
        self._least = np.inf
        self._history: list[float] = []

    def stop(self, time_s: FloatArray) -> str | None:
        """``converged`` at the tolerance, ``stalled`` where float32 comes no nearer."""
        t = np.clip(time_s, self._lower, self._upper)
        gradient = self._f.gradient(t)
        value = float((t - self._lower) @ (gradient + self._at_lower)) / 2  # above the objective at the lower bound
        if value < self._least or not self._history:
            self._least, self.best_s = value, t
        left = float(np.abs(projected_gradient(gradient, t, self._lower, self._upper, self._step)).max())
        self._history.append(left)
        if left <= self._enough:
            self.best_s = t
            return "converged"
        stalled = len(self._history) > 3 and left > STALLED * self._history[-4]
        return "stalled" if stalled and self.can_stall else None
