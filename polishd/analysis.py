"""What a researcher computes with, in one place: maps, spots, robots, dwell, jobs in a closed loop, studies.

Each name is also polishd's own: ``polishd.read_map("map.dat")``. Examples: docs/researcher.md. Plugins and drivers have
`polishd.api` instead.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from polishd.config.cell import CellConfig, load_config
from polishd.config.study import LoopStudy
from polishd.config.sweep import SweepStudy, load_swept
from polishd.config.table_files import read_tif
from polishd.config.toml_loader import TomlSource
from polishd.model.errors import ConfigError
from polishd.model.process import (
    ComplianceOptions,
    HybridRobot,
    MeasuredCompliance,
    MeasuredTif,
    Optic,
    Placement,
    SerialRobot,
    ToolProcess,
)
from polishd.model.surface import Grid, SurfaceMap
from polishd.process.dwell.from_arrays import DwellCase, dwell_from_arrays
from polishd.process.removal.measured_tif import measured_figures, spot_figures
from polishd.process.robot.compliance import compliance_field
from polishd.studies.case_runner import closed_loop
from polishd.studies.case_runner import read as _read
from polishd.studies.cases import CaseFactory
from polishd.studies.closed_loop import ClosedLoopResult
from polishd.studies.options import StudyOptions
from polishd.studies.plant_client import PlantProcess
from polishd.studies.result_store import Rows, read_table
from polishd.studies.run import run_cases
from polishd.studies.summary import Summary, summarise

__all__ = [
    "CellConfig",
    "ClosedLoopResult",
    "ComplianceOptions",
    "DwellCase",
    "Grid",
    "HybridRobot",
    "MeasuredCompliance",
    "MeasuredTif",
    "Optic",
    "Placement",
    "SerialRobot",
    "Summary",
    "SurfaceMap",
    "ToolProcess",
    "compliance_field",
    "dwell_from_arrays",
    "loop_job",
    "measured_figures",
    "read_cell",
    "read_map",
    "read_study",
    "read_tif",
    "run_study",
    "spot_figures",
    "summarise",
]

_JOB = "job"
_ONE = "nothing"


def read_map(path: str | Path) -> SurfaceMap:
    """A map in any format that a cell reads: (ny, nx) heights in nm, positive high, row 0 the top, NaN where no data.

    SurfaceError where it cannot be read.
    """
    return _read(Path(path))


def read_cell(path: str | Path, overrides: Mapping[str, Any] | None = None) -> CellConfig:
    """A cell's file; ``overrides`` are values by dotted key, as ``{"process.force_n": 10.0}``. ConfigError.

    Its ``robot_model()``, ``tool_process()``, ``placement()`` and ``compliance_options()`` are what the functions here
    take.
    """
    return load_config(Path(path), overrides)


def loop_job(
    cell: str | Path,
    plant: str | Path,
    seed: int = 1,
    *,
    cell_with: Mapping[str, Any] | None = None,
    plant_with: Mapping[str, Mapping[str, Any]] | None = None,
    passes: int = 6,
    raster: bool = True,
) -> ClosedLoopResult:
    """One job in a closed loop, from its first map to its end, against a simulated plant in a process of its own.

    Args:
        cell: the cell's file.
        plant: the plant's, as the simulator reads it (SIM.toml).
        seed: what all that the plant hides is drawn from.
        cell_with: what differs from the cell's file, by dotted key; also ``witness``, ``poses`` and ``learns`` of a
            study's loop.
        plant_with: what differs from the plant's, by section and key.
        passes: most of them.
        raster: take a raster of one's own, instead of the cell's program.

    Returns:
        What the loop saw, and what was true, nm RMS after each pass.

    Raises:
        ConfigError: a file or a key is wrong. ProgramError: the cell's program is.
    """
    raw = {
        "kind": "loop",
        "title": _JOB,
        "cell": str(Path(cell).absolute()),
        "plant": str(Path(plant).absolute()),
        "controllers": {_JOB: dict(cell_with or {})},
        "plant_with": {name: dict(keys) for name, keys in (plant_with or {}).items()},
        "passes": passes,
        "raster": raster,
    }
    study = LoopStudy.of(raw, TomlSource("loop_job", ""))
    making = CaseFactory(SweepStudy(Path(cell), raw, study.source, ({},), is_sweep=False))
    making.config(study, _JOB)
    making.check_plant(study, _ONE)
    with PlantProcess() as machine:
        return closed_loop(study, _JOB).run(machine, making.plant(study, _ONE), _ONE, _JOB, seed)


def run_study(
    study: str | Path,
    out: str | Path | None = None,
    *,
    limit: int | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
) -> Rows:
    """The rows of a study of many cases (a ``[sweep]``, or loops), as ``polishd study`` computes them.

    Args:
        study: its file.
        out: folder in which cases are kept, and from which they go on.
        limit: the first so many cases.
        workers: processes of this machine; None: one a core.
        scheduler: a Dask scheduler's address instead, as ``tcp://HOST:PORT``.

    Returns:
        A row a case, in their order: the columns are those of docs/studies.md.

    Raises:
        ConfigError: a case cannot be, or nobody computes it; nothing was computed.
    """
    folder = None if out is None else Path(out)
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    swept = load_swept(Path(study))
    if not swept.is_sweep and swept.raw["kind"] != "loop":
        raise ConfigError(f'{study}: is one case; give it a [sweep], or run it with "polishd study"')
    return run_cases(swept, StudyOptions(folder, limit, workers, scheduler)).rows


def read_study(folder: str | Path) -> tuple[Rows, dict[str, Any]]:
    """The rows that a study has left in its folder, ended or not, and its file's values. ConfigError."""
    rows, text = read_table(Path(folder))
    return rows, tomllib.loads(text)
