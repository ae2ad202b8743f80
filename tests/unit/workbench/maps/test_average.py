"""``polishd map average``: the mean, what was left out, and a file that reads back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from polishd.workbench.maps.files import MapSource
from tests.unit.said import Polishd
from tests.unit.workbench.maps.maps import PITCH_MM, dat, surface

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


def test_people_are_told_the_same(polishd: Polishd, tmp_path: Path, repeats: list[Path]) -> None:
    said = polishd("map", "average", *repeats).out
    assert "repeat3.dat" in said
    assert "left out" in said
    assert "+-" in said
    assert "not written" in said
    written = polishd("map", "average", *repeats, "--out", tmp_path / "mean.dat").out
    assert "written to" in written


@pytest.mark.parametrize("out", [".x3p", ".png"])
def test_what_is_refused(polishd: Polishd, tmp_path: Path, repeats: list[Path], out: str) -> None:
    few = polishd("map", "average", *repeats[:2])
    assert (few.code, few.err.count("too few")) == (8, 1)
    other = dat(tmp_path / "other.dat", surface(), part="else")
    mixed = polishd("map", "average", *repeats, other)
    assert (mixed.code, mixed.err.count("several parts: blank-7, else")) == (8, 1)
    taken = repeats[0] if out == ".x3p" else tmp_path / f"mean{out}"
    before = repeats[0].read_bytes()
    assert polishd("map", "average", *repeats, "--out", taken).code == (2 if out == ".png" else 3)
    assert repeats[0].read_bytes() == before
