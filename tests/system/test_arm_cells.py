"""Cells with arms that are drawn at random: `polishd check` and the rehearsed robot judge alike what is reached."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles
from polishd.sim_backends.common.mechanics import Screws
from tests.system.cell_rig import Daemon, events, summary, with_keys, with_part, write_small
from tests.system.test_rehearsal import rehearsed
from tests.time_limits import SOON_S
from tests.unit.process.robot.arms import arm_cell

pytestmark = [pytest.mark.system, pytest.mark.slow]

STIFF = [4e8, 4e8, 3e8, 2e8, 2e8, 2e8]
"""An arm that an ordinary bonnet does not bend out of contact."""
PART = {"aperture_mm": 14.0, "edge_mm": 1.0}


def write_files(out: Path, seed: int, *, is_opposed: bool = False) -> DemoFiles:
    """The demo's cell with a random arm, and a small part where that arm's part lies.

    ``is_opposed``: at home the flange's x is exactly opposite to ``flange_x``, where a single start once stalled.
    """
    drawn = arm_cell(seed)
    arm = drawn.robot
    kinematics: dict[str, Any] = {
        "type": "serial",
        "dh": arm.dh,
        "convention": arm.convention,
        "joint_stiffness_n_mm_per_rad": STIFF,
        "joint_limits_deg": arm.joint_limits_deg,
        "home_deg": arm.home_deg,
        "tool_length_mm": arm.tool_length_mm,
        "flange_x": (-Screws.of(arm).flange[:, 0]).tolist() if is_opposed else arm.flange_x,
    }
    files = write_small(out, tolerance_nm=40.0, max_cycles=1)
    lies = {"origin_mm": drawn.origin_mm, "rotation_rpy_deg": drawn.rotation_rpy_deg}
    files.cell.write_text(with_keys(files.cell.read_text(), {"kinematics": kinematics, "part": lies}))
    with_part(files, PART)
    return files


def checked(cell: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "polishd", "check", str(cell), "--json"]
    return subprocess.run(command, capture_output=True, text=True, timeout=SOON_S, check=False)


@pytest.mark.parametrize(("seed", "is_opposed"), [(2, False), (36, False), (12, True)])
def test_what_check_says_is_reached_the_rehearsed_arm_runs_along(tmp_path: Path, seed: int, is_opposed: bool) -> None:
    """An arm of each kind, each with another ``flange_x`` and home."""
    real = write_files(tmp_path / "cell", seed, is_opposed=is_opposed)
    said = checked(real.cell)
    assert said.returncode == 0, said.stderr
    assert json.loads(said.stdout)["reach"].startswith("all ")
    with rehearsed(real.cell, "--speed", "10") as files, Daemon(files, "--no-hold") as daemon:
        assert daemon.wait() == 0, daemon.output.read_text()
    assert len(events(files, "blocks")) > 0
    assert summary(files)["outcome"] in {"in_tolerance", "cycles_used"}
