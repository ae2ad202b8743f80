"""``polishd map convert``: every pair of formats comes back as it was, and nothing is written where it would not."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polishd.hookspecs import SurfaceReader
from polishd.maps import convert as map_convert
from polishd.maps.map_files import MapSource, readers_for
from polishd.model.errors import MapError
from polishd.model.surface import SurfaceMap
from tests.unit.cli_result import Polishd
from tests.unit.maps.maps import PITCH_MM, TAKEN_S, dat, surface

WRITERS = (".dat", ".datx", ".x3p")


@pytest.fixture
def source(tmp_path: Path) -> Path:
    return dat(tmp_path / "source.dat", surface())


@pytest.fixture
def lossy(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """``lossy(height_nm=...)``: what is read back of the file that would be written has these fields instead."""

    def install(**fields: Any) -> None:
        read = MapSource.read

        def reading(source: MapSource, path: Path) -> SurfaceMap:
            found = read(source, path)
            if path.stem != "map":
                return found
            if "height_nm" in fields and callable(fields["height_nm"]):
                return found.with_height(fields["height_nm"](found.height_nm.copy()))
            return SurfaceMap(**{name: fields.get(name, getattr(found, name)) for name in SurfaceMap.__slots__})

        monkeypatch.setattr(MapSource, "read", reading)

    return install


@pytest.mark.one_of_each
@pytest.mark.parametrize("first", WRITERS)
@pytest.mark.parametrize("second", WRITERS)
def test_each_pair_comes_back(polishd: Polishd, tmp_path: Path, source: Path, first: str, second: str) -> None:
    """Through two formats: heights within the counts of both, holes, pitch; and the figures through the shell."""
    one, two = tmp_path / f"one{first}", tmp_path / f"two{second}"
    for path_from, path_to in ((source, one), (one, two)):
        answer = polishd("map", "convert", path_from, path_to, "--json").answer
        assert answer["out"] == str(path_to)
        assert answer["bytes"] == path_to.stat().st_size
        assert answer["largest_change_nm"] <= map_convert.WITHIN_NM
    was, now = (MapSource.of().read(path) for path in (source, two))
    assert np.array_equal(was.valid, now.valid)
    np.testing.assert_allclose(now.height_nm, was.height_nm, atol=2 * map_convert.WITHIN_NM)
    assert now.pitch_mm == pytest.approx(PITCH_MM, rel=1e-6)
    assert now.unsaid == was.unsaid
    assert polishd("map", two, "--json").answer["missing"] == np.count_nonzero(np.isnan(surface()))


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize("name", ["zygo_metropro.dat", "zygo_mx.datx", "profilometer.x3p", "mountainsmap.sdf"])
@pytest.mark.parametrize("suffix", WRITERS)
def test_real_maps_keep_their_figures(
    polishd: Polishd, shared_data: Path, tmp_path: Path, name: str, suffix: str
) -> None:
    """Whole, or refused by name: never other figures."""
    target = tmp_path / f"out{suffix}"
    said = polishd("map", "convert", shared_data / name, target)
    if said.code:
        assert said.code == 8
        assert str(target) in said.err
        assert not target.exists()
        return
    was, now = (MapSource.of().read(path) for path in (shared_data / name, target))
    assert np.nanstd(now.height_nm) == pytest.approx(np.nanstd(was.height_nm), rel=1e-4)
    assert np.array_equal(was.valid, now.valid)
    assert now.pitch_mm == pytest.approx(was.pitch_mm, rel=1e-6)


def test_it_is_said(polishd: Polishd, source: Path) -> None:
    said = polishd("map", "convert", source, source.with_suffix(".x3p"))
    assert said.code == 0
    assert "source.x3p" in said.out
    assert "read back" in said.out
    assert f"{source.with_suffix('.x3p').stat().st_size} bytes" in said.out


def test_what_the_format_does_not_keep_is_noted() -> None:
    """A part's name, say; a time that is rounded to the second is kept."""
    was = SurfaceMap(surface(), PITCH_MM, part_id="blank-7", fiducials_px=((1.0, 2.0),))
    assert map_convert._notes(was, was, profiled=False) == []
    lost = SurfaceMap(surface(), PITCH_MM)
    assert map_convert._notes(was, lost, profiled=False) == ["the format does not keep the part, fiducials"]
    assert map_convert._notes(lost, was, profiled=False) == []
    assert "twice" in map_convert._notes(was, was, profiled=True)[0]


def test_a_missing_pitch_stays_missing(polishd: Polishd, tmp_path: Path) -> None:
    bare = dat(tmp_path / "bare.dat", surface(), pitch_mm=0.0)
    for suffix in WRITERS:
        target = tmp_path / f"out{suffix}"
        said = polishd("map", "convert", bare, target)
        assert said.code in {0, 8}, said.err
        if said.code == 0:
            assert polishd("map", target, "--json").answer["pitch_mm"] is None
        assert target.exists() == (said.code == 0)


def test_what_a_map_does_not_say_is_not_invented(polishd: Polishd, tmp_path: Path) -> None:
    """Bare numbers must not become trusted nanometres by being written into a .dat; the profile may say them."""
    bare, out = tmp_path / "m.npy", tmp_path / "out.dat"
    np.save(bare, surface())
    said = polishd("map", "convert", bare, out)
    assert said.code == 8
    assert "profile" in said.err
    for word in ("unit", "surface", "orientation"):
        assert word in said.err
    assert not out.exists()
    profile = tmp_path / "p.toml"
    profile.write_text(
        'name = "x"\ngives = ["surface", "orientation"]\n[height]\nunit_nm = 2.0\n[lateral]\npitch_mm = 0.25\n'
    )
    answer = polishd("map", "convert", bare, out, "--profile", profile, "--json").answer
    assert any("twice" in note for note in answer["notes"])
    now = polishd("map", out, "--json").answer
    assert now["rms_nm"] == pytest.approx(2 * np.nanstd(surface()), rel=1e-5)
    assert now["pitch_mm"] == pytest.approx(0.25, rel=1e-6)


def test_a_format_that_claims_to_know_more() -> None:
    """Whatever its writer thinks: what is read back must not say more than the map did."""
    height = surface()
    was = SurfaceMap(height, PITCH_MM, unsaid=frozenset({"unit", "surface"}))
    assert map_convert.require_same(was, was, Path("out.dat")) == 0
    with pytest.raises(MapError, match=r"out\.dat: the map does not say its surface, and .* --profile"):
        map_convert.require_same(was, SurfaceMap(height, PITCH_MM, unsaid=frozenset({"unit"})), Path("out.dat"))


def test_an_existing_file_is_not_replaced_unasked(polishd: Polishd, source: Path) -> None:
    target = source.with_suffix(".x3p")
    target.write_text("another file")
    said = polishd("map", "convert", source, target)
    assert said.code == 3
    assert "--force" in said.err
    assert target.read_text() == "another file"
    assert polishd("map", "convert", source, target, "--force").code == 0
    assert polishd("map", target, "--json").answer["rows"] == 60


@pytest.mark.parametrize("how", ["itself", "link"])
def test_never_over_what_is_read(polishd: Polishd, source: Path, how: str) -> None:
    before = source.read_bytes()
    target = source
    if how == "link":
        target = source.with_name("link.dat")
        target.symlink_to(source)
    said = polishd("map", "convert", source, target, "--force")
    assert said.code == 3
    assert "is the map that is read" in said.err
    assert source.read_bytes() == before


@pytest.mark.one_of_each
@pytest.mark.parametrize("name", ["out.int", "out", "out.txt", "out.dat.gz"])
def test_endings_that_nothing_writes(polishd: Polishd, source: Path, name: str) -> None:
    said = polishd("map", "convert", source, source.with_name(name))
    assert said.code == 2
    for suffix in WRITERS:
        assert suffix in said.err
    assert not source.with_name(name).exists()


def test_an_ending_in_capitals(polishd: Polishd, source: Path) -> None:
    assert polishd("map", "convert", source, source.with_name("OUT.X3P")).code == 0
    assert polishd("map", source.with_name("OUT.X3P"), "--json").answer["format"] == "x3p"


def test_a_folder_that_is_not_there(polishd: Polishd, source: Path) -> None:
    said = polishd("map", "convert", source, source.parent / "none" / "out.dat")
    assert said.code == 3
    assert "none: is not a folder; make it" in said.err


def test_a_source_that_is_no_map(polishd: Polishd, tmp_path: Path) -> None:
    said = polishd("map", "convert", tmp_path / "none.dat", tmp_path / "out.dat")
    assert said.code == 8
    assert list(tmp_path.iterdir()) == []


def spiked(height_nm: Any) -> Any:
    height_nm[30, 24] += 0.02
    return height_nm


def holed(height_nm: Any) -> Any:
    height_nm[30, 24] = np.nan
    return height_nm


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"height_nm": spiked}, "heights would change by up to 0.02 nm"),
        ({"height_nm": holed}, "missing samples"),
        ({"height_nm": np.transpose}, "shape"),
        ({"pitch_mm": 0.50001}, "pitch of 0.5"),
        ({"pitch_mm": None}, "pitch of 0.5"),
    ],
)
def test_what_does_not_read_back_is_not_written(
    polishd: Polishd, source: Path, lossy: Callable[..., None], fields: dict[str, Any], words: str
) -> None:
    lossy(**fields)
    target = source.with_suffix(".x3p")
    said = polishd("map", "convert", source, target)
    assert said.code == 8
    assert words in said.err
    assert not target.exists()
    assert [path.name for path in source.parent.iterdir()] == ["source.dat"]


def test_what_a_writer_refuses_is_one_message(polishd: Polishd, source: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def write(_: SurfaceMap) -> bytes:
        raise MapError("heights beyond its integers")

    readers = dict(readers_for())
    held = readers["metropro"]
    readers["metropro"] = SurfaceReader(held.name, held.sniff, held.read, (".dat",), write)
    monkeypatch.setattr("polishd.maps.map_files._of_cell", lambda _: (None, readers))
    said = polishd("map", "convert", source, source.with_name("out.dat"))
    assert said.code == 8
    assert "heights beyond its integers" in said.err
    assert "out.dat" in said.err


def test_the_time_is_kept_where_there_is_a_field(polishd: Polishd, source: Path) -> None:
    target = source.with_name("out.dat")
    assert polishd("map", "convert", source, target).code == 0
    now = MapSource.of().read(target)
    assert now.taken_at is not None
    assert now.taken_at.timestamp() == TAKEN_S
    assert now.part_id == "blank-7"
