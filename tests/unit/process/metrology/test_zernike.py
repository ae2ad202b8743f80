"""Zernike terms: standard names, recovered on any mask, refused where the mask does not separate them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polishd.model.errors import MapError
from polishd.model.surface import BoolArray, FloatArray, Grid
from polishd.process.metrology import zernike
from polishd.process.metrology.zernike import FIRST, Norm, Ordering, order, pvr, values
from tests.unit.process.gaussian import rough
from tests.unit.process.masked import shapes

GRID = Grid(150, 140, 1.0)
MASKS = shapes(GRID)
ORDERINGS: tuple[Ordering, ...] = ("noll", "fringe", "ansi")


def of_terms(coefficients: FloatArray, mask: BoolArray, ordering: Ordering, norm: Norm) -> FloatArray:
    """The surface with these terms over the circle around a mask."""
    row, column, radius = zernike.enclosing_circle(mask)
    y, x = np.mgrid[: mask.shape[0], : mask.shape[1]]
    x, y = (x - column) / radius, (row - y) / radius
    terms = values(order(ordering, len(coefficients)), norm, x.ravel(), y.ravel())
    return np.where(mask, (coefficients @ terms).reshape(mask.shape), np.nan)


@pytest.mark.parametrize("ordering", ORDERINGS)
def test_indices_and_values_are_prysms(ordering: Ordering) -> None:
    from prysm.polynomials import ansi_j_to_nm, fringe_to_nm, noll_to_nm, zernike_nm

    to_nm = {"noll": noll_to_nm, "fringe": fringe_to_nm, "ansi": ansi_j_to_nm}[ordering]
    rng = np.random.default_rng(1)
    r, angle = np.sqrt(rng.random(50)), rng.uniform(-np.pi, np.pi, 50)
    pairs = order(ordering, 60)
    assert list(pairs) == [to_nm(FIRST[ordering] + i) for i in range(60)]
    for norm in ("rms", "edge"):
        own = values(pairs, norm, r * np.cos(angle), r * np.sin(angle))
        theirs = [zernike_nm(n, m, r, angle, norm=norm == "rms") for n, m in pairs]
        np.testing.assert_allclose(own, theirs, rtol=1e-9, atol=1e-9)


def test_the_first_terms_by_hand() -> None:
    assert order("noll", 6) == ((0, 0), (1, 1), (1, -1), (2, 0), (2, -2), (2, 2))
    assert order("fringe", 9) == ((0, 0), (1, 1), (1, -1), (2, 0), (2, 2), (2, -2), (3, 1), (3, -1), (4, 0))
    assert order("ansi", 4) == ((0, 0), (1, -1), (1, 1), (2, -2))
    x, y = np.array([0.6]), np.array([0.3])
    tilt_y, power = values(((1, -1), (2, 0)), "edge", x, y)[:, 0]
    assert (tilt_y, power) == pytest.approx((0.3, 2 * 0.45 - 1))


@pytest.mark.parametrize("ordering", ORDERINGS)
@pytest.mark.parametrize("name", sorted(MASKS))
@pytest.mark.parametrize("terms", [36, 37])
def test_terms_are_recovered_on_any_mask(ordering: Ordering, name: str, terms: int) -> None:
    rng = np.random.default_rng(terms)
    expected = rng.standard_normal(terms) * 30
    fitted = zernike.fit(of_terms(expected, MASKS[name], ordering, "rms"), MASKS[name], terms, ordering, norm="rms")
    np.testing.assert_allclose(fitted.coefficients_nm, expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    assert fitted.residual_rms_nm < 1e-9
    assert len(fitted.terms) == terms


def test_each_ordering_has_its_usual_norm() -> None:
    mask = MASKS["circle"]
    for ordering, norm in (("noll", "rms"), ("ansi", "rms"), ("fringe", "edge")):
        fitted = zernike.fit(rough(GRID), mask, 11, ordering)
        assert (fitted.norm, fitted.ordering) == (norm, ordering)


def test_one_term_of_a_whole_circle_is_its_rms() -> None:
    n = 400
    grid = Grid(n, n, 1.0)
    mask = grid.radius_mm() <= n / 2
    fitted = zernike.fit(of_terms(np.eye(11)[7] * 5, mask, "noll", "rms"), mask, 11)
    assert np.nanstd(zernike.surface(fitted, mask)) == pytest.approx(5, rel=0.01)
    assert 1 < fitted.condition < 1.2


@pytest.mark.parametrize("name", sorted(MASKS))
def test_over_the_mask_terms_are_shares_of_the_variance(name: str) -> None:
    mask, height = MASKS[name], rough(GRID, seed=4)
    fitted = zernike.fit(height, mask, 37)
    shape = zernike.surface(fitted, mask)[mask]
    assert np.sum(fitted.over_mask_nm[1:] ** 2) == pytest.approx(shape.var(), rel=1e-9)
    assert abs(fitted.over_mask_nm[0]) == pytest.approx(abs(height[mask].mean()), rel=1e-9)
    assert fitted.residual_rms_nm**2 + shape.var() == pytest.approx(height[mask].var(), rel=1e-9)
    fewer = zernike.fit(height, mask, 15)  # orthogonal: other terms do not change them
    np.testing.assert_allclose(fewer.over_mask_nm, fitted.over_mask_nm[:15], atol=1e-9)


def test_a_fit_is_that_of_the_whole_design_matrix() -> None:
    mask, height = MASKS["ellipse"], rough(GRID, seed=5)
    row, column, radius = zernike.enclosing_circle(mask)
    i, j = np.nonzero(mask)
    design = values(order("noll", 21), "rms", (j - column) / radius, (row - i) / radius).T
    expected = np.linalg.lstsq(design, height[mask], rcond=None)[0]
    fitted = zernike.fit(height, mask, 21)
    np.testing.assert_allclose(fitted.coefficients_nm, expected, atol=1e-9)
    assert fitted.condition == pytest.approx(np.linalg.cond(design), rel=1e-6)


@settings(max_examples=20)
@given(st.integers(0, 10**6), st.floats(-1e3, 1e3), st.floats(-20, 20))
def test_piston_and_tilt_touch_the_first_three_terms_only(seed: int, c: float, a: float) -> None:
    mask, height = MASKS["annulus"], rough(GRID, seed=seed)
    one = zernike.fit(height, mask, 15)
    other = zernike.fit(height + c + a * GRID.x_mm[None, :], mask, 15)
    np.testing.assert_allclose(other.coefficients_nm[3:], one.coefficients_nm[3:], atol=1e-7)
    assert other.residual_rms_nm == pytest.approx(one.residual_rms_nm, rel=1e-9)


def test_a_turn_by_90_degrees_turns_the_terms() -> None:
    grid = Grid(121, 121, 1.0)
    mask = grid.radius_mm() <= 58
    height = rough(grid, seed=6)
    one = zernike.fit(height, mask, 8)
    turned = zernike.fit(np.rot90(height), mask, 8)  # anticlockwise: x goes to y, y to -x
    at = {pair: index for index, pair in enumerate(one.terms)}
    a, b = one.coefficients_nm, turned.coefficients_nm
    assert (b[at[1, -1]], b[at[1, 1]]) == pytest.approx((a[at[1, 1]], -a[at[1, -1]]), abs=1e-9)
    assert (b[at[2, 2]], b[at[2, -2]]) == pytest.approx((-a[at[2, 2]], -a[at[2, -2]]), abs=1e-9)
    assert b[at[2, 0]] == pytest.approx(a[at[2, 0]], abs=1e-9)


def test_the_unit_circle_can_be_named() -> None:
    mask = MASKS["circle"]
    fitted = zernike.fit(rough(GRID), mask, 6, circle_px=(70.0, 71.5, 90.0))
    assert (fitted.centre_px, fitted.radius_px) == ((70.0, 71.5), 90.0)
    with pytest.raises(ValueError, match="radius 0"):
        zernike.fit(rough(GRID), mask, 6, circle_px=(70.0, 71.5, 0.0))


def test_the_enclosing_circle() -> None:
    mask = np.zeros((9, 11), dtype=bool)
    mask[2:7, 4] = True
    assert zernike.enclosing_circle(mask) == (4.0, 4.0, 2.0)
    mask[4, 1:8] = True
    assert zernike.enclosing_circle(mask) == (4.0, 4.0, 3.0)
    with pytest.raises(MapError, match="no sample"):
        zernike.enclosing_circle(np.zeros((3, 3), dtype=bool))


def test_what_cannot_be_distinguished_is_refused() -> None:
    height = rough(GRID)
    line, ring = np.zeros(GRID.shape, dtype=bool), np.abs(GRID.radius_mm() - 50) < 0.4
    line[70, :] = True
    for mask in (line, ring):
        with pytest.raises(MapError, match="cannot be separated"):
            zernike.fit(height, mask, 37)
    with pytest.raises(MapError, match="cannot be separated"):  # a spot in a large circle
        zernike.fit(height, GRID.radius_mm() < 6, 37, circle_px=(75.0, 70.0, 500.0))
    few = np.zeros(GRID.shape, dtype=bool)
    few[:4, :5] = True
    with pytest.raises(MapError, match="20 samples are too few for 37"):
        zernike.fit(height, few, 37)
    with pytest.raises(MapError, match="no data"):
        zernike.fit(np.where(MASKS["circle"], np.nan, height), MASKS["circle"])
    with pytest.raises(ValueError, match="noll, fringe, ansi"):
        zernike.fit(height, MASKS["circle"], 6, "born")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="1 or more"):
        zernike.fit(height, MASKS["circle"], 0)


def test_pvr_is_that_of_its_definition() -> None:
    mask, height = MASKS["circle"], rough(GRID, seed=8)
    for terms in (36, 37):
        fitted = zernike.fit(height, mask, terms, "fringe")
        shape = zernike.surface(fitted, mask)
        found = pvr(height, mask, terms)
        rest = (height - shape)[mask]
        assert found.pvr_nm == pytest.approx(np.nanmax(shape) - np.nanmin(shape) + 3 * np.sqrt(np.mean(rest**2)))
    assert pvr(height, mask) == pvr(height, mask, 36)


def test_one_bad_pixel_does_not_set_pvr() -> None:
    mask, height = MASKS["circle"], rough(GRID, seed=8)
    spiked = height.copy()
    spiked[60, 60] += 2000
    assert np.ptp(spiked[mask]) > 1900
    assert pvr(spiked, mask).pvr_nm < pvr(height, mask).pvr_nm * 1.6


def test_terms_of_noise_scatter_as_their_covariance_says() -> None:
    """On half a circle, where terms are far from orthogonal: 400 draws, each entry within 4 standard deviations."""
    small = Grid(24, 24, 1.0)
    x, y = small.axes_mm
    mask = (np.hypot(x, y) <= 12) & (x + 0 * y < 3)
    rng = np.random.default_rng(5)
    drawn = [zernike.fit(rng.normal(size=mask.shape), mask, 6) for _ in range(400)]
    stated = drawn[0].per_noise
    seen = np.cov(np.array([one.coefficients_nm for one in drawn]).T)
    deviation = np.sqrt((stated**2 + np.outer(np.diag(stated), np.diag(stated))) / 400)
    assert (np.abs(seen - stated) < 4 * deviation).all()


DENSE = {
    "disc": np.hypot(*np.mgrid[-1:1:401j, -1:1:401j]) <= 1,
    "annulus": abs(np.hypot(*np.mgrid[-1:1:401j, -1:1:401j]) - 0.8) <= 0.2,
    "strip": np.abs(np.mgrid[-1:1:401j, -1:1:401j][0]) <= 0.4,
    "square of a width that the stride divides": np.ones((384, 384), dtype=bool),
}


@pytest.mark.one_of_each
@pytest.mark.parametrize("name", DENSE)
@pytest.mark.parametrize("noise", [0.0, 3.0])
def test_the_triangle_of_many_samples_is_that_of_qr(name: str, noise: float) -> None:
    """Also where some samples do not stand for all, and where the terms leave nothing of the values."""
    mask = DENSE[name]
    x, y = zernike.unit_coordinates(mask, zernike.enclosing_circle(mask))
    assert x.size > 2 * zernike.SAMPLED
    pairs = order("noll", 22)

    def basis(u: FloatArray, v: FloatArray) -> FloatArray:
        return values(pairs, "rms", u, v)

    heights = basis(x, y).T @ np.arange(1.0, 23.0) + noise * np.random.default_rng(3).standard_normal(x.size)
    found, exact = (
        one * np.where(np.diag(one) < 0, -1.0, 1.0)[:, None]
        for one in (zernike.triangle(basis, x, y, heights), zernike._triangle_by_qr(basis, x, y, heights))
    )
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-12 * np.abs(exact).max())


def test_samples_that_do_not_stand_for_all_are_no_start() -> None:
    rng = np.random.default_rng(4)
    x, y = rng.uniform(-1, 1, (2, 60_000))

    def basis(u: FloatArray, v: FloatArray) -> FloatArray:
        return np.stack([np.ones_like(u), u, v])

    few = zernike._triangle_by_qr(basis, x[:100] / 1e3, y[:100], x[:100])
    assert zernike._triangle_near(few, basis, x, y, x + rng.standard_normal(x.size)) is None
