"""docs/how-to/recipe.md: its example on the shipped cell with a smaller part gives what `polishd plan` does."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from polishd.pipeline import steps
from polishd.pipeline.run_folder import read_map
from polishd.plugin_loader import load_own
from tests.unit.daemon.small_job import as_map, small_map, small_text

ROOT = Path(__file__).parents[3]
(EXAMPLE,) = re.findall(
    r"^```python\n(.*?)^```", (ROOT / "docs" / "how-to" / "recipe.md").read_text(), re.DOTALL | re.MULTILINE
)
SMALLER = (
    ("aperture_mm = 100.0", "aperture_mm = 24.0"),
    ("edge_mm = 3.0", "edge_mm = 2.0"),
    ("grid_mm = 0.5", "grid_mm = 1.0"),
    ("tolerance_nm = 2.0", "tolerance_nm = 0.5"),
)
REMOVED = 0.9
"""Removal relative to the expected one."""


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cell, its program, a map, and another one that the example's own plan would lead to."""
    text = (ROOT / "examples" / "cell.toml").read_text()
    for old, new in SMALLER:
        assert old in text
        text = text.replace(old, new)
    (tmp_path / "cell.toml").write_text(text)
    (tmp_path / "program.rnc").write_bytes(small_text())
    write_map(tmp_path / "map.dat", small_map())
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write_map(path: Path, surface: Any) -> None:
    write = load_own().surface_readers()["metropro"].write
    assert write is not None
    path.write_bytes(write(surface))


@pytest.mark.full
def test_the_example_runs_and_learns(site: Path, capsys: pytest.CaptureFixture[str]) -> None:
    until_pass, after_pass = EXAMPLE.split("# after the pass", 1)
    names: dict[str, Any] = {}
    exec(compile(until_pass, "docs/how-to/recipe.md", "exec"), names)
    recipe, program, plan = names["recipe"], names["program"], names["plan"]
    assert (site / "next.rnc").read_bytes() == plan.program.text
    assert any("tool axis" in veto for veto in names["vetoes"]), "the small program states none"
    surface = read_map(site / "map.dat", load_own().surface_readers().values())
    removed = REMOVED * steps.effect_of(recipe, program, surface.grid).removal_nm(plan.expected_time_s)
    write_map(site / "after.dat", as_map(surface.height_nm - removed))
    exec(compile("# after the pass" + after_pass, "docs/how-to/recipe.md", "exec"), names)
    said = capsys.readouterr().out.splitlines()
    assert re.fullmatch(r"\d+\.\d\d nm RMS in the clear aperture", said[0])
    assert re.fullmatch(r"\d+ s leave \d+\.\d\d nm", said[1])
    assert names["taught"].believed.rate == pytest.approx(REMOVED, abs=0.03)
    assert re.fullmatch(r"the next map: \d+\.\d\d to \d+\.\d\d nm \(90 %\)", said[2])
    assert said[3].startswith("rate 0.")
    assert names["again"].dwell.certificate.predicted_rms_nm < names["after"].stats.rms_nm
