"""Turning the part measures the instrument's error, which is subtracted; the certificate is compared with the truth."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polishd.config.study import LoopStudy, load_study
from polishd.model.errors import ComputeError, ConfigError
from polishd.model.surface import FloatArray
from polishd.studies.closed_loop import with_absolute_test, with_certified_map
from polishd.studies.plant_client import PlantProcess
from tests.unit.daemon.small_job import small_recipe
from tests.unit.studies.studies import TABLE_III, runs_here

POSES = ((0.0, 0.0, 0.0), (90.0, 0.0, 0.0), (180.0, 0.0, 0.0), (270.0, 0.0, 0.0), (0.0, 1.5, 0.0))
STUDY = 'kind = "loop"\ntitle = "t"\n[controllers.a]\nposes = {poses}\n'


@pytest.fixture(scope="module")
def plant() -> Iterator[PlantProcess]:
    with PlantProcess() as process:
        yield process


def drawn(plant: PlantProcess, **errors: Any) -> None:
    part = {"aperture_mm": 30.0, "pv_nm": 100.0}
    plant.new({"plant": part, "hidden_truth": {"map_noise_nm": 0.3}, "interferometer": {"errors": errors}}, 1)


def rms_nm(height_nm: FloatArray) -> float:
    return float(np.nanstd(height_nm))


@pytest.mark.full
def test_the_instruments_astigmatism_is_measured_and_subtracted(plant: PlantProcess) -> None:
    drawn(plant, astigmatism_nm=3.0)
    recipe = with_absolute_test(small_recipe(), plant, POSES)
    assert recipe.system is not None
    assert recipe.accept == "bound"
    report = recipe.system.result
    assert (2, 2) not in report.unknown
    assert report.unknown[2, 0] == pytest.approx(1.0)
    assert (4, 0) not in report.unknown, "the shift measures it"
    off = recipe.system.surface.height_nm
    assert rms_nm(off) == pytest.approx(3.0, rel=0.15)
    measured, _ = plant.measure()
    _, true = plant.truth()
    left = measured - off - true
    inside = np.isfinite(left)
    assert rms_nm(left - np.mean(left[inside])) < 0.5, "its noise, and a little of the map's"


@pytest.mark.full
def test_what_turns_with_the_part_is_the_parts_as_its_mount_holds_it(plant: PlantProcess) -> None:
    drawn(plant, mount_nm=3.0, mount_turns=True)
    recipe = with_absolute_test(small_recipe(), plant, POSES)
    assert recipe.system is not None
    assert rms_nm(recipe.system.surface.height_nm) < 0.5
    _, alone = plant.truth()
    _, held = plant.truth(held=True)
    assert rms_nm(held - alone) == pytest.approx(3.0, rel=0.15)
    drawn(plant, mount_nm=3.0)
    assert np.array_equal(plant.truth()[1], plant.truth(held=True)[1], equal_nan=True), "it stays: the instrument's"


@pytest.mark.full
def test_the_truth_is_judged_by_what_the_certificate_says(plant: PlantProcess) -> None:
    whole, without = (with_certified_map(small_recipe(accept_by=accept)) for accept in ("bound", "bound_without_power"))
    assert (whole.part.alignment, without.part.alignment) == ("tilt", "power")
    assert {whole.accept, without.accept} == {"figure"}
    drawn(plant)
    with pytest.raises(ComputeError, match=r"shifted 0\.3,0 mm.*whole samples of 0\.5 mm"):
        with_absolute_test(small_recipe(), plant, ((0.0, 0.0, 0.0), (0.0, 0.3, 0.0)))


@pytest.mark.full
@pytest.mark.parametrize(
    ("poses", "read"),
    [("[[0.0], [90.0, 2.5, 0.0]]", ((0.0, 0.0, 0.0), (90.0, 2.5, 0.0))), ("[0.0]", None), ("[[0.0, 1.0]]", None)],
)
def test_poses_are_an_angle_and_a_shift(tmp_path: Path, poses: str, read: object) -> None:
    path = tmp_path / "study.toml"
    path.write_text(STUDY.format(poses=poses))
    study = load_study(path)
    assert isinstance(study, LoopStudy)
    if read is not None:
        assert study.loop("a")[2] == read
    else:
        with pytest.raises(ConfigError, match=r"study\.toml:4: controllers\.a\.poses: must be a list of \[angle_deg"):
            study.loop("a")


LOOPS = """
kind = "loop"
title = "t"
cell = "{examples}/cell.toml"
plant = "{examples}/sim.toml"
raster = true
scenarios = ["{examples}/scenarios/instrument_astigmatism.toml"]
seeds = 1
passes = 3
[cell_with]
"part.aperture_mm" = 30.0
"job.tolerance_nm" = 1.7               # the bound has the ripple of two passes in it, which the map does not show
[plant_with.plant]
aperture_mm = 30.0
pv_nm = 100.0
[plant_with.effects]
eq_44 = [1.0, 1.0]                   # as the cell believes: what one pass leaves is then the instrument's
friction = [0.0, 0.0]
[controllers.measured]
[controllers.turned]
poses = [[0.0], [90.0], [180.0], [270.0], [0.0, 1.5, 0.0]]
"job.accept_by" = "bound_without_power"
[controllers.demanding]
poses = [[0.0], [90.0], [180.0], [270.0], [0.0, 1.5, 0.0]]
"job.accept_by" = "bound"
"""


@pytest.mark.full
def test_turning_the_part_brings_the_true_figure_into_tolerance(tmp_path: Path) -> None:
    path = tmp_path / "study.toml"
    path.write_text(LOOPS.format(examples=TABLE_III.parent))
    study = load_study(path)
    assert isinstance(study, LoopStudy)
    runs = {run.loop: run for run in runs_here(study)}
    believed, turned, demanding = (runs[name] for name in study.controllers)
    assert believed.falsely_accepted
    assert believed.true_rms_nm[-1] > 1.7 > believed.rms_nm[-1]
    assert turned.accepted
    assert turned.true_fits
    assert turned.true_rms_nm[-1] < 1.0
    assert not demanding.accepted, "nothing measures 5 nm of power"
