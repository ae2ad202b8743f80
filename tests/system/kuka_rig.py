"""Set up a small simulated cell with a dwell program on a KUKA controller."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles, free_port, simulated_cell
from polishd.config.cell import CellConfig
from polishd.process.frames import angles_from_axis
from polishd.programs.make import own_path
from polishd.sim_backends.kuka_kvp.controller import to_abc
from polishd.sim_backends.universal_robots.arm import from_wrist
from tests.system.cell_rig import PATIENT, with_faults, with_keys, with_part, without, write_small

PART = {"aperture_mm": 14.0, "edge_mm": 1.0}
POINTS_MM = 1.0
DWELL_S = 0.1
FEED_MM_S = 20.0
SAFE_Z_MM = 20.0


def write_files(
    out: Path, *, cut_s: float = 0.0, watchdog_s: float = 20.0, part: Mapping[str, float] = PART, **job: Any
) -> DemoFiles:
    """Write the demo's files with a small part, that robot, and a program with a dwell at each point.

    ``cut_s``: the robot's link is cut after so long in contact.
    """
    files = write_small(out, **job)
    take(files, watchdog_s=watchdog_s, cut_s=cut_s)
    with_part(files, part, module, pv_nm=500.0, rms_nm=100.0)
    return files


def take(files: DemoFiles, *, watchdog_s: float = 20.0, cut_s: float = 0.0) -> None:
    """Replace the cell's robot with such a controller."""
    keys = {
        "type": "kuka_kvp",
        "address": f"tcp://127.0.0.1:{free_port()}",
        "delivery": "folder:sim/programs",
        "poll_ms": 5.0,
        "silence_s": 3.0,
        "watchdog_s": watchdog_s,
        "no_progress_s": PATIENT["robot"]["no_progress_s"],
    }
    section = "\n".join(["[robot]", *(f"{key} = {json.dumps(value)}" for key, value in keys.items())])
    cell = without(files.cell.read_text(), "robot").replace('format = "rs274"', 'format = "krl"')
    files.cell.write_text(f"{cell}\n{section}\n")
    cut = {"device": "robot", "what": "unplug", "contact_s": cut_s}
    files.sim.write_text(with_faults(with_keys(files.sim.read_text(), {}), *([cut] if cut_s else [])))


def module(config: CellConfig) -> bytes:
    """Return the points as KRL: over the first point, down, a wait after each move, up."""
    points, axes = own_path(config, POINTS_MM)
    turns = [to_abc(from_wrist(float(a), float(c))) for a, c in np.stack(angles_from_axis(axes), axis=1)]
    moves = [_lin(point, turn) for point, turn in zip(points, turns, strict=True)]
    above, over = ([*points[at][:2], points[at][2] + SAFE_Z_MM] for at in (0, -1))
    lines = [b"&ACCESS RVP", b"DEF polish( )", b";FOLD posted", b"$TOOL=TOOL_DATA[1]", b"$BASE=BASE_DATA[1]"]
    lines += [b"$VEL.CP=%.4f" % (FEED_MM_S / 1e3)]
    lines += [_lin(above, turns[0]), moves[0]]
    for move in moves[1:]:
        lines += [move, b"WAIT SEC %.3f" % DWELL_S]
    return b"\n".join([*lines, _lin(over, turns[-1]), b";ENDFOLD", b"END", b""])


def _lin(point: Any, turn: Any) -> bytes:
    pairs = zip("XYZABC", [*(float(part) for part in point), *turn], strict=True)
    return f"LIN {{{', '.join(f'{axis} {value:.4f}' for axis, value in pairs)}}}".encode()


@contextlib.contextmanager
def dwell_cell(out: Path, *, speed: float = 4.0, **job: Any) -> Iterator[DemoFiles]:
    """Run the simulator of these files for the duration of the block."""
    files = write_files(out, **job)
    options = ["--state", str(files.sim_dir), "--seed", "1", "--speed", f"{speed:g}"]
    with simulated_cell(files.sim, options, files.out / "sim.stderr"):
        yield files
