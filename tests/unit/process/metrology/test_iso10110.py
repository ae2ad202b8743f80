"""ISO 10110-5, slope and the comparison of two maps, on surfaces whose figures are known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polishd.model.errors import MapError
from polishd.model.surface import FloatArray, Grid
from polishd.process.metrology.spectra import band_rms, compare_maps, radial_psd
from polishd.process.metrology.statistics import pv_rms, remove_terms, slope, slope_map
from polishd.process.metrology.tolerance import irregularity
from tests.unit.process.gaussian import rough
from tests.unit.process.masked import shapes

GRID = Grid(161, 161, 0.5)
X, Y = np.meshgrid(GRID.x_mm, GRID.y_mm)
R = GRID.radius_mm() / 40
DISC = R <= 1
MASKS = shapes(GRID)


class TestIso10110:
    def test_a_sphere_is_a(self) -> None:
        found = irregularity(300 * R**2 + 5 * X - 3 * Y + 8, DISC)
        assert found.a_nm == pytest.approx(300, rel=1e-9)
        assert max(found.b_nm, found.c_nm, found.rms_i_nm, found.rms_a_nm) < 1e-9
        assert found.rms_t_nm == pytest.approx(300 * (R**2)[DISC].std(), rel=1e-9)

    def test_astigmatism_is_b_and_not_c(self) -> None:
        found = irregularity(50 * R**2 * np.cos(2 * np.arctan2(Y, X)), DISC)
        assert found.b_nm == pytest.approx(100, rel=1e-6)
        assert max(found.a_nm, found.c_nm) < 1e-6
        assert found.rms_a_nm == pytest.approx(found.rms_i_nm, rel=1e-9)

    def test_a_zone_is_c(self) -> None:
        zone = 90 * (6 * R**4 - 6 * R**2 + 1)  # primary spherical: -0.5 ... 1
        found = irregularity(zone, DISC)
        assert found.c_nm == pytest.approx(found.b_nm, rel=1e-9)
        assert found.c_nm == pytest.approx(135, rel=0.02)
        assert found.a_nm < 5  # the discrete disc's r^2 and r^4 are not quite orthogonal
        assert found.rms_a_nm < 1e-9

    def test_parts_add_up_in_squares(self) -> None:
        found = irregularity(rough(GRID, seed=3), DISC)
        assert found.rms_a_nm < found.rms_i_nm < found.rms_t_nm
        sphere = np.sqrt(found.rms_t_nm**2 - found.rms_i_nm**2)
        assert sphere == pytest.approx(found.a_nm * (R**2)[DISC].std(), rel=0.01)

    @settings(max_examples=20)
    @given(st.sampled_from(sorted(MASKS)), st.floats(-900, 900), st.floats(-9, 9), st.floats(-9, 9))
    def test_piston_and_tilt_do_not_matter(self, name: str, c: float, a: float, b: float) -> None:
        mask, height = MASKS[name], rough(GRID, seed=4)
        plain = irregularity(height, mask)
        moved = irregularity(height + c + a * X + b * Y, mask)
        for figure in ("a_nm", "b_nm", "c_nm", "rms_t_nm", "rms_i_nm", "rms_a_nm"):
            assert getattr(moved, figure) == pytest.approx(getattr(plain, figure), rel=1e-7, abs=1e-7)

    def test_the_axis_can_be_named(self) -> None:
        off = np.hypot(X - 5, Y) / 40
        zone = 90 * (6 * off**4 - 6 * off**2)
        where = irregularity(zone, DISC, centre_px=(80.0, 90.0))
        assert where.rms_a_nm < irregularity(zone, DISC).rms_a_nm / 1.8

    def test_refusals(self) -> None:
        with pytest.raises(MapError, match="no sample"):
            irregularity(X, ~(DISC | ~DISC))


class TestSlope:
    def test_the_map_of_it_has_its_figures_in_its_places(self) -> None:
        found, magnitude = slope(2.0 * X**2, DISC, 0.5, 2.0), slope_map(2.0 * X**2, DISC, 0.5, 2.0)
        known = np.isfinite(magnitude)
        assert magnitude.shape == DISC.shape
        assert np.count_nonzero(known) == found.samples
        assert np.sqrt(np.mean(magnitude[known] ** 2)) == pytest.approx(found.rms_urad, rel=1e-12)
        np.testing.assert_allclose(magnitude[known], np.abs(4.0 * X[known]), atol=1e-9)

    def test_a_bowl_has_a_slope_that_grows_with_x(self) -> None:
        found = slope(2.0 * X**2, DISC, 0.5)  # 4 x nm per mm
        assert found.integration_mm == 1.0
        assert found.rms_x_urad == pytest.approx(4 * X[DISC].std(), rel=0.02)
        assert found.rms_y_urad == pytest.approx(0, abs=1e-9)
        assert found.max_urad == pytest.approx(4 * 39.5, rel=0.02)
        assert found.pv_x_urad == pytest.approx(2 * found.max_urad, rel=1e-6)

    @pytest.mark.parametrize("length", [1.0, 2.0, 5.0])
    def test_a_longer_length_damps_short_waves(self, length: float) -> None:
        k = 2 * np.pi / 8
        wave = np.sin(k * Y)
        found = slope(wave, np.ones(wave.shape, dtype=bool), 0.5, length)
        expected = k / np.sqrt(2) * abs(np.sinc(length / 8))
        assert found.integration_mm == length
        assert found.rms_y_urad == pytest.approx(expected, rel=0.03)

    @settings(max_examples=20)
    @given(st.sampled_from(sorted(MASKS)), st.floats(-900, 900), st.floats(-9, 9), st.floats(0.1, 9))
    def test_tilt_does_not_matter_and_it_scales(self, name: str, c: float, a: float, factor: float) -> None:
        mask, height = MASKS[name], rough(GRID, seed=6)
        plain, moved = slope(height, mask, 0.5), slope(factor * height + c + a * X, mask, 0.5)
        for figure in ("rms_x_urad", "pv_x_urad", "rms_y_urad", "pv_y_urad", "rms_urad", "max_urad"):
            assert getattr(moved, figure) == pytest.approx(factor * getattr(plain, figure), rel=1e-7, abs=1e-8)

    def test_a_turn_swaps_x_and_y(self) -> None:
        height = rough(GRID, seed=7)
        one, other = slope(height, DISC, 0.5), slope(np.rot90(height), np.rot90(DISC), 0.5)
        assert other.rms_x_urad == pytest.approx(one.rms_y_urad, rel=1e-9)
        assert other.rms_urad == pytest.approx(one.rms_urad, rel=1e-9)

    def test_samples_beyond_the_mask_never_enter(self) -> None:
        height = rough(GRID, seed=8)
        dirty = np.where(DISC, height, 1e9)
        assert slope(dirty, DISC, 0.5).max_urad == slope(np.where(DISC, height, np.nan), DISC, 0.5).max_urad

    def test_refusals(self) -> None:
        with pytest.raises(ValueError, match="integration length"):
            slope(X, DISC, 0.5, 0.0)
        for length in (79.0, 500.0):
            with pytest.raises(MapError, match="nowhere as wide"):
                slope(X, R < 0.5, 0.5, length)


class TestComparison:
    def test_the_papers_table_v(self) -> None:
        """Changes are relative to the surface before: C and D of both cases come back from the percentages."""
        cases = ((15.334, 18.353, 10.252, 0.1969, -0.4414), (15.377, 19.467, 10.909, 0.2660, -0.4396))
        unit = rough(GRID, rms_nm=1.0)
        unit = unit / unit[DISC].std()
        for b, c, d, to_c, to_d in cases:
            first, second = compare_maps(b * unit, c * unit, DISC, 0.5), compare_maps(c * unit, d * unit, DISC, 0.5)
            assert (first.rms_change, second.rms_change) == pytest.approx((to_c, to_d), abs=1e-4)

    def test_every_figure_is_that_of_its_function(self) -> None:
        before, after = rough(GRID, seed=1), rough(GRID, rms_nm=4, seed=2)
        found = compare_maps(before, after, DISC, 0.5, (33.0, 8.0))
        for height, side in ((before, found.before), (after, found.after)):
            assert (side.pv_nm, side.rms_nm) == pv_rms(height, DISC)
            assert side.band_rms_nm[0] == pytest.approx(band_rms(remove_terms(height, DISC, "tilt"), DISC, 0.5, 33.0))
            np.testing.assert_array_equal(side.psd.density_nm2_mm2, radial_psd(height, DISC, 0.5).density_nm2_mm2)
        for change, b, a in zip(found.band_changes, found.before.band_rms_nm, found.after.band_rms_nm, strict=True):
            assert change == pytest.approx(a / b - 1)
        assert found.pv_change == pytest.approx(found.after.pv_nm / found.before.pv_nm - 1)
        assert found.removed_rms_nm == pytest.approx((before - after)[DISC].std())
        assert (found.edges_mm, found.samples) == ((33.0, 8.0), DISC.sum())

    def test_what_was_removed_shows_in_its_band_only(self) -> None:
        ripple = 5 * np.sin(2 * np.pi * X / 8)
        base = rough(GRID, seed=3, cut_mm=30)
        found = compare_maps(base + ripple, base, DISC, 0.5, (20.0, 4.0))
        assert found.band_changes[1] < -0.75
        assert abs(found.band_changes[0]) < 0.02

    def test_from_nothing(self) -> None:
        flat: FloatArray = np.zeros(GRID.shape)
        assert compare_maps(flat, flat, DISC, 0.5).rms_change == 0
        assert compare_maps(flat, flat + X, DISC, 0.5).rms_change == np.inf

    def test_one_mask_for_both(self) -> None:
        height = rough(GRID)
        with pytest.raises(MapError, match="no data"):
            compare_maps(height, np.where(R < 0.5, np.nan, height), DISC, 0.5)
        with pytest.raises(MapError, match="its mask"):
            compare_maps(height, height[1:], DISC, 0.5)
