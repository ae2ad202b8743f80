"""``polishd map subtract`` and ``average --system``: what is left is right, how sure it is, and what is refused."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from polishd.maps.map_files import PROFILED, MapSource
from polishd.model.surface import FloatArray, Grid
from tests.unit.cli_result import Polishd
from tests.unit.maps.maps import PITCH_MM, dat
from tests.unit.plugins.interferometer.map_files import HEIGHT_NM, foursight

NOISE_NM = 1.0
GRID = Grid(160, 128, PITCH_MM)
"""20 000 samples: their RMS is known to half a percent, so that a factor of sqrt(2) is far off."""
WITHIN = 0.03
SYSTEM = 6 * np.cos(GRID.x_mm / 9)[None, :] * np.sin(GRID.y_mm / 7)[:, None]
PART = 20 * np.sin(GRID.x_mm / 5)[None, :] + GRID.y_mm[:, None]


def noise(seed: int, shape: tuple[int, int] = GRID.shape, sigma_nm: float = NOISE_NM) -> FloatArray:
    return np.random.default_rng(seed).normal(0.0, sigma_nm, shape)


def measured(path: Path, height_nm: FloatArray, seed: int, sigma_nm: float = NOISE_NM) -> Path:
    return dat(path, height_nm + noise(seed, height_nm.shape, sigma_nm))


def residual_nm(path: Path, true_nm: FloatArray) -> float:
    """RMS of what the file's map is off the truth, piston and tilt aside."""
    back = MapSource.of().read(path)
    off = (back.height_nm - true_nm)[back.valid]
    rows, columns = np.nonzero(back.valid)
    plane = np.column_stack([np.ones(off.size), rows, columns])
    return float((off - plane @ np.linalg.lstsq(plane, off, rcond=None)[0]).std())


@pytest.mark.full
@pytest.mark.parametrize("ending", [".x3p", ".datx", ".dat"])
def test_errors_of_both_add_in_squares(polishd: Polishd, tmp_path: Path, ending: str) -> None:
    one, two = measured(tmp_path / "a.dat", PART + SYSTEM, 1), measured(tmp_path / "b.dat", SYSTEM, 2, 2 * NOISE_NM)
    out, drawn = tmp_path / f"c{ending}", tmp_path / "c.png"
    answer = polishd("map", "subtract", one, two, "--out", out, "--picture", drawn, "--json").answer
    assert residual_nm(out, PART) == pytest.approx(math.sqrt(5) * NOISE_NM, rel=WITHIN)
    assert answer["rms_nm"] == pytest.approx(np.std(PART), rel=0.02)
    assert (answer["samples"], answer["sample_uncertainty_nm"]) == (PART.size, None)
    assert answer["map"]["path"] == str(one)
    assert answer["subtracted"]["rms_nm"] == pytest.approx(math.hypot(SYSTEM.std(), 2 * NOISE_NM), rel=WITHIN)
    assert drawn.read_bytes().startswith(b"\x89PNG")
    back = MapSource.of().read(out)
    assert back.pitch_mm == pytest.approx(PITCH_MM)
    if ending == ".dat":
        assert "history" in answer["notes"][-1]
        return
    assert back.history is not None
    assert [(one.role, one.name) for one in back.history.inputs] == [("map", "a.dat"), ("subtracted", "b.dat")]


def test_the_text_says_the_same(polishd: Polishd, tmp_path: Path) -> None:
    one, two = measured(tmp_path / "a.dat", PART, 1), measured(tmp_path / "b.dat", SYSTEM, 2)
    said = polishd("map", "subtract", one, two).out
    assert "a.dat less b.dat" in said
    assert "the uncertainty of a sample is unknown" in said
    assert "not written: --out" in said
    assert "written to" in polishd("map", "subtract", one, two, "--out", tmp_path / "c.x3p").out


def test_of_two_pitches_the_coarser_one_is_left(polishd: Polishd, tmp_path: Path) -> None:
    """Four samples' mean has half their noise."""
    coarse = Grid(80, 64, 2 * PITCH_MM)
    one = measured(tmp_path / "a.dat", np.zeros(GRID.shape), 1)
    two = dat(tmp_path / "b.dat", noise(2, coarse.shape), 2 * PITCH_MM)
    out = tmp_path / "c.x3p"
    answer = polishd("map", "subtract", one, two, "--out", out, "--json").answer
    assert (answer["rows"], answer["cols"], answer["pitch_mm"]) == (80, 64, pytest.approx(2 * PITCH_MM))
    assert "resampled to 80 x 64" in answer["notes"][0]
    assert residual_nm(out, np.zeros(coarse.shape)) == pytest.approx(math.hypot(0.5, 1.0) * NOISE_NM, rel=WITHIN)


def test_a_hole_of_either_is_a_hole(polishd: Polishd, tmp_path: Path) -> None:
    radius = GRID.radius_mm()
    one = dat(tmp_path / "a.dat", np.where(radius < 25, PART, np.nan))
    two = dat(tmp_path / "b.dat", np.where(radius > 5, SYSTEM, np.nan))
    out = tmp_path / "c.datx"
    assert polishd("map", "subtract", one, two, "--out", out).code == 0
    back = MapSource.of().read(out)
    assert np.array_equal(back.valid, (radius < 25) & (radius > 5))
    np.testing.assert_allclose(back.height_nm[back.valid], (PART - SYSTEM)[back.valid], atol=0.01)


def test_what_cannot_be_laid_on_each_other_is_refused(polishd: Polishd, tmp_path: Path) -> None:
    one = dat(tmp_path / "a.dat", PART)
    small = dat(tmp_path / "small.dat", PART[::2], pitch_mm=0.0)
    elsewhere = dat(tmp_path / "elsewhere.dat", np.where(GRID.x_mm < -20, PART, np.nan))
    here = dat(tmp_path / "here.dat", np.where(GRID.x_mm > -21, PART, np.nan))
    bare = tmp_path / "bare.npy"
    np.save(bare, SYSTEM)
    for first, second, words in (
        (one, small, "has not the samples of"),
        (elsewhere, here, "another part, or another place on it"),
        (one, bare, "does not state its orientation and surface and unit"),
    ):
        said = polishd("map", "subtract", first, second, "--out", tmp_path / "c.x3p")
        assert (said.code, said.err.count(words)) == (8, 1), said.err
        assert not (tmp_path / "c.x3p").exists()
    before = one.read_bytes()
    assert polishd("map", "subtract", here, one, "--out", one, "--force").code == 3
    assert polishd("map", "subtract", one, one, "--picture", tmp_path / "c.dat").code == 3
    assert one.read_bytes() == before


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize(("repeats", "system_repeats"), [(4, 4), (9, 3)])
def test_a_mean_without_the_system_error_is_as_sure_as_it_says(
    polishd: Polishd, tmp_path: Path, repeats: int, system_repeats: int
) -> None:
    """s / sqrt(n) of the repeats and S / sqrt(N) of the system error's, in squares; both in the file, too."""
    true = [measured(tmp_path / f"s{n}.dat", SYSTEM, 100 + n) for n in range(system_repeats)]
    system, mean = tmp_path / "system.x3p", tmp_path / "mean.x3p"
    known = polishd("map", "average", *true, "--out", system, "--json").answer["sample_uncertainty_nm"]
    files = [measured(tmp_path / f"m{n}.dat", PART + SYSTEM, n) for n in range(repeats)]
    answer = polishd("map", "average", *files, "--system", system, "--out", mean, "--json").answer
    left = residual_nm(mean, PART)
    assert left == pytest.approx(NOISE_NM * math.hypot(repeats**-0.5, system_repeats**-0.5), rel=WITHIN)
    assert answer["system"]["sample_uncertainty_nm"] == known
    # the median of so few repeats' scatter is some 10 % low
    assert answer["system"]["with_mean_nm"] == pytest.approx(left, rel=0.2)
    assert answer["system"]["rms_nm"] == pytest.approx(np.hypot(SYSTEM.std(), system_repeats**-0.5), rel=WITHIN)
    back = MapSource.of().read(mean)
    assert back.history is not None
    assert back.history.uncertainty_nm == answer["system"]["with_mean_nm"]
    assert [one.role for one in back.history.inputs] == ["repeat"] * repeats + ["system error"]
    assert polishd("map", "subtract", mean, system, "--json").answer["sample_uncertainty_nm"] == pytest.approx(
        math.hypot(back.history.uncertainty_nm, known)
    )


@pytest.mark.full
def test_the_text_names_the_system_error(polishd: Polishd, tmp_path: Path) -> None:
    files = [measured(tmp_path / f"m{n}.dat", PART + SYSTEM, n) for n in range(3)]
    system = measured(tmp_path / "system.dat", SYSTEM, 9)
    said = polishd("map", "average", *files, "--system", system, "--picture", tmp_path / "p.png").out
    assert "less the system error system.dat" in said
    assert "its file does not say" in said
    assert (tmp_path / "p.png").exists()
    assert polishd("map", "average", *files, "--system", system, "--out", system, "--force").code == 3


def test_a_system_error_of_another_instrument_is_refused(polishd: Polishd, tmp_path: Path) -> None:
    files = [tmp_path / f"{number}.h5" for number in range(4)]
    for number, path in enumerate(files):
        head = "20715" if number == 3 else "20714"
        path.write_bytes(foursight(HEIGHT_NM + noise(number, HEIGHT_NM.shape), head_serial=head))
    said = polishd("map", "average", *files[:3], "--system", files[3])
    assert said.code == 8
    assert "of the instrument '4D, system 20714', the system error" in said.err
    assert polishd("map", "average", *files[:3], "--system", files[3], "--mixed").code == 0


def test_a_profile_is_not_applied_to_what_has_it_in_it(polishd: Polishd, tmp_path: Path) -> None:
    """Raw repeats need the profile; the system error that was averaged with it must not be turned again."""
    profile = tmp_path / "p.toml"
    profile.write_text('name = "turned"\n[orientation]\nrotation_deg = 180\n')
    raw = [measured(tmp_path / f"s{n}.dat", np.rot90(SYSTEM, 2), 100 + n, 0.1) for n in range(3)]
    files = [measured(tmp_path / f"m{n}.dat", np.rot90(PART + SYSTEM, 2), n, 0.1) for n in range(3)]
    system, mean = tmp_path / "system.datx", tmp_path / "mean.x3p"
    assert polishd("map", "average", *raw, "--out", system, "--profile", profile).code == 0
    answer = polishd("map", "average", *files, "--system", system, "--profile", profile, "--out", mean, "--json").answer
    assert answer["system"]["warnings"] == [PROFILED]
    assert residual_nm(mean, PART) == pytest.approx(0.1 * math.sqrt(2 / 3), rel=WITHIN)
