"""A small simulated cell whose robot's controller loads files."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from polishd.config.cell import load_config
from polishd.config.controller_profile import FOLDER
from polishd.console.demo_files import DemoFiles, demo_program
from polishd.console.simulator import simulated_cell
from tests.system.cell_rig import with_keys, write_small

OVERHEAD_S = 0.03
"""What a block costs that controller: nobody planned it before the first pass."""


def write_files(out: Path, kind: str, profile: str, aperture_mm: float, **job: Any) -> DemoFiles:
    """The demo's files with a small part and such a controller; ``robot_link`` for the same cell with that."""
    files = write_small(out, **job)
    part = {"aperture_mm": aperture_mm}
    cell, sim = files.cell.read_text(), files.sim.read_text()
    truth = {"overhead_s": OVERHEAD_S, "overhead_spread": 0.5}
    robot: dict[str, Any] = {}
    if kind != "link":
        text = (FOLDER / f"{profile}.toml").read_text()
        (out / "controller.toml").write_text(text.replace("watchdog_s = 8.0", "watchdog_s = 20.0\nsilence_s = 6.0"))
        robot = {"kind": kind, "watchdog_s": 20.0, "report_ms": 20.0}
        address = load_config(files.cell).robot.model_dump()["address"].replace("tcp://", "opc.tcp://")
        keys = {"type": "handover", "profile": "controller.toml", "address": address, "delivery": "folder:sim/programs"}
        head, _, rest = cell.partition("[robot]")
        lines = "\n".join(f"{key} = {json.dumps(value)}" for key, value in keys.items())
        cell = f"{head}[robot]\n{lines}\n\n[{rest.partition(chr(10) + '[')[2]}"
        cell = cell.replace('load = ["rnc_robot"', 'load = ["rnc_robot", "handover"')
    cell = with_keys(cell, {"part": part, "limits": {"pit_nm": 60.0}})
    files.cell.write_text(cell)
    files.sim.write_text(with_keys(sim, {"plant": part, "robot": robot, "truth": truth}))
    config = load_config(files.cell)
    config.program_path.write_bytes(demo_program(config))
    return files


@contextlib.contextmanager
def running(files: DemoFiles, speed: float) -> Iterator[DemoFiles]:
    """The simulator of those files."""
    options = ["--state", str(files.sim_dir), "--seed", "1", "--speed", f"{speed:g}"]
    with simulated_cell(files.sim, options, files.out / "sim.stderr"):
        yield files
