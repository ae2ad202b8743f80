"""Acceptance of a part, as measured or by the bound of its true figure; demanded references and messages."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from polishd.model.errors import ConfigError, MapError
from polishd.model.instrument import Instrument, UnmeasuredTerms
from polishd.model.surface import FloatArray, SurfaceMap
from polishd.model.tolerance import LineResult
from polishd.pipeline import acceptance, steps
from polishd.pipeline.recipe import Recipe
from polishd.process.metrology.absolute_poses import LEVEL, terms
from polishd.process.metrology.absolute_test import AbsoluteTestResult, SystemMap
from tests.unit.daemon.small_job import small_map, small_recipe

KNOWN = UnmeasuredTerms(0.1, 0.1, 0.1, 0.1, 0.1, 0.1)
SEEN = terms(4)[LEVEL:]


def system(map_: SurfaceMap, height_nm: FloatArray | float, unknown: dict[tuple[int, int], float]) -> SystemMap:
    """Return a system map in the frame of that map."""
    rows, columns = map_.height_nm.shape
    circle = ((rows - 1) / 2, (columns - 1) / 2, (rows - 1) / 2)
    solved = AbsoluteTestResult(4, SEEN, np.eye(len(SEEN)) * 0.01**2, unknown, 0.0, circle)
    return SystemMap(replace(map_, sha256="5" * 64).with_height(0 * map_.height_nm + height_nm), solved)


def of(**changes: Any) -> Recipe:
    return small_recipe(**changes)


def judged(recipe: Recipe, surface: SurfaceMap) -> LineResult:
    (one,) = steps.condition(recipe, surface).judged
    return one


@pytest.fixture(scope="module")
def surface() -> SurfaceMap:
    return small_map()


def test_without_knowledge_a_part_is_accepted_as_measured_and_that_is_said(surface: SurfaceMap) -> None:
    recipe = of()
    assert recipe.accept == "figure"
    assert judged(recipe, surface).bound is None
    assert "is not known" in acceptance.acceptance_words(recipe)
    assert recipe.facts()["accept"] == "figure"


def test_with_a_system_map_the_bound_accepts_unless_the_job_says_otherwise(surface: SurfaceMap) -> None:
    known = system(surface, 0.0, {})
    assert of(system=known).accept == "bound"
    assert of(system=known, accept_by="figure").accept == "figure"
    assert of(system=known, alignment="piston").accept == "figure", "no bound has a tilt"


def test_the_bound_has_what_is_unseen_in_squares(surface: SurfaceMap) -> None:
    measured = judged(of(), surface).value
    power = system(surface, 0.0, {(2, 0): 1.0})
    wide = judged(of(system=power, instrument=Instrument("i", unseen=replace(KNOWN, power_nm=50.0))), surface)
    close = judged(of(system=power, instrument=Instrument("i", unseen=KNOWN)), surface)
    without = judged(of(system=power, accept_by="bound_without_power"), surface)
    assert wide.value == close.value == without.value == pytest.approx(measured)
    assert close.bound == pytest.approx(measured, rel=0.03)
    assert wide.bound is not None
    assert wide.bound > 50.0
    assert wide.guard == pytest.approx(wide.bound - wide.value)
    assert without.bound is not None
    assert without.bound < 1.03 * measured
    assert (wide.removed, without.removed) == ("", "power")
    assert "power removed" in str(without)


def test_by_the_bound_a_line_holds_or_not() -> None:
    beyond = LineResult("RMS", 1.0, 2.0, "nm", 0.3, bound=2.5)
    assert not beyond.holds
    assert not beyond.unsure
    assert beyond.excess == pytest.approx(1.25)
    assert LineResult.of(beyond.facts()) == beyond
    assert beyond.facts()["guard"] == pytest.approx(1.5)
    old = {key: value for key, value in beyond.facts().items() if key not in {"bound", "removed", "guard"}}
    assert LineResult.of(old).holds, "an earlier polishd had none"


def test_the_system_map_is_off_and_recorded(surface: SurfaceMap) -> None:
    y, x = np.mgrid[-1 : 1 : complex(surface.height_nm.shape[0]), -1 : 1 : complex(surface.height_nm.shape[1])]
    own = 30.0 * (x**2 - y**2)
    seen = surface.with_height(surface.height_nm + own)
    measured = steps.condition(of(system=system(surface, own, {})), seen)
    assert measured.stats.rms_nm == pytest.approx(steps.condition(of(), surface).stats.rms_nm)
    assert measured.facts()["system"] == "5" * 64
    assert steps.condition(of(), surface).facts()["system"] == ""
    with pytest.raises(MapError, match="system map"):
        steps.condition(of(system=system(small_map(), 0.0, {})), surface.with_height(surface.height_nm[:-1]))


def test_a_prior_above_the_tolerance_demands_a_reference(surface: SurfaceMap) -> None:
    power = system(surface, 0.0, {(2, 0): 1.0})
    recipe = of(system=power, tolerance_nm=2.0)
    (one,) = acceptance.demanded(recipe)
    assert (one.name, one.prior_nm) == ("power", 5.0)
    with pytest.raises(ConfigError, match=r"power, alone 5 nm: a reference of known radius.*bound_without_power"):
        acceptance.require_acceptable(recipe)
    assert acceptance.acceptance_words(recipe).startswith("run will refuse")
    for mended in (
        of(system=power, tolerance_nm=2.0, accept_by="bound_without_power"),
        of(system=power, tolerance_nm=2.0, alignment="power"),
        of(system=power, tolerance_nm=2.0, instrument=Instrument("i", unseen=KNOWN)),
        of(tolerance_nm=2.0),
    ):
        acceptance.require_acceptable(mended)


def test_without_a_system_map_all_terms_are_unseen() -> None:
    names = {one.name for one in acceptance.demanded(of(accept_by="bound", tolerance_nm=2.0))}
    assert {"power", "astigmatism", "coma"} <= names
    assert not acceptance.demanded(of(accept_by="bound", tolerance_nm=20.0))


def test_of_some_periods_noise_counts_as_figure(surface: SurfaceMap) -> None:
    noisy = Instrument("i", repeatability_nm=1.0, unseen=KNOWN)
    assert acceptance.errors_of(of(instrument=noisy)).noise.white_nm == 1.0
    assert acceptance.errors_of(of(instrument=noisy), periods=True).noise.white_nm == 0.0
    one = judged(of(instrument=noisy, accept_by="bound", tolerance_period_mm=8.0), surface)
    assert one.bound is not None
    assert one.bound >= 0.999 * one.value
