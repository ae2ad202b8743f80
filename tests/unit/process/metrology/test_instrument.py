"""A profile is applied once, to the array and to what goes with it, and refuses what it cannot answer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from polishd.model.errors import MapError
from polishd.model.instrument import Instrument
from polishd.model.surface import SurfaceMap
from polishd.process.frames import ORIENTATIONS, ArrayOrientation, orientations
from polishd.process.metrology.instrument import apply_profile

HEIGHT = np.arange(12.0).reshape(3, 4)
HEIGHT[0, 1] = np.nan
MAP = SurfaceMap(HEIGHT, 0.25, instrument="SN 7", factors={"sign": 1}, fiducials_px=((0.0, 1.0), (1.5, 2.25)))
PROFILE = Instrument("shop")


@pytest.mark.parametrize("way", ORIENTATIONS, ids=lambda way: way.name)
def test_each_way_is_applied_to_array_marks_and_vectors(way: ArrayOrientation) -> None:
    profile = replace(PROFILE, mirror=way.mirror, rotation_deg=way.rotation_deg, sign=-1, factor=0.5)
    seen = apply_profile(MAP, profile)
    np.testing.assert_array_equal(seen.height_nm, -0.5 * way.turn(HEIGHT))
    np.testing.assert_array_equal(seen.height_nm, -0.5 * way.turn(HEIGHT))
    row, column = seen.fiducials_px[0]
    assert np.isnan(seen.height_nm[int(row), int(column)])  # the mark is still where the hole is
    ny, nx = HEIGHT.shape
    offset = (2.25 - (nx - 1) / 2, (ny - 1) / 2 - 1.5)
    ny, nx = seen.height_nm.shape
    row, column = seen.fiducials_px[1]
    assert way.turn_vector(offset) == pytest.approx((column - (nx - 1) / 2, (ny - 1) / 2 - row))
    assert seen.factors["profile"] == {
        "name": "shop", "mirror": way.mirror, "rotation_deg": way.rotation_deg, "sign": -1, "factor": 0.5,
        "unit_nm": 1.0, "pitch_mm": 0.25, "pitch_from": "file",
    }  # fmt: skip
    assert seen.factors["sign"] == 1
    assert way.name in seen.orientation


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("as it is", [[1, 2], [3, 4]]), ("turned 90", [[2, 4], [1, 3]]), ("turned 180", [[4, 3], [2, 1]]),
        ("turned 270", [[3, 1], [4, 2]]), ("flipped left-right", [[2, 1], [4, 3]]), ("transposed", [[1, 3], [2, 4]]),
        ("flipped up-down", [[3, 4], [1, 2]]), ("transposed across", [[4, 2], [3, 1]]),
    ],
)  # fmt: skip
def test_the_names_mean_what_they_say(name: str, expected: list[list[int]]) -> None:
    way = next(way for way in ORIENTATIONS if way.name == name)
    assert way.turn(np.array([[1, 2], [3, 4]])).tolist() == expected


def test_ways_combine_and_undo_each_other() -> None:
    for one in ORIENTATIONS:
        np.testing.assert_array_equal(one.undone.turn(one.turn(HEIGHT)), HEIGHT)
        for two in ORIENTATIONS:
            np.testing.assert_array_equal(one.then(two).turn(HEIGHT), two.turn(one.turn(HEIGHT)))
    assert len({way.turn(HEIGHT).tobytes() for way in ORIENTATIONS}) == 8


def test_maps_that_are_not_square_have_four() -> None:
    assert len(orientations((5, 5))) == 8
    assert {way.name for way in orientations((5, 4))} == {
        "as it is", "turned 180", "flipped left-right", "flipped up-down",
    }  # fmt: skip


def test_a_profile_is_applied_once() -> None:
    with pytest.raises(MapError, match="second time"):
        apply_profile(apply_profile(MAP, PROFILE), PROFILE)
    with pytest.raises(MapError, match="second time"):
        apply_profile(apply_profile(MAP, PROFILE), None)


def test_without_a_profile_the_file_must_say_all() -> None:
    assert apply_profile(MAP, None) is MAP
    for key in ("unit", "surface", "orientation", "pitch"):
        with pytest.raises(MapError, match=rf"does not say its {key}.*\[instrument\]"):
            apply_profile(replace(MAP, unsaid=frozenset({key})), None)
    with pytest.raises(MapError, match="pitch_mm"):
        apply_profile(replace(MAP, pitch_mm=None), None)


@pytest.mark.parametrize("key", ["unit", "surface", "orientation", "pitch"])
def test_what_neither_says_is_refused(key: str) -> None:
    with pytest.raises(MapError, match=rf"does not say its {key}.*neither does the profile 'shop'"):
        apply_profile(replace(MAP, unsaid=frozenset({key})), PROFILE)


def test_what_the_profile_says_is_taken() -> None:
    asked = replace(MAP, pitch_mm=None, unsaid=frozenset({"pitch", "unit", "surface", "orientation"}))
    profile = replace(PROFILE, pitch_mm=0.2, unit_nm=632.8, factor=0.5, gives=frozenset({"surface", "orientation"}))
    seen = apply_profile(asked, profile)
    assert seen.pitch_mm == 0.2
    assert seen.unsaid == frozenset()
    np.testing.assert_allclose(seen.height_nm, HEIGHT * 316.4)
    assert seen.factors["profile"]["unit_nm"] == 632.8


def test_numbers_are_not_given_by_naming_them() -> None:
    asked = replace(MAP, pitch_mm=None, unsaid=frozenset({"pitch", "unit"}))
    with pytest.raises(MapError, match="pitch and unit"):
        apply_profile(asked, replace(PROFILE, gives=frozenset({"pitch", "unit"})))


def test_a_unit_that_the_file_gives_is_not_applied_again() -> None:
    np.testing.assert_array_equal(apply_profile(MAP, replace(PROFILE, unit_nm=632.8)).height_nm, HEIGHT)


def test_pitches_must_agree() -> None:
    assert apply_profile(MAP, replace(PROFILE, pitch_mm=0.253)).pitch_mm == 0.25
    with pytest.raises(MapError, match=r"0\.25 mm.*0\.26 mm.*zoom"):
        apply_profile(MAP, replace(PROFILE, pitch_mm=0.26))


def test_a_number_cut_to_16_bits_is_that_of_its_twin() -> None:
    """651365 in the text and 61541 in the ``.dat`` of one measurement."""
    twins = [replace(MAP, instrument=name) for name in ("Zygo MetroPro, system 61541", "Zygo, system 651365")]
    for entry in ("651365", "61541", *(twin.instrument for twin in twins)):
        for twin in twins:
            assert apply_profile(twin, replace(PROFILE, serials=(entry,))).pitch_mm == MAP.pitch_mm
    for other in ("Zygo, system 651366", "Zygo, system 127077", "4D, system 651365x", "system 61541"):
        with pytest.raises(MapError, match="serials"):
            apply_profile(replace(MAP, instrument=other), replace(PROFILE, serials=("651365",)))


def test_one_key_is_enough_to_look_but_not_to_polish() -> None:
    doubts = {"pitch": "no lateral scale", "unit": "no unit"}
    asked = replace(
        MAP,
        pitch_mm=None,
        unsaid=frozenset({"pitch", "unit", "surface"}),
        doubts=doubts,
        warnings=(*doubts.values(), "cut"),
    )
    for profile, left, pitch_mm, factor in (
        (replace(PROFILE, pitch_mm=0.2), {"unit", "surface"}, 0.2, 1.0),
        (replace(PROFILE, unit_nm=10.0), {"pitch", "surface"}, None, 10.0),
        (replace(PROFILE, unit_nm=10.0, pitch_mm=0.2, gives=frozenset({"surface"})), set(), 0.2, 10.0),
    ):
        seen = apply_profile(asked, profile, partly=True)
        assert (set(seen.unsaid), seen.pitch_mm) == (left, pitch_mm)
        assert seen.warnings == (*(doubts[key] for key in ("pitch", "unit") if key in left), "cut")
        np.testing.assert_array_equal(seen.height_nm, HEIGHT * factor)
        if left:
            with pytest.raises(MapError, match="does not say its"):
                apply_profile(asked, profile)
    odd = replace(asked, unsaid=frozenset({"square pixels"}))
    assert apply_profile(odd, replace(PROFILE, pitch_mm=0.2), partly=True).pitch_mm is None


def test_another_instrument_is_refused() -> None:
    assert apply_profile(MAP, replace(PROFILE, serials=("SN 6", "SN 7"))).instrument == "SN 7"
    zygo = replace(MAP, instrument="Zygo MetroPro, system 62398")
    assert apply_profile(zygo, replace(PROFILE, serials=("1", "62398"))).instrument == zygo.instrument
    for named in ("SN 8", ""):
        with pytest.raises(MapError, match="serials"):
            apply_profile(replace(MAP, instrument=named), replace(PROFILE, serials=("SN 7",)))
