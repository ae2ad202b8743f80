"""The array API: coordinates, interpolation, lattices, goals, every refusal, and the example of the documentation."""

from __future__ import annotations

import runpy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polishd.model.errors import ComputeError
from polishd.model.surface import FloatArray
from polishd.process.dwell import douglas_rachford, from_arrays
from polishd.process.dwell.from_arrays import (
    DwellCase,
    array_problem,
    default_solve,
    dwell_from_arrays,
    dwell_lattice,
    map_axes,
)
from polishd.process.removal.convolution import ConvolutionEffect
from polishd.process.removal.effect import SparseEffect

EXAMPLE = Path(__file__).resolve().parents[4] / "examples" / "dwell_from_arrays.py"
X, Y = 100 + np.arange(31) * 0.5, 50 - np.arange(21) * 0.5
U = (np.arange(33) - 16) * 0.25
HEIGHT = 30 + 20 * np.sin(X[None, :] / 3) * np.cos(Y[:, None] / 4)


def gauss(dx: FloatArray, dy: FloatArray) -> FloatArray:
    """nm/s, longer along x, and heavier towards positive x and y."""
    return np.asarray(4 * np.exp(-(dx**2) / 4 - dy**2) * (1 + 0.2 * np.tanh(dx) + 0.1 * np.tanh(dy)))


# rows run as the map's, whose y falls
CASE = DwellCase(X, Y, HEIGHT, gauss(U[None, :], -U[:, None]), 0.25)


def removal_by_hand(points: FloatArray, time_s: FloatArray) -> FloatArray:
    total = np.zeros(HEIGHT.shape)
    for (px, py), seconds in zip(points, time_s, strict=True):
        dx, dy = X[None, :] - px, Y[:, None] - py
        total += seconds * np.where((np.abs(dx) <= 4) & (np.abs(dy) <= 4), gauss(dx, dy), 0)
    return total


def test_the_effect_is_the_tif_about_each_point() -> None:
    rng = np.random.default_rng(0)
    points = np.stack([rng.uniform(97, 118, 30), rng.uniform(37, 53, 30)], axis=1)
    problem, at = array_problem(replace(CASE, points_mm=points))
    assert isinstance(problem.effect, SparseEffect)
    np.testing.assert_array_equal(at, points)
    time_s = rng.random(30)
    assert np.abs(problem.effect.removal_nm(time_s) - removal_by_hand(points, time_s)).max() < 8e-3


def test_at_its_own_samples_the_tif_is_exact() -> None:
    problem, _ = array_problem(replace(CASE, points_mm=np.array([[105.0, 45.0]])))
    removal = problem.effect.removal_nm(np.ones(1))
    assert removal == pytest.approx(removal_by_hand(np.array([[105.0, 45.0]]), np.ones(1)), abs=1e-12)
    assert removal[2, 10] == pytest.approx(CASE.tif_nm_s[0, 16])  # 4 mm above: the rim's own sample counts


@pytest.mark.parametrize("way", ["y rises", "x falls", "meshgrid"])
def test_the_axes_may_run_either_way(way: str) -> None:
    points = np.array([[103.3, 44.1], [110.2, 47.7], [106.0, 42.0]])
    case = replace(CASE, points_mm=points)
    plain = dwell_from_arrays(case)
    if way == "y rises":
        case = replace(case, y_mm=Y[::-1], height_nm=HEIGHT[::-1], tif_nm_s=CASE.tif_nm_s[::-1])
        back: Any = (slice(None, None, -1), slice(None))
    elif way == "x falls":
        case = replace(case, x_mm=X[::-1], height_nm=HEIGHT[:, ::-1], tif_nm_s=CASE.tif_nm_s[:, ::-1])
        back = (slice(None), slice(None, None, -1))
    else:
        x, y = np.meshgrid(X, Y)
        case, back = replace(case, x_mm=x, y_mm=y), (slice(None), slice(None))
    turned = dwell_from_arrays(case)
    assert turned.time_s == pytest.approx(plain.time_s, abs=1e-6)
    assert turned.residual_nm[back] == pytest.approx(plain.residual_nm, abs=1e-6)


def test_the_lattice_is_centred_and_covers_the_reach() -> None:
    axes = map_axes(X, Y, HEIGHT.shape)
    points = dwell_lattice(axes, np.ones(HEIGHT.shape, dtype=bool), np.array([4.0, 4.0]), 1.0)
    # 15 x 10 mm and 4 mm each way: 24 and 19 points
    assert points.shape == (24 * 19, 2)
    assert points.mean(axis=0) == pytest.approx([107.5, 45.0])
    assert np.ptp(points, axis=0) == pytest.approx([23, 18])
    assert points[1] - points[0] == pytest.approx([0, 1])  # along the shorter axis first
    mask = np.zeros(HEIGHT.shape, dtype=bool)
    mask[3, 5:8] = True
    alone = dwell_lattice(axes, mask, np.array([1.0, 2.0]), 0.5)
    assert alone.mean(axis=0) == pytest.approx([X[6], Y[3]])
    assert len(alone) == 7 * 9


def test_solving_brings_the_map_down_and_says_how_far() -> None:
    found = dwell_from_arrays(CASE)
    assert found.certificate.stopped == "converged"
    assert found.certificate.kkt_residual <= 1e-8
    left = HEIGHT - found.problem.effect.removal_nm(found.time_s)
    assert left.std() == pytest.approx(found.certificate.predicted_rms_nm, rel=1e-9)
    assert left.std() < 0.01 * HEIGHT.std()
    assert len(found.time_s) == len(found.points_mm)


def test_missing_data_masks_and_the_clear_aperture() -> None:
    height = HEIGHT.copy()
    height[:4] = np.nan
    clear = np.zeros(HEIGHT.shape, dtype=bool)
    clear[8:15, 8:20] = True
    found = dwell_from_arrays(replace(CASE, height_nm=height, clear=clear))
    assert np.isnan(found.residual_nm[:4]).all()
    assert np.isfinite(found.residual_nm[4:]).all()
    assert found.residual_nm[clear].std() == pytest.approx(found.certificate.predicted_rms_nm)
    assert found.points_mm[:, 1].max() <= Y[4] + 4 + 1e-9
    weighted = dwell_from_arrays(replace(CASE, weight=np.where(clear, 1.0, 0.01), clear=clear))
    assert (
        weighted.certificate.predicted_rms_nm
        < dwell_from_arrays(replace(CASE, clear=clear)).certificate.predicted_rms_nm
    )


def test_bounds_hold_and_a_chosen_piston_lifts_the_map() -> None:
    found = dwell_from_arrays(replace(CASE, lower_s=0.01, upper_s=3.0))
    assert (found.time_s >= 0.01).all()
    assert (found.time_s <= 3.0).all()
    each = np.linspace(0, 0.02, len(found.time_s))
    assert (dwell_from_arrays(replace(CASE, lower_s=each)).time_s >= each).all()
    flat = replace(CASE, height_nm=HEIGHT - HEIGHT.mean())
    low = dwell_from_arrays(flat).certificate
    assert any("raise piston_nm" in note for note in low.notes)
    chosen = dwell_from_arrays(replace(flat, piston_nm=None)).certificate
    assert not any("raise piston_nm" in note for note in chosen.notes)
    assert chosen.predicted_rms_nm < 0.1 * low.predicted_rms_nm
    given = dwell_from_arrays(replace(flat, piston_nm=25.0))
    assert given.certificate.piston_nm == pytest.approx(25.0)


@pytest.mark.full
def test_goals() -> None:
    free = dwell_from_arrays(CASE).certificate
    budget = 0.9 * free.dwell_total_s
    hurried = dwell_from_arrays(CASE, budget_s=budget)
    assert 0.999 * budget <= hurried.certificate.dwell_total_s <= budget
    assert hurried.problem.price_nm2_per_s > 0
    enough = dwell_from_arrays(CASE, target_rms_nm=1.0).certificate
    assert 0.99 <= enough.predicted_rms_nm <= 1.0
    assert enough.dwell_total_s < free.dwell_total_s
    dear = dwell_from_arrays(CASE, price_nm2_per_s=hurried.problem.price_nm2_per_s)
    assert dear.certificate.dwell_total_s == pytest.approx(hurried.certificate.dwell_total_s, rel=1e-4)
    with pytest.raises(ComputeError, match="give one"):
        dwell_from_arrays(CASE, budget_s=1.0, target_rms_nm=1.0)


def test_points_that_reach_nothing_but_the_corner_are_noted() -> None:
    tif = np.where(np.hypot(U[None, :], U[:, None]) <= 4, CASE.tif_nm_s, 0.0)
    corner = np.array([[105.0, 45.0], [X[0] - 3.5, Y[0] + 3.5]])
    found = dwell_from_arrays(replace(CASE, tif_nm_s=tif, points_mm=corner))
    assert found.time_s[1] == 0
    assert any(note.startswith("1 points reach no sample") for note in found.certificate.notes)


@pytest.mark.full
def test_many_points_on_the_maps_own_samples_are_a_convolution(monkeypatch: pytest.MonkeyPatch) -> None:
    x, y = np.meshgrid(X[0] + 0.5 * np.arange(-5, 36), Y[0] - 0.5 * np.arange(-5, 26))
    case = replace(CASE, points_mm=np.stack([x.ravel(), y.ravel()], axis=1), rho=1e-4)
    plain, _ = array_problem(case)
    monkeypatch.setattr(from_arrays, "MATRIX_ENTRIES", 1000)
    problem, points = array_problem(case)
    assert isinstance(plain.effect, SparseEffect)
    assert isinstance(problem.effect, ConvolutionEffect)
    rng = np.random.default_rng(2)
    time_s, weight = rng.random(len(points)), rng.random(HEIGHT.shape)
    assert problem.effect.removal_nm(time_s) == pytest.approx(plain.effect.removal_nm(time_s), abs=1e-9)
    assert problem.effect.adjoint(weight) == pytest.approx(plain.effect.adjoint(weight), abs=1e-9)
    found = default_solve(problem)
    assert found.certificate.solver == douglas_rachford.NAME
    assert found.certificate.objective == pytest.approx(default_solve(plain).certificate.objective, rel=1e-4)
    monkeypatch.setattr(from_arrays, "MOST_ENTRIES", 1000)
    with pytest.raises(ComputeError, match="too many for a matrix"):
        array_problem(replace(case, points_mm=case.points_mm + 0.1))


def with_nan() -> FloatArray:
    height = HEIGHT.copy()
    height[3, 7] = np.nan
    return height


WHOLE = np.ones(HEIGHT.shape, dtype=bool)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"height_nm": with_nan(), "mask": WHOLE}, r"height_nm is nan at row 3, column 7.*1 such"),
        ({"height_nm": np.full(HEIGHT.shape, np.nan)}, "mask is empty"),
        ({"mask": ~WHOLE}, "mask is empty"),
        ({"clear": ~WHOLE}, "clear is empty"),
        ({"mask": WHOLE[:-1]}, r"mask is bool \(20, 31\), it must be bool \(21, 31\)"),
        ({"mask": HEIGHT}, "mask is float64"),
        ({"height_nm": HEIGHT[0]}, "it must be"),
        ({"x_mm": X[:-1]}, r"x_mm is \(30,\), it must be \(31,\)"),
        ({"x_mm": X**2}, "x_mm is .* even"),
        ({"x_mm": 2 * X}, "resample to one pitch"),
        ({"x_mm": np.where(X[3] == X, np.nan, X)}, "x_mm is nan mm, it must be finite and even"),
        ({"x_mm": HEIGHT}, "no meshgrid"),
        ({"tif_nm_s": 0 * CASE.tif_nm_s}, "zero everywhere"),
        ({"tif_nm_s": -CASE.tif_nm_s}, "tif_nm_s is negative at row 0, column 0"),
        ({"tif_nm_s": CASE.tif_nm_s * np.nan}, "tif_nm_s is not finite"),
        ({"tif_nm_s": CASE.tif_nm_s[0]}, "two-dimensional"),
        ({"tif_pitch_mm": 0.0}, "tif_pitch_mm is 0 mm"),
        ({"points_mm": np.array([[105.0, 45.0], [300.0, 45.0]])}, r"point 1 at \(300, 45\) mm lies outside"),
        ({"points_mm": np.zeros((0, 2))}, "must be"),
        ({"points_mm": np.zeros((3, 3))}, "must be"),
        ({"points_mm": np.array([[105.0, np.nan]])}, "point 0: y of points_mm is nan"),
        ({"step_mm": 0.0}, "step_mm is 0"),
        ({"lower_s": 2.0, "upper_s": 1.0}, "lower_s is above upper_s at point 0"),
        ({"lower_s": -1.0}, "lower_s is negative"),
        ({"lower_s": np.zeros(3)}, r"lower_s is \(3,\), it must be one number"),
        ({"piston_nm": np.inf}, "piston_nm is inf nm"),
        ({"rho": -1.0}, "rho must be finite"),
        ({"weight": -np.ones(HEIGHT.shape)}, "weight must be"),
    ],
)
def test_what_is_wrong_is_said(changes: dict[str, Any], says: str) -> None:
    with pytest.raises(ComputeError, match=says):
        dwell_from_arrays(replace(CASE, **changes))


def test_a_budget_below_the_floor() -> None:
    with pytest.raises(ComputeError, match=r"the budget is 3 s, but the dwell floor alone takes 45\.6 s"):
        dwell_from_arrays(replace(CASE, lower_s=0.1), budget_s=3.0)


@pytest.mark.full
def test_the_documented_example_runs(capsys: pytest.CaptureFixture[str]) -> None:
    runpy.run_path(str(EXAMPLE), run_name="__main__")
    printed = capsys.readouterr().out
    assert "least residual" in printed
    assert "knee" in printed
    assert "1 nm is enough" in printed
