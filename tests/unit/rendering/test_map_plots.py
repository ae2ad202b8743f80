"""The plots of all pictures: color scales, spectra up to Nyquist, convergence with interrupted passes."""

from __future__ import annotations

import math

import numpy as np
import pytest
from matplotlib.axes import Axes

from polishd.process.metrology.spectra import radial_psd
from polishd.rendering.map_plots import (
    MAX_PX,
    ConvergenceStep,
    Spectrum,
    convergence,
    height_map,
    histogram,
    path_map,
    profiles,
    spectrum,
    value_map,
)
from polishd.rendering.plots import figure
from polishd.rendering.scales import height_limit


@pytest.fixture
def ax() -> Axes:
    return figure(3, 3).subplots()


def noise(*shape: int) -> np.ndarray:
    return np.random.default_rng(1).normal(0.0, 1.0, shape)


def legend(ax: Axes) -> list[str]:
    found = ax.get_legend()
    assert found is not None
    return [text.get_text() for text in found.texts]


def test_spikes_do_not_make_the_rest_pale() -> None:
    height = noise(100, 100)
    height[5, 5] = 1e4
    assert height_limit(height) < 10
    assert height_limit(height, 100.0) == 1e4


@pytest.mark.parametrize("value", [0.0, 2e-13, math.nan])
def test_a_flat_map_has_a_scale(value: float) -> None:
    assert height_limit(np.full((3, 3), value)) == 1.0


def test_a_map_lies_about_its_center(ax: Axes) -> None:
    image = height_map(ax, noise(4, 6), 0.5, "t", limit_nm=2.0)
    assert list(image.get_extent()) == [-1.5, 1.5, -1.0, 1.0]
    assert image.get_clim() == (-2.0, 2.0)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("x, mm", "y, mm")


def test_a_map_without_a_scale_is_in_pixels(ax: Axes) -> None:
    assert list(height_map(ax, noise(4, 6), None, "t").get_extent()) == [-3.0, 3.0, -2.0, 2.0]
    assert ax.get_xlabel() == "x, px"


def test_a_large_map_is_thinned(ax: Axes) -> None:
    shown = height_map(ax, noise(3 * MAX_PX, 6), 0.5, "t", edge=np.ones((3 * MAX_PX, 6), dtype=bool))
    assert shown.get_array() is not None
    assert shown.get_size()[0] == MAX_PX
    assert list(shown.get_extent()) == [-1.5, 1.5, -0.75 * MAX_PX, 0.75 * MAX_PX]


@pytest.mark.parametrize(("height", "extend"), [(3.0, "max"), (-3.0, "min"), (1.0, "neither"), (math.nan, "neither")])
def test_the_bar_is_pointed_where_values_are_beyond_its_end(ax: Axes, height: float, extend: str) -> None:
    image = height_map(ax, np.full((2, 2), height), 1.0, "", limit_nm=2.0)
    assert image.colorbar is not None
    assert image.colorbar.extend == extend


@pytest.mark.parametrize("shape", [(20, 20), (20, 40), (40, 20)])
def test_a_title_that_is_wider_than_its_map_is_not_under_the_bar(shape: tuple[int, int]) -> None:
    page = figure(3, 5)
    ax = page.subplots()
    image = height_map(ax, noise(*shape), 1.0, "calibrated: 1.03 nm RMS, PV 5.64", limit_nm=1.0)
    page.draw_without_rendering()
    assert image.colorbar is not None
    assert not ax.title.get_window_extent().overlaps(image.colorbar.ax.get_tightbbox())


def test_the_edge_of_the_aperture_is_drawn(ax: Axes) -> None:
    edge = np.zeros((9, 9), dtype=bool)
    edge[2:7, 2:7] = True
    height_map(ax, noise(9, 9), 1.0, "", edge=edge)
    (contour,) = [one for one in ax.collections if hasattr(one, "levels")]
    (path,) = contour.get_paths()
    assert np.abs(path.vertices).max() == pytest.approx(2.5)


def test_values_have_their_own_scale_and_edges(ax: Axes) -> None:
    image = value_map(ax, np.arange(4.0).reshape(2, 2), 1.0, "", "s", extent_mm=(5.0, 9.0, 1.0, 2.0))
    assert image.get_clim() == (0.0, 3.0)
    assert list(image.get_extent()) == [5.0, 9.0, 1.0, 2.0]


def test_a_spectrum_ends_at_nyquist(ax: Axes) -> None:
    """White noise has power in the corners of the square of frequencies, up to 1.41 times the Nyquist frequency."""
    psd = radial_psd(noise(64, 64), np.ones((64, 64), dtype=np.bool_), 0.5)
    assert psd.frequency_per_mm[-1] > 1.3
    curve = Spectrum(psd.frequency_per_mm, psd.density_nm2_mm2)
    spectrum(ax, {"": curve}, nyquist_per_mm=1.0, periods_mm=[4.0, 1000.0])
    curve_line, mark = ax.lines
    assert 0.96 < np.max(np.asarray(curve_line.get_xdata())) <= 1.0, "the last ring within it"
    assert list(np.asarray(mark.get_xdata())) == [0.25, 0.25], "a period outside the axis is not marked"


def test_a_flat_map_has_no_spectrum(ax: Axes) -> None:
    spectrum(ax, {"": Spectrum([0.1, 0.2], [0.0, 0.0])})
    assert [text.get_text() for text in ax.texts] == ["flat: no spectrum"]


def test_profiles_have_a_legend_where_there_are_several(ax: Axes) -> None:
    profiles(ax, {"one": ([0, 1], [0, 1])})
    assert ax.get_legend() is None
    profiles(ax, {"two": ([0, 1], [0, 1]), "three": ([0, 1], [0, math.nan])})
    assert {"two", "three"} <= {*legend(ax)}


def test_all_values_are_in_the_histogram(ax: Axes) -> None:
    histogram(ax, noise(500), "t", xlabel="nm")
    assert sum(bar.get_height() for bar in ax.patches) == 500
    flat = figure(3, 3).subplots()
    histogram(flat, np.zeros(7), "t", xlabel="nm")
    assert flat.get_xlim()[0] < -0.9, "equal values have an axis, too"


STEPS = [
    ConvergenceStep("start", 20.0),
    ConvergenceStep("after pass 1", 5.0, predicted_nm=4.0, expected_nm=(3.0, 6.0)),
    ConvergenceStep("after an interrupted pass", 4.0, interrupted=True),
]


def test_convergence_shows_measured_predicted_expected_and_limit(ax: Axes) -> None:
    convergence(ax, STEPS, 2.0)
    assert legend(ax) == ["measured", "expected, 9 of 10", "predicted by the plan", "limit 2 nm"]
    assert [text.get_text() for text in ax.texts] == ["20.00", "5.00", "4.00"]
    whole, interrupted = ax.lines[:2]
    assert (whole.get_linestyle(), interrupted.get_linestyle()) == ("-", "--")
    assert [label.get_text() for label in ax.get_xticklabels()][-1] == "after an\ninterrupted pass"


def test_convergence_of_one_map_without_predictions(ax: Axes) -> None:
    convergence(ax, [ConvergenceStep("start", 20.0)], None)
    assert legend(ax) == ["measured"]


def test_many_measurements_have_numbers(ax: Axes) -> None:
    convergence(ax, [ConvergenceStep(f"after pass {k}", 20.0 / (k + 1)) for k in range(9)], None)
    assert ax.get_xlabel() == "measurement (0 = start)"


def test_points_of_a_path_end_their_colors_at_the_percentile(ax: Axes) -> None:
    position = np.column_stack([np.arange(1000.0), np.arange(1000.0) % 7])
    values = np.ones(1000)
    values[3] = 1e6
    path_map(ax, position, values, "t", "s", percentile=99.5)
    (points,) = ax.collections
    assert points.get_clim() == pytest.approx((1.0, 1.0), abs=1e-6)
