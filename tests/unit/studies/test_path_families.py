"""Families of paths against spots that differ from the model."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polishd.config.study import PathsStudy, load_study
from polishd.config.sweep import load_swept
from polishd.model.errors import ConfigError
from polishd.process.metrology.spectra import RadialPsd
from polishd.process.removal.tif import HertzSpot
from polishd.studies import path_families
from polishd.studies.case_runner import read
from polishd.studies.options import StudyOptions
from polishd.studies.output import of_paths, path_table
from polishd.studies.path_families import PathComparison, compare_paths
from polishd.studies.run import run_cases
from polishd.studies.scene import start_surface, study_grid
from tests.unit.studies.studies import EXAMPLES, variant

PATHS = EXAMPLES / "paths.toml"
SMALL = (
    ("aperture_mm = 60.0", "aperture_mm = 26.0"),
    ("period_mm = [12.0, 60.0]", "period_mm = [8.0, 20.0]"),
    ("radius_errors = [-0.05, -0.03, 0.0, 0.05, 0.03]", "radius_errors = [0.0, 0.03]"),
)


def small(folder: Path, *families: str) -> Path:
    """The shipped study on a small part, with these families."""
    path = variant(folder, PATHS, *SMALL)
    head, *tables = path.read_text(encoding="utf-8").split("[families.")
    kept = [table for table in tables if table.partition("]")[0] in families]
    path.write_text("[families.".join([head, *kept]), encoding="utf-8")
    return path


def study_of(path: Path) -> PathsStudy:
    study = load_study(path)
    assert isinstance(study, PathsStudy)
    return study


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory) -> PathComparison:
    study = study_of(small(tmp_path_factory.mktemp("paths"), "raster", "random_dense", "crossed"))
    return compare_paths(study, read, lambda words: None)


@pytest.mark.full
def test_each_family_meets_each_disturbance(compared: PathComparison) -> None:
    assert [row.disturbance for row in compared.rows[:4]] == ["as modeled", "radius +3 %", "lag 20 ms", "lines 30 um"]
    assert [row.family for row in compared.rows[::4]] == ["raster", "crossed", "random_dense"]
    assert len({row.time_s for row in compared.rows}) == 3
    assert compared.msf_ratio(compared.rows[1]) == 1.0
    assert compared.spectra_of == "radius +3 %"


@pytest.mark.full
def test_a_raster_has_a_line_and_a_random_path_has_none(compared: PathComparison) -> None:
    rows = {(row.family, row.disturbance): row for row in compared.rows}
    raster, random = rows["raster", "radius +3 %"], rows["random_dense", "radius +3 %"]
    assert raster.line_peak > 10
    assert random.line_peak < raster.line_peak / 10
    assert random.msf_nm < raster.msf_nm
    assert raster.acceleration_mm_s2 == pytest.approx(0.0, abs=1e-6)
    assert 0 < random.acceleration_mm_s2 <= 800.0
    assert 0.9 < random.convergence < 1


def test_the_direct_sum_is_what_the_matrix_has(tmp_path: Path) -> None:
    """The sum over the tool's positions and the effect of moving blocks are the same, on the fine cells."""
    study = study_of(small(tmp_path, "raster"))
    fine = study_grid(study, 0.1)
    made = path_families._make_path(study, study.families["raster"], start_surface(study, read))
    time_s = made.program.length_mm / 10.0
    summed = path_families._true_removal(fine, made, time_s, path_families._Disturbance("as modeled"))
    smooth = replace(made.path, spot=HertzSpot(made.path.process, path_families.SQUARES))
    exact = smooth.matrix(fine, made.spots).removal_nm(time_s)
    inside = fine.radius_mm() < 10
    np.testing.assert_allclose(summed[inside], exact[inside], rtol=0.02)
    # the matrix takes a moving block as rests a fraction of the spot apart; across the lines nothing of that is left
    middle = np.abs(fine.x_mm) < 5
    across = [one[np.abs(fine.y_mm) < 8][:, middle].mean(axis=1) for one in (summed, exact)]
    assert np.std(across[0] - across[1]) < 0.1 * np.std(across[1])


def test_a_peak_is_the_ring_over_its_surroundings() -> None:
    f = np.geomspace(0.1, 5, 200)
    flat = RadialPsd(f, np.ones(200), np.ones(200))
    np.testing.assert_allclose(path_families._peaks(flat), 1.0)
    line = replace(flat, density_nm2_mm2=np.where(np.arange(200) == 120, 50.0, 1.0))
    assert path_families._peaks(line)[120] == 50.0


@pytest.mark.full
def test_it_is_shown_and_swept(compared: PathComparison, tmp_path: Path) -> None:
    assert path_table("title", compared).row_count == len(compared.rows)
    assert all(draw().startswith(b"\x89PNG") for draw in of_paths(compared).values())
    path = small(tmp_path, "raster")
    path.write_text(path.read_text() + '\n[[sweep.group]]\nover."surface.seed" = [1, 2]\n')
    found = run_cases(load_swept(path), StudyOptions(workers=1))
    assert len(found.rows) == 8
    assert json.dumps([row["msf_nm"] for row in found.rows])
    assert not any(row["error"] for row in found.rows)


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ('shape = "raster"', 'shape = "zigzag"', r"paths\.toml:\d+: families\.raster\.shape"),
        ("pitch_mm = 0.924", "pitch_mm = 0.0", r"families\.raster\.pitch_mm"),
        (
            "line_noise_um = 30.0",
            "line_noise_um = 30.0\ncell_mm = 0.2",
            "msf_period_mm: must rise from above two cells",
        ),
        ("line_noise_um = 30.0", "line_noise_um = 30.0\ncell_mm = 0.01", "cell_mm: .* cells; at most"),
        ("min_feed_mm_s = 0.5", "min_feed_mm_s = 60.0", "must be less than max_feed_mm_s"),
    ],
)
def test_wrong_values_are_one_error(tmp_path: Path, old: str, new: str, what: str) -> None:
    with pytest.raises(ConfigError, match=what):
        load_study(variant(tmp_path, PATHS, (old, new)))


def test_a_radius_that_does_not_fit_is_blamed_on_its_family(tmp_path: Path) -> None:
    study = study_of(variant(tmp_path, small(tmp_path, "random"), ("max_feed_mm_s = 50.0", "max_feed_mm_s = 90.0")))
    with pytest.raises(ConfigError, match=r"families\.random: bends of 10\.1 mm radius do not fit"):
        compare_paths(study, read, lambda words: None)
