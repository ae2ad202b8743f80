"""The surface that a study starts from."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from polishd.config.study import CorrectionsStudy, load_study
from polishd.model.errors import ConfigError, MapError
from polishd.model.surface import Grid, SurfaceMap
from polishd.process.metrology.spectra import split_bands
from polishd.studies.scene import random_waves, start_surface, study_grid
from tests.unit.studies.studies import TABLE_IV, line_of, small, variant


def corrections(path: Path) -> CorrectionsStudy:
    study = load_study(path)
    assert isinstance(study, CorrectionsStudy)
    return study


def never(path: Path) -> SurfaceMap:
    raise AssertionError("a drawn surface reads nothing")


def test_a_drawn_surface_has_the_stated_rms_over_the_clear_aperture() -> None:
    start = start_surface(corrections(TABLE_IV), never)
    inside = start.height_nm[start.metric_mask]
    assert np.sqrt(np.mean(inside**2)) == pytest.approx(18.5, rel=1e-12)
    assert inside.mean() == pytest.approx(0.0, abs=1e-9)
    radius = start.grid.radius_mm()
    assert np.array_equal(np.isfinite(start.height_nm), radius <= 30.0)
    assert np.array_equal(start.metric_mask, radius <= 27.0)


def test_a_drawn_surface_keeps_to_its_periods() -> None:
    """On a wide field, where 33 mm is resolved: next to nothing has shorter periods."""
    grid = Grid(300, 300, 1.0)
    height = random_waves(grid, (33.0, 120.0), 3)
    long, short = split_bands(height, np.ones(grid.shape, dtype=bool), 1.0, (30.0,))
    assert short.std() < 0.03 * long.std()


def test_a_finer_grid_samples_the_same_surface() -> None:
    coarse, fine = Grid(21, 21, 1.0), Grid(41, 41, 0.5)
    assert np.allclose(random_waves(fine, (5.0, 20.0), 1)[::2, ::2], random_waves(coarse, (5.0, 20.0), 1))


def test_a_seed_is_a_surface() -> None:
    grid = Grid(20, 20, 1.0)
    first = random_waves(grid, (5.0, 20.0), 1)
    assert np.array_equal(first, random_waves(grid, (5.0, 20.0), 1))
    assert not np.allclose(first, random_waves(grid, (5.0, 20.0), 2))


def test_grid_and_dwell_points_share_the_nodes() -> None:
    study = corrections(TABLE_IV)
    assert study_grid(study, study.path.step_mm) == study_grid(study, study.process.grid_mm)


def test_the_grid_holds_the_paths_extension(tmp_path: Path) -> None:
    study = corrections(small(tmp_path, ("extension_mm = 2.0", "extension_mm = 8.0")))
    assert study_grid(study, 1.0).x_mm[-1] + 0.5 == pytest.approx(12.0 + 8.0)


def test_a_measured_map_is_read_and_conditioned(tmp_path: Path) -> None:
    study = corrections(
        small(tmp_path, ("rms_nm = 18.5", 'file = "map.dat"'), ("period_mm = [14.0, 40.0]", "# no period"))
    )
    grid = Grid(60, 60, 0.5)
    height = np.where(grid.radius_mm() <= 12.5, 5.0 + grid.x_mm[None, :] + 0 * grid.y_mm[:, None], np.nan)
    asked: list[Path] = []

    def read(path: Path) -> SurfaceMap:
        asked.append(path)
        return SurfaceMap(height, 0.5)

    start = start_surface(study, read)
    assert asked == [tmp_path / "map.dat"]
    assert start.grid == study_grid(study, 1.0)
    inside = start.metric_mask
    expected = np.broadcast_to(start.grid.x_mm[None, :], start.grid.shape)[inside]
    assert np.allclose(start.height_nm[inside], expected - expected.mean(), atol=1e-9)  # piston off, tilt is figure


def test_the_form_wanted_is_taken_off_a_measured_map(tmp_path: Path) -> None:
    study = corrections(
        small(
            tmp_path,
            ("rms_nm = 18.5", 'file = "map.dat"'),
            ("period_mm = [14.0, 40.0]", "# no period"),
            ("[part]\n", '[part]\nform = "form.dat"\n'),
        )
    )
    form = SurfaceMap(np.random.default_rng(1).normal(0.0, 9.0, (52, 52)), 0.5)
    tilt = form.with_height(form.height_nm + form.grid.x_mm[None, :])
    start = start_surface(study, lambda path: form if path.name == "form.dat" else tilt)
    expected = np.broadcast_to(start.grid.x_mm[None, :], start.grid.shape)[start.metric_mask]
    assert np.allclose(start.height_nm[start.metric_mask], expected - expected.mean(), atol=1e-9)


def test_a_map_that_cannot_be_used_is_blamed_on_its_key(tmp_path: Path) -> None:
    path = variant(tmp_path, TABLE_IV, ("rms_nm = 18.5", 'file = "map.dat"'), ("period_mm = [33.0, 120.0]", ""))

    def read(path: Path) -> SurfaceMap:
        raise MapError(f"{path.name}: the file is empty; export the map again")

    with pytest.raises(ConfigError) as caught:
        start_surface(corrections(path), read)
    line = line_of(path, "file")
    assert str(caught.value) == f"{path}:{line}: surface.file: map.dat: the file is empty; export the map again"


def test_a_clear_aperture_of_a_few_samples_is_refused(tmp_path: Path) -> None:
    path = variant(tmp_path, TABLE_IV, ("aperture_mm = 60.0", "aperture_mm = 10.0"))
    with pytest.raises(ConfigError, match=r"part: the clear aperture has \d+ samples of process.grid_mm = 1; at least"):
        start_surface(corrections(path), never)


def test_a_drawn_surface_is_levelled_as_the_part_says(tmp_path: Path) -> None:
    """The default takes a tilt for alignment, as in a cell."""
    path = small(tmp_path, ('alignment = "piston"', "# the default"))
    start = start_surface(corrections(path), never)
    inside = start.metric_mask
    x, _ = np.broadcast_arrays(start.grid.x_mm[None, :], start.height_nm)
    assert np.corrcoef(x[inside], start.height_nm[inside])[0, 1] == pytest.approx(0.0, abs=1e-9)
    assert start.height_nm[inside].std() == pytest.approx(18.5)
