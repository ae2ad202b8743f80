"""docs/tutorials/rehearsed-cell.md: its answers and commands as written, from an empty folder and a map."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.patience import SOON_S
from tests.unit.maps.maps import dat

pytestmark = [pytest.mark.system, pytest.mark.full]

PAGE = (Path(__file__).parents[2] / "docs" / "tutorials" / "rehearsed-cell.md").read_text()
MOST_TO_A_PLAN = 6


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


def commands() -> list[list[str]]:
    """Of all blocks, in their order."""
    return [line.split() for block in blocks("sh") for line in block.splitlines()]


def measured(path: Path) -> None:
    """A mirror of 150 mm with two hills."""
    at = (np.arange(301) - 150) * 0.5
    x, y = np.meshgrid(at, -at)
    hills = 60 * np.exp(-((x - 30) ** 2 + (y - 18) ** 2) / 700) + 45 * np.exp(-((x + 25) ** 2 + (y + 20) ** 2) / 900)
    dat(path, np.where(np.hypot(x, y) <= 75, hills, np.nan), pitch_mm=0.5, part="MIRROR-150")


def test_its_commands_lead_to_a_plan_and_to_a_simulator_of_that_cell(tmp_path: Path) -> None:
    (tmp_path / "answers.toml").write_text(blocks("toml")[0])
    measured(tmp_path / "part.dat")
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    told: dict[str, str] = {}
    for command in commands():
        if command[1] == "rehearse":
            _simulate(command, tmp_path, path)
            continue
        env = {**os.environ, "PATH": path}
        done = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True, check=False)
        assert done.returncode == 0, (command, done.stderr)
        told[command[1]] = done.stdout
    verbs = [command[1] for command in commands()]
    assert verbs.index("plan") < MOST_TO_A_PLAN
    assert verbs[verbs.index("plan") + 1] == "rehearse"
    (cycle,) = json.loads((tmp_path / "cell" / "plan" / "summary.json").read_text())["cycles"]
    assert cycle["predicted_rms_nm"] < cycle["rms_nm"] / 10
    assert "[x] plan: " in told["init"]
    assert "[x] check: " in told["init"]
    assert "[ ] run: no run has ended" in told["init"]


def _simulate(command: list[str], folder: Path, path: str) -> None:
    """Until it is ready to be rehearsed with."""
    env = {**os.environ, "PATH": path}
    with subprocess.Popen(command, cwd=folder, env=env, stdout=subprocess.PIPE, text=True) as simulator:
        try:
            assert simulator.stdout is not None
            assert any(line.startswith("READY") for line in simulator.stdout)
        finally:
            simulator.terminate()
            simulator.communicate(timeout=SOON_S)
    assert (folder / "cell" / "cell-rehearsal" / "cell-rehearsal.toml").is_file()
