"""``polishd doctor --compile``: afterwards a large plan compiles nothing."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from polishd.cli.app import app
from polishd.commissioning import compile_ahead, doctor
from polishd.commissioning.rehearsal.simulated_cell import write_demo
from polishd.config.cell import load_config
from polishd.model.errors import DeviceError
from polishd.sim_backends.common.metropro import DatMap, pack

Patch = pytest.MonkeyPatch
FUNCTIONS = {"scan", "direct", "reciprocal", "splice", "_step", "_removal", "_adjoint", "_begin", "_advance"}


def kept(cache: Path) -> list[str]:
    """Name of each compiled version of a function."""
    return sorted(path.name.split("-")[0].rpartition(".")[2] for path in cache.rglob("*.nbc"))


def run(cache: Path, *words: str) -> str:
    environment = {**os.environ, "XDG_CACHE_HOME": str(cache)}
    command = [sys.executable, "-m", "polishd", *words]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout


def test_without_a_compiler_there_is_nothing_to_do(monkeypatch: Patch) -> None:
    monkeypatch.setattr(compile_ahead, "has_compiler", lambda: False)
    monkeypatch.setattr(doctor, "has_compiler", lambda: False)
    found = CliRunner().invoke(app, ["doctor", "--compile"])
    assert found.exit_code == 0
    assert "pip install 'polishd[fast]'" in found.output
    assert not list(doctor.compiled_rows())


def test_a_cache_that_cannot_be_written_is_an_error(tmp_path: Path, monkeypatch: Patch) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    with pytest.raises(DeviceError, match=r"compiled code cannot be kept: .*Set XDG_CACHE_HOME"):
        compile_ahead.compile_ahead()


def test_the_doctor_says_whether_it_was_done(tmp_path: Path, monkeypatch: Patch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    (row,) = doctor.compiled_rows()
    assert (row.state, row.todo) == ("ok", "To compile it now, run: polishd doctor --compile")
    for work in ("_rewrite_programs", "_solve_moving", "_solve_resting"):
        monkeypatch.setattr(compile_ahead, work, lambda: None)
    compile_ahead.compile_ahead()
    (row,) = doctor.compiled_rows()
    assert (row.found, row.todo) == ("compiled ahead for this user", "")
    monkeypatch.setattr("numba.__version__", "0")
    assert not compile_ahead.is_compiled_ahead()


@pytest.mark.full
def test_a_large_plan_then_compiles_nothing(tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    first = json.loads(run(cache, "doctor", "--compile", "--json"))
    assert first["functions"] == len(FUNCTIONS)
    assert kept(cache) == sorted(FUNCTIONS), "one version each: what a plan calls is of the same types"
    assert json.loads(run(cache, "doctor", "--compile", "--json"))["functions"] == 0

    cell, surface = large_cell(tmp_path)
    said = run(cache, "plan", str(cell), str(surface), "--out", str(tmp_path / "plan"))
    assert "no matrix: " in said, "the plan is to use the compiled products"
    assert kept(cache) == sorted(FUNCTIONS)


def large_cell(folder: Path) -> tuple[Path, Path]:
    """A cell with a spot of 13 mm on a part of 160 mm, and a map of the part."""
    demo = write_demo(folder / "demo", None, 2.0, 4, None)
    text = demo.cell.read_text()
    for old, new in (
        ("aperture_mm = 100.0", "aperture_mm = 160.0"),
        ("edge_mm = 3.0", "edge_mm = 12.0"),
        ("tool_radius_mm = 20.0", "tool_radius_mm = 400.0"),
        ("force_n = 12.0", "force_n = 30.0"),
        ("rpm = 1000.0", "rpm = 300.0"),
        ("[-90.0, 90.0]", "[-95.0, 95.0]"),
    ):
        assert old in text, old
        text = text.replace(old, new)
    demo.cell.write_text(text)
    program = load_config(demo.cell).program_path
    program.unlink()
    words = ("raster", "--cell", str(demo.cell), "--aperture", "circle:164", "--pitch", "1", "--step", "1")
    run(folder / "other", "program", "make", *words, "--out", str(program))
    at_mm = np.arange(-79.75, 80, 0.5)
    x, y = np.meshgrid(at_mm, at_mm)
    height = np.where(np.hypot(x, y) <= 80, 60 * np.cos(x / 20) * np.cos(y / 25), np.nan)
    surface = folder / "map.dat"
    surface.write_bytes(pack(DatMap(height, 0.5, part="DEMO-100")))
    return demo.cell, surface
