"""Passes of equal dwell against gamma."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from polishd.config.study import PassesStudy, load_study
from polishd.model.errors import ComputeError, ConfigError
from polishd.process.removal.contact import hertz_depth_mm, volume_rate_nm_mm2_s
from polishd.studies.scene import make_scene
from polishd.studies.spots import Passes, against_gamma, gamma_map, polish_evenly
from tests.unit.studies.studies import FIG_12, line_of, variant


def study_of(path: Path) -> PassesStudy:
    study = load_study(path)
    assert isinstance(study, PassesStudy)
    return study


def polish(path: Path) -> Passes:
    return polish_evenly(study_of(path), lambda words: None)


def small(folder: Path, *changes: tuple[str, str]) -> Path:
    return variant(folder, FIG_12, ("aperture_mm = 200.0", "aperture_mm = 60.0"), *changes)


@pytest.fixture(scope="module")
def shipped() -> Passes:
    return polish(FIG_12)


@pytest.mark.full
def test_removal_goes_as_the_power_of_gamma_that_hertz_says(shipped: Passes) -> None:
    assert shipped.slope == pytest.approx(1.5, abs=0.02)
    assert shipped.correlation > 0.999


@pytest.mark.full
def test_removal_is_the_volume_rate_over_the_cell(shipped: Passes) -> None:
    """Far from the rim, of a lattice of 1 mm: seconds times volume rate at the local depth, per mm^2."""
    process = study_of(FIG_12).tool_process()
    rate = volume_rate_nm_mm2_s(process, hertz_depth_mm(process) * shipped.gamma[shipped.metric_mask])
    assert np.allclose(shipped.removal_nm[shipped.metric_mask], 10 * 0.01 * rate, rtol=2e-3)


@pytest.mark.full
def test_equal_dwell_does_not_remove_equally(shipped: Passes) -> None:
    inside = shipped.removal_nm[shipped.metric_mask]
    assert (shipped.mean_nm, shipped.rms_nm) == (inside.mean(), inside.std())
    assert shipped.pv_nm == inside.max() - inside.min()
    gamma = shipped.gamma[shipped.metric_mask]
    assert shipped.pv_nm / shipped.mean_nm == pytest.approx(1.5 * np.ptp(gamma) / gamma.mean(), rel=0.05)


def test_passes_add_up(tmp_path: Path) -> None:
    one, ten = polish(small(tmp_path, ("passes = 10", "passes = 1"))), polish(small(tmp_path))
    assert np.allclose(ten.removal_nm, 10 * one.removal_nm, rtol=1e-12)
    assert ten.slope == pytest.approx(one.slope, rel=1e-9)


def test_a_part_that_is_not_round_is_studied_over_its_own_outline(tmp_path: Path) -> None:
    path = variant(tmp_path, FIG_12, ("aperture_mm = 200.0", "rectangle_mm = [40.0, 24.0]"))
    found = polish(path)
    assert np.count_nonzero(found.metric_mask) * found.grid.pitch_mm**2 == pytest.approx(30 * 14, rel=0.01)
    assert found.grid.nx > 1.3 * found.grid.ny


def test_gamma_at_a_sample_is_that_of_the_point_there(tmp_path: Path) -> None:
    scene = make_scene(study_of(small(tmp_path)))
    inside = scene.grid.radius_mm() <= 28.0
    assert np.allclose(gamma_map(scene)[inside], scene.on_lattice(scene.gamma)[inside], atol=1e-4)


def test_gamma_is_unknown_where_no_point_reaches(tmp_path: Path) -> None:
    scene = make_scene(study_of(small(tmp_path)))
    assert np.isnan(gamma_map(scene)[0, 0])


def test_a_power_law_is_found_as_such() -> None:
    gamma = np.linspace(0.8, 0.9, 50)
    correlation, slope = against_gamma(3.0 * gamma**1.7, gamma)
    assert slope == pytest.approx(1.7)
    assert correlation == pytest.approx(1.0, abs=1e-3)
    assert against_gamma(1 / gamma, gamma)[0] < -0.99


def test_what_cannot_be_held_against_gamma_is_refused() -> None:
    with pytest.raises(ComputeError, match=r"gamma is 0\.85 everywhere"):
        against_gamma(np.ones(5), np.full(5, 0.85))
    with pytest.raises(ComputeError, match="no dwell point reaches some samples"):
        against_gamma(np.array([1.0, 0.0]), np.array([0.8, 0.9]))


def test_a_lattice_too_wide_for_the_spot_is_refused_with_its_place(tmp_path: Path) -> None:
    path = small(tmp_path, ("step_mm = 1.0", "step_mm = 8.0"))
    with pytest.raises(ConfigError) as caught:
        polish(path)
    assert str(caught.value).startswith(f"{path}:{line_of(path, '[path]')}: path: no dwell point reaches some samples")


@pytest.mark.full
def test_as_json(shipped: Passes) -> None:
    answer = shipped.as_json()
    assert answer["passes"] == 10
    assert answer["pv_share"] == pytest.approx(shipped.pv_nm / shipped.mean_nm)
    assert 0.8 < answer["gamma_min"] < answer["gamma_max"] < 0.95
