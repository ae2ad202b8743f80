"""Part, robot and path of a study."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from polishd.config.study import CorrectionsStudy, load_study
from polishd.model.errors import ConfigError
from polishd.model.surface import Grid
from polishd.process.optic_surface import sag_mm
from polishd.process.removal.contact import hertz_depth_mm
from polishd.process.removal.dynamic_tif import tif_at_point
from polishd.studies.scene import Scene, lattice_points, make_scene
from tests.unit.studies.studies import TABLE_IV, line_of, small, variant


def scene_of(path: Path) -> Scene:
    study = load_study(path)
    assert isinstance(study, CorrectionsStudy)
    return make_scene(study)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return scene_of(TABLE_IV)


def test_points_are_the_nodes_within_the_radius_in_running_order() -> None:
    lattice = Grid(9, 9, 1.0)
    points = lattice_points(lattice, lattice.radius_mm() <= 3.2)
    assert len(points) == np.count_nonzero(lattice.radius_mm() <= 3.2)
    assert (np.hypot(points[:, 0], points[:, 1]) <= 3.2).all()
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert steps.max() <= np.hypot(1.0, 3.0)  # to and fro: never back across the part
    assert len(np.unique(points, axis=0)) == len(points)


def test_the_path_covers_aperture_and_extension(scene: Scene) -> None:
    radius = np.hypot(*scene.program.end_mm[:, :2].T)
    assert 31.5 < radius.max() <= 32.0
    assert scene.program.n == pytest.approx(np.pi * 32.0**2, rel=0.01)
    assert (scene.program.length_mm == 0).all()


def test_the_tool_leans_as_the_file_says(scene: Scene) -> None:
    dip, azimuth = np.radians(15.0), np.radians(296.0)
    lean = [np.sin(dip) * np.cos(azimuth), np.sin(dip) * np.sin(azimuth), np.cos(dip)]
    assert np.allclose(scene.program.axis, lean, atol=1e-12)


def test_gamma_is_the_references_range(scene: Scene) -> None:
    """Over the aperture 0.854 to 0.913, where the independent figures of table IV were computed."""
    inside = np.hypot(*scene.program.end_mm[:, :2].T) <= 30.0
    assert scene.gamma[inside].min() == pytest.approx(0.854, abs=2e-3)
    assert scene.gamma[inside].max() == pytest.approx(0.913, abs=2e-3)
    assert len(scene.notes) == 1, "no jumps, no fallbacks"


def test_gamma_is_smooth_from_point_to_point(scene: Scene) -> None:
    gamma = scene.on_lattice(scene.gamma)
    assert max(np.nanmax(np.abs(np.diff(gamma, axis=axis))) for axis in (0, 1)) < 0.002


def test_gamma_is_eq_48(scene: Scene) -> None:
    offset = scene.compliance_um_per_n * 1e-3 * 12.0 / np.cos(np.radians(15.0))
    assert np.allclose(scene.gamma, 1 - offset / hertz_depth_mm(scene.spot.process), rtol=1e-12)


def test_a_dip_turned_inward_hardly_changes_gamma(tmp_path: Path, scene: Scene) -> None:
    """Why the shipped study fixes the direction: inward, no place gives the reference's range on 60 mm."""
    inward = scene_of(variant(tmp_path, TABLE_IV, ('dip_direction = "fixed"', 'dip_direction = "inward"')))
    assert np.ptp(inward.gamma) < 0.015 < np.ptp(scene.gamma) / 4


def test_a_map_of_the_lattice_holds_each_value_where_its_point_lies(scene: Scene) -> None:
    x = scene.on_lattice(scene.program.end_mm[:, 0])
    known = np.isfinite(x)
    assert known.sum() == scene.program.n
    assert np.allclose(x[known], np.broadcast_to(scene.lattice.x_mm, x.shape)[known])


def test_an_effect_removes_where_the_tool_dwells(tmp_path: Path) -> None:
    scene = scene_of(small(tmp_path))
    time = np.zeros(scene.program.n)
    time[40] = 2.0
    removal = scene.effect(tif_at_point("exact", scene.gamma)).removal_nm(time)
    row, column = np.unravel_index(removal.argmax(), removal.shape)
    place = np.array([scene.grid.x_mm[column], scene.grid.y_mm[row]])
    assert np.linalg.norm(place - scene.program.end_mm[40, :2]) < 1.5


def test_other_pitches_are_not_on_nodes(tmp_path: Path) -> None:
    assert scene_of(small(tmp_path)).on_nodes
    assert not scene_of(small(tmp_path, ("grid_mm = 1.0", "grid_mm = 0.5"))).on_nodes


@pytest.mark.parametrize(
    ("change", "start", "says"),
    [
        (("[-340.0, -480.0, 1990.0]", "[-3400.0, -480.0, 1990.0]"), "[part]", "part: point 0: "),
        (("force_n = 12.0", "force_n = 12.0\ntool_modulus_mpa = 0.1"), "[process]", "too deep for Hertz"),
        (("force_n = 12.0", "force_n = 12.0\ntool_modulus_mpa = 2960.0"), "[kinematics]", "gamma would not be above 0"),
    ],
)
def test_the_impossible_is_refused_with_its_place(
    tmp_path: Path, change: tuple[str, str], start: str, says: str
) -> None:
    path = small(tmp_path, change)
    with pytest.raises(ConfigError) as caught:
        scene_of(path)
    said = str(caught.value)
    assert says in said
    assert said.startswith(f"{path}:{line_of(path, start)}: ")
    assert "\n" not in said


CURVED = "aperture_mm = 24.0\ncurvature_radius_mm = 800.0\norigin_mm = [450.0, 0.0, 2135.0]\nconic = -1.0"
INWARD = (('dip_direction = "fixed"', 'dip_direction = "inward"'), ("origin_mm = [-340.0", "# origin_mm = [-340.0"))


def curved(folder: Path, *more: str) -> Scene:
    return scene_of(small(folder, *INWARD, ("aperture_mm = 24.0", "\n".join([CURVED, *more]))))


@pytest.mark.parametrize("key", ["even = [-2e-6]", "off_axis_mm = [200.0, 0.0]"])
def test_the_optic_is_all_that_the_part_says(tmp_path: Path, key: str) -> None:
    plain, reported = curved(tmp_path), curved(tmp_path, key)
    study = load_study(tmp_path / "table_iv.toml")
    assert isinstance(study, CorrectionsStudy)
    assert np.allclose(reported.program.end_mm[:, 2], sag_mm(study.optic(), reported.program.end_mm[:, :2]))
    assert np.abs(reported.program.end_mm[:, 2] - plain.program.end_mm[:, 2]).max() > 1e-3
    assert np.abs(reported.gamma - plain.gamma).max() > 1e-4


def test_spots_sink_over_a_free_rim_and_nowhere_else(tmp_path: Path) -> None:
    ring = scene_of(small(tmp_path))
    free = scene_of(small(tmp_path, ("edge_mm = 3.0", "edge_mm = 3.0\nfree_edge = true")))
    assert np.array_equal(free.gamma, ring.gamma)
    spots = tif_at_point("exact", ring.gamma)
    assert np.array_equal(ring.on_part(spots)[0].depth_ratio, ring.gamma)
    deeper = free.on_part(spots)[0].depth_ratio > ring.gamma
    reach = 12.0 - 1.75 - np.hypot(*free.program.end_mm[:, :2].T)  # 1.75 mm: the contact's radius, and its offset
    assert deeper.any()
    assert (reach[deeper] < 0).all()
    rate = [scene.effect(spots).removal_nm(deeper.astype(float)).sum() for scene in (ring, free)]
    assert rate[1] > 1.05 * rate[0], "what the study removes with is what sinks"
    assert free.notes[-1].startswith("free rim: the bonnet hangs over it at ")
    assert not any(note.startswith("free rim") for note in ring.notes)
