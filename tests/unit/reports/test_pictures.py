"""Pictures that all reports have: limits and ripple in the spectrum, one color scale of the maps."""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import pytest

from polishd.model.tolerance import ToleranceLine
from polishd.rendering.map_plots import ConvergenceStep, Spectrum
from polishd.rendering.plots import polishd_style
from polishd.reports.pictures import NamedMap, convergence_figure, maps_figure, spectra_figure
from polishd.reports.wording import psd_limits
from tests.unit.rendering.printed import require_legible

FREQUENCY_PER_MM = np.geomspace(0.01, 1.0, 50)
LINE = ToleranceLine("psd", 30.0, above_mm=5.0, below_mm=30.0, exponent=2.0)


def curves(count: int) -> dict[str, Spectrum]:
    return {f"after pass {k}": Spectrum(FREQUENCY_PER_MM, 10.0**-k / FREQUENCY_PER_MM) for k in range(count)}


@pytest.mark.parametrize("count", [1, 2, pytest.param(7, marks=pytest.mark.full)])
def test_a_spectrum_has_the_limits_of_the_drawing_and_the_ripple(count: int) -> None:
    summary = {"tolerance": [{"what": LINE.what, **asdict(LINE)}, {"what": "RMS", "limit": 2.0, "unit": "nm"}]}
    with polishd_style():
        fig = spectra_figure(curves(count), psd_limits(summary), [2.0, 2.0, 0.5])
        require_legible(fig)
    (ax,) = fig.axes
    legend = ax.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.texts][-2:] == ["limit 30 / f^2", "ripple, 2.00 mm"]
    limit = next(line for line in ax.lines if line.get_label() == "limit 30 / f^2")
    assert np.asarray(limit.get_xdata()) == pytest.approx([1 / 30, 1 / 5])
    assert np.asarray(limit.get_ydata()) == pytest.approx([30 * 30.0**2, 30 * 5.0**2])


def test_a_summary_of_an_earlier_polishd_has_no_limits_to_draw() -> None:
    assert psd_limits({"tolerance": [{"what": "PSD", "limit": 30.0, "unit": "nm^2 mm^2"}]}) == []
    assert psd_limits({"tolerance": None}) == []


def test_maps_before_and_after_have_one_color_scale_and_the_last_its_own() -> None:
    clear = np.ones((20, 20), dtype=bool)
    noise = np.random.default_rng(1).normal(0.0, 1.0, (20, 20))
    maps = [NamedMap(name, size * noise, clear, size) for name, size in (("Start", 9.0), ("After pass 1", 1.0))]
    with polishd_style():
        fig = maps_figure(maps, 1.0)
    ends = [ax.images[0].get_clim()[1] for ax in fig.axes if ax.images]
    assert ends[0] == ends[1] == pytest.approx(9 * ends[2])
    assert [ax.get_title(loc="left") for ax in fig.axes if ax.images] == [
        "Start\n9.00 nm RMS",
        "After pass 1\n1.00 nm RMS",
        "After pass 1, own scale\n1.00 nm RMS",
    ]
    assert len([ax for ax in maps_figure(maps[:1], 1.0).axes if ax.images]) == 1


def test_the_names_of_the_convergence_lie_beside_it() -> None:
    steps = [ConvergenceStep("start", 20.0), ConvergenceStep("after pass 1", 5.0, 4.0, (3.0, 6.0))]
    with polishd_style():
        fig = convergence_figure(steps, 2.0, "measured, periods above 7 mm")
        require_legible(fig)
    (ax,) = fig.axes
    legend = ax.get_legend()
    assert legend is not None
    assert legend.get_window_extent().x0 >= ax.bbox.x1 - 1
