"""Analysis API for researchers: maps, spots, robots, dwell, closed-loop jobs, studies.

Each name is also a name of the package: ``polishd.read_map("map.dat")``. Examples:
docs/how-to/researcher.md. Plugins and drivers use `polishd.api` instead.
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
    """Read a map in any format of a cell: (ny, nx) heights in nm, positive high, row 0 the top, NaN for no data.

    SurfaceError if it cannot be read.
    """
    return _read(Path(path))


def read_cell(path: str | Path, overrides: Mapping[str, Any] | None = None) -> CellConfig:
    """Read a cell file; ``overrides`` are values by dotted key, as ``{"process.force_n": 10.0}``. ConfigError.

    Its ``robot_model()``, ``tool_process()``, ``placement()`` and ``compliance_options()`` are arguments of the
    functions here.
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
    """Run a job in a closed loop, from its first map to its end, against a simulated plant in a separate process.

    Args:
        cell: Cell file.
        plant: Plant file of the simulator (SIM.toml).
        seed: Seed of the plant's hidden values.
        cell_with: Overrides of the cell file, by dotted key; also ``witness``, ``poses`` and ``learns`` of a
            study's loop.
        plant_with: Overrides of the plant file, by section and key.
        passes: Largest number of passes.
        raster: Use a generated raster instead of the cell's program.

    Returns:
        Measured and true residual, nm RMS after each pass.

    Raises:
        ConfigError: A file or a key is wrong. ProgramError: The cell's program is wrong.
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
    """Compute a study of many cases (a ``[sweep]``, or loops), as ``polishd study`` does.

    Args:
        study: Study file.
        out: Folder that stores the cases, to continue an interrupted study.
        limit: Number of cases to compute, from the first.
        workers: Processes of this computer; None: one per core.
        scheduler: Address of a Dask scheduler instead, as ``tcp://HOST:PORT``.

    Returns:
        One row per case, in order, with the columns of docs/how-to/studies.md.

    Raises:
        ConfigError: A case is invalid, or no process computes it; nothing was computed.
    """
    folder = None if out is None else Path(out)
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    swept = load_swept(Path(study))
    if not swept.is_sweep and swept.raw["kind"] != "loop":
        raise ConfigError(f'{study}: is a single case. Add a [sweep], or run it with "polishd study".')
    return run_cases(swept, StudyOptions(folder, limit, workers, scheduler)).rows


def read_study(folder: str | Path) -> tuple[Rows, dict[str, Any]]:
    """Read the rows in a study's folder, complete or not, and the values of its file. ConfigError."""
    rows, text = read_table(Path(folder))
    return rows, tomllib.loads(text)
