"""``polishd map commission``: a map that shows the artefact proves the profile; anything else leaves it as it was."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polishd.config.instrument_profile import load_profile
from polishd.model.surface import FloatArray
from polishd.rendering.terminal import stdout
from tests.unit.cli_result import Polishd
from tests.unit.maps.maps import PITCH_MM, dat

PNG = b"\x89PNG\r\n\x1a\n"
BUMPS = ((9.0, 6.0, 4.0, 2.5, 120.0), (-7.0, 11.0, 2.0, 2.0, 80.0), (-4.0, -10.0, 2.5, 2.5, -60.0))
"""x, y, sigma x, sigma y in mm, height in nm."""


@pytest.fixture(autouse=True)
def wide(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stdout, "_width", 160)


def artefact(bumps: Any = BUMPS, across: int = 90) -> FloatArray:
    """(across, across) nm at 0.5 mm, x right and y up from the middle, in a circle; with a tilt and a little noise."""
    at = (np.arange(across) - (across - 1) / 2) * PITCH_MM
    x, y = np.meshgrid(at, -at)
    height = 0.3 * x + np.random.default_rng(5).normal(0.0, 1.0, x.shape)
    for bx, by, sx, sy, nm in bumps:
        height += nm * np.exp(-((x - bx) ** 2) / (2 * sx**2) - (y - by) ** 2 / (2 * sy**2))
    return np.where(np.hypot(x, y) < at[-1], height, np.nan)


def profile(path: Path, extra: str = "", bumps: Any = BUMPS) -> Path:
    names = ("x_mm", "y_mm", "sigma_x_mm", "sigma_y_mm", "height_nm")
    rows = ", ".join("{ " + ", ".join(f"{k} = {v}" for k, v in zip(names, bump, strict=True)) + " }" for bump in bumps)
    text = f'# ours\nname = "fizeau"\n{extra}\n[artefact]\nname = "bumps"\nbumps = [{rows}]\n'
    path.write_text(text if bumps else f'name = "fizeau"\n{extra}\n')
    return path


@pytest.fixture
def good(tmp_path: Path) -> Path:
    return dat(tmp_path / "good.dat", artefact(), part="artefact")


@pytest.fixture
def ours(tmp_path: Path) -> Path:
    return profile(tmp_path / "p.toml")


def test_a_true_map_is_recorded(polishd: Polishd, ours: Path, good: Path) -> None:
    """The record says which map and which values; comments stay, and a changed value makes it void."""
    assert "never commissioned" in load_profile(ours).unproved
    answer = polishd("map", "commission", ours, good, "--json").answer
    assert answer["map_sha256"] == hashlib.sha256(good.read_bytes()).hexdigest()
    assert answer["profile_sha256"] == load_profile(ours).sha256
    assert answer["correlation"] > 0.99 > 0.9 > answer["next_best"]
    assert (answer["scale"], answer["pitch_ratio"]) == pytest.approx((1.0, 1.0), abs=0.01)
    assert (answer["artefact"], answer["profile"]) == ("bumps", str(ours))
    record = load_profile(ours).instrument.commissioned
    assert record is not None
    assert record.at.isoformat() == answer["at"]
    text = ours.read_text()
    assert text.startswith("# ours\n")
    ours.write_text(text.replace('"fizeau"', '"another"'))
    assert "edited after" in load_profile(ours).unproved


@pytest.mark.full
def test_what_a_mask_leaves_out_spoils_no_proof(polishd: Polishd, tmp_path: Path) -> None:
    """Of a profile that turns: the mask lies on what it makes of the file."""
    ours = profile(tmp_path / "p.toml", "[orientation]\nrotation_deg = 90")
    height = np.where(np.hypot(*np.mgrid[-44.5:45, -44.5:45]) < 46, artefact(), np.nan)
    height[:, :8] += 5000.0  # a clamp at the artefact's left
    file = dat(tmp_path / "clamped.dat", np.rot90(height, -1), part="artefact")
    assert polishd("map", "commission", ours, file).code == 8
    said = polishd("map", "commission", ours, file, "--mask", "not:rectangle:-22,0,8,60")
    assert (said.code, said.err) == (0, "")
    assert "mask not:rectangle:-22,0,8,60 holds " in said.out


def test_proved_again_it_has_one_record(polishd: Polishd, ours: Path, good: Path) -> None:
    for _ in range(2):
        assert polishd("map", "commission", ours, good).code == 0
    assert ours.read_text().count("[commissioned]") == 1
    assert load_profile(ours).unproved == ""


def test_for_people(polishd: Polishd, ours: Path, good: Path) -> None:
    said = polishd("map", "commission", ours, good)
    assert said.code == 0
    for words in ("fizeau: commissioned", "bumps", "correlation", "next best", "0.5 mm", "turned"):
        assert words in said.out, words


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize(
    ("change", "mend"),
    [
        (lambda z: z[:, ::-1], "[orientation]\nmirror = true"),
        (np.rot90, "[orientation]\nrotation_deg = 270"),
        (lambda z: -z, "[height]\nsign = -1"),
        (lambda z: 2 * z, "[height]\nfactor = 0.5"),
    ],
    ids=["flipped", "turned", "negated", "doubled"],
)
def test_a_wrong_profile_is_refused_and_the_advice_mends_it(
    polishd: Polishd, tmp_path: Path, ours: Path, change: Any, mend: str
) -> None:
    wrong = dat(tmp_path / "wrong.dat", np.ascontiguousarray(change(artefact())))
    before, out = ours.read_bytes(), tmp_path / "p.png"
    said = polishd("map", "commission", ours, wrong, "--out", out)
    assert (said.code, said.out) == (8, "")
    assert said.err.startswith(f"polishd: {wrong}: ")
    assert mend.splitlines()[1] in said.err
    assert ours.read_bytes() == before
    assert out.read_bytes().startswith(PNG)
    assert polishd("map", "commission", profile(ours, mend), wrong).code == 0


@pytest.mark.parametrize("profiled", [False, True])
def test_a_wrong_pitch_is_mended_where_it_is_said(polishd: Polishd, tmp_path: Path, profiled: bool) -> None:
    """A pitch_mm beside the file's own was advised, and refused by the next try."""
    lateral = f"[lateral]\npitch_mm = {0.85 * PITCH_MM}"
    ours = profile(tmp_path / "p.toml", lateral if profiled else "")
    wrong = dat(tmp_path / "wrong.dat", artefact(), pitch_mm=0.0 if profiled else 0.85 * PITCH_MM)
    said = polishd("map", "commission", ours, wrong)
    assert said.code == 8
    if profiled:
        advised = said.err.split("set pitch_mm = ")[1].split()[0]
        ours = profile(tmp_path / "p.toml", f"[lateral]\npitch_mm = {advised}")
        assert polishd("map", "commission", ours, wrong).code == 0
    else:
        assert "set pitch_mm" not in said.err
        assert "calibrate the lateral scale at the instrument, whose files say 0.425 mm a pixel" in said.err


@pytest.mark.full
def test_what_does_not_show_the_artefact(polishd: Polishd, tmp_path: Path, ours: Path) -> None:
    """Another artefact; one of which two bumps are out of the map; a map without a scale."""
    before = ours.read_bytes()
    other = [(-9.0, -3.0, 3.0, 3.0, 90.0), (2.0, 12.0, 2.0, 4.0, 100.0)]
    beside = [(bump[0] + 26.0, *bump[1:]) for bump in BUMPS]
    for bumps in (other, beside):
        said = polishd("map", "commission", ours, dat(tmp_path / "m.dat", artefact(bumps)))
        assert said.code == 8
        assert "does not show the artefact" in said.err
    said = polishd("map", "commission", ours, dat(tmp_path / "bare.dat", artefact(), pitch_mm=0.0))
    assert said.code == 8
    assert "pitch_mm" in said.err
    assert ours.read_bytes() == before


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize("ending", [".dat", ".x3p", ".datx"])
def test_a_made_up_map_proves_nothing(polishd: Polishd, tmp_path: Path, ending: str) -> None:
    """A profile by hand was applied to it, or it is a mean of two instruments' maps."""
    ours = profile(tmp_path / "p.toml")
    before, hand = ours.read_bytes(), tmp_path / "hand.toml"
    hand.write_text(f'name = "by hand"\n[lateral]\npitch_mm = {PITCH_MM}\n')
    bare = [dat(tmp_path / f"bare{n}.dat", artefact(), pitch_mm=0.0, part="artefact") for n in range(3)]
    scaled, mean = tmp_path / f"scaled{ending}", tmp_path / f"mean{ending}"
    assert polishd("map", "convert", bare[0], scaled, "--profile", hand).code == 0
    said = polishd("map", "commission", ours, scaled)
    assert (said.code, ours.read_bytes()) == (8, before)
    assert f"{scaled.name} had the profile applied before" in said.err
    good = [dat(tmp_path / f"good{n}.dat", artefact() + n, part="artefact") for n in range(3)]
    assert polishd("map", "average", *good, "--mixed", "--out", mean).code == 0
    said = polishd("map", "commission", ours, mean)
    assert (said.code, ours.read_bytes()) == (8, before)
    assert f"{mean.name}: by its history it holds a mean of mixed repeats" in said.err
    assert polishd("map", mean, "--profile", ours).code == 0  # to look at
    assert polishd("map", "average", *good, "--out", mean, "--force").code == 0
    assert polishd("map", "commission", ours, mean).code == 0


@pytest.mark.full
def test_a_list_that_was_called_a_format_proves_nothing(polishd: Polishd, tmp_path: Path) -> None:
    """``--format`` is to look: commission reads a file as what it is, and it does not say its unit."""
    ours, path = profile(tmp_path / "p.toml"), tmp_path / "list.dat"
    rows = [f"{x * PITCH_MM} {y * PITCH_MM} {nm}" for (y, x), nm in np.ndenumerate(artefact()) if np.isfinite(nm)]
    path.write_text("\n".join(rows) + "\n")
    assert polishd("map", path, "--format", "xyz").code == 0
    said = polishd("map", "commission", ours, path)
    assert said.code == 8
    assert "--format xyz" in said.err
    named = path.rename(path.with_suffix(".xyz"))
    said = polishd("map", "commission", ours, named)
    assert said.code == 8
    assert "its file does not say its" in said.err
    assert "unit" in said.err
    assert "commissioned" not in ours.read_text()
    assert polishd("map", "convert", named, tmp_path / "new.dat").code == 8


def test_no_artefact_and_a_symmetric_one(polishd: Polishd, tmp_path: Path, good: Path) -> None:
    said = polishd("map", "commission", profile(tmp_path / "none.toml", bumps=()), good)
    assert said.code == 3
    assert "[artefact] is missing" in said.err
    round_one = profile(tmp_path / "round.toml", bumps=[(0.0, 0.0, 5.0, 5.0, 100.0)])
    said = polishd("map", "commission", round_one, good)
    assert said.code == 3
    assert str(round_one) in said.err
    assert "looks like itself" in said.err


@pytest.mark.full
def test_files_that_are_none(polishd: Polishd, tmp_path: Path, ours: Path, good: Path) -> None:
    for words, code in (
        ((tmp_path / "none.toml", good), 3),
        ((good, good), 3),
        ((ours, tmp_path / "none.dat"), 8),
        ((ours, tmp_path), 8),
        ((ours,), 2),
        ((ours, good, "--out", good), 3),
    ):
        said = polishd("map", "commission", *words)
        assert (said.code, said.out) == (code, ""), words
    assert "commissioned" not in ours.read_text()


@pytest.mark.full
def test_a_picture_that_cannot_be_written_proves_nothing(polishd: Polishd, ours: Path, good: Path) -> None:
    said = polishd("map", "commission", ours, good, "--out", ours.parent / "none" / "p.png")
    assert said.code == 3
    assert "commissioned" not in ours.read_text()
