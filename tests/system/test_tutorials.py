"""The files and commands of docs/tutorials and docs/how-to/universal-robots.md, as written, in an empty folder."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from datetime import datetime
from pathlib import Path

import pytest

from tests.time_limits import SOON_S

pytestmark = [pytest.mark.system, pytest.mark.full]

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
TUTORIALS = DOCS / "tutorials"
MOST_CONCEPTS = 15
FENCE = re.compile(r"^```(\w+)(?: (\S+))?\n(.*?)^```", re.MULTILINE | re.DOTALL)


class Lesson:
    """A tutorial in a folder: its named files are there, and its commands can run."""

    def __init__(self, page: str, folder: Path) -> None:
        text = (DOCS / page).read_text(encoding="utf-8")
        self.folder, self.commands = folder, list[str]()
        for language, name, content in FENCE.findall(text):
            if name:
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                (folder / name).write_text(content)
            elif language == "sh":
                self.commands.append(content)
        self.env = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}

    def run(self, commands: str) -> str:
        """Run them in one shell, which ends at the first that fails; return what they print."""
        done = subprocess.run(
            ["bash", "-e", "-c", commands], cwd=self.folder, env=self.env, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, (commands, done.stdout[-2000:], done.stderr[-2000:])
        return done.stdout


def test_the_first_plan(tmp_path: Path) -> None:
    lesson = Lesson("tutorials/first-plan.md", tmp_path)
    lesson.run("".join(lesson.commands))
    (cycle,) = json.loads((tmp_path / "plan" / "summary.json").read_text())["cycles"]
    assert cycle["predicted_rms_nm"] < cycle["rms_nm"] / 10
    assert {"report.html", "program.rnc", "dwell.csv", "certificate.json"} <= {
        path.name for path in (tmp_path / "plan").iterdir()
    }


def test_the_first_plan_needs_few_concepts_and_defines_each() -> None:
    text = (TUTORIALS / "first-plan.md").read_text(encoding="utf-8")
    lesson, _, table = text.partition("## The words of this page")
    terms = re.findall(r"^\| (?!term\b|---)([^|]+?) \|", table, re.MULTILINE)
    assert 0 < len(terms) <= MOST_CONCEPTS
    for term in terms:
        names = [name.rstrip("s") for name in re.split(r", | \(|\)", term) if name]
        used = [name for name in names if re.search(rf"\b{re.escape(name)}", lesson, re.IGNORECASE)]
        assert used, f"{term} is defined, not used"


def test_the_rehearsed_cell(tmp_path: Path) -> None:
    lesson = Lesson("tutorials/rehearsed-cell.md", tmp_path)
    begin, rehearse, run, status = lesson.commands
    lesson.run(begin)
    command = rehearse.split()
    with subprocess.Popen(command, cwd=tmp_path, env=lesson.env, stdout=subprocess.PIPE, text=True) as simulator:
        try:
            assert simulator.stdout is not None
            assert any(line.startswith("READY") for line in simulator.stdout)
            lesson.run(run)
        finally:
            simulator.terminate()
            simulator.communicate(timeout=SOON_S)
    (summary,) = (tmp_path / "cell" / "cell-rehearsal" / "state" / "runs").glob("*/summary.json")
    assert json.loads(summary.read_text())["outcome"] == "in_tolerance"
    left = lesson.run(status)
    assert "[x] plan: " in left
    assert "[ ] run: no run has ended" in left


def test_the_plugin(tmp_path: Path) -> None:
    lesson = Lesson("tutorials/plugin.md", tmp_path)
    printed = lesson.run("".join(lesson.commands))
    listed, _, checked = printed.partition("checked, nothing was opened")
    assert "polishd-weekend" in listed
    assert "weekend, " in checked
    assert checked.rstrip().endswith("in_tolerance runs/1")
    names: dict[str, object] = {}
    exec((tmp_path / "weekend" / "polishd_weekend.py").read_text(), names)
    veto = names["polishd_check_plan"](None, None)  # type: ignore[operator]
    assert len(veto) == (datetime.now().astimezone().weekday() >= 5)


def test_a_cell_with_an_arm_of_universal_robots(tmp_path: Path) -> None:
    """As far as ``polishd check`` and the files of the rehearsal."""
    lesson = Lesson("how-to/universal-robots.md", tmp_path)
    checked = lesson.run("".join(lesson.commands))
    assert "program.script: 825 timed points" in checked
    assert "all 825 points" in checked
    assert (tmp_path / "cell" / "cell-rehearsal" / "sim.toml").exists()
    rehearsed = (tmp_path / "cell" / "cell-rehearsal" / "cell-rehearsal.toml").read_text()
    assert 'type = "universal_robots"' in rehearsed


def test_the_paper(tmp_path: Path) -> None:
    lesson = Lesson("tutorials/paper.md", tmp_path)
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    printed = lesson.run("".join(lesson.commands))
    assert "no x profile is M-shaped" in printed
    assert "1.5062" in printed
    rows = json.loads((tmp_path / "table_iv" / "table.json").read_text())
    rms = {(row["plant"], row["correction"]): row["rms_nm"] for row in rows}
    assert rms["eq49", "pointwise"] == pytest.approx(rms["eq49", "linear"], rel=1e-3)
    assert rms["depth", "linear"] / rms["depth", "none"] == pytest.approx(0.357, abs=1e-3)
    assert rms["depth", "exact"] < 0.01 * rms["depth", "none"]
    assert rms["depth", "calibrated"] < rms["depth", "linear"]
