"""``polishd map compare``: known reductions come back, over the samples that both maps have."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polishd.maps.compare import paired
from polishd.model.errors import MapError
from polishd.model.surface import SurfaceMap
from polishd.rendering.terminal import stdout
from tests.unit.cli_result import Polishd
from tests.unit.maps.maps import dat, surface

PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture(autouse=True)
def wide(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stdout, "_width", 160)


@pytest.fixture
def before(tmp_path: Path) -> Path:
    return dat(tmp_path / "before.dat", 40 * surface())


def written(path: Path, height_nm: Any, **options: Any) -> Path:
    return dat(path, np.asarray(height_nm, dtype=np.float64), **options)


def test_a_quarter_of_everything_is_left(polishd: Polishd, before: Path) -> None:
    after = written(before.with_name("after.dat"), 10 * surface() + 55)
    answer = polishd("map", "compare", before, after, "--json", "--bands", "10,2").answer
    change = answer["change_percent"]
    assert set(change) == {"pv", "rms", "pv_tilt_removed", "rms_tilt_removed", "LSF", "MSF", "HSF"}
    assert list(change.values()) == pytest.approx([-75.0] * 7, abs=0.01)
    inside = surface()[np.isfinite(surface())]
    assert answer["before"]["rms_nm"] == pytest.approx(40 * inside.std(), rel=1e-5)
    assert answer["after"]["pv_nm"] == pytest.approx(10 * np.ptp(inside), rel=1e-5)
    assert answer["difference_rms_nm"] == pytest.approx(30 * inside.std(), rel=1e-5)
    assert answer["samples"] == inside.size
    assert answer["notes"] == []


def test_one_band_only(polishd: Polishd, before: Path) -> None:
    """A ripple that goes: its band falls, the long periods stay."""
    rows, columns = np.indices((80, 80))
    ripple, bowl = 20 * np.sin(2 * np.pi * columns / 8), 0.01 * ((rows - 40) ** 2 + (columns - 40) ** 2)
    first, second = (
        written(before.with_name(name), bowl + part * ripple) for name, part in (("a.dat", 1), ("b.dat", 0.1))
    )
    answer = polishd("map", "compare", first, second, "--json", "--bands", "10,2").answer
    change, psd = answer["change_percent"], answer["psd"]
    assert change["MSF"] == pytest.approx(-90.0, abs=1.0)
    assert abs(change["LSF"]) < 10
    peak = int(np.argmin(np.abs(np.array(psd["frequency_per_mm"]) - 1 / 4)))  # 8 pixels of 0.5 mm
    assert 0.005 < psd["after_nm2_mm2"][peak] / psd["before_nm2_mm2"][peak] < 0.02
    assert np.argmax(psd["before_nm2_mm2"][2:]) + 2 == peak


def test_what_rose_is_positive(polishd: Polishd, before: Path) -> None:
    after = written(before.with_name("after.dat"), 60 * surface())
    answer = polishd("map", "compare", before, after, "--json").answer
    assert answer["change_percent"]["rms"] == pytest.approx(50.0, abs=0.01)
    assert answer["change_percent"]["HSF"] is None


def test_over_what_both_have(polishd: Polishd, before: Path) -> None:
    """A spike where the other map has a hole counts in neither."""
    after = 10 * surface()
    after[30, 24] = np.nan
    spiked = 40 * surface()
    spiked[30, 24] += 1e5
    answer = polishd(
        "map", "compare", written(before, spiked), written(before.with_name("after.dat"), after), "--json"
    ).answer
    both = np.isfinite(after)
    assert answer["samples"] == np.count_nonzero(both)
    assert answer["before"]["pv_nm"] == pytest.approx(np.ptp(40 * surface()[both]), rel=1e-5)
    assert answer["change_percent"]["rms"] == pytest.approx(-75.0, abs=0.01)


def test_trimmed(polishd: Polishd, before: Path) -> None:
    after = written(before.with_name("after.dat"), 10 * surface())
    whole, trimmed = (polishd("map", "compare", before, after, "--json", "--trim", n).answer for n in (0, 3))
    assert trimmed["samples"] < whole["samples"]
    assert trimmed["trim"] == 3
    said = polishd("map", "compare", before, after, "--trim", 200)
    assert said.code == 8
    assert "trim" in said.err


def smooth(n: int, pitch_mm: float) -> Any:
    at = (np.arange(n) - (n - 1) / 2) * pitch_mm
    return 50 * np.exp(-((at[None, :] - 3) ** 2 + (at[:, None] + 2) ** 2) / 60)


def test_other_grids_are_brought_onto_the_coarser(polishd: Polishd, tmp_path: Path) -> None:
    """The same surface at half the pitch, and a little larger: its figures are the same within the averaging."""
    fine = written(tmp_path / "fine.dat", smooth(124, 0.25), pitch_mm=0.25)
    coarse = written(tmp_path / "coarse.dat", smooth(60, 0.5) / 5, pitch_mm=0.5)
    for pair in ((fine, coarse), (coarse, fine)):
        answer = polishd("map", "compare", *pair, "--json").answer
        assert (answer["rows"], answer["cols"], answer["pitch_mm"]) == (60, 60, pytest.approx(0.5, rel=1e-6))
        assert any("resampled" in note for note in answer["notes"])
        expected = -80.0 if pair[0] is fine else 400.0
        assert answer["change_percent"]["rms"] == pytest.approx(expected, rel=1e-2)
    assert "note: resampled" in polishd("map", "compare", fine, coarse).out


def test_another_part_is_refused(polishd: Polishd, tmp_path: Path) -> None:
    left, right = np.full((2, 40, 40), np.nan)
    left[:, :22] = np.arange(40)[:, None]
    right[:, 18:] = np.arange(40)[:, None]
    said = polishd("map", "compare", written(tmp_path / "l.dat", left), written(tmp_path / "r.dat", right))
    assert said.code == 8
    assert "shares only 160 samples" in said.err


def test_two_parts_names_are_noted(polishd: Polishd, before: Path) -> None:
    after = written(before.with_name("after.dat"), surface(), part="blank-8")
    notes = polishd("map", "compare", before, after, "--json").answer["notes"]
    assert notes == ["the maps name two parts: blank-7, blank-8"]


def test_without_a_scale(polishd: Polishd, before: Path) -> None:
    """Samples of one shape compare; bands need a pitch, and one map's serves both."""
    bare = written(before.with_name("bare.dat"), 10 * surface(), pitch_mm=0.0)
    answer = polishd("map", "compare", bare, bare, "--json").answer
    assert (answer["pitch_mm"], answer["before"]["bands"]) == (None, None)
    assert answer["change_percent"]["rms"] == 0
    assert answer["psd"] is None
    answer = polishd("map", "compare", before, bare, "--json").answer
    assert answer["pitch_mm"] == pytest.approx(0.5, rel=1e-7)
    assert any("no lateral scale" in note for note in answer["notes"])
    other = written(before.with_name("other.dat"), surface(rows=50), pitch_mm=0.0)
    said = polishd("map", "compare", before, other)
    assert said.code == 8
    assert "no lateral scale" in said.err


def test_what_only_one_map_says_is_noted() -> None:
    one = SurfaceMap(surface(), 0.5, unsaid=frozenset({"unit"}))
    assert paired(one, SurfaceMap(surface(), 0.5)).notes == ("only one of the maps says its unit",)
    assert paired(one, one).notes == ()


def test_no_data_in_common() -> None:
    empty = SurfaceMap(np.full((60, 48), np.nan), 0.5)
    with pytest.raises(MapError, match="shares only 0"):
        paired(empty, SurfaceMap(surface(), 0.5))


def test_for_people(polishd: Polishd, before: Path) -> None:
    after = written(before.with_name("after.dat"), 10 * surface())
    said = polishd("map", "compare", before, after)
    assert said.code == 0
    assert "before.dat to after.dat" in said.out
    assert said.out.count("-75.00") >= 4
    assert "MSF RMS" in said.out


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize("pitch_mm", [0.5, 0.0])
def test_it_is_drawn(polishd: Polishd, tmp_path: Path, pitch_mm: float) -> None:
    out = tmp_path / "c.png"
    maps = [written(tmp_path / f"{k}.dat", k * surface(), pitch_mm=pitch_mm) for k in (4, 1)]
    assert polishd("map", "compare", *maps, "--out", out).code == 0
    assert out.read_bytes().startswith(PNG)
    assert out.stat().st_size > 20_000


def test_a_bad_map_of_the_two(polishd: Polishd, before: Path) -> None:
    said = polishd("map", "compare", before, before.with_name("none.dat"), "--json")
    assert said.failure == 8
    assert "none.dat" in said.err
    assert polishd("map", "compare", before).code == 2
    assert polishd("map", "compare", before, before, "--out", before).code == 3
