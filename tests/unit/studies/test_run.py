"""``polishd study``: JSON for programs, tables and sentences for people, pictures in a folder, one clear error."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from polishd.config.study import PassesStudy, load_study
from polishd.model.errors import ConfigError
from polishd.rendering.terminal import stdout
from polishd.studies.options import StudyOptions
from polishd.studies.output import passes_table
from polishd.studies.run import study_verb
from polishd.studies.spots import polish_evenly
from tests.unit.studies.studies import FIG_12, TABLE_III, TABLE_IV, line_of, small, variant

PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture(autouse=True)
def wide(monkeypatch: pytest.MonkeyPatch) -> None:
    """A terminal in which no table is cut."""
    monkeypatch.setattr(stdout, "_width", 200)


@pytest.fixture
def few_passes(tmp_path: Path) -> Path:
    return variant(tmp_path, FIG_12, ("aperture_mm = 200.0", "aperture_mm = 40.0"))


def test_corrections_as_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    study_verb(small(tmp_path), StudyOptions(), as_json=True)
    printed = capsys.readouterr()
    rows = json.loads(printed.out)
    corrections = ["none", "calibrated", "pointwise", "linear", "power", "exact"]
    assert [row["correction"] for row in rows] == 2 * corrections
    assert [row["plant"] for row in rows] == 6 * ["eq49"] + 6 * ["depth"]
    numbers = ("pv_nm", "rms_nm", "rms_piston_removed_nm", "band_rms_nm", "dwell_s", "wall_s")
    assert all(set(row) == {"plant", "correction", *numbers} for row in rows)
    assert all(np.isfinite(row[name]) and row[name] > 0 for row in rows for name in numbers)
    assert len(printed.out.splitlines()) == 1


@pytest.mark.full
def test_corrections_for_people(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    study_verb(small(tmp_path), StudyOptions(out=out), as_json=False)
    said = capsys.readouterr().out
    assert "plant eq. 49: R0 diag(gamma)" in said
    assert "plant depth: each point's spot at its own depth" in said
    assert "plant eq49: pointwise and linear tie, as they must" in said
    assert "plant depth: pointwise and linear tie here too" in said
    assert "the paper's Table IV has 0.343 for linear" in said
    for figures in (("none", "16.81", "5.62"), ("pointwise", "8.91", "4.95"), ("linear", "6.57", "1.93")):
        beside = [line for line in said.splitlines() if all(figure in line for figure in figures)]
        assert len(beside) == 2, "the paper's row beside ours, for both plants"
    assert "the solver's model is a sum of" in said
    assert f"written to {out}" in said


@pytest.mark.full
def test_out_gets_pictures_and_the_same_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "deep" / "out"
    study_verb(small(tmp_path), StudyOptions(out=out), as_json=True)
    pictures = {"setting.png", "residuals_eq49.png", "residuals_depth.png", "psd.png"}
    assert {path.name for path in out.iterdir()} == {*pictures, "table.json"}
    assert all((out / name).read_bytes().startswith(PNG) for name in pictures)
    assert json.loads((out / "table.json").read_text()) == json.loads(capsys.readouterr().out)


@pytest.mark.full
def test_spots_as_json_and_pictures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    study_verb(TABLE_III, StudyOptions(out=tmp_path), as_json=True)
    rows = json.loads(capsys.readouterr().out)
    assert [row["name"] for row in rows if row["size_is"] == "radius"] == list("123456")
    assert rows[0]["paper_jsd"] == 0.298
    assert {path.name for path in tmp_path.iterdir()} == {"profiles_radius.png", "profiles_diameter.png", "table.json"}


def test_spots_for_people(capsys: pytest.CaptureFixture[str]) -> None:
    study_verb(TABLE_III, StudyOptions(), as_json=False)
    said = capsys.readouterr().out
    assert "size = radius: no x profile is M-shaped; it needs (R - d) tan(dip) < a" in said
    assert "log base 2" in said
    row = next(line for line in said.splitlines() if "4.704" in line)
    assert "2.232" in row
    assert "0.206" in row


@pytest.mark.full
def test_passes_as_json_and_for_people(few_passes: Path, capsys: pytest.CaptureFixture[str]) -> None:
    study_verb(few_passes, StudyOptions(), as_json=True)
    (row,) = json.loads(capsys.readouterr().out)
    assert row["passes"] == 10
    assert row["slope"] == pytest.approx(1.5, abs=0.05)
    study_verb(few_passes, StudyOptions(out=few_passes.parent / "out"), as_json=False)
    said = capsys.readouterr().out
    assert f"PV {row['pv_nm']:.3f} nm" in said
    assert f"{row['slope']:.4f} (Hertz 1.5; eq. 48-49 take it for 1)" in said
    assert (few_passes.parent / "out" / "passes.png").read_bytes().startswith(PNG)


def test_a_table_of_passes_states_the_range_of_gamma(few_passes: Path) -> None:
    study = load_study(few_passes)
    assert isinstance(study, PassesStudy)
    passes = polish_evenly(study, lambda words: None)
    cells = list(passes_table(study, passes).columns[1].cells)
    assert cells[0] == "10 of 0.01 s at each point"
    assert str(cells[1]).startswith(f"{passes.gamma[passes.metric_mask].min():.4f} to ")


def test_a_map_is_read_by_the_cells_own_readers(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    no_map = (("rms_nm = 18.5", 'file = "map.dat"'), ("period_mm = [33.0, 120.0]", ""))
    path = variant(tmp_path, TABLE_IV, *no_map)
    for content, says in ((None, "cannot be read"), (b"", "the file is empty"), (b"no map", "no loaded reader knows")):
        if content is not None:
            (tmp_path / "map.dat").write_bytes(content)
        with pytest.raises(ConfigError) as caught:
            study_verb(path, StudyOptions(), as_json=True)
        said = str(caught.value)
        assert said.startswith(f"{path}:{line_of(path, 'file')}: surface.file: ")
        assert says in said
        assert "\n" not in said
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("force_n = 12.0", "force_nn = 12.0"), "process.force_nn: unknown key; did you mean 'force_n'?"),
        (('kind = "corrections"', 'kind = "tables"'), "kind: 'tables' is not allowed"),
        (("dip_deg = 15.0", "dip_deg = 90.0"), "process.dip_deg: 90.0 is out of range"),
        (
            ("force_n = 12.0", "force_n = 12.0\ntool_modulus_mpa = 2960.0"),
            "gamma would not be above 0",
        ),
    ],
)
def test_an_error_is_one_line_with_its_place(tmp_path: Path, change: tuple[str, str], says: str) -> None:
    path = small(tmp_path, change)
    out = tmp_path / "out"
    with pytest.raises(ConfigError) as caught:
        study_verb(path, StudyOptions(out=out), as_json=True)
    said = str(caught.value)
    assert said.startswith(f"{path}:")
    assert says in said
    assert "\n" not in said
    assert not out.exists() or not any(out.iterdir())


def test_a_folder_that_cannot_be_created_is_reported_before_anything_is_computed(tmp_path: Path) -> None:
    taken = tmp_path / "taken"
    taken.write_text("a file")
    with pytest.raises(ConfigError, match=r"taken: cannot create the folder: File exists"):
        study_verb(TABLE_IV, StudyOptions(out=taken), as_json=True)
