"""The pictures of ``polishd map``: drawn for every map that can be read, and never in the place of a map."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from polishd.maps import pictures as map_pictures
from tests.unit.cli_result import Polishd
from tests.unit.maps.maps import dat, surface

PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture
def good(tmp_path: Path) -> Path:
    return dat(tmp_path / "good.dat", surface())


@pytest.mark.full
def test_it_is_drawn(polishd: Polishd, tmp_path: Path, good: Path) -> None:
    out = tmp_path / "maps.png"
    bare = dat(tmp_path / "bare.dat", surface(), pitch_mm=0.0)
    said = polishd("map", good, bare, tmp_path / "missing.dat", "--json", "--out", out)
    assert said.code == 8
    assert said.out.count('"path"') == 2
    assert out.read_bytes().startswith(PNG)
    both = out.stat().st_size
    assert both > 40_000
    assert polishd("map", good, "--out", out).code == 0
    assert 20_000 < out.stat().st_size < both


@pytest.mark.full
def test_a_flat_map_is_drawn(polishd: Polishd, tmp_path: Path) -> None:
    """No height, no spectrum, no range of colours."""
    height = np.zeros((12, 12))
    height[3, 3] = np.nan
    height[-1, -1] = 0.1  # a tail of zeros is a torn file's
    out = tmp_path / "flat.png"
    assert polishd("map", dat(tmp_path / "m.dat", height), "--trim", 1, "--out", out).code == 0
    assert out.read_bytes().startswith(PNG)


@pytest.mark.full
def test_a_narrow_map_with_many_bands_is_drawn(polishd: Polishd, tmp_path: Path) -> None:
    """Upright and lying, beside one without a scale: rows of unlike many panels."""
    height = np.random.default_rng(2).normal(0.0, 5.0, (90, 12))
    maps = [dat(tmp_path / "up.dat", height), dat(tmp_path / "flat.dat", height.T.copy())]
    maps.append(dat(tmp_path / "bare.dat", height, pitch_mm=0.0))
    out = tmp_path / "p.png"
    assert polishd("map", *maps, "--bands", "20,10,5,2", "--out", out).code == 0
    assert out.read_bytes().startswith(PNG)


@pytest.mark.parametrize(
    ("limits", "words"), [((None, 33.0), "> 33 mm"), ((33.0, 0.12), "33 to 0.12 mm"), ((0.12, None), "< 0.12 mm")]
)
def test_periods_are_named(limits: tuple[float | None, float | None], words: str) -> None:
    assert map_pictures._periods({"from_mm": limits[0], "to_mm": limits[1]}) == words


def test_rounding_errors_are_no_heights() -> None:
    assert map_pictures._nm(3e-13) == "0 nm"
    assert map_pictures._nm(0.25) == "0.25 nm"


def test_a_picture_does_not_take_a_maps_place(polishd: Polishd, good: Path) -> None:
    before = good.read_bytes()
    said = polishd("map", good, "--out", good)
    assert said.code == 3
    assert "PNG" in said.err
    assert good.read_bytes() == before


@pytest.mark.full
def test_a_picture_that_cannot_be_written(polishd: Polishd, good: Path) -> None:
    said = polishd("map", good, "--out", good.parent / "none" / "p.png")
    assert said.code == 3
    assert "none" in said.err


def test_too_many_maps_for_a_picture(polishd: Polishd, good: Path) -> None:
    said = polishd("map", *[good] * 13, "--out", good.with_name("p.png"))
    assert said.code == 2
    assert not good.with_name("p.png").exists()


@pytest.mark.full
def test_names_are_taken_as_they_are(polishd: Polishd, good: Path) -> None:
    """Neither as mathematics nor as UTF-8, and a long one is cut."""
    odd = good.rename(good.with_name(os.fsdecode(b"m\xff$x_{$.dat")))
    out = good.with_name("p.png")
    assert polishd("map", odd, "--out", out).code == 0
    assert out.read_bytes().startswith(PNG)
    assert map_pictures._short("a" * 24) == "a" * 24
    assert map_pictures._short("before" + "a" * 40 + "after-3.datx") == "beforeaaaa...fter-3.datx"
