"""A cell's plugins read maps wherever the cell is named, and are asked before polishd's own readers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polishd.commissioning.rehearsal.simulated_cell import with_values
from tests.unit.cli_result import Polishd

READER = """
import numpy as np

def sniff(head, path):
    return path.suffix == ".csv"

def read(path):
    return SurfaceMap(np.loadtxt(path, delimiter=",", skiprows=1), 0.5, "DEMO-100", path=path, format="acme")

@hookimpl
def polishd_surface_readers():
    return [SurfaceReader("acme", sniff, read, (".csv", ".dat"))]
"""
OWN = ["rnc_robot", "devices", "voice_coil", "interferometer", "removal_models", "dwell_solvers", "plan_checks"]


@pytest.fixture
def cell(tmp_path: Path, example: str, install: Callable[..., str]) -> Path:
    """The shipped example with a plugin more, named last, that reads tables of heights."""
    path = tmp_path / "cell.toml"
    path.write_text(with_values(example, {"plugins": {"load": [*OWN, install("acme", READER)]}}))
    return path


@pytest.fixture
def table(tmp_path: Path) -> Path:
    """Heights as a table of three columns: ``points`` of polishd's own would take it for a list of points."""
    path = tmp_path / "heights.csv"
    path.write_text("heights in nm\n1,2,3\n2,1,3\n3,2,1\n1,3,2\n")
    return path


def test_a_plugin_named_last_is_asked_first(polishd: Polishd, cell: Path) -> None:
    formats = polishd("map", "formats", "--json", "--cell", cell).answer["formats"]
    names = [answer["name"] for answer in formats]
    assert names[0] == "acme", names
    assert names[-2:] == ["points", "tail"]
    assert [answer["own"] for answer in formats] == [False] + [True] * (len(names) - 1)
    assert "a plugin of the cell" in polishd("map", "formats", "--cell", cell).out


@pytest.mark.full
def test_every_verb_reads_as_the_cell_does(polishd: Polishd, cell: Path, table: Path, tmp_path: Path) -> None:
    assert polishd("map", table, "--json", "--cell", cell).answer["format"] == "acme"
    compared = polishd("map", "compare", table, table, "--json", "--cell", cell).answer
    assert (compared["rows"], compared["cols"]) == (4, 3)
    converted = polishd("map", "convert", table, tmp_path / "out.x3p", "--json", "--cell", cell).answer
    assert (converted["format"], converted["out_format"]) == ("acme", "x3p")
    repeats = [table.with_name(f"heights{n}.csv") for n in range(3)]
    for n, repeat in enumerate(repeats):
        repeat.write_text(table.read_text().replace("heights", f"repeat {n}: heights"))
    averaged = polishd("map", "average", *repeats, "--json", "--cell", cell).answer
    assert averaged["samples"] == 12
    profile = tmp_path / "instrument.toml"
    profile.write_text((Path(__file__).parents[3] / "examples" / "instrument.toml").read_text())
    assert "artefact" in polishd("map", "commission", profile, table, "--cell", cell).err


def test_calibration_reads_as_the_cell_does(polishd: Polishd, cell: Path, tmp_path: Path) -> None:
    x = np.arange(-40, 41) * 0.5
    spot = 200.0 * np.exp(-(x[:, None] ** 2 + x**2) / 18)
    for name, height in (("before.csv", 0 * spot), ("after.csv", -spot)):
        rows = "\n".join(",".join(f"{value:.4f}" for value in row) for row in height)
        (tmp_path / name).write_text(f"heights in nm\n{rows}\n")
    said = polishd(
        "calibrate", "tif", tmp_path / "before.csv", tmp_path / "after.csv", "--seconds", 10, "--cell", cell, "--json"
    )
    assert said.answer["peak_nm_s"] == pytest.approx(20.0, rel=0.05)


@pytest.mark.full
def test_a_reader_that_fails_is_one_line_wherever_maps_are_read(polishd: Polishd, cell: Path, tmp_path: Path) -> None:
    (tmp_path / "odd.csv").write_text("heights in nm\n1,two,3\n")
    (tmp_path / "program.rnc").write_text("G21\n")
    plain = tmp_path / "plain.toml"
    plain.write_text(cell.read_text())
    cell.write_text(with_values(cell.read_text(), {"part": {"form": "odd.csv"}}))
    calls: list[tuple[int, tuple[Any, ...]]] = [
        (8, ("plan", plain, tmp_path / "odd.csv", "--program", tmp_path / "program.rnc", "--out", tmp_path / "out")),
        (8, ("map", tmp_path / "odd.csv", "--cell", plain)),
        (8, ("calibrate", "tif", tmp_path / "odd.csv", tmp_path / "odd.csv", "--seconds", 9, "--cell", plain)),
        (3, ("check", cell)),
    ]
    for code, words in calls:
        said = polishd(*words)
        assert said.code == code, words[0]
        (line,) = said.err.strip().splitlines()
        assert "odd.csv: the reader 'acme' failed: ValueError: could not convert string 'two'" in line
    assert "cell.toml:" in line
    assert "part.form" in line
