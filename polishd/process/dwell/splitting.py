"""Over-relaxed Douglas-Rachford splitting of the dwell problem on Fourier transforms.

The problem is split in two that are each solved in closed form, with ``y`` the removal and ``w_k = c_k t`` the dwell as
the k-th convolution of the effect sees it:

- sample by sample and point by point: the misfit of ``y``, and regularisation, price and bounds of ``t``;
- frequency by frequency: ``y = sum_k K_k w_k``.

An iteration takes 2 (rank + 1) transforms, in float32. Nothing here is trusted: the certificate is computed anew.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from polishd.model.dwell import Start
from polishd.model.surface import FloatArray
from polishd.process.convolution import ConvolutionEffect
from polishd.process.dwell.problem import DwellProblem
from polishd.process.dwell.quadratic import quadratic, warm_start_s

RELAXATION = 1.9
MISFIT_STEP = 0.06
"""Step parameter of y over the misfit's curvature; flat between 0.05 and 0.1."""
LEAST_REGULARISATION = 1e-5
"""Regularisation below this share of the misfit's curvature is taken for this, in the step parameter only."""
ADAPT_AT = (20, 40)
"""Iterations between which the dual and the primal variables' changes are compared, to mend the step of w."""
ADAPT_POWER = 0.25
"""How strongly; measured on spots of 1.7 to 20 mm, where the best step varies by 2 and the ratio by 60."""

Array = NDArray[Any]


@dataclass(slots=True)
class Splitting:
    """The iteration's fixed arrays and its state; made by `splitting`."""

    effect: ConvolutionEffect
    size: tuple[int, int]
    spectra: Array
    """(k, ...) K_k, times the balance."""
    balance: FloatArray
    """(k,) by which the effect's kernels are multiplied, and its coefficients divided."""
    strength: Array
    """(...) sum_k |K_k|^2."""
    coefficient: Array
    """(k, ny, nx) c_k on the domain; 0 where no dwell point lies."""
    pull: Array
    """(ny, nx) misfit's curvature of a sample, ``2 weight / N_r``; 0 where none counts."""
    target: Array
    """(ny, nx) removal wanted; 0 where no sample counts."""
    bounds: tuple[Array, Array]
    """(ny, nx) least and most dwell."""
    regularisation: float
    price: float
    rho: float
    """Step parameter of y."""
    mu: float
    """Step parameter of w."""
    y: Array
    """(ny, nx) the iterate; with w it is what a warm start needs."""
    w: Array
    """(k, ny, nx)."""
    dwell: Array
    """(ny, nx) t of the last iteration: within the bounds, whenever one stops."""
    iterations: int = 0
    _fixed: dict[str, Array] = field(default_factory=dict)
    _seen: tuple[Array, Array] | None = None

    @property
    def time_s(self) -> FloatArray:
        """(n,) dwell of each point, float64, within the bounds."""
        return np.asarray(self.dwell[self._where()], dtype=np.float64)

    @property
    def state(self) -> Mapping[str, Array]:
        """What a later problem on the same domain can start from."""
        return {"y": self.y, "w": self.w, "balance": self.balance, "steps": np.array([self.rho, self.mu])}

    def _where(self) -> tuple[Array, Array]:
        return np.divmod(self.effect.node, self.effect.lattice[1])

    def iterate(self) -> None:
        """One iteration."""
        fixed = self._fixed or self._prepare()
        self.iterations += 1
        spectrum = fft.rfft2(self.y)
        for kernel, w in zip(self.spectra, self.w, strict=True):
            part = fft.rfft2(w)
            part *= kernel
            spectrum -= part
        spectrum *= fixed["gain"]
        moved = [fft.irfft2(kernel * spectrum, self.size, overwrite_x=True) for kernel in fixed["back"]]
        met = [w + change for w, change in zip(self.w, moved, strict=True)]  # with y they fulfil y = sum K w
        for k in range(self.rank):
            moved[k] += met[k]  # the reflection
        self._dwell_nearest_to(moved)
        for k in range(self.rank):
            np.multiply(self.dwell, self.coefficient[k], out=moved[k])
            moved[k] -= met[k]
            moved[k] *= RELAXATION
            self.w[k] += moved[k]
        change = fft.irfft2(spectrum, self.size, overwrite_x=True)
        change *= fixed["y_change"]
        self.y *= fixed["y_keep"]
        self.y += change
        self.y += fixed["y_add"]
        if self.iterations in ADAPT_AT:
            self._adapt()

    @property
    def rank(self) -> int:
        """Number of convolutions."""
        return len(self.spectra)

    def _dwell_nearest_to(self, wanted: list[Array]) -> None:
        """The dwell within its bounds, point by point, where each w's (ny, nx), regularisation and price agree."""
        gain, scratch = self._fixed["t_gain"], self._fixed["scratch"]
        np.multiply(wanted[0], gain[0], out=self.dwell)
        for k in range(1, self.rank):
            np.multiply(wanted[k], gain[k], out=scratch)
            self.dwell += scratch
        if self.price:
            self.dwell -= self._fixed["t_price"]
        np.clip(self.dwell, *self.bounds, out=self.dwell)

    def _prepare(self) -> dict[str, Array]:
        """What the iteration multiplies by; anew whenever a step parameter changes."""
        real = self.y.dtype.type
        kept = self.pull / (self.pull + self.rho)
        square = (self.coefficient.astype(np.float64) ** 2).sum(axis=0)
        firm = 1 / np.where(square > 0, 2 * self.regularisation + self.mu * square, np.inf)
        self._fixed = {
            "gain": (1 / (1 + self.strength * (self.rho / self.mu))).astype(real),
            "back": (self.spectra.conj() * (self.rho / self.mu)).astype(self.spectra.dtype),
            "y_keep": (1 - RELAXATION * kept).astype(real),
            "y_change": (RELAXATION * (2 * kept - 1)).astype(real),
            "y_add": (RELAXATION * kept * self.target).astype(real),
            "t_gain": (self.mu * firm * self.coefficient).astype(real),
            "scratch": np.empty_like(self.dwell),
            "t_price": (self.price * firm).astype(real),
        }
        return self._fixed

    def _adapt(self) -> None:
        """Mend w's step by how much the dual variable moved for what the primal moved."""
        primal = self.coefficient * self.dwell
        dual = self.w - primal
        if self._seen is not None:
            moved = float(np.linalg.norm(primal - self._seen[0]))
            ratio = float(np.linalg.norm(dual - self._seen[1])) / moved if moved > 0 else 1.0
            self._rescale(float(np.clip(ratio**ADAPT_POWER, 0.5, 3.0)))
        self._seen = (primal, dual)

    def _rescale(self, factor: float) -> None:
        """Another step parameter of w; the scaled dual variable goes with it."""
        primal = self.coefficient * self.dwell
        self.w = (primal + (self.w - primal) / factor).astype(self.w.dtype)
        self.mu *= factor
        self._fixed = {}


def splitting(problem: DwellProblem, effect: ConvolutionEffect, real: type = np.float32) -> Splitting:
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
    found = Splitting(
        effect=effect,
        size=size,
        spectra=spectra.astype(complex_type),
        balance=balance,
        strength=strength,
        coefficient=coefficient.astype(real),
        pull=pull,
        target=target,
        bounds=(lower.astype(real), upper.astype(real)),
        regularisation=problem.regularisation,
        price=problem.price_nm2_per_s,
        rho=rho,
        mu=mu,
        y=target.astype(real),
        w=np.zeros((effect.rank, *size), dtype=real),
        dwell=np.zeros(size, dtype=real),
    )
    start = warm_start_s(problem, quadratic(problem))
    if problem.warm is not None and start is not None:
        _start_warm(found, problem.warm, start)
    return found


def continued(last: Splitting, anew: Splitting) -> Splitting:
    """``anew``, which has the same domain, from where ``last`` has come to: how float64 takes over from float32."""
    anew.y, anew.w = last.y.astype(anew.y.dtype), last.w.astype(anew.w.dtype)
    anew.rho, anew.mu, anew.iterations = last.rho, last.mu, last.iterations
    return anew


def _balance(effect: ConvolutionEffect) -> FloatArray:
    """(k,) square roots of the coefficients' sizes over the first's: kernel and coefficient of each share alike.

    A family's kernels come with coefficients that fall by an order of magnitude each. Left so, three convolutions take
    a third more iterations than one; so balanced they take as many.
    """
    size = np.sqrt((effect.coefficients**2).mean(axis=0))
    return np.asarray(np.sqrt(np.maximum(size, 1e-12 * size.max()) / size.max()), dtype=np.float64)


def _start_warm(found: Splitting, warm: Start, time_s: FloatArray) -> None:
    """From the state of a solution where it fits; else from its dwell, (n,) within the bounds."""
    state = warm.state
    if "w" in state and state["w"].shape == found.w.shape and state["y"].shape == found.y.shape:
        found.y = np.array(state["y"], dtype=found.y.dtype)
        found.w = (state["w"] * (state["balance"] / found.balance)[:, None, None]).astype(found.w.dtype)
        found.rho, found.mu = (float(value) for value in state["steps"])
        return
    dwell = np.zeros(found.size)
    dwell[np.divmod(found.effect.node, found.effect.lattice[1])] = time_s
    found.w = (found.coefficient * dwell).astype(found.w.dtype)
    total = sum(kernel * fft.rfft2(w) for kernel, w in zip(found.spectra, found.w, strict=True))
    found.y = np.asarray(fft.irfft2(total, found.size), dtype=found.y.dtype)
