"""The rows of Table III."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import integrate

from polishd.config.study import SpotsStudy, load_study
from polishd.model.errors import ConfigError
from polishd.studies.spots import SpotRow, compute_spots, shape_words
from tests.unit.studies.studies import TABLE_III, line_of, variant


def compute(path: Path) -> tuple[SpotRow, ...]:
    study = load_study(path)
    assert isinstance(study, SpotsStudy)
    return compute_spots(study, lambda words: None)


@pytest.fixture(scope="module")
def rows() -> tuple[SpotRow, ...]:
    return compute(TABLE_III)


def test_six_rows_for_each_reading(rows: tuple[SpotRow, ...]) -> None:
    assert [(row.size_is, row.name) for row in rows] == [
        (reading, str(k)) for reading in ("radius", "diameter") for k in range(1, 7)
    ]


def test_contacts_are_hertz_in_closed_form(rows: tuple[SpotRow, ...]) -> None:
    """``F = 4/3 E* sqrt(R) d^1.5`` with the moduli of Table II, worked out here."""
    reduced = 1 / ((1 - 0.40**2) / 29.6 + (1 - 0.16**2) / 70.5e3)
    for row in rows:
        radius = row.section.size_mm * (1.0 if row.size_is == "radius" else 0.5)
        depth, a = row.figures.depth_mm, row.figures.contact_radius_mm
        assert 4 / 3 * reduced * np.sqrt(radius) * depth**1.5 == pytest.approx(row.section.force_n, rel=1e-9)
        assert a == pytest.approx(np.sqrt(radius * depth), rel=1e-12)
        assert row.figures.peak_pressure_mpa == pytest.approx(1.5 * row.section.force_n / (np.pi * a**2), rel=1e-9)


def test_size_40_as_a_diameter_is_the_papers_main_process(rows: tuple[SpotRow, ...]) -> None:
    """Row 5 then is R 20, 12 N, 1000 rpm, 15 deg: the closed-form figures that everything else is held to."""
    row = next(row for row in rows if (row.size_is, row.name) == ("diameter", "5"))
    assert row.figures.depth_mm == pytest.approx(0.14835, abs=5e-6)
    assert row.figures.contact_radius_mm == pytest.approx(1.7225, abs=5e-5)
    assert row.figures.peak_pressure_mpa == pytest.approx(1.9311, abs=5e-5)
    assert row.volume_mm3 == pytest.approx(0.058, abs=5e-4)


def removed_mm3(row: SpotRow) -> float:
    """Return the removal of a minute by adaptive quadrature of ``k p v``, without the dissipative shift."""
    figures, spot = row.figures, row.section
    radius = spot.size_mm * (1.0 if row.size_is == "radius" else 0.5)
    spin, dip, height = spot.rpm * np.pi / 30, np.radians(spot.dip_deg), radius - figures.depth_mm

    def ring(angle: float, r: float) -> float:
        across, along = r * np.cos(angle), r * np.sin(angle)
        speed = spin * np.hypot(np.sin(dip) * height + np.cos(dip) * along, np.cos(dip) * across)
        return float(np.sqrt(max(1 - (r / figures.contact_radius_mm) ** 2, 0.0)) * speed * r)

    found = integrate.dblquad(ring, 0, figures.contact_radius_mm, 0, 2 * np.pi, epsabs=1e-6, epsrel=1e-6)
    return float(found[0]) * figures.peak_pressure_mpa * 1.49e-7 * 60


@pytest.mark.full
def test_a_minute_removes_what_preston_says(rows: tuple[SpotRow, ...]) -> None:
    for row in rows:
        assert row.volume_mm3 == pytest.approx(removed_mm3(row), rel=1e-4)


def test_the_peak_is_that_of_a_minute(rows: tuple[SpotRow, ...]) -> None:
    for row in rows:
        assert row.removal_depth_nm == pytest.approx(60 * row.figures.peak_nm_s)
        assert (
            row.removal_depth_nm >= 60 * max(row.figures.profile_x_nm_s.max(), row.figures.profile_y_nm_s.max()) - 1e-9
        )


def test_no_row_is_m_shaped_where_its_size_is_a_radius(rows: tuple[SpotRow, ...]) -> None:
    for row in rows:
        pole = (row.section.size_mm * (1 if row.size_is == "radius" else 0.5) - row.figures.depth_mm) * np.tan(
            np.radians(row.section.dip_deg)
        )
        assert row.figures.pole_mm == pytest.approx(pole)
        assert row.figures.m_shaped == (pole < row.figures.contact_radius_mm)
        profile = row.figures.profile_x_nm_s
        assert row.figures.m_shaped == bool(profile[profile.size // 2] < profile.max() * (1 - 1e-4))
    assert [row.name for row in rows if row.size_is == "radius" and row.figures.m_shaped] == []
    assert [row.name for row in rows if row.size_is == "diameter" and row.figures.m_shaped] == ["1"]


def test_the_shapes_are_said(rows: tuple[SpotRow, ...]) -> None:
    assert shape_words(rows) == [
        "size = radius: no x profile is M-shaped; it needs (R - d) tan(dip) < a, and the least is 1.46 a (1)",
        "size = diameter: the x profile is M-shaped in 1; it needs (R - d) tan(dip) < a, and the least is 0.91 a (1)",
    ]


def test_the_divergence_is_that_of_the_normalised_profiles(rows: tuple[SpotRow, ...]) -> None:
    for row in rows:
        p, q = (profile / profile.sum() for profile in (row.figures.profile_x_nm_s, row.figures.profile_y_nm_s))
        middle = (p + q) / 2
        parts = [np.sum(s[s > 0] * np.log2(s[s > 0] / middle[s > 0])) for s in (p, q)]
        assert row.divergence == pytest.approx(sum(parts) / 2, rel=1e-6)


def test_rows_as_json(rows: tuple[SpotRow, ...]) -> None:
    answer = rows[0].as_json()
    assert answer["paper_depth_error_percent"] == 3.204
    assert answer["jsd_base"] == 2.0
    assert len(answer["profile_x"]["x_mm"]) == len(answer["profile_y"]["rate_nm_s"])
    assert {"depth_mm", "volume_mm3", "removal_depth_nm", "m_shaped", "jsd_x_y", "paper_jsd"} <= set(answer)


def test_a_spot_that_cannot_be_is_refused_with_its_place(tmp_path: Path) -> None:
    path = variant(tmp_path, TABLE_III, ("size_mm = 40.0", "size_mm = 0.5"))
    with pytest.raises(ConfigError) as caught:
        compute(path)
    assert str(caught.value).startswith(f"{path}:{line_of(path, '[spots.5]')}: spots.5: the contact's depth is ")
    assert "too deep for Hertz" in str(caught.value)
