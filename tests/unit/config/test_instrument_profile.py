"""Instruments' profiles: what they may say, where a mistake stands, and the record that comes and goes."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
import tomlkit

from polishd.config.instrument_profile import load_profile, write_commissioned
from polishd.model.errors import ConfigError
from polishd.model.instrument import CommissioningRecord, Instrument
from tests.commissioned import AT, SHIPPED, commissioned, forged

FULL = """
name = "bench"
serials = ["A-1"]
gives = ["surface", "orientation"]
[orientation]
mirror = true
rotation_deg = 90
[height]
sign = -1
factor = 0.5
unit_nm = 1000.0
[lateral]
pitch_mm = 0.25
pitch_tolerance = 0.01
[aperture]
diameter_mm = 98.0
tolerance_mm = 0.4
[fiducials]
positions_mm = [[40.0, 0.0], [-10.0, 38.0], [-30.0, -20.0]]
tolerance_mm = 0.3
[registration]
by = "both"
max_shift_mm = 3.0
max_turn_deg = 1.0
max_drift_mm = 0.2
[artefact]
name = "A"
[[artefact.bumps]]
x_mm = 1.0
y_mm = 2.0
sigma_x_mm = 3.0
sigma_y_mm = 4.0
height_nm = -50.0
"""


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "p.toml"
    path.write_text(text)
    return path


def test_every_value_arrives(tmp_path: Path) -> None:
    profile = load_profile(written(tmp_path, FULL))
    assert replace(profile.instrument, raw={}) == Instrument(
        name="bench",
        mirror=True,
        rotation_deg=90,
        sign=-1,
        factor=0.5,
        unit_nm=1000.0,
        pitch_mm=0.25,
        pitch_tolerance=0.01,
        gives=frozenset({"surface", "orientation"}),
        serials=("A-1",),
        aperture_mm=98.0,
        aperture_tolerance_mm=0.4,
        fiducials_mm=((40.0, 0.0), (-10.0, 38.0), (-30.0, -20.0)),
        fiducial_tolerance_mm=0.3,
        register_by="both",
        max_shift_mm=3.0,
        max_turn_deg=1.0,
        max_drift_mm=0.2,
    )
    assert profile.artefact == "A"
    (bump,) = profile.bumps
    assert (bump.x_mm, bump.sigma_y_mm, bump.height_nm, bump.angle_deg) == (1.0, 4.0, -50.0, 0.0)


def test_defaults_are_the_nouns(tmp_path: Path) -> None:
    profile = load_profile(written(tmp_path, 'name = "x"\n'))
    assert replace(profile.instrument, raw={}) == Instrument("x")
    assert (profile.artefact, profile.bumps) == ("", ())
    assert "never commissioned" in profile.unproved


def test_the_shipped_one_is_read_and_not_commissioned() -> None:
    profile = load_profile(SHIPPED)
    assert profile.instrument.commissioned is None
    assert len(profile.bumps) == 3


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('name = "bench"', 'nmae = "bench"', r"p.toml:2: nmae: unknown key; did you mean 'name'"),
        ("mirror = true", "miror = true", r"p.toml:6: orientation.miror: unknown key; did you mean 'mirror'"),
        ("rotation_deg = 90", "rotation_deg = 45", r"p.toml:7: orientation.rotation_deg: 45 is not allowed"),
        ("mirror = true", 'mirror = "yes"', r"p.toml:6: orientation.mirror: must be true or false"),
        ("sign = -1", "sign = 0", r"p.toml:9: height.sign: 0 is not allowed"),
        ("factor = 0.5", "factor = 0.0", r"p.toml:10: height.factor: 0.0 is out of range"),
        ("factor = 0.5", "factor = inf", r"p.toml:10: height.factor: inf is not allowed"),
        ("pitch_mm = 0.25", "pitch_mm = -1.0", r"p.toml:13: lateral.pitch_mm"),
        ('by = "both"', 'by = "fiducial"', r"registration.by: 'fiducial' is not allowed.*did you mean 'fiducials'"),
        ("[-10.0, 38.0], [-30.0, -20.0]", "[-10.0, 38.0]", r'registration: by = "both" needs at least 3'),
        ('"surface", "orientation"', '"surface", "pitch"', r"p.toml:4: gives: 'pitch' is not allowed"),
        ("sigma_x_mm = 3.0", "sigma_x_mm = 0.0", r"artefact.bumps"),
        ("[height]", "[height", r"p.toml:8: this is not TOML"),
    ],
)
def test_mistakes_are_named_with_their_place(tmp_path: Path, old: str, new: str, says: str) -> None:
    assert old in FULL
    with pytest.raises(ConfigError, match=says):
        load_profile(written(tmp_path, FULL.replace(old, new)))


def test_a_mistake_in_a_list_of_tables_is_placed_in_its_own(tmp_path: Path) -> None:
    second = "[[artefact.bumps]]\nx_mm = 1.0\ny_mm = 2.0\nsigma_x_mm = -3.0\nheight_nm = -50.0\nangel_deg = 3.0\n"
    with pytest.raises(ConfigError) as caught:
        load_profile(written(tmp_path, FULL + second))
    start = (FULL + second).count("\n") - second.count("\n")
    known = "Known here: 'angle_deg', 'height_nm', 'sigma_x_mm', 'sigma_y_mm', 'x_mm', 'y_mm'. Correct or remove it"
    assert str(caught.value).replace(str(tmp_path / "p.toml"), "P").splitlines() == [
        f"P:{start + 1}: artefact.bumps.sigma_y_mm: is missing; add it: sigma_y_mm = ...",
        f"P:{start + 4}: artefact.bumps.sigma_x_mm: -3.0 is out of range; must be greater than 0.0",
        f"P:{start + 6}: artefact.bumps.angel_deg: unknown key; did you mean 'angle_deg'? {known}",
    ]


def test_a_profile_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        load_profile(tmp_path / "none.toml")


# the record


def record(path: Path, **changes: Any) -> CommissioningRecord:
    return replace(
        CommissioningRecord(AT, 'a "good" one', "ab" * 32, 0.98765, 0.4, load_profile(path).sha256), **changes
    )


def test_a_record_is_read_back_and_leaves_the_users_text_alone(tmp_path: Path) -> None:
    path = written(tmp_path, "# mine\n" + FULL)
    proof = record(path)
    write_commissioned(path, proof)
    assert path.read_text().startswith("# mine\n" + FULL)
    profile = load_profile(path)
    assert profile.unproved == ""
    assert profile.instrument.commissioned == proof
    assert "commissioned" not in profile.instrument.raw


def test_a_second_record_takes_the_place_of_the_first(tmp_path: Path) -> None:
    path = written(tmp_path, FULL)
    write_commissioned(path, record(path))
    once = path.read_text()
    later = record(path, at=datetime(2027, 1, 1, tzinfo=UTC), artefact="another")
    write_commissioned(path, later)
    assert load_profile(path).instrument.commissioned == later
    assert path.read_text().count("[commissioned]") == 1
    assert len(path.read_text().splitlines()) == len(once.splitlines())


def test_a_record_in_the_middle_of_the_file_is_replaced_too(tmp_path: Path) -> None:
    path = written(tmp_path, FULL)
    write_commissioned(path, record(path))
    head, _, tail = path.read_text().partition("[commissioned]")
    path.write_text('name = "bench"\n[commissioned]' + tail + "\n# my camera\n[lateral]\npitch_mm = 0.25\n")
    write_commissioned(path, record(path))
    text = path.read_text()
    assert load_profile(path).unproved == ""
    assert text.endswith("\n# my camera\n[lateral]\npitch_mm = 0.25\n")
    assert text.count("[commissioned]") == 1
    assert head


@pytest.mark.parametrize(
    ("old", "new"),
    [("mirror = true", "mirror = false"), ("factor = 0.5", "factor = 1.0"), ("x_mm = 1.0", "x_mm = 1.5")],
)
def test_an_edited_value_makes_it_void(tmp_path: Path, old: str, new: str) -> None:
    path = forged(written(tmp_path, FULL))
    path.write_text(path.read_text().replace(old, new))
    profile = load_profile(path)
    assert profile.instrument.commissioned is None
    assert "edited after it was commissioned (2026-05-04 12:00)" in profile.unproved


def test_layout_comments_and_defaults_written_out_change_nothing(tmp_path: Path) -> None:
    path = forged(written(tmp_path, 'name = "x"\n'))
    path.write_text("# a comment\n" + path.read_text().replace('"x"\n', '"x"   # ours\n[height]\nsign = 1\n'))
    assert load_profile(path).unproved == ""


def test_a_text_that_only_looks_like_a_record_stays(tmp_path: Path) -> None:
    path = forged(written(tmp_path, 'name = """x\n[commissioned]\nat = 1"""\n'))
    assert load_profile(path).instrument.name == "x\n[commissioned]\nat = 1"


@pytest.mark.parametrize(
    "earlier",
    [
        '[commissioned]\nat = 2026-01-01T00:00:00Z\nartefact = """a\nb"""\n',
        'commissioned = { at = 2026-01-01T00:00:00Z, artefact = "a" }\n[height]\nsign = 1\n',
        'commissioned.at = 2026-01-01T00:00:00Z\ncommissioned.artefact = "a"\n# mine\n[height]\nsign = 1\n',
        '[[artefact.bumps]]  # mine\nx_mm = 1\nsigma_x_mm = 1\nheight_nm = 1\n[artefact]\nname = "a"\n',
    ],
    ids=["several lines", "inline", "dotted", "none"],
)
def test_a_record_goes_into_any_layout(tmp_path: Path, earlier: str) -> None:
    path = written(tmp_path, f'name = "x"\n{earlier}')
    proof = CommissioningRecord(AT, "another", "0" * 64, 0.9, 0.1, "1" * 64)
    write_commissioned(path, proof)
    raw = tomllib.loads(path.read_text())
    assert CommissioningRecord(**raw.pop("commissioned")) == proof
    assert raw == {
        key: value for key, value in tomllib.loads(f'name = "x"\n{earlier}').items() if key != "commissioned"
    }
    assert path.read_text().count("# mine") == earlier.count("# mine")


def test_what_cannot_be_written_is_as_it_was(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path, FULL)
    before = path.read_bytes()
    monkeypatch.setattr(tomlkit, "dumps", lambda document: str(document.as_string()).replace("0.25", "0.5"))
    with pytest.raises(ConfigError, match=r"remove \[commissioned\]"):
        write_commissioned(path, record(path))
    assert path.read_bytes() == before
    assert [item.name for item in tmp_path.iterdir()] == ["p.toml"]


def test_the_helper_of_the_other_tests(tmp_path: Path) -> None:
    assert load_profile(commissioned(tmp_path, orientation={"mirror": True})).instrument.mirror
