"""A spot on a witness part gives a loop estimates of its machine before the first pass."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from polishd.config.simulator import load_plant
from polishd.config.study import LoopStudy, load_study
from polishd.model.errors import ConfigError
from polishd.studies.cases import laid_over
from polishd.studies.closed_loop import ClosedLoop, _Account
from polishd.studies.plant_client import PlantProcess
from tests.unit.studies.studies import TABLE_III, runs_here

EXAMPLES = TABLE_III.parent
RATE = -0.3
HEAD = f"""
kind = "loop"
title = "t"
cell = "{EXAMPLES / "cell.toml"}"
plant = "{EXAMPLES / "sim.toml"}"
raster = true
seeds = 1
passes = 2
[cell_with]
"part.aperture_mm" = 30.0
"job.tolerance_nm" = 2.5
[plant_with.plant]
aperture_mm = 30.0
pv_nm = 100.0
[plant_with.hidden_truth]
rate = [{RATE}, {RATE}]
stiffness = 0.0
drift = 0.0
[plant_with.effects]
eq_44 = [1.0, 1.0]
"""


def study(folder: Path, loops: str) -> LoopStudy:
    path = folder / "study.toml"
    path.write_text(HEAD + loops)
    found = load_study(path)
    assert isinstance(found, LoopStudy)
    return found


@pytest.mark.full
def test_its_rate_and_its_spot_are_those_of_the_machine(tmp_path: Path) -> None:
    of = study(tmp_path, '[controllers.exact]\nwitness = "rate"\n[controllers.static]\nwitness = "spot"\n')
    sections, _ = load_plant(EXAMPLES / "sim.toml")
    (scenario,) = of.all_scenarios().values()
    sections = {**sections, **of.plant_with, "plant": {**sections["plant"], **of.plant_with["plant"]}}
    with PlantProcess() as plant:
        begun = {}
        for name in of.controllers:
            plant.new(laid_over(sections, scenario), 1)
            keys, witness, *_ = of.loop(name)
            loop = ClosedLoop(of.resolve(of.cell), keys, of.passes, raster=True, witness=witness)
            begun[name] = loop._begun(plant, _Account())
    recipe, believed = begun["exact"]
    assert believed.rate == pytest.approx(1 + RATE, rel=0.02), "of eq. 44 as of the plant"
    assert recipe.tif is None
    recipe, believed = begun["static"]
    assert believed.rate == 1.0, "it is in the spot"
    assert recipe.tif is not None
    assert recipe.model.name == "measured_tif"


@pytest.mark.full
def test_a_loop_that_has_it_is_right_from_the_first_pass_on(tmp_path: Path) -> None:
    exact, witnessed = runs_here(study(tmp_path, '[controllers.exact]\n[controllers.witnessed]\nwitness = "rate"\n'))
    assert exact.rms_nm[0] == witnessed.rms_nm[0], "the part itself is the same, whatever the witness took"
    assert exact.rms_nm[1] > 2 * witnessed.rms_nm[1]
    assert witnessed.accepted


def test_an_unusable_start_is_reported(tmp_path: Path) -> None:
    wrong = study(tmp_path, '[controllers.odd]\nwitness = "spit"\n')
    with pytest.raises(ConfigError, match=re.escape('\'spit\' is not allowed; must be "rate", "spot" or "touch"')):
        runs_here(wrong)


def wrong_with(of: LoopStudy, section: str, **keys: object) -> LoopStudy:
    plant = {**of.plant_with, section: {**of.plant_with.get(section, {}), **keys}}
    return of.model_copy(update={"plant_with": plant})


TOUCHED = '[controllers.touched]\nwitness = "touch"\n"process.estimates" = "machine"\n'


@pytest.mark.full
def test_a_spot_that_is_off_is_found_by_a_touch_and_corrected_in_the_first_pass(tmp_path: Path) -> None:
    """Without it the gate stops after the first pass, for a person."""
    off = wrong_with(study(tmp_path, f"[controllers.untouched]\n{TOUCHED}"), "effects", spot_shift_mm=1.5)
    untouched, touched = runs_here(off)
    assert (untouched.ended, untouched.named) == ("gate", ("shift",))
    assert touched.accepted
    assert touched.passes == 1
    ((low, high, came),) = touched.came_nm
    assert low <= came <= high


@pytest.mark.full
def test_a_touch_that_stops_says_why_and_no_part_is_polished(tmp_path: Path) -> None:
    worn = wrong_with(study(tmp_path, TOUCHED), "hidden_truth", tool_wear=0.5, rate=[0.0, 0.0])
    (run,) = runs_here(worn)
    assert (run.ended, run.named, run.passes) == ("gate", ("rate",), 0)
    assert "about half" in run.why
