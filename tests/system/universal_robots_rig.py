"""A small simulated cell with a dwell program, on a Universal Robots controller or on the robot link."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np

from polishd.config.cell import CellConfig, load_config
from polishd.console.demo_files import DemoFiles, free_port, with_values, write_demo
from polishd.console.simulator import simulated_cell
from polishd.model.surface import FloatArray
from polishd.plugins.rnc_robot.make import path_program
from polishd.process.frames import angles_from_axis
from polishd.process.paths.apertures import circle
from polishd.process.paths.raster import raster
from polishd.process.paths.wrist import tool_axes
from polishd.sim_backends.universal_robots.turning import from_wrist, to_vector
from tests.commissioned import forged
from tests.system.cell_rig import PATIENT, PATIENT_SIM, REPORT, with_faults, with_keys, without

PART = {"aperture_mm": 14.0, "edge_mm": 1.0}
PITCH_MM = 1.0
DWELL_S = 0.1
FEED_MM_S = 20.0
ACCEL_MM_S2 = 800.0
"""As the cell's [machine] says: a script writes out what its moves accelerate with."""
SAFE_Z_MM = 20.0
Kind = Literal["universal_robots", "robot_link"]


def write_files(out: Path, kind: Kind, *, cut_s: float = 0.0, watchdog_s: float = 20.0, **job: Any) -> DemoFiles:
    """The demo's files with a small part, that robot, and a program with a dwell at each point.

    ``cut_s``: the robot's links are cut every so often.
    """
    files = write_demo(out, None, 2.0, 4, None)
    cell = without(with_values(files.cell.read_text(), {"part": PART, "job": job}), "touch_off").replace(REPORT, "")
    sim = with_values(files.sim.read_text(), {"plant": {**PART, "pv_nm": 500.0, "rms_nm": 100.0}})
    cell, sim = with_keys(cell, PATIENT), with_keys(sim, PATIENT_SIM)
    if kind == "universal_robots":
        rtde, dashboard, primary = free_port(), free_port(), free_port()
        keys = {"address": f"tcp://127.0.0.1:{rtde}", "dashboard_port": dashboard, "primary_port": primary}
        cell = cell.replace('type = "robot_link"', 'type = "universal_robots"')
        cell = with_keys(cell, {"robot": {"silence_s": 3.0, "watchdog_s": watchdog_s, **keys}})
        cell = cell.replace('format = "rs274"', 'format = "urscript"').replace(
            '"rnc_robot", ', '"rnc_robot", "universal_robots", '
        )
        robot = {"kind": kind, "cycle_hz": 125, "port": rtde, "dashboard_port": dashboard, "primary_port": primary}
        cut = {"device": "robot", "link": "rtde", "what": "unplug", "every_s": cut_s}
        sim = with_faults(with_keys(sim, {"robot": robot}), *([cut] if cut_s else []))
    files.cell.write_text(cell)
    files.sim.write_text(sim)
    forged(files.profile)
    config = load_config(files.cell)
    points, axes = path_of(config)
    made = urscript(points, axes) if kind == "universal_robots" else nc(points, axes)
    config.program_path.write_bytes(made)
    return files


def path_of(config: CellConfig) -> tuple[FloatArray, FloatArray]:
    """(n, 3) points of a coarse raster, and the tool axes there."""
    points = raster(circle(config.part.aperture_mm), PITCH_MM, PITCH_MM)
    return points, tool_axes(
        points, config.optic(), config.process.dip_deg, config.compliance_options(), config.placement()
    )


def nc(points: FloatArray, axes: FloatArray) -> bytes:
    """As NC text."""
    return path_program(points, axes, FEED_MM_S * 60.0, "dwells", encoding="dwell", dwell_s=DWELL_S)


def urscript(points: FloatArray, axes: FloatArray) -> bytes:
    """As URScript: over the first point, down, a dwell behind each move, up."""
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
def dwell_cell(out: Path, kind: Kind, *, speed: float = 4.0, seed: int = 1, **job: Any) -> Iterator[DemoFiles]:
    """A running simulator for it."""
    files = write_files(out, kind, **job)
    options = ["--state", str(files.sim_dir), "--seed", str(seed), "--speed", f"{speed:g}"]
    with simulated_cell(files.sim, options, files.out / "sim.stderr"):
        yield files
