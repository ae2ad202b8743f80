"""Set up a small simulated cell with a TP program of dwells on a FANUC controller with RMI, in real time only."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles, free_port, simulated_cell
from polishd.config.cell import CellConfig
from polishd.process.frames import angles_from_axis
from polishd.programs.make import own_path
from polishd.sim_backends.fanuc_rmi.controller import turns_of
from tests.system.cell_rig import with_faults, with_keys, with_part, write_small

PART = {"aperture_mm": 12.0, "edge_mm": 1.0}
RIMMED = {"aperture_mm": 12.0, "edge_mm": 2.0}
"""Room for a touch-off on the rim."""
POINTS_MM = 3.0
DWELL_S = 1.8
FEED_MM_S = 20
SAFE_Z_MM = 20.0
QUICK = {
    "robot": {"silence_s": 2.0, "watchdog_s": 40.0},
    "actuator": {"silence_s": 0.8, "watchdog_ms": 1200, "retract_s": 2.0},
    "machine": {"max_feed_mm_s": float(FEED_MM_S), "least_point_s": 1.5},
    "job": {"stream_ahead_s": 4.5},
    "limits": {
        "max_removal_nm": 3000.0,
        "min_improvement": 0.0,
    },  # few points, far apart: their ripple is no matter here
}
"""A lift by the actuator's watchdog takes 3.4 s; three points of 1.5 s have a margin for a busy computer."""


def write_files(out: Path, *faults: dict[str, Any], part: dict[str, float] = PART, **job: Any) -> DemoFiles:
    """Write the demo's files with a small part, that robot, and a program with a dwell at each point."""
    files = write_small(out, **job)
    take(files)
    with_part(files, part, tp_program, pv_nm=300.0, rms_nm=60.0)
    files.sim.write_text(with_faults(files.sim.read_text(), *({"device": "robot", **fault} for fault in faults)))
    return files


def take(files: DemoFiles) -> None:
    """Replace the cell's robot with such a controller."""
    port = free_port()
    cell = files.cell.read_text().replace('type = "robot_link"', 'type = "fanuc_rmi"')
    robot = {"address": f"tcp://127.0.0.1:{port}", **QUICK["robot"]}
    cell = with_keys(cell, {**QUICK, "robot": robot}).replace('format = "rs274"', 'format = "fanuc-tp"')
    files.cell.write_text(cell.replace('path = "program.rnc"', 'path = "program.ls"'))
    simulated = {"robot": {"kind": "fanuc_rmi", "port": port}, "actuator": {"lift_s": 0.5}}
    files.sim.write_text(with_keys(files.sim.read_text(), simulated))


def tp_program(config: CellConfig, points_mm: float = POINTS_MM, dwell_s: float = DWELL_S) -> bytes:
    """Return the points as a TP program: over the first point, down, a wait after each move, up."""
    points, axes = own_path(config, points_mm)
    turns = [turns_of(float(a), float(c)) for a, c in np.stack(angles_from_axis(axes), axis=1)]
    above = [*points[0][:2], points[0][2] + SAFE_Z_MM], [*points[-1][:2], points[-1][2] + SAFE_Z_MM]
    places = [(above[0], turns[0]), *zip(points, turns, strict=True), (above[1], turns[-1])]
    body = ["UFRAME_NUM=1 ;", "UTOOL_NUM=1 ;", _linear(1), _linear(2)]
    for number in range(3, len(places)):
        body += [_linear(number), f"  WAIT {dwell_s:6.2f}(sec) ;"]
    body.append(_linear(len(places)))
    lines = ["/PROG  POLISH", "/ATTR", 'COMMENT\t\t= "polishd" ;', "/MN"]
    lines += [f"{number:4d}:{statement}" for number, statement in enumerate(body, 1)]
    lines += ["/POS", *(line for number, place in enumerate(places, 1) for line in _position(number, *place)), "/END"]
    return "".join(f"{line}\n" for line in lines).encode()


def _linear(number: int) -> str:
    return f"L P[{number}] {FEED_MM_S}mm/sec FINE    ;"


def _position(number: int, xyz: Sequence[float], wpr: Sequence[float]) -> list[str]:
    x, y, z = (f"{float(value):.4f}" for value in xyz)
    w, p, r = (f"{value:.5f}" for value in wpr)
    return [
        f"P[{number}]{{",
        "   GP1:",
        "\tUF : 1, UT : 1,\t\tCONFIG : 'N U T, 0, 0, 0',",
        f"\tX = {x} mm,\tY = {y} mm,\tZ = {z} mm,",
        f"\tW = {w} deg,\tP = {p} deg,\tR = {r} deg",
        "};",
    ]


@contextlib.contextmanager
def dwell_cell(out: Path, *faults: dict[str, Any], part: dict[str, float] = PART, **job: Any) -> Iterator[DemoFiles]:
    """Run the simulator of these files for the duration of the block."""
    files = write_files(out, *faults, part=part, **job)
    options = ["--state", str(files.sim_dir), "--seed", "1", "--speed", "1"]
    with simulated_cell(files.sim, options, files.out / "sim.stderr"):
        yield files
