"""Compiled transforms against numpy's, and the dwell's iteration by them against the one by scipy's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from polishd.process.dwell import douglas_rachford as module
from polishd.process.dwell.douglas_rachford import start_splitting
from polishd.process.dwell.problem import DwellProblem
from polishd.process.fft.simd import COUNT, load, store
from polishd.process.fft.transforms import (
    columns_back,
    columns_forth,
    forward_fft,
    inline,
    inverse_fft,
    length,
    rows_back,
    rows_forth,
    transform_plane,
)
from polishd.process.removal.convolution import ConvolutionEffect
from tests.unit.process.lattices import lattice_problem


def noise(*shape: int) -> np.ndarray:
    return np.random.default_rng(sum(shape)).standard_normal(shape)


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 8, 9, 12, 25, 60, 480, 486, 1000])
def test_a_transform_is_numpys_in_its_own_order(n: int) -> None:
    plan, frequency = length(n)
    whole = (noise(n, COUNT) + 1j * noise(COUNT, n).T).astype(np.complex64)
    re, im = whole.real.copy(), whole.imag.copy()
    forward_fft(re, im, plan)
    wanted = np.fft.fft(whole, axis=0)
    np.testing.assert_allclose(re + 1j * im, wanted[frequency], atol=1e-6 * np.abs(wanted).max())
    inverse_fft(re, im, plan)
    np.testing.assert_allclose((re + 1j * im) / n, whole, atol=3e-6)


def test_a_length_with_another_factor_is_refused() -> None:
    with pytest.raises(ValueError, match="14 has a factor that is none of 2, 3, 5"):
        length(14)


@pytest.mark.full
@pytest.mark.parametrize("size", [(90, 60), (32, 32), (45, 75), (64, 30), (1, 8)])
def test_a_field_has_the_spectrum_of_rfft2(size: tuple[int, int]) -> None:
    on, field = transform_plane(size), noise(*size).astype(np.float32)
    kept = on.packed(field)
    np.testing.assert_array_equal(on.unpacked(kept), field)
    for slab in range(on.order.slabs):
        rows_forth(kept, slab, on.order)
    wanted, columns = on.spectrum(np.fft.rfft2(field)), on.columns(1)[0]
    for block in range(on.order.blocks):
        columns_forth(kept, block, columns, on.order)
        np.testing.assert_allclose(columns[:, : size[0]] / 2, wanted[:, block], atol=1e-6 * np.abs(wanted).max())
        columns_back(kept, block, columns, on.order)
    for slab in range(on.order.slabs):
        rows_back(kept, slab, on.order)
    np.testing.assert_allclose(on.unpacked(kept) / (2 * size[0] * size[1]), field, atol=3e-6)


@inline
def copied(source: np.ndarray, into: np.ndarray) -> None:
    store(into, 0, load(source, 0))


@pytest.mark.parametrize(
    "source", [np.zeros(2 * COUNT, np.float32)[::2], np.zeros(COUNT)], ids=["every second", "float64"]
)
def test_what_does_not_lie_side_by_side_is_refused(source: np.ndarray) -> None:
    with pytest.raises(Exception, match="C-contiguous arrays of float32 only"):
        copied(source, np.zeros(COUNT, np.float32))


@pytest.fixture(scope="module")
def problem() -> DwellProblem:
    return lattice_problem()


@pytest.mark.parametrize("case", ["as it is", "bounds, weights and a price", "one convolution"])
def test_the_compiled_iteration_is_the_plain_one(
    problem: DwellProblem, case: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """To float32, over both times at which its step is mended."""
    effect = problem.effect
    assert isinstance(effect, ConvolutionEffect)
    if case == "one convolution":
        effect = replace(effect, coefficients=effect.coefficients[:, :1], spectra=effect.spectra[:1])
        problem = replace(problem, effect=effect)
    elif case != "as it is":
        n, weight = effect.n, np.broadcast_to(np.linspace(0.1, 3.0, effect.grid.nx), effect.grid.shape)
        lower, upper = np.full(n, 0.02), np.linspace(0.1, 0.3, n)
        problem = replace(problem, weight=weight, price_nm2_per_s=0.5, lower_s=lower, upper_s=upper)
    plain = start_splitting(problem, effect)
    monkeypatch.setattr(module, "COMPILED_NODES", 0)
    compiled = start_splitting(problem, effect)
    assert type(compiled.iteration) is not type(plain.iteration)
    for _ in range(50):
        plain.iterate()
        compiled.iterate()
    np.testing.assert_allclose(compiled.time_s, plain.time_s, atol=2e-5 * plain.time_s.max())
    for name, value in plain.state.items():
        np.testing.assert_allclose(compiled.state[name], value, atol=5e-5 * np.abs(value).max())
    assert ((compiled.time_s >= problem.lower_s - 1e-7) & (compiled.time_s <= problem.upper_s + 1e-7)).all()
    again = start_splitting(replace(problem, warm=_Start(compiled)), effect)
    np.testing.assert_allclose(again.state["y"], compiled.state["y"], rtol=1e-6)


class _Start:
    def __init__(self, work: module.SplittingState) -> None:
        self.state, self.time_s = work.state, work.time_s
