"""Errors kept beside an instrument's map: they return from JSON unchanged and fit maps of the same frame only."""

from __future__ import annotations

import json

import numpy as np
import pytest

from polishd.model.errors import MapError
from polishd.model.surface import SurfaceMap
from polishd.process.metrology.absolute_test import AbsoluteTestResult, SystemMap, separate_instrument
from tests.unit.process.metrology.turned_maps import PITCH_MM, instrument_nm, maps, part_nm, rms_nm, true_nm, turns


@pytest.fixture(scope="module")
def system() -> SystemMap:
    found = separate_instrument(maps(turns(4)), turns(4), PITCH_MM, degree=6)
    return SystemMap(SurfaceMap(found.instrument_nm, PITCH_MM), AbsoluteTestResult.of(found))


def test_it_comes_back_from_json(system: SystemMap) -> None:
    result = system.result
    again = AbsoluteTestResult.load(json.loads(json.dumps(result.facts())))
    assert again.covariance == pytest.approx(result.covariance, rel=1e-8, abs=1e-12)
    assert np.array_equal(again.covariance, again.covariance.T)
    for name in ("degree", "terms", "unknown", "rest_nm", "circle_px"):
        assert getattr(again, name) == getattr(result, name)
    assert result.unknown[2, 0] == pytest.approx(1.0)


def test_a_damaged_absolute_test_record_is_refused(system: SystemMap) -> None:
    facts = system.result.facts()
    with pytest.raises(ValueError, match=r"shape|broadcast"):
        AbsoluteTestResult.load(facts | {"covariance": [1.0, 2.0]})


def test_a_reference_determines_only_what_no_pose_does(system: SystemMap) -> None:
    known = system.result.with_reference((2, 0), 0.5)
    at = known.terms.index((2, 0))
    assert known.covariance[at, at] == pytest.approx(0.25)
    assert np.count_nonzero(known.covariance[at]) == 1
    assert set(system.result.unknown) - set(known.unknown) == {(2, 0)}
    with pytest.raises(MapError, match=r"\(2, 2\) is none that the poses left unknown"):
        system.result.with_reference((2, 2), 0.5)


def test_a_map_less_it_is_the_part(system: SystemMap) -> None:
    measured = maps(turns(1), 0.3, seed=5)[0]
    off = system.off(SurfaceMap(measured, PITCH_MM)).height_nm - true_nm(part_nm)
    assert rms_nm(measured - true_nm(part_nm)) > rms_nm(true_nm(instrument_nm))
    assert rms_nm(off) < 1.2 * np.hypot(0.3, 0.3 / 2), "the map's own noise, and that of the mean of four"


@pytest.mark.parametrize(
    ("rows", "pitch_mm", "words"),
    [(-1, PITCH_MM, "88 x 89 samples of 1 mm"), (89, 1.01 * PITCH_MM, "of 1.01 mm"), (89, None, "of no pitch")],
)
def test_a_map_of_another_frame_is_refused(system: SystemMap, rows: int, pitch_mm: float | None, words: str) -> None:
    with pytest.raises(MapError, match=words) as refused:
        system.off(SurfaceMap(maps(turns(1))[0][:rows], pitch_mm))
    assert "calibrate" in str(refused.value)
