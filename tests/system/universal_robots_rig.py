"""Set up a small simulated cell with a dwell program on a Universal Robots controller."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles, free_port, simulated_cell
from polishd.config.cell import CellConfig
from polishd.plugins.rnc_robot.formats import path_program
from polishd.process.frames import angles_from_axis
from polishd.programs.make import own_path
from polishd.sim_backends.universal_robots.arm import from_wrist, to_vector
from tests.system.cell_rig import with_faults, with_keys, with_part, write_small

PART = {"aperture_mm": 14.0, "edge_mm": 1.0}
POINTS_MM = 1.0
DWELL_S = 0.1
FEED_MM_S = 20.0
ACCEL_MM_S2 = 800.0
"""Acceleration of the cell's [machine], which a script contains for each move."""
SAFE_Z_MM = 20.0


def write_files(out: Path, *, cut_s: float = 0.0, watchdog_s: float = 20.0, **job: Any) -> DemoFiles:
    """Write the demo's files with a small part, that robot, and a program with a dwell at each point.

    ``cut_s``: the robot's link is cut that long after the tool lands.
    """
    files = write_small(out, **job)
    take(files, watchdog_s=watchdog_s, cut_s=cut_s)
    with_part(files, PART, script, pv_nm=500.0, rms_nm=100.0)
    return files


def take(files: DemoFiles, *, watchdog_s: float = 20.0, cut_s: float = 0.0, cycle_hz: int = 125) -> None:
    """Replace the cell's robot with a CB3 controller, which takes less CPU time than an e-Series with 500 Hz."""
    rtde, dashboard, primary = free_port(), free_port(), free_port()
    keys = {"address": f"tcp://127.0.0.1:{rtde}", "dashboard_port": dashboard, "primary_port": primary}
    cell = files.cell.read_text().replace('type = "robot_link"', 'type = "universal_robots"')
    cell = with_keys(cell, {"robot": {"silence_s": 3.0, "watchdog_s": watchdog_s, **keys}})
    cell = cell.replace('format = "rs274"', 'format = "urscript"')
    files.cell.write_text(cell)
    sim = with_keys(files.sim.read_text(), {"robot": {"cycle_hz": cycle_hz}})
    cut = {"device": "robot", "link": "rtde", "what": "unplug", "contact_s": cut_s}
    files.sim.write_text(with_faults(sim, *([cut] if cut_s else [])))


def nc(config: CellConfig) -> bytes:
    """Return the points as G-code, for another robot."""
    return path_program(*own_path(config, POINTS_MM), FEED_MM_S * 60.0, "dwells", encoding="dwell", dwell_s=DWELL_S)


def script(config: CellConfig) -> bytes:
    """Return the points as URScript: over the first point, down, a dwell after each move, up."""
    points, axes = own_path(config, POINTS_MM)
    vectors = [to_vector(from_wrist(float(a), float(c))) for a, c in np.stack(angles_from_axis(axes), axis=1)]
    moves = [_movel(point, turn) for point, turn in zip(points, vectors, strict=True)]
    above, over = ([*points[at][:2], points[at][2] + SAFE_Z_MM] for at in (0, -1))
    lines = [b"def polish():", b"  # posted", _movel(above, vectors[0]), moves[0]]
    for move in moves[1:]:
        lines += [move, b"  sleep(%.3f)" % DWELL_S]
    return b"\n".join([*lines, _movel(over, vectors[-1]), b"end", b"polish()", b""])


def _movel(point: Any, turn: Any) -> bytes:
    pose = ", ".join(f"{value:.6f}" for value in [*(float(part) / 1000.0 for part in point), *turn])
    return f"  movel(p[{pose}], a={ACCEL_MM_S2 / 1000.0:g}, v={FEED_MM_S / 1000.0:g}, r=0)".encode()


@contextlib.contextmanager
def dwell_cell(out: Path, *, speed: float = 4.0, **job: Any) -> Iterator[DemoFiles]:
    """Run the simulator of these files for the duration of the block."""
    files = write_files(out, **job)
    options = ["--state", str(files.sim_dir), "--seed", "1", "--speed", f"{speed:g}"]
    with simulated_cell(files.sim, options, files.out / "sim.stderr"):
        yield files
