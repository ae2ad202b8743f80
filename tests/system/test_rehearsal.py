"""Rehearse a whole job: ``polishd rehearse`` of a cell, then ``polishd run`` with the file that it wrote."""

from __future__ import annotations

import contextlib
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles, demo_program
from polishd.config.cell import load_config
from polishd.config.table_files import tif_bytes
from polishd.model.process import MeasuredTif, ToolProcess
from polishd.process.removal import contact
from tests.system import abb_rig, kuka_rig, plc_robot_rig, universal_robots_rig
from tests.system.cell_rig import Daemon, events, summary, with_keys, write_small
from tests.system.test_daemon import require_safe_order
from tests.time_limits import SOON_S

pytestmark = [pytest.mark.system, pytest.mark.full]

MEASURED_AT = 0.87
"""Gamma at which the spot was measured."""
Maker = Callable[[Path], DemoFiles]


def lens(out: Path) -> DemoFiles:
    """Write the demo's cell with a small lens instead of its flat, another tool, and a measured spot."""
    files = write_small(out, tolerance_nm=4.0, max_cycles=3)
    part = {"id": "LENS-7", "aperture_mm": 24.0, "curvature_radius_mm": 150.0, "conic": -1.0}
    process = {"tool_radius_mm": 25.0, "preston": "2.2e-9 cm2/N", "removal_model": "measured_tif", "tif": "spot.npz"}
    files.cell.write_text(with_keys(files.cell.read_text(), {"part": part, "process": process}))
    write_spot(files.out / "spot.npz")
    config = load_config(files.cell)
    config.program_path.write_bytes(demo_program(config))
    return files


def write_spot(path: Path) -> None:
    """Return the spot of a 25 mm bonnet whose spindle leans upwards in the map."""
    process = ToolProcess(tool_radius_mm=25.0, preston_cm2_per_n=2.2e-9)
    at = (np.arange(49) - 24) * 0.1
    depth = MEASURED_AT * contact.hertz_depth_mm(process)
    rate = contact.removal_rate_nm_s(process, depth, at[None, :], -at[:, None])
    path.write_bytes(tif_bytes(MeasuredTif(np.asarray(rate), 0.1, azimuth_deg=90.0, depth_ratio=MEASURED_AT)))


def loads_files(out: Path) -> DemoFiles:
    """Write the cell with a controller that loads files, over OPC UA."""
    return plc_robot_rig.write_files(out, "opcua", 20.0, tolerance_nm=8.0, max_cycles=3)


def arm(out: Path) -> DemoFiles:
    """Write the cell with a Universal Robots arm."""
    return universal_robots_rig.write_files(out, tolerance_nm=40.0, max_cycles=3)


def abb(out: Path) -> DemoFiles:
    """Write the cell with an ABB controller with RobotWare 7."""
    return abb_rig.write_files(out, version="2.0", tolerance_nm=40.0, max_cycles=3)


def kuka(out: Path) -> DemoFiles:
    """Write the cell with a KUKA arm."""
    return kuka_rig.write_files(out, tolerance_nm=40.0, max_cycles=3)


def yaskawa(out: Path) -> DemoFiles:
    """Write the cell with a Yaskawa controller: INFORM jobs, each move with its wait."""
    return plc_robot_rig.write_language_cell(out, "inform", "dwell", tolerance_nm=40.0, max_cycles=3)


def yaskawa_hses(out: Path) -> DemoFiles:
    """Write the cell with a Yaskawa controller over HSES, which has no clock: it runs in real time."""
    return plc_robot_rig.write_language_cell(out, "inform over hses", "dwell", tolerance_nm=40.0, max_cycles=3)


def staubli(out: Path) -> DemoFiles:
    """Write the cell with a Staubli controller: VAL3 programs with speeds."""
    return plc_robot_rig.write_language_cell(out, "val3", "feed", tolerance_nm=40.0, max_cycles=3)


SPEEDS: dict[Maker, tuple[str, ...]] = {lens: ("--speed", "10")}
"""Options for cells that do not run at the usual speed."""


@contextlib.contextmanager
def rehearsed(cell: Path, *options: str) -> Iterator[DemoFiles]:
    """Rehearse a cell and run its simulator for the duration of the block."""
    command = [sys.executable, "-m", "polishd", "rehearse", str(cell), *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as simulator:
        try:
            assert simulator.stdout is not None
            assert any(line.startswith("READY") for line in simulator.stdout)
            files = DemoFiles(cell.parent / f"{cell.stem}-rehearsal")
            files.cell = files.out / f"{cell.stem}-rehearsal.toml"
            yield files
        finally:
            simulator.terminate()
            simulator.communicate(timeout=SOON_S)  # until all that it started is gone


@pytest.mark.parametrize(
    "make", [lens, loads_files, arm, abb, kuka, yaskawa, pytest.param(yaskawa_hses, marks=pytest.mark.slow), staubli]
)
def test_a_job_is_rehearsed_to_its_tolerance_and_the_real_cell_stays_as_it_was(tmp_path: Path, make: Maker) -> None:
    real = make(tmp_path / "cell")
    before = {path: path.read_bytes() for path in real.out.rglob("*") if path.is_file()}
    with rehearsed(real.cell, *SPEEDS.get(make, ())) as files:
        with Daemon(files, "--no-hold") as daemon:
            assert daemon.wait() == 0, daemon.output.read_text()
        require_safe_order(events(files))
    end = summary(files)
    assert end["outcome"] == "in_tolerance"
    true_nm = events(files, "measured")[-1]["true_rms_nm"]
    assert end["cycles"][-1]["rms_nm"] == pytest.approx(true_nm, abs=0.4)
    assert {path: path.read_bytes() for path in before} == before
    assert not real.state_dir.exists()
    assert not real.run_dir.exists()
