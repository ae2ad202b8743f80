"""The history inside a map's file: each verb adds to it, and what is broken in it costs no height."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polishd import __version__
from polishd.maps.map_files import MapSource
from polishd.model.errors import MapError
from polishd.model.surface import MOST_CHARACTERS, MOST_DEPTH, MapInput, MapStep, SurfaceMap
from polishd.plugins.interferometer.formats.format import MARK
from polishd.plugins.interferometer.formats.x3p import X3P
from polishd.rendering.terminal import stdout
from tests.unit.cli_result import Polishd
from tests.unit.maps.maps import PITCH_MM, dat, surface

LEAF = MapStep("convert", "0.1.0", {}, (MapInput("map", "m.dat", "ab" * 32),))


def sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize(("first", "second"), [(".x3p", ".datx"), (".datx", ".x3p")])
def test_a_later_verb_adds_to_it(polishd: Polishd, tmp_path: Path, first: str, second: str) -> None:
    rng = np.random.default_rng(4)
    files = [dat(tmp_path / f"m{n}.dat", surface() + rng.normal(0, 0.5, surface().shape)) for n in range(3)]
    mean, cut = tmp_path / f"mean{first}", tmp_path / f"cut{second}"
    polishd("map", "average", *files, "--out", mean, "--json")
    polishd("map", "convert", mean, cut, "--mask", "circle:0,0,8", "--json")
    history = polishd("map", cut, "--json").answer["history"]
    assert {key: history[key] for key in ("verb", "version", "options")} == {
        "verb": "convert",
        "version": __version__,
        "options": {"mask": ["circle:0,0,8"]},
    }
    (averaged,) = history["inputs"]
    assert (averaged["name"], averaged["sha256"]) == (mean.name, sha256(mean))
    leaves = [(one["role"], one["name"], one["sha256"], one["history"]) for one in averaged["history"]["inputs"]]
    assert leaves == [("repeat", path.name, sha256(path), None) for path in files]
    stdout.width = 200
    said = " ".join(polishd("map", cut).out.split())
    assert f"made by convert │ polishd {__version__}; mask circle:0,0,8" in said
    assert f"made by average │ polishd {__version__}" in said
    assert f"m2.dat, sha256 {sha256(files[2])[:12]}" in said


def test_a_format_without_room_says_so(polishd: Polishd, tmp_path: Path) -> None:
    made = dat(tmp_path / "m.dat", surface())
    assert polishd("map", made, "--json").answer["history"] is None
    said = polishd("map", "convert", made, tmp_path / "out.dat")
    assert "does not keep the history" in said.out


@pytest.mark.parametrize("text", ["{}", "[" * 100_000, '{"verb":1}', LEAF.to_json()[:-1], "null"])
def test_a_broken_one_is_a_warning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    """Others' programs may write comments as they like."""
    monkeypatch.setattr(MapStep, "to_json", lambda _: text)
    path = tmp_path / "m.x3p"
    assert X3P.write is not None
    path.write_bytes(X3P.write(SurfaceMap(surface(), PITCH_MM, history=LEAF)))
    back = MapSource.of().read(path)
    np.testing.assert_allclose(back.height_nm, surface(), atol=1e-6)
    assert back.history is None
    assert [word for word in back.warnings if "its history cannot be read" in word]


def test_one_that_grows_beyond_bounds_is_refused(tmp_path: Path) -> None:
    deep = LEAF
    for _ in range(MOST_DEPTH - 1):
        deep = replace(deep, inputs=(MapInput("map", "m.x3p", "", deep),))
    assert MapStep.from_json(deep.to_json()) == deep
    assert X3P.write is not None
    too_deep = replace(deep, inputs=(MapInput("map", "m.x3p", "", deep),))
    wide = replace(LEAF, options={"mask": ["x" * MOST_CHARACTERS]})
    for history in (too_deep, wide):
        with pytest.raises(MapError, match=r"its history is too long: .* begin with the measured maps again"):
            X3P.write(SurfaceMap(surface(), PITCH_MM, history=history))


def test_the_part_stays_beside_it(tmp_path: Path) -> None:
    from x3pio import read

    path = tmp_path / "m.x3p"
    assert X3P.write is not None
    path.write_bytes(X3P.write(SurfaceMap(surface(), PITCH_MM, part_id="blank-7", history=LEAF)))
    metadata = read(path).metadata
    assert metadata is not None
    assert metadata.comment == f"part blank-7\n{MARK}{LEAF.to_json()}"
    assert MapSource.of().read(path).history == LEAF
