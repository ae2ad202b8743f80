"""Set up a small simulated cell whose robot is a real LinuxCNC, in a private network namespace."""

from __future__ import annotations

import contextlib
import json
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import pytest

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles
from polishd.config.cell import CellConfig, load_config
from polishd.plugins.rnc_robot.dialect import GcodeDialect, dialect
from polishd.plugins.rnc_robot.formats import path_program
from polishd.process.toolpath.apertures import over_outline, tool_axes
from polishd.process.toolpath.paths import raster
from polishd.sim_backends.linuxcnc.device import ISOLATE
from tests.system.cell_rig import Daemon, with_keys, with_part, write_small
from tests.system.sim_rig import ROOT, alive, wait_for
from tests.time_limits import SOON_S

PART = {"aperture_mm": 7.0, "edge_mm": 0.5}
"""A pass over it takes some seconds: LinuxCNC knows real time only."""
ON_RING = {"points_mm": [[0.0, 5.0], [-4.3, -2.5], [4.3, -2.5]]}
"""Points for the touch-off: the rim of the part is narrower than the tool's contact."""
DWELL_PITCH_MM = 1.75
Turns = Literal["tool", "table"]
TABLE = """extends = "rs274"
name = "table"
title = "LinuxCNC with xyzac-trt-kins"

[axes]
turns = "table"
rotary = ["AC"]
"""
"""The dialect of a machine whose A tilts a table and C turns it."""
RAPID_MM_MIN = 3000.0
LATE = {"limits": {"excess_nm": 50.0}}
"""Limit for tests that do not check time: on a busy machine a real controller is late by tenths of a second."""
QUICK_S = 2.5
"""Watchdog time of the robot: longer than the actuator takes to lift the tool."""
APART = (
    *("unshare", "--map-root-user", "--net", "sh", "-c"),
    *('ip link set lo up && exec setpriv --pdeathsig TERM "$@"', "sh"),
)
"""Prefix that runs a command in a network with loopback only; the command ends with its parent process."""
TOOLS = {"linuxcnc": "linuxcnc-uspace", "ip": "iproute2", "unshare": "util-linux", "nsenter": "util-linux"}
"""Programs that the rig needs, and the packages that they come from."""


def require_linuxcnc() -> None:
    """Skip where there is no LinuxCNC, or no namespaces to run it in."""
    for tool, package in TOOLS.items():
        if shutil.which(tool) is None:
            pytest.skip(f"{tool} is not installed (apt-get install {package})")
    tried = subprocess.run([*APART, *ISOLATE, "mount -t tmpfs none /tmp"], capture_output=True, text=True, check=False)
    if tried.returncode:
        pytest.skip(f"no namespaces here: {tried.stderr.strip()}")


class Cell:
    """Running simulator with commands that enter its network."""

    def __init__(self, files: DemoFiles, process: subprocess.Popen[str]) -> None:
        self.files = files
        self.process = process

    @property
    def inside(self) -> list[str]:
        """Prefix of a command that is to run in the cell's network."""
        return ["nsenter", "--preserve-credentials", "--user", "--net", "-t", str(self.process.pid)]

    def daemon(self) -> Daemon:
        """Start ``polishd run`` in the cell's network."""
        return _Daemon(self)

    def moves(self) -> dict[str, Any]:
        """Run ``linuxcnc_moves`` and return its results."""
        programs = str(self.files.sim_dir / "linuxcnc" / "nc")
        command = [*self.inside, sys.executable, "-m", "tests.system.linuxcnc_moves", str(_port(self.files)), programs]
        done = subprocess.run(command, capture_output=True, text=True, timeout=SOON_S, cwd=ROOT, check=False)
        assert done.returncode == 0, done.stderr
        return dict(json.loads(done.stdout))

    def linuxcncrsh(self, *lines: str) -> list[str]:
        """Log in, send these ``get NAME`` and return the answers, up to the line that begins with the last name."""
        talk = (
            "import socket,sys\n"
            "s=socket.create_connection(('127.0.0.1',int(sys.argv[1])))\n"
            "s.sendall(('\\r\\n'.join(['hello EMC test 1.0',*sys.argv[2:]])+'\\r\\n').encode())\n"
            "for line in s.makefile():\n"
            " sys.stdout.write(line)\n"
            " if line.strip().startswith(sys.argv[-1].split()[1].upper()): break\n"
        )
        command = [*self.inside, sys.executable, "-c", talk, str(_port(self.files)), *lines]
        said = subprocess.run(command, capture_output=True, text=True, check=True, timeout=SOON_S).stdout
        return said.split("\n")


class _Daemon(Daemon):
    def __init__(self, cell: Cell) -> None:
        self.files = cell.files
        self.output = cell.files.daemon_log
        with self.output.open("ab") as log:
            command = [*cell.inside, sys.executable, "-m", "polishd.cli.app", "run", str(cell.files.cell), "--json"]
            self.process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)


def write_files(out: Path, *, turns: Turns = "tool", touch_off: bool = False, **job: Any) -> DemoFiles:
    """Write the demo's files with a tiny part, LinuxCNC as the robot, and a program of dwells."""
    files = write_small(out, patient=False, touch_off=touch_off, **job)
    take(files, turns)
    files.cell.write_text(with_keys(files.cell.read_text(), LATE))
    if touch_off:
        files.cell.write_text(with_keys(files.cell.read_text(), {"touch_off": ON_RING}))
    with_part(files, PART, dwell_program, pv_nm=150.0, rms_nm=30.0)  # so high that dwells are long
    return files


def take(files: DemoFiles, turns: Turns = "tool") -> None:
    """Replace the cell's robot with LinuxCNC and use a quick actuator, because LinuxCNC runs in real time only."""
    (files.out / "table.toml").write_text(TABLE)
    robot = 'type = "linuxcnc"\nprogram_dir = "sim/linuxcnc/nc"\ncontroller_dir = "/mnt/nc"'
    cell = files.cell.read_text().replace('type = "robot_link"', robot)
    quick: dict[str, dict[str, Any]] = {
        "robot": {"watchdog_s": QUICK_S},
        "actuator": {"silence_s": 0.8, "retract_s": 0.5},
        "limits": {"min_improvement": 0.0},  # sparse points: their ripple does not matter
    }
    if turns == "table":
        quick["program"] = {"dialects": ["table.toml"], "format": "table"}
    files.cell.write_text(with_keys(cell, quick))
    coil = {"land_s": 0.1, "lift_s": 0.06, "stick_share": 0.0}
    robot_keys = {"rotary_axes_carry": turns}
    sim = with_keys(files.sim.read_text(), {"plant": {"speed": 1.0}, "actuator": coil, "robot": robot_keys})
    files.sim.write_text(sim)


def dwell_program(config: CellConfig) -> bytes:
    """Return a coarse raster with a dwell at each point, for the cell's dialect: the tool turns or the table."""
    points = raster(over_outline(config.outline()), DWELL_PITCH_MM, DWELL_PITCH_MM)
    axes = tool_axes(points, config.optic(), config.process.dip_deg, config.compliance_options(), config.placement())
    to = dialect(next(iter(config.dialect_paths), config.program.format))
    assert isinstance(to, GcodeDialect)
    return path_program(points, axes, RAPID_MM_MIN, "dwells", encoding="dwell", dwell_s=0.2, to=to)


@contextlib.contextmanager
def linuxcnc_cell(files: DemoFiles) -> Iterator[Cell]:
    """Run the simulator with LinuxCNC, switched on and homed, for the duration of the block."""
    require_linuxcnc()
    command = [*APART, sys.executable, "-m", "polishd.sim_backends", str(files.sim), "--state", str(files.sim_dir)]
    with (files.out / "sim.stderr").open("wb") as stderr:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=stderr, text=True)
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        assert line.startswith("READY"), (files.out / "sim.stderr").read_text() + _log(files)
        yield Cell(files, process)
    finally:
        process.terminate()
        process.wait(SOON_S)
        if process.stdout is not None:
            process.stdout.close()
        wait_for(lambda: not alive(process.pid), "the simulator's end")


def _log(files: DemoFiles) -> str:
    path = files.sim_dir / "linuxcnc" / "linuxcnc.log"
    return path.read_text() if path.exists() else ""


def _port(files: DemoFiles) -> int:
    return int(load_config(files.cell).robot.model_dump()["address"].rpartition(":")[2])
