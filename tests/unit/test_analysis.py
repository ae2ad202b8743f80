"""The researcher's module: each example of its page runs, and polishd itself has its names, late."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import polishd
from polishd import analysis
from polishd.model.errors import ConfigError

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "how-to" / "researcher.md").read_text()
EXAMPLES = re.findall(r"## ([^\n]+)\n(?:(?!## ).)*?```python\n(.*?)```", PAGE, re.DOTALL)
QUICK = ("Maps", "Spots", "Robots", "Dwell")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Beside the examples' files, a map."""
    for name in ("cell.toml", "sim.toml", "robustness.toml"):
        (tmp_path / name).write_text((ROOT / "examples" / name).read_text())
    np.save(tmp_path / "map.npy", np.random.default_rng(1).normal(0.0, 1.0, (40, 40)))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def runs(code: str, capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile(code, "docs/how-to/researcher.md", "exec"), {})  # it is our own page
    printed = capsys.readouterr().out.strip()
    assert printed
    assert "nan" not in re.findall(r"[a-z]+", printed.lower())


@pytest.mark.parametrize(("title", "code"), [one for one in EXAMPLES if one[0] in QUICK])
def test_an_example_runs(title: str, code: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    runs(code, capsys)


@pytest.mark.full
@pytest.mark.parametrize(("title", "code"), [one for one in EXAMPLES if one[0] not in QUICK])
def test_a_longer_example_runs(title: str, code: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    runs(code, capsys)


def test_the_page_has_all_and_each_is_short() -> None:
    assert [title for title, _ in EXAMPLES] == [
        "Maps", "Spots", "Robots", "Dwell", "A job in a closed loop", "Many of them",
    ]  # fmt: skip
    code = "".join(text for _, text in EXAMPLES)
    assert all(f"polishd.{name}" in code for name in analysis.__all__ if name[0].islower() and "tif" not in name[:8]
               and name not in {"measured_figures", "read_study"})  # fmt: skip
    assert all(len(text.strip().splitlines()) <= 9 for _, text in EXAMPLES)


@pytest.mark.full
def test_polishd_has_the_names_late() -> None:
    assert polishd.read_map is analysis.read_map
    with pytest.raises(AttributeError, match="no attribute 'read_mop'"):
        polishd.read_mop  # noqa: B018
    code = "import polishd, sys; assert 'numpy' not in sys.modules; polishd.spot_figures; assert 'numpy' in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.full
def test_a_verb_that_is_not_known_is_an_error_and_not_a_traceback() -> None:
    """It is looked for among the plugins' verbs, which imports modules of polishd by ``from polishd import``."""
    command = [sys.executable, "-m", "polishd", "polsh", "cell.toml"]
    said = subprocess.run(command, capture_output=True, text=True, check=False, env={**os.environ, "NO_COLOR": "1"})
    assert said.returncode == 2
    assert "No such command 'polsh'" in said.stderr
    assert "Traceback" not in said.stderr


def test_what_cannot_be_is_said(folder: Path) -> None:
    with pytest.raises(ConfigError, match=r"process\.forc_n: unknown key"):
        polishd.loop_job("cell.toml", "sim.toml", cell_with={"process.forc_n": 1.0})
    with pytest.raises(ConfigError, match=r"truth\.drft: unknown key"):
        polishd.loop_job("cell.toml", "sim.toml", plant_with={"hidden_truth": {"drft": 1.0}})
    with pytest.raises(ConfigError, match="is a single case"):
        polishd.run_study(ROOT / "examples" / "table_iii.toml")
