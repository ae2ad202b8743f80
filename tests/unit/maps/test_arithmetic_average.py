"""``polishd map average``: the mean, what was left out, and a file that reads back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polishd.maps.map_files import MapSource
from polishd.model.errors import MapError
from polishd.model.surface import SurfaceMap
from polishd.plugins.interferometer.formats.x3p import X3P
from polishd.process.metrology.averaging import average_maps
from tests.unit.cli_result import Polishd
from tests.unit.maps.maps import PITCH_MM, dat, surface
from tests.unit.plugins.interferometer.map_files import HEIGHT_NM, foursight

NOISE_NM = 0.5


@pytest.fixture
def repeats(tmp_path: Path) -> list[Path]:
    """Five maps of one surface with noise and a tilt each; the fourth was knocked."""
    clean, rng = surface(), np.random.default_rng(8)
    x = np.linspace(-1, 1, clean.shape[1])
    files = []
    for number in range(5):
        height = clean + rng.normal(0, NOISE_NM, clean.shape) + number * 20 * x + (number == 3) * 40 * np.cos(6 * x)
        files.append(dat(tmp_path / f"repeat{number}.dat", height))
    return files


def test_the_mean_leaves_out_what_deviates(polishd: Polishd, tmp_path: Path, repeats: list[Path]) -> None:
    mean = tmp_path / "mean.x3p"
    answer = polishd("map", "average", *repeats, "--out", mean, "--json").answer
    assert answer["used"] == ["repeat0.dat", "repeat1.dat", "repeat2.dat", "repeat4.dat"]
    assert answer["rejected"]["repeat3.dat"] > 10
    assert answer["sample_uncertainty_nm"] == pytest.approx(NOISE_NM / 2, rel=0.25)
    back, clean = MapSource.of().read(mean), surface()
    assert np.array_equal(back.valid, np.isfinite(clean))
    off = (back.height_nm - clean)[back.valid]
    rows, columns = np.nonzero(back.valid)
    plane = np.column_stack([np.ones(off.size), rows, columns])
    off = off - plane @ np.linalg.lstsq(plane, off, rcond=None)[0]
    assert off.std() == pytest.approx(NOISE_NM / 2, rel=0.15)
    assert back.pitch_mm == pytest.approx(PITCH_MM)


def test_the_text_says_the_same(polishd: Polishd, tmp_path: Path, repeats: list[Path]) -> None:
    said = polishd("map", "average", *repeats).out
    assert "repeat3.dat" in said
    assert "left out" in said
    assert "+-" in said
    assert "not written" in said
    written = polishd("map", "average", *repeats, "--out", tmp_path / "mean.dat").out
    assert "written to" in written


@pytest.mark.full
def test_repeats_of_unknown_pitch_are_averaged_only_when_asked(
    polishd: Polishd, tmp_path: Path, repeats: list[Path]
) -> None:
    bare = [dat(tmp_path / f"bare{number}.dat", surface(seed=number), pitch_mm=0.0) for number in range(3)]
    said = polishd("map", "average", *bare)
    assert said.code == 8
    assert "bare0.dat, bare1.dat, bare2.dat: without a lateral scale" in said.err
    assert polishd("map", "average", *bare, "--mixed", "--json").answer["used"] == [path.name for path in bare]
    profile = tmp_path / "p.toml"
    profile.write_text(f'name = "x"\n[lateral]\npitch_mm = {PITCH_MM}\n')
    assert polishd("map", "average", *bare, "--profile", profile, "--json").code == 0
    one = polishd("map", "average", *repeats[:3], bare[1])
    assert one.code == 8
    assert "polishd: bare1.dat: without a lateral scale" in one.err
    assert polishd("map", "average", *repeats[:3], bare[1], "--mixed").code == 8  # 0.5 mm and none are two


@pytest.mark.full
def test_one_pitch_in_two_formats_is_one(polishd: Polishd, tmp_path: Path, repeats: list[Path]) -> None:
    """``.dat`` rounds it to 32 bits; a mean that was written as one is of its repeats' instrument, or of none."""
    files = [repeats[0], repeats[1], tmp_path / "third.x3p"]
    exact = SurfaceMap(MapSource.of().read(repeats[2]).height_nm, PITCH_MM)
    assert X3P.write is not None
    files[2].write_bytes(X3P.write(exact))
    assert polishd("map", "average", *files, "--json").answer["used"] == [path.name for path in files]
    mean = tmp_path / "mean.dat"
    zygo = replace(exact, instrument="Zygo, system 651365")
    named = [tmp_path / f"named{number}.x3p" for number in range(3)]
    for number, path in enumerate(named):
        path.write_bytes(X3P.write(replace(zygo, height_nm=MapSource.of().read(repeats[number]).height_nm)))
    assert polishd("map", "average", *named, "--out", mean).code == 0
    assert polishd("map", mean, "--json").answer["instrument"] == "Zygo MetroPro, system 61541"
    assert polishd("map", "average", *named, "--system", mean).code == 0


def test_repeats_of_another_instrument_are_refused_by_name(polishd: Polishd, tmp_path: Path) -> None:
    """4Sight's files name the head; Zygo's ``.dat`` keeps 16 bits of the number that its text has."""
    heads = ["20714", "20714", "20715", ""]
    files = [tmp_path / f"{number}.h5" for number in range(4)]
    for number, (path, head) in enumerate(zip(files, heads, strict=True)):
        noise = np.random.default_rng(number).normal(0.0, 1.0, HEIGHT_NM.shape)
        path.write_bytes(foursight(HEIGHT_NM + noise, head_serial=head))
    said = polishd("map", "average", *files)
    assert said.code == 8
    assert "2.h5 is of the instrument '4D, system 20715', 0.h5 of '4D, system 20714'" in said.err
    assert polishd("map", "average", *files, "--mixed").code == 0
    names = ["Zygo MetroPro, system 61541", "Zygo, system 651365", ""]
    maps = [
        SurfaceMap(surface(seed=n), PITCH_MM, instrument=name, path=Path(f"{n}.dat")) for n, name in enumerate(names)
    ]
    assert average_maps(maps).used == ("0.dat", "1.dat", "2.dat")
    other = replace(maps[2], instrument="Zygo, system 651366")
    with pytest.raises(MapError, match=r"2\.dat is of the instrument"):
        average_maps([*maps[:2], other])


@pytest.mark.full
@pytest.mark.parametrize("out", [".x3p", ".png"])
def test_what_is_refused(polishd: Polishd, tmp_path: Path, repeats: list[Path], out: str) -> None:
    few = polishd("map", "average", *repeats[:2])
    assert (few.code, few.err.count("too few")) == (8, 1)
    copied = tmp_path / "copied.dat"
    copied.write_bytes(repeats[0].read_bytes())
    twice = polishd("map", "average", *repeats[:3], copied)
    assert (twice.code, twice.err.count("copied.dat and repeat0.dat hold the same measurement")) == (8, 1)
    larger = polishd("map", "average", *repeats[:3], dat(tmp_path / "larger.dat", surface(80, 48)))
    assert "larger.dat has 80 x 48 samples and a pitch of 0.5 mm, the first repeat 60 x 48 samples" in larger.err
    other = dat(tmp_path / "other.dat", surface(), part="else")
    mixed = polishd("map", "average", *repeats, other)
    assert (mixed.code, mixed.err.count("several parts: blank-7, else")) == (8, 1)
    taken = repeats[0] if out == ".x3p" else tmp_path / f"mean{out}"
    before = repeats[0].read_bytes()
    assert polishd("map", "average", *repeats, "--out", taken).code == (2 if out == ".png" else 3)
    assert repeats[0].read_bytes() == before
