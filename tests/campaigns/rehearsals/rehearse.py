"""Try one example cell: make its program where it has none, rehearse it, and run it to the tolerance."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles
from polishd.config.cell import CellConfig, load_config
from tests.system.cell_rig import Daemon, events
from tests.system.sim_rig import ROOT
from tests.system.test_rehearsal import rehearsed

EXAMPLES = ROOT / "examples"
ACCEPTED = "in_tolerance"


@dataclass(frozen=True, slots=True)
class Finding:
    """Row of the table."""

    cell: str
    robot: str
    """Type of the job's robot."""
    language: str
    outcome: str
    passes: int
    first_nm: float | None
    """RMS of the first map; None without one."""
    last_nm: float | None
    true_nm: float | None
    """RMS of the simulated part at the end, from the plant."""
    duration_s: float
    reason: str
    tolerance_nm: float | None = None
    """RMS tolerance of the job; None where its tolerance is not an RMS alone."""

    @property
    def is_accepted(self) -> bool:
        """Whether the part is in tolerance."""
        return self.outcome == ACCEPTED


def cells(folder: Path = EXAMPLES) -> dict[str, Path]:
    """Return the example cells by their path in the folder: files with a robot and a state folder."""
    found = {}
    for path in sorted(folder.rglob("*.toml")):
        raw = tomllib.loads(path.read_text(encoding="utf-8"))
        if isinstance(raw.get("robot"), dict) and isinstance(raw.get("cell"), dict):
            found[path.relative_to(folder).as_posix()] = path
    return found


def measure(name: str, folder: Path) -> Finding:
    """Rehearse a copy of the example with that name in the folder. AssertionError with the output of what failed."""
    copy = folder / "examples"
    shutil.copytree(EXAMPLES, copy)
    cell = copy / name
    config = load_config(cell)
    if not config.program_path.exists():
        _polishd(cell.parent, "program", "make", "raster", "--cell", cell.name, "--out", config.program.path)
    with rehearsed(cell, "--seed", "1") as files, Daemon(files, "--no-hold") as daemon:
        daemon.process.wait()
        return finding(name, files, config)


def finding(name: str, files: DemoFiles, config: CellConfig) -> Finding:
    """Return the row of a rehearsal whose daemon has ended. AssertionError with its output without a summary."""
    summaries = [files.run_dir / "summary.json", *files.state_dir.glob("runs/*/summary.json")]
    written = [path for path in summaries if path.exists()]
    assert written, files.daemon_log.read_text()
    found, maps = json.loads(written[-1].read_text()), events(files, "measured")
    rms = [cycle["rms_nm"] for cycle in found["cycles"]]
    return Finding(
        name,
        str(config.devices[config.used["robot"]].type),
        config.program.format,
        str(found["outcome"]),
        max(len(rms) - 1, 0),
        rms[0] if rms else None,
        rms[-1] if rms else None,
        maps[-1]["true_rms_nm"] if maps else None,
        sum(found["phase_times_s"].values()),
        str(found["reason"]),
        config.job.tolerance_nm,
    )


def _polishd(folder: Path, *arguments: str) -> None:
    command = [sys.executable, "-m", "polishd", *arguments]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


COLUMNS: Mapping[str, int] = {
    "cell": 22, "robot": 16, "program": 8, "outcome": 13, "passes": 6, "RMS before, nm": 14, "after": 8, "true": 8,
    "time, s": 8,
}  # fmt: skip


def line(finding: Finding | None = None) -> str:
    """Return a row of the table as text; without a finding the head."""
    cells_of = [*COLUMNS]
    if finding is not None:
        figures = (finding.first_nm, finding.last_nm, finding.true_nm)
        numbers = ["-" if figure is None else f"{figure:.1f}" for figure in figures]
        cells_of = [finding.cell, finding.robot, finding.language, finding.outcome, str(finding.passes), *numbers]
        cells_of += [f"{finding.duration_s:.0f}"]
    text = "  ".join(cell.ljust(width) for cell, width in zip(cells_of, COLUMNS.values(), strict=True)).rstrip()
    return f"{text}  {finding.reason}" if finding is not None and finding.reason else text
