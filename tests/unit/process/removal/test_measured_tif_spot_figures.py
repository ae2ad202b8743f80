"""Figures of a spot against published numbers, hand-made profiles and brute force."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from polishd.model.errors import ComputeError
from polishd.model.process import MeasuredTif, ToolProcess
from polishd.process.removal import contact
from polishd.process.removal.measured_tif import map_nm_s, measured_figures, profile_divergence, spot_figures

PAPER = ToolProcess()
# Table III: speed 1/min, force N, size mm, dip deg
TABLE_III = [
    (200, 4, 20, 5),
    (400, 6, 20, 10),
    (600, 6, 20, 15),
    (1000, 10, 20, 15),
    (1000, 12, 40, 15),
    (1000, 12, 40, 20),
]


def row_of_table_iii(rpm: float, force: float, radius: float, dip: float) -> ToolProcess:
    return dataclasses.replace(PAPER, rpm=rpm, force_n=force, tool_radius_mm=radius, dip_deg=dip)


def test_the_paper_s_process() -> None:
    figures = spot_figures(PAPER)
    assert figures.depth_mm == pytest.approx(0.14835, rel=1e-5)
    assert figures.contact_radius_mm == pytest.approx(1.7225, rel=1e-5)
    assert figures.peak_pressure_mpa == pytest.approx(1.9311, rel=1e-5)
    assert figures.peak_nm_s == pytest.approx(162, abs=0.5)
    assert figures.volume_mm3_min == pytest.approx(0.0583, abs=1e-4)
    assert figures.dissipative_fraction == pytest.approx(6.70e-4, rel=2e-3)
    assert figures.pole_mm == pytest.approx(19.85165 * np.tan(np.radians(15)), rel=1e-6)


def test_the_depth_ratio_shrinks_the_spot() -> None:
    full, part = spot_figures(PAPER), spot_figures(PAPER, 0.87)
    assert part.depth_mm / full.depth_mm == pytest.approx(0.87, rel=1e-12)
    assert part.contact_radius_mm / full.contact_radius_mm == pytest.approx(np.sqrt(0.87), rel=1e-12)
    assert part.volume_mm3_min / full.volume_mm3_min == pytest.approx(0.811, abs=1e-3)


@pytest.mark.parametrize("dip", [0.0, 2.0, 4.0, 15.0, 60.0])
def test_no_place_of_the_spot_removes_more_than_its_peak(dip: float) -> None:
    process = dataclasses.replace(PAPER, dip_deg=dip)
    figures = spot_figures(process)
    place = figures.contact_radius_mm * np.random.default_rng(2).uniform(-1, 1, (2, 400_000))
    most = contact.removal_rate_nm_s(process, figures.depth_mm, *place).max()
    assert most <= figures.peak_nm_s
    assert most == pytest.approx(figures.peak_nm_s, rel=1e-4)


def test_the_profiles_lie_along_the_axes_of_the_tools_frame() -> None:
    figures = spot_figures(PAPER)
    x, rate = map_nm_s(PAPER, 1.0, 0.01)
    middle = len(x) // 2
    assert x[middle] == 0
    inside = np.abs(figures.x_mm) < 1.6  # at the rim the rate falls steeply
    for row, profile in ((rate[middle], figures.profile_x_nm_s), (rate[::-1, middle], figures.profile_y_nm_s)):
        np.testing.assert_allclose(np.interp(figures.x_mm, x, row)[inside], profile[inside], atol=0.2)
    y = figures.profile_y_nm_s
    assert y[figures.y_mm > 0].sum() > 1.05 * y[figures.y_mm < 0].sum()  # more where the spindle leans
    assert figures.profile_x_nm_s[[0, -1]].tolist() == [0, 0]


def test_the_picture_holds_the_spot() -> None:
    x, rate = map_nm_s(PAPER, 0.9, 0.02)
    assert rate.shape == (len(x), len(x))
    assert rate.sum() * 0.02**2 * 60e-6 == pytest.approx(spot_figures(PAPER, 0.9).volume_mm3_min, rel=1e-3)
    assert rate[0].max() == rate[:, 0].max() == 0
    top, bottom = rate[: len(x) // 2].sum(), rate[len(x) // 2 + 1 :].sum()
    assert top > bottom


def valley(profile: np.ndarray) -> bool:
    """Whether the middle lies below both shoulders."""
    middle = len(profile) // 2
    return bool(profile[middle] < (1 - 1e-9) * min(profile[:middle].max(), profile[middle:].max()))


@pytest.mark.parametrize("dip", [0.0, 2.0, 4.0, 4.9, 5.1, 10.0, 15.0])
def test_the_criterion_of_the_m_shape_is_what_the_profile_does(dip: float) -> None:
    """(R - d) tan(dip) < a: at the paper's force and radius up to 4.96 degrees."""
    figures = spot_figures(dataclasses.replace(PAPER, dip_deg=dip))
    assert figures.m_shaped == valley(figures.profile_x_nm_s) == (dip < 4.96)


@pytest.mark.parametrize(("rpm", "force", "radius", "dip"), TABLE_III)
def test_no_row_of_table_iii_has_an_m_shaped_profile(rpm: float, force: float, radius: float, dip: float) -> None:
    """With the size read as the bonnet's radius, although the paper's text says that they are."""
    figures = spot_figures(row_of_table_iii(rpm, force, radius, dip))
    assert not figures.m_shaped
    assert not valley(figures.profile_x_nm_s)
    assert figures.pole_mm > figures.contact_radius_mm


def test_equal_shapes_do_not_diverge_and_disjoint_ones_diverge_most() -> None:
    p, q = np.array([1.0, 2.0, 0.0, 0.0]), np.array([0.0, 0.0, 3.0, 1.0])
    assert profile_divergence(p, 7 * p) == pytest.approx(0, abs=1e-15)
    assert profile_divergence(p, q) == pytest.approx(1.0)
    assert profile_divergence(p, q, np.e) == pytest.approx(np.log(2))


def test_the_divergence_is_the_mean_relative_entropy_to_the_mean() -> None:
    p, q = np.array([0.1, 0.4, 0.5]), np.array([0.3, 0.3, 0.4])
    mean = (p + q) / 2
    by_hand = (np.sum(p * np.log2(p / mean)) + np.sum(q * np.log2(q / mean))) / 2
    assert profile_divergence(5 * p, q) == pytest.approx(by_hand, rel=1e-12)
    assert profile_divergence(q, p) == pytest.approx(by_hand, rel=1e-12)


@pytest.mark.parametrize(
    ("p", "q", "base", "says"),
    [
        ([1.0, 2.0], [1.0], 2.0, "they must be finite and of one length"),
        ([1.0, np.nan], [1.0, 1.0], 2.0, "they must be finite"),
        ([1.0, -1.0], [1.0, 1.0], 2.0, "the first profile is not a distribution"),
        ([1.0, 1.0], [0.0, 0.0], 2.0, "the second profile is not a distribution"),
        ([], [], 2.0, "the first profile is not a distribution"),
        ([1.0], [1.0], 1.0, "the logarithm's base is 1"),
    ],
)
def test_what_is_no_distribution_does_not_diverge(p: list[float], q: list[float], base: float, says: str) -> None:
    with pytest.raises(ComputeError, match=says):
        profile_divergence(np.array(p), np.array(q), base)


def as_measured(process: ToolProcess, azimuth_deg: float, pitch: float = 0.02) -> MeasuredTif:
    """The modelled spot as it would be measured with the spindle leaning that way."""
    axis = np.arange(-100, 101) * pitch
    right, up = np.meshgrid(axis, -axis)
    azimuth = np.radians(azimuth_deg)
    x = right * np.sin(azimuth) - up * np.cos(azimuth)
    y = right * np.cos(azimuth) + up * np.sin(azimuth)
    rate = contact.removal_rate_nm_s(process, contact.hertz_depth_mm(process), x, y)
    return MeasuredTif(rate, pitch, azimuth_deg)


@pytest.mark.parametrize("azimuth", [0.0, 90.0, 200.0])
@pytest.mark.parametrize("dip", [1.0, 15.0])
def test_a_measured_spot_has_the_figures_of_the_model_it_was_made_with(azimuth: float, dip: float) -> None:
    process = dataclasses.replace(PAPER, dip_deg=dip)
    model, measured = spot_figures(process), measured_figures(as_measured(process, azimuth), process)
    assert measured.peak_nm_s == pytest.approx(model.peak_nm_s, rel=1e-3)
    assert measured.volume_mm3_min == pytest.approx(model.volume_mm3_min, rel=1e-3)
    assert measured.m_shaped == model.m_shaped == (dip == 1.0)
    peak = model.peak_nm_s
    for name in ("x", "y"):
        line, profile = getattr(measured, f"{name}_mm"), getattr(measured, f"profile_{name}_nm_s")
        want = np.interp(line, getattr(model, f"{name}_mm"), getattr(model, f"profile_{name}_nm_s"))
        assert np.abs(profile - want)[np.abs(line) < 1.6].max() < 0.02 * peak
        assert profile_divergence(profile, want) < 1e-3


def test_a_measured_spot_s_depth_is_that_of_its_place() -> None:
    tif = dataclasses.replace(as_measured(PAPER, 0.0), depth_ratio=0.9)
    assert measured_figures(tif, PAPER).depth_mm == pytest.approx(0.9 * 0.148349, rel=1e-5)


@pytest.mark.parametrize(
    ("ratio", "pitch", "says"),
    [
        (0.0, 0.1, "the depth ratio gamma is 0"),
        (np.nan, 0.1, "the depth ratio gamma is nan"),
        (1.0, 0.0, "the picture's pitch is 0 mm"),
        (1.0, 1e-5, "too many"),
    ],
)
def test_a_picture_that_cannot_be_is_refused(ratio: float, pitch: float, says: str) -> None:
    with pytest.raises(ComputeError, match=says):
        map_nm_s(PAPER, ratio, pitch)
