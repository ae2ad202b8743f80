"""A part that is not round: planned from its map by its own outline, and polished by a simulated cell."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles, demo_program, simulated_cell
from polishd.config.cell import load_config
from polishd.config.simulator import load_simulator
from polishd.model.surface import Grid
from polishd.sim_backends.common.metropro import DatMap, pack
from polishd.sim_backends.plant import part as plant_part
from tests.commissioned import forged
from tests.system.cell_rig import Daemon, events, summary, write_small
from tests.time_limits import SOON_S

pytestmark = pytest.mark.system

OUTLINES = {
    "rectangle": ("rectangle_mm = [40.0, 24.0]", 40 * 24, (50, 34)),
    "hexagon": ("hexagon_mm = 24.0", 24**2 * np.sqrt(3) / 2, (38, 34)),
    "ring": ("aperture_mm = 40.0\nhole_mm = 16.0", np.pi * (20**2 - 8**2), (50, 50)),
    "file": ('polygon_file = "corners.csv"', 26 * 30 - 10 * 12 / 2, (36, 40)),
}
"""Outlines by name: key of the cell file, area in mm^2, and half extent of the process grid along x and y in mm."""
CORNERS = "x_mm,y_mm\n13,15\n-13,15\n-13,-15\n3,-15\n13,-3\n"


def write_files(out: Path, name: str) -> DemoFiles:
    """Write the demo's cell with such a part, which the daemon locates in its maps by its outline."""
    files = write_small(out, touch_off=True, tolerance_nm=4.0, max_cycles=3)
    key = OUTLINES[name][0]
    (out / "corners.csv").write_text(CORNERS)
    text = files.cell.read_text()
    assert text.count("\naperture_mm = 30.0\n") == 1
    files.cell.write_text(text.replace("\naperture_mm = 30.0\n", f"\n{key}\n"))
    profile = files.profile.read_text()
    files.profile.write_text(profile.replace('by = "none"', 'by = "aperture"').partition("[commissioned]")[0])
    forged(files.profile)
    config = load_config(files.cell)
    config.program_path.write_bytes(demo_program(config))
    return files


def run(*words: object) -> None:
    """Run a command of ``polishd``, which must succeed, and return its output."""
    command = [sys.executable, "-m", "polishd", *map(str, words)]
    said = subprocess.run(command, check=False, capture_output=True, timeout=SOON_S)
    assert said.returncode == 0, said.stderr.decode()


def write_map(files: DemoFiles) -> Path:
    """Write a map of the simulated part that lies off the center of its frame."""
    plant = load_simulator(files.sim).plant
    seen = np.pad(plant_part.make(plant, 3).map_nm(), ((6, 3), (2, 8)), constant_values=np.nan)
    path = files.out / "before.dat"
    path.write_bytes(pack(DatMap(seen, plant.pitch_mm, part=plant.part_id, taken_s=1_760_000_000)))
    return path


@pytest.mark.full
@pytest.mark.parametrize("name", ["rectangle", "hexagon", "ring", "file"])
def test_it_is_planned_by_its_outline(tmp_path: Path, name: str) -> None:
    files = write_files(tmp_path / "cell", name)
    run("check", files.cell)
    out = tmp_path / "plan"
    config = load_config(files.cell)
    run("plan", files.cell, write_map(files), "--program", config.program_path, "--out", out)
    _, area_mm2, (nx, ny) = OUTLINES[name]
    with np.load(out / "surface.npz") as stored:
        solve, metric, pitch = stored["solve_mask"], stored["metric_mask"], float(stored["pitch_mm"])
    grid = Grid(*solve.shape, pitch)
    assert grid.nx * pitch == pytest.approx(nx, abs=2.0)
    assert grid.ny * pitch == pytest.approx(ny, abs=2.0)
    outline = config.outline()
    assert np.count_nonzero(solve) * pitch**2 == pytest.approx(area_mm2, rel=0.03)
    edge = config.part.edge_mm
    np.testing.assert_array_equal(metric & ~outline.contains(*grid.axes_mm, edge), np.zeros(grid.shape, dtype=bool))
    left_out = outline.contains(*grid.axes_mm, edge + 2 * pitch) & ~metric
    assert not left_out.any()
    planned = json.loads((out / "summary.json").read_text())
    (cycle,) = planned["cycles"]
    assert cycle["predicted_rms_nm"] < 0.5 * cycle["rms_nm"]
    assert not [note for note in planned["notes"] if "on the part" in note or "check will refuse" in note]


@pytest.mark.full
def test_it_is_polished_to_its_tolerance(tmp_path: Path) -> None:
    files = write_files(tmp_path / "cell", "rectangle")
    options = ["--state", str(files.sim_dir), "--seed", "1", "--speed", "10"]
    with simulated_cell(files.sim, options, files.out / "sim.stderr"):
        with Daemon(files, "--no-hold") as daemon:
            assert daemon.wait() == 0, daemon.output.read_text()
        end = summary(files)
        assert end["outcome"] == "in_tolerance"
        assert end["outline"] == "a rectangle of 40 x 24 mm"
        assert (files.run_dir / "cycle-00" / "touch_off.json").exists()
        assert end["cycles"][-1]["rms_nm"] == pytest.approx(events(files, "measured")[-1]["true_rms_nm"], abs=0.4)
