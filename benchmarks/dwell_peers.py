"""Dwell solvers of others and our two, each run until the problem's objective is at most the goal."""

from __future__ import annotations

import signal
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import fft, optimize
from scipy.sparse.linalg import LinearOperator

from benchmarks.bench_dwell import Goal, require
from polishd.model.surface import FloatArray
from polishd.plugins import dwell_solvers
from polishd.process.dwell import douglas_rachford, newton_cg
from polishd.process.dwell.douglas_rachford import SplittingState, start_splitting
from polishd.process.dwell.problem import DwellProblem
from polishd.process.dwell.quadratic import QuadraticObjective
from polishd.process.fft.simd import COUNT, load, store
from polishd.process.fft.transforms import (
    Columns,
    FftPlanArrays,
    Field,
    columns_back,
    columns_forth,
    inline,
    kernel,
    rows_back,
    rows_forth,
    transform_plane,
)
from polishd.process.removal.convolution import ConvolutionEffect

TINY = np.float32(1e-6)
Indices = NDArray[np.int64]
Spectrum = NDArray[np.complex128]


def lean(problem: DwellProblem) -> QuadraticObjective:
    """The objective in float64 for an effect of convolutions, at little more than the cost of the transforms."""
    effect, mask = problem.effect, problem.solve_mask
    assert isinstance(effect, ConvolutionEffect)
    size, (top, left), factors = effect.size, effect.corner, list(effect.coefficients.T.copy())
    kernels, backs = effect.spectra, effect.spectra.conj()
    row, column = np.divmod(effect.node, effect.lattice[1])
    point = row * size[1] + column
    i, j = np.nonzero(mask)
    sample = (i + top) * size[1] + j + left

    def transform(values: FloatArray, where: Indices) -> Spectrum:
        domain = np.zeros(size)
        domain.ravel()[where] = values
        return np.asarray(fft.rfft2(domain, overwrite_x=True))

    def restore(spectrum: Spectrum, where: Indices) -> FloatArray:
        return np.asarray(fft.irfft2(spectrum, size, overwrite_x=True).ravel()[where])

    def forward(t: FloatArray) -> FloatArray:
        total = transform(factors[0] * t, point)
        total *= kernels[0]
        for factor, spectrum in zip(factors[1:], kernels[1:], strict=True):
            total += spectrum * transform(factor * t, point)
        return restore(total, sample)

    def backward(w: FloatArray) -> FloatArray:
        spectrum = transform(w, sample)
        total = np.zeros(effect.n)
        for factor, back in zip(factors, backs, strict=True):
            total += factor * restore(back * spectrum, point)
        return total

    return QuadraticObjective(forward, backward, problem.target_nm[mask], problem.effect.n, problem.regularisation)


def ours(problem: DwellProblem, value: Callable[[FloatArray], float], goal: Goal) -> None:
    """Douglas-Rachford as its `solve` runs it; the objective is evaluated in float64, at the solver's own interval."""
    work, stop = started(problem, value, goal)
    douglas_rachford.minimise(work, stop, lambda: False)
    if value(work.time_s) > goal.objective or (work.time_s < 0).any():
        raise RuntimeError(f"reached {value(work.time_s):g} of {goal.objective:g}")


def started(
    problem: DwellProblem, value: Callable[[FloatArray], float], goal: Goal
) -> tuple[SplittingState, douglas_rachford.Stop]:
    assert isinstance(problem.effect, ConvolutionEffect)
    return start_splitting(problem, problem.effect), lambda t: "reached" if value(t) <= goal.objective else None


def iterations(problem: DwellProblem, value: Callable[[FloatArray], float], goal: Goal) -> int:
    """Count our iterations, with a check after each."""
    work, stop = started(problem, value, goal)
    if douglas_rachford.minimise(work, stop, lambda: False, ask_every=1) != "reached":
        raise RuntimeError("the goal was not reached")
    return work.iterations


def transforms(problem: DwellProblem, times: int) -> None:
    """Run the transforms of so many of our iterations: both ways, one for the removal, one for each convolution."""
    effect = problem.effect
    assert isinstance(effect, ConvolutionEffect)
    on = transform_plane(effect.size)
    fields = np.stack([on.packed(np.ones(on.size))] * (1 + effect.rank))
    kernel(_alone)(times, fields, on.columns(1)[0], on.order)


def _alone(times: int, fields: Field, columns: Columns, order: FftPlanArrays) -> None:
    for _ in range(times):
        for f in range(len(fields)):
            for slab in range(order.slabs):
                rows_forth(fields[f], slab, order)
            for block in range(order.blocks):
                columns_forth(fields[f], block, columns, order)
                columns_back(fields[f], block, columns, order)
            for slab in range(order.slabs):
                rows_back(fields[f], slab, order)
                _scaled(fields[f], slab, order)


@inline
def _scaled(field: Field, slab: int, order: FftPlanArrays) -> None:
    """Bound all variables."""
    for half in range(2):
        for x in range(order.row.n):
            store(field[half, slab], x * COUNT, TINY * load(field[half, slab], x * COUNT))


def newton(problem: DwellProblem, f: QuadraticObjective, goal: Goal) -> None:
    zero = np.zeros(problem.effect.n)
    value, slope = f.value(zero), f.gradient(zero)

    def stop(t: FloatArray, gradient: FloatArray) -> str | None:
        return "reached" if float(t @ (gradient + slope)) / 2 + value <= goal.objective else None

    t, _, _ = newton_cg.minimise(f, (problem.lower_s, problem.upper_s), problem.lower_s, stop)
    require(f, t, problem, goal)


def lsq_linear(problem: DwellProblem, f: QuadraticObjective, goal: Goal) -> None:
    """It cannot stop at an objective: run it at ever smaller tolerances until it reaches the goal."""
    m, n = f.target.size, problem.effect.n
    root = np.sqrt(m * f.regularisation)
    whole = LinearOperator(
        (m + n, n),
        matvec=lambda t: np.concatenate([f.forward(t.ravel()), root * t.ravel()]),
        rmatvec=lambda w: f.backward(w.ravel()[:m]) + root * w.ravel()[m:],
        dtype=np.float64,
    )
    wanted = np.concatenate([f.target, np.zeros(n)])
    tolerance = 1e-8
    while True:
        found = optimize.lsq_linear(
            whole, wanted, (0, np.inf), tol=tolerance, lsmr_tol="auto", max_iter=100_000, lsq_solver="lsmr"
        )
        if f.value(np.maximum(found.x, 0)) <= goal.objective:
            return
        tolerance /= 100


def backend(problem: DwellProblem, name: str, goal: Goal, within_s: float) -> None:
    certificate = dwell_solvers.solve_qp(problem, within_s, name).certificate
    if certificate.objective > goal.objective:
        give_up()


def give_up() -> None:
    """A peer that will not reach the goal is left to the race's cap: it did not finish."""
    signal.pause()


def reference(problem: DwellProblem, gap: float, within_s: float = 600.0, kkt_tolerance: float = 1e-9) -> Goal:
    """Return the objective at this relative gap from a minimum found in float64, to that KKT residual."""
    found = douglas_rachford.solve(replace(problem, warm=None), within_s, kkt_tolerance).certificate
    if not found.kkt_residual <= kkt_tolerance:
        raise RuntimeError(f"the reference has a KKT residual of {found.kkt_residual:g}")
    return Goal(found.objective * (1 + gap))
