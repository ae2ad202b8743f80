"""Set up a small simulated cell with a dwell program in RAPID on an ABB controller."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles, free_port, simulated_cell
from polishd.config.cell import CellConfig
from polishd.process.frames import angles_from_axis
from polishd.programs.make import own_path
from polishd.sim_backends.universal_robots.arm import from_wrist
from tests.system.cell_rig import with_faults, with_keys, with_part, write_small
from tests.system.universal_robots_rig import DWELL_S, PART, POINTS_MM, SAFE_Z_MM

SPEED = 20


def write_files(out: Path, *, version: str = "1.0", cut_s: float = 0.0, **job: Any) -> DemoFiles:
    """Write the demo's files with a small part, that robot, and a program with a dwell at each point.

    ``cut_s``: the robot's link is cut every so often.
    """
    files = write_small(out, **job)
    keys = {"address": f"tcp://127.0.0.1:{free_port()}", "version": version, "silence_s": 3.0, "watchdog_s": 20.0}
    cell = files.cell.read_text().replace('type = "robot_link"', 'type = "abb_rws"')
    cell = with_keys(cell, {"robot": keys}).replace('format = "rs274"', 'format = "rapid"')
    files.cell.write_text(cell)
    cut = {"device": "robot", "what": "unplug", "every_s": cut_s}
    files.sim.write_text(with_faults(files.sim.read_text(), *([cut] if cut_s else [])))
    with_part(files, PART, module, pv_nm=500.0, rms_nm=100.0)
    return files


def module(config: CellConfig) -> bytes:
    """Return the points as RAPID: over the first point, down, a dwell after each move, up."""
    points, axes = own_path(config, POINTS_MM)
    turns = [from_wrist(float(a), float(c)) for a, c in np.stack(angles_from_axis(axes), axis=1)]
    moves = [_move(point, turn) for point, turn in zip(points, turns, strict=True)]
    above, over = ([*points[at][:2], points[at][2] + SAFE_Z_MM] for at in (0, -1))
    lines = ["MODULE part", "  PROC main()", "    ! posted", _move(above, turns[0]), moves[0]]
    for move in moves[1:]:
        lines += [move, f"    WaitTime {DWELL_S:.3f};"]
    return "\n".join([*lines, _move(over, turns[-1]), "  ENDPROC", "ENDMODULE", ""]).encode()


def _move(point: Any, turn: Any) -> str:
    xyz = ",".join(f"{float(value):.4f}" for value in point)
    orient = ",".join(f"{float(value):.7f}" for value in turn)
    return f"    MoveL [[{xyz}],[{orient}],[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]],v{SPEED},fine,tool0\\WObj:=wobj0;"


@contextlib.contextmanager
def dwell_cell(out: Path, *, speed: float = 4.0, **job: Any) -> Iterator[DemoFiles]:
    """Run the simulator of these files for the duration of the block."""
    files = write_files(out, **job)
    options = ["--state", str(files.sim_dir), "--seed", "1", "--speed", f"{speed:g}"]
    with simulated_cell(files.sim, options, files.out / "sim.stderr"):
        yield files
