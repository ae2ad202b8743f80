"""A surface beyond its rim: the data stay, planes and band-limited surfaces go on as they are, bad input is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import ndimage

from polishd.model.errors import ComputeError
from polishd.model.surface import BoolArray, FloatArray, Grid
from polishd.process.metrology import edge_extension
from polishd.process.metrology.edge_extension import ExtendedSurface, Extension, extend_surface
from polishd.process.metrology.statistics import polynomial
from tests.unit.process.gaussian import rough

GRID = Grid(110, 120, 1.0)
DISC = GRID.radius_mm() <= 40.0
METHODS: tuple[Extension, ...] = ("nearest", "c1", "gerchberg_papoulis")
CUTOFF = 12.0


def extended(height: FloatArray, mask: BoolArray, method: Extension, reach_mm: float = 10.0) -> ExtendedSurface:
    """The surface as far as the mask shows it, extended; what lies outside must not matter."""
    return extend_surface(
        np.where(mask, height, np.nan), mask, GRID.pitch_mm, reach_mm, method, cutoff_period_mm=CUTOFF
    )


def plane() -> FloatArray:
    return np.asarray(3 * GRID.x_mm[None, :] - 2 * GRID.y_mm[:, None] + 7, dtype=np.float64)


def error_nm(result: ExtendedSurface, truth: FloatArray, ring: tuple[float, float]) -> float:
    """RMS against the truth between two distances beyond the disc's rim."""
    beyond = GRID.radius_mm() - 40.0
    there = result.mask & (beyond > ring[0]) & (beyond <= ring[1])
    return float(np.sqrt(np.mean((result.height_nm - truth)[there] ** 2)))


def jumps_nm(height: FloatArray, order: int) -> float:
    """Largest difference of this order, along x, that has samples on either side of the disc's rim."""
    difference = np.diff(height, order, axis=1)
    across = np.diff(DISC.astype(int), axis=1) != 0
    touched = ndimage.binary_dilation(across, np.ones((1, 2 * order - 1)))[:, : difference.shape[1]]
    steep = np.abs(GRID.y_mm)[:, None] < 25  # where the rim is steep to x
    return float(np.nanmax(np.abs(difference[touched & steep & np.isfinite(difference)])))


@pytest.mark.parametrize("method", METHODS)
def test_the_data_stay_and_the_reach_is_kept(method: Extension) -> None:
    height = rough(GRID, cut_mm=CUTOFF)
    result = extended(height, DISC, method, 7.0)
    np.testing.assert_array_equal(result.height_nm[DISC], height[DISC])
    distance = ndimage.distance_transform_edt(~DISC)
    np.testing.assert_array_equal(result.mask, distance <= 7.0)
    np.testing.assert_array_equal(np.isfinite(result.height_nm), result.mask)


@pytest.mark.parametrize("method", METHODS)
def test_what_lies_outside_the_mask_does_not_matter(method: Extension) -> None:
    height = rough(GRID, cut_mm=CUTOFF)
    rubbish = np.where(DISC, height, 1e6)
    one = extend_surface(rubbish, DISC, 1.0, 5.0, method, cutoff_period_mm=CUTOFF)
    np.testing.assert_array_equal(one.height_nm, extended(height, DISC, method, 5.0).height_nm)


@pytest.mark.parametrize("method", METHODS)
def test_it_follows_scale_and_offset_of_the_surface(method: Extension) -> None:
    height = rough(GRID, cut_mm=CUTOFF)
    one, other = extended(height, DISC, method), extended(5 * height - 100, DISC, method)
    np.testing.assert_allclose(other.height_nm, 5 * one.height_nm - 100, atol=0.02 * 5 * height.std())


@pytest.mark.parametrize("method", METHODS)
def test_the_pitch_only_scales_the_reach(method: Extension) -> None:
    height = rough(GRID, cut_mm=CUTOFF)
    fine = extend_surface(height, DISC, 0.25, 2.5, method, cutoff_period_mm=CUTOFF / 4)
    np.testing.assert_array_equal(fine.height_nm, extended(height, DISC, method).height_nm)


@pytest.mark.parametrize("method", ["c1", "gerchberg_papoulis"])
def test_planes_go_on_as_planes(method: Extension) -> None:
    result = extended(plane(), DISC, method)
    np.testing.assert_allclose(result.height_nm[result.mask], plane()[result.mask], atol=1e-5)
    assert result.rounds == 0


def test_a_bowl_goes_on_where_it_is_band_limited() -> None:
    bowl = GRID.radius_mm() ** 2 / 50
    result = extended(bowl, DISC, "gerchberg_papoulis")
    np.testing.assert_allclose(result.height_nm[result.mask], bowl[result.mask], atol=1e-9)


def test_nearest_repeats_the_rim() -> None:
    result = extended(plane(), DISC, "nearest")
    row = result.height_nm[54]
    last = int(np.flatnonzero(DISC[54])[-1])
    np.testing.assert_array_equal(row[last : last + 9], np.full(9, row[last]))


def test_c1_goes_on_with_value_and_slope_and_nearest_only_with_the_value() -> None:
    x, y = np.meshgrid(GRID.x_mm, GRID.y_mm)
    wave = 20 * np.sin(2 * np.pi * x / 40) * np.cos(2 * np.pi * y / 60)
    smooth = jumps_nm(wave, 2)  # what the surface's own curvature gives
    nearest, c1 = (extended(wave, DISC, method) for method in ("nearest", "c1"))
    assert jumps_nm(nearest.height_nm, 1) < 1.2 * jumps_nm(wave, 1)
    assert jumps_nm(nearest.height_nm, 2) > 3 * smooth
    assert jumps_nm(c1.height_nm, 2) < 1.5 * smooth


@pytest.mark.parametrize("seed", range(3))
def test_the_better_the_method_the_nearer_to_the_true_outside(seed: int) -> None:
    truth = rough(GRID, seed=seed, cut_mm=CUTOFF) + 0.1 * GRID.x_mm
    results = {method: extended(truth, DISC, method) for method in METHODS}
    for ring in ((0.0, 2.0), (2.0, 4.0)):
        nearest, c1, band = (error_nm(results[method], truth, ring) for method in METHODS)
        assert band < 0.55 * c1
        assert c1 < 0.85 * nearest
    assert error_nm(results["gerchberg_papoulis"], truth, (0.0, 2.0)) < 0.06 * truth[DISC].std()


@pytest.mark.parametrize("seed", range(3))
def test_noise_is_not_blown_up(seed: int) -> None:
    truth = rough(GRID, seed=seed, cut_mm=CUTOFF)
    noisy = truth + 0.5 * np.random.default_rng(seed).standard_normal(truth.shape)
    results = {method: extended(noisy, DISC, method) for method in METHODS}
    nearest, c1, band = (error_nm(results[method], truth, (0.0, 3.0)) for method in METHODS)
    assert band < 0.7 * c1
    assert c1 < 0.8 * nearest
    # half a nanometre of noise among 18.5 nm is out of the band, and said to be
    figure = (truth - polynomial(truth, DISC, 2))[DISC].std()
    assert results["gerchberg_papoulis"].misfit == pytest.approx(0.5 / figure, rel=0.1)
    assert results["gerchberg_papoulis"].rounds < edge_extension.ROUNDS


def test_the_projections_are_those_of_gerchberg(monkeypatch: pytest.MonkeyPatch) -> None:
    """Plain alternate projections from the same start come to the same surface, and take longer."""
    truth = rough(GRID, cut_mm=20.0)
    shape = (160, 180)
    window = (slice(25, 135), slice(30, 150))
    inside, data = np.zeros(shape, dtype=bool), np.zeros(shape)
    inside[window], data[window] = DISC, np.where(DISC, truth - truth[DISC].mean(), 0.0)
    fy, fx = np.fft.fftfreq(shape[0])[:, None], np.fft.rfftfreq(shape[1])[None, :]
    band = np.hypot(fy, fx) <= 1 / 20.0
    plain = np.zeros(shape)
    for _ in range(400):
        plain = np.fft.irfft2(np.fft.rfft2(np.where(inside, data, plain)) * band, shape)
    monkeypatch.setattr(edge_extension, "ROUNDS", 50)
    fast, rounds, misfit = edge_extension._conjugate_gradients(np.zeros(shape), data, inside, band)
    assert rounds == 50
    assert misfit < np.sqrt(np.mean((data - plain)[inside] ** 2))
    near = ndimage.binary_dilation(inside, iterations=3) & ~inside
    assert np.sqrt(np.mean((fast - plain)[near] ** 2)) < 0.1 * data[inside].std()
    assert misfit == pytest.approx(float(np.sqrt(np.mean((data - fast)[inside] ** 2))))
    np.testing.assert_allclose(np.fft.irfft2(np.fft.rfft2(fast) * band, shape), fast, atol=1e-9)


def test_the_extension_has_no_periods_below_the_cutoff() -> None:
    """With data of the band only, data and extension together stay in it."""
    truth = rough(GRID, cut_mm=CUTOFF)
    result = extended(truth, DISC, "gerchberg_papoulis", 6.0)
    assert result.misfit < 5e-3
    roughness = {m: np.abs(ndimage.laplace(extended(truth, DISC, m, 6.0).height_nm)) for m in METHODS}
    rim = ndimage.binary_dilation(DISC, iterations=3) & ~ndimage.binary_erosion(DISC, iterations=2)
    worst = {m: float(np.nanmax(value[rim])) for m, value in roughness.items()}
    natural = float(np.abs(ndimage.laplace(truth))[rim].max())
    assert worst["gerchberg_papoulis"] < 1.5 * natural
    assert worst["nearest"] > worst["gerchberg_papoulis"]


@pytest.mark.parametrize("method", METHODS)
def test_holes_are_filled_as_the_outside_is(method: Extension) -> None:
    mask = DISC.copy()
    mask[50:57, 60:68] = False
    mask[30, 40] = False
    truth = rough(GRID, cut_mm=20.0)
    result = extended(truth, mask, method, 5.0)
    hole = DISC & ~mask
    assert result.mask[hole].all()
    error = np.abs(result.height_nm - truth)[hole].max()
    assert error < {"nearest": 0.6, "c1": 0.2, "gerchberg_papoulis": 0.05}[method] * truth[DISC].std()


@pytest.mark.parametrize("method", METHODS)
def test_a_hole_wider_than_the_reach_stays_open_in_the_middle(method: Extension) -> None:
    ring = DISC & (GRID.radius_mm() > 20)
    result = extended(rough(GRID, cut_mm=20.0), ring, method, 5.0)
    assert not result.mask[55, 60]
    assert np.isnan(result.height_nm[55, 60])


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("shape", ["sample", "row", "rectangle", "whole map", "two islands"])
def test_any_mask_is_extended_to_finite_heights(method: Extension, shape: str) -> None:
    mask = np.zeros(GRID.shape, dtype=bool)
    where: dict[str, list[Any]] = {
        "sample": [np.s_[50, 60]],
        "row": [np.s_[50, 40:80]],
        "rectangle": [np.s_[20:90, 10:100]],
        "whole map": [np.s_[:, :]],
        "two islands": [np.s_[20:40, 20:40], np.s_[70:90, 80:100]],
    }
    for part in where[shape]:
        mask[part] = True
    height = np.full(GRID.shape, 5.0)
    result = extended(height, mask, method)
    np.testing.assert_allclose(result.height_nm[result.mask], 5.0, atol=1e-2)


@pytest.mark.parametrize("method", METHODS)
def test_a_flat_surface_stays_flat(method: Extension) -> None:
    result = extended(np.zeros(GRID.shape), DISC, method)
    np.testing.assert_array_equal(result.height_nm[result.mask], 0.0)
    assert (result.rounds, result.misfit) == (0, 0.0)


def test_what_cannot_be_extended_is_refused() -> None:
    height = rough(GRID, cut_mm=CUTOFF)
    nothing = np.zeros(GRID.shape, dtype=bool)
    with pytest.raises(ComputeError, match="the mask is empty"):
        extended(height, nothing, "c1")
    with pytest.raises(ComputeError, match=r"the surface is \(110, 120\), its mask \(3, 3\)"):
        extend_surface(height, np.ones((3, 3), dtype=bool), 1.0, 5.0, "c1")
    holed = height.copy()
    holed[50, 50:53] = np.nan
    with pytest.raises(ComputeError, match="3 samples inside the mask have no data"):
        extend_surface(holed, DISC, 1.0, 5.0, "c1")
    for reach in (0.5, -1.0, np.nan, np.inf):
        with pytest.raises(ComputeError, match="the reach of the extension"):
            extended(height, DISC, "nearest", reach)
    for pitch in (0.0, np.nan):
        with pytest.raises(ComputeError, match="the map's pitch"):
            extend_surface(height, DISC, pitch, 5.0, "nearest")
    with pytest.raises(ComputeError, match="give cutoff_period_mm"):
        extend_surface(height, DISC, 1.0, 5.0, "gerchberg_papoulis")
    with pytest.raises(ComputeError, match="the spot's cut-off period is 2 mm, it must be above 2"):
        extend_surface(height, DISC, 1.0, 5.0, "gerchberg_papoulis", cutoff_period_mm=2.0)
    with pytest.raises(ComputeError, match="no extension 'spline'"):
        extend_surface(height, DISC, 1.0, 5.0, "spline")  # type: ignore[arg-type]
