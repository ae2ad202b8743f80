"""Fits of the cell's numbers to measurements."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from rich.table import Table

from polishd.config.cell import CellConfig, load_config
from polishd.config.table_files import PLACE, read_columns, tif_bytes
from polishd.maps.map_files import MapSource
from polishd.model.errors import ComputeError, ConfigError, MapError
from polishd.model.process import HybridRobot, MeasuredCompliance, MeasuredTif, Projection, SerialRobot, ToolProcess
from polishd.process.metrology.instrument import require_complete
from polishd.process.removal.measured_tif import TifReport, preston_from_tif, tif_from_maps
from polishd.process.robot.calibration import LoadingTests, StiffnessFit, fit_doubts, fit_exponent, fit_stiffness
from polishd.rendering.terminal import emit, key_table, record_table, stderr
from polishd.util.files import write_together

# ``polishd calibrate``: fits to measurements, with their errors, written as fragments that a cell includes.

AXIS = ("axis_x", "axis_y", "axis_z")
DIRECTION = ("dir_x", "dir_y", "dir_z")


@dataclass(frozen=True, slots=True)
class LoadingFiles:
    """Loading tests, those that are only predicted, and what a test measured."""

    tests: Path
    held_out: Path | None
    projection: Projection


def stiffness_verb(files: LoadingFiles, cell: Path | None, out: Path | None, *, anyway: bool, as_json: bool) -> None:
    """Fit the robot's stiffnesses to loading tests; nothing doubtful is written unless ``anyway``."""
    _require_toml(out)
    tests = _loading_tests(files.tests)
    unseen = None if files.held_out is None else _loading_tests(files.held_out)
    try:
        fit = fit_stiffness(_elastic_robot(cell), tests, projection=files.projection, hold_out=unseen)
    except ComputeError as error:
        raise ComputeError(f"{files.tests}: {error}") from error
    doubtful = fit_doubts(fit, tests)
    if out is not None and doubtful and not anyway:
        raise ComputeError(f"{files.tests}: {'; '.join(doubtful)}; nothing was written (--anyway writes it)")
    if out is not None:
        what = f"stiffnesses fitted to {files.tests.name}" + "".join(f"; DOUBTFUL: {doubt}" for doubt in doubtful)
        _write_fragment(out, "kinematics", _stiffness_keys(fit.robot, fit), what)
    answer = {
        "stiffnesses": fit.stiffnesses,
        "fitted": fit.fitted,
        "cross_validated": fit.cross_validated,
        "held_out": fit.held_out,
        "doubts": doubtful,
    }
    _emit(answer, out, as_json=as_json, table=lambda: _stiffness_table(fit), lines=[*_error_lines(fit), *fit.notes])
    for doubt in doubtful:
        stderr.print(f"DO NOT BELIEVE THIS: {doubt}", style="red", markup=False, soft_wrap=True)


def _error_lines(fit: StiffnessFit[Any]) -> list[str]:
    """The paper's own figures: mean and largest absolute percentage error (4.19 and 6.38 % in its fig. 10)."""
    known = {
        "on the tests": fit.fitted,
        "cross-validated": fit.cross_validated,
        "on the held-out tests": fit.held_out,
    }
    return [
        f"error {where}: mean {found.mean_percent:.2f} %, largest {found.max_percent:.2f} % ({found.tests} tests)"
        for where, found in known.items()
        if found is not None
    ]


def _elastic_robot(cell: Path | None) -> Any:
    if cell is None:
        return HybridRobot()
    config = load_config(cell)
    robot = config.robot_model()
    if isinstance(robot, MeasuredCompliance):
        raise config.error("kinematics.type", "'measured': a table has no stiffness to fit; mend the table itself")
    return robot


def _loading_tests(path: Path) -> LoadingTests:
    columns = read_columns(path, (*PLACE, *AXIS, *DIRECTION, "compliance_um_per_n"))
    tip, axis, direction = (np.column_stack([columns[name] for name in names]) for names in (PLACE, AXIS, DIRECTION))
    return LoadingTests(tip, axis, direction, columns["compliance_um_per_n"])


def _stiffness_keys(robot: HybridRobot | SerialRobot, fit: StiffnessFit[Any]) -> dict[str, str]:
    """The keys of [kinematics] that were determined, as TOML; a serial arm's stiffnesses are one list."""
    if isinstance(robot, SerialRobot):
        values = ", ".join(f"{value:.6g}" for value in robot.joint_stiffness_n_mm_per_rad)
        return {"joint_stiffness_n_mm_per_rad": f"[{values}]"}
    changed = [stiffness for stiffness in fit.stiffnesses if stiffness.value != stiffness.given]
    return {
        item.name: f"{item.value:.6g}" + (f"  # +- {100 * item.sigma:.2g} %" if item.determined else "  # held")
        for item in changed
    }


def _stiffness_table(fit: StiffnessFit[Any]) -> Table:
    rows = [
        (
            item.name,
            f"{item.given:.4g}",
            f"{item.value:.4g}",
            f"{100 * item.sigma:.2g} %" if item.determined else "not determined",
            f"{item.low:.4g} to {item.high:.4g}",
            item.unit,
        )
        for item in fit.stiffnesses
    ]
    return record_table("stiffnesses", ("key", "given", "fitted", "1 sigma", "of all starts", "unit"), rows)


@dataclass(frozen=True, slots=True)
class SpotPlace:
    """How a measured spot was made."""

    depth_ratio: float
    azimuth_deg: float
    radius_mm: float | None


def tif_verb(
    maps: tuple[Path, Path],
    seconds: float,
    cell: Path | None,
    place: SpotPlace,
    out: Path | None,
    *,
    profile: Path | None = None,
    as_json: bool,
) -> None:
    """Make a measured TIF of two maps, and the Preston constant that goes with it."""
    _require_toml(out)
    config = None if cell is None else load_config(cell)
    process = ToolProcess() if config is None else config.tool_process()
    source = MapSource.of(cell, profile)
    tif, report = tif_of_maps(source, maps, seconds, place)
    preston = preston_from_tif(process, place.depth_ratio, tif)
    if out is not None:
        _write_tif_fragment(out, config, tif, preston, f"a spot of {seconds:g} s, {maps[0].name} to {maps[1].name}")
    answer = {**asdict(report), "preston_cm2_per_n": preston, "read_by": source.options}
    table = key_table("measured TIF", _tif_rows(answer))
    _emit(answer, out, as_json=as_json, table=lambda: table, lines=[source.read_by])


def tif_of_maps(
    source: MapSource, maps: tuple[Path, Path], seconds: float, place: SpotPlace
) -> tuple[MeasuredTif, TifReport]:
    """The TIF of a spot, and how well it was measured; MapError or ComputeError where the maps show none."""
    before, after = (source.read(path) for path in maps)
    for path, found in zip(maps, (before, after), strict=True):
        if found.pitch_mm is None:
            raise MapError(f"{path}: has no lateral scale; export it with one")
        if source.instrument is not None:
            require_complete(found, source.instrument)
    if before.pitch_mm != after.pitch_mm or before.height_nm.shape != after.height_nm.shape:
        raise MapError(f"{maps[1]}: has not the samples of {maps[0].name}; measure both with the same setting")
    return tif_from_maps(before.height_nm, after.height_nm, before.grid.pitch_mm, seconds, **asdict(place))


def _tif_rows(answer: Mapping[str, Any]) -> list[tuple[str, str]]:
    x, y = answer["centroid_mm"]
    return [
        ("volume", f"{answer['volume_mm3_min']:.4g} mm3/min"),
        ("peak", f"{answer['peak_nm_s']:.4g} nm/s"),
        ("FWHM", f"{answer['fwhm_mm']:.3f} mm"),
        ("rim", f"{answer['rim_mm']:.3f} mm from the centre"),
        ("noise", f"{answer['noise_nm_s']:.3g} nm/s a sample"),
        ("cleaning changed the volume by", f"{100 * answer['volume_change']:.2f} % (put back)"),
        ("centroid", f"{x:.3f}, {y:.3f} mm from the map's centre"),
        ("Preston constant", f"{answer['preston_cm2_per_n']:.4g} cm2/N, at which the model removes as much"),
    ]


def _write_tif_fragment(out: Path, config: CellConfig | None, tif: MeasuredTif, preston: float, what: str) -> None:
    """The fragment, and the TIF beside it, named as seen from the cell's folder."""
    spot = out.with_suffix(".npz")
    name = spot.name if config is None else config.relative(spot)
    keys = {"removal_model": '"measured_tif"', "tif": f'"{name}"', "preston": f'"{preston:.5g} cm2/N"'}
    _write_fragment(out, "process", keys, what, {spot.name: tif_bytes(tif)})


def exponent_verb(spots: Path, out: Path | None, *, as_json: bool) -> None:
    """Fit the exponent with which volume goes with depth."""
    _require_toml(out)
    columns = read_columns(spots, ("depth_ratio", "volume_mm3_min"))
    fit = fit_exponent(columns["depth_ratio"], columns["volume_mm3_min"])
    if out is not None:
        line = f"{fit.exponent:.4g}  # +- {fit.uncertainty:.2g}"
        _write_fragment(out, "process", {"depth_exponent": line}, f"fitted to {spots.name}")
    rows = [
        ("exponent", f"{fit.exponent:.3f} +- {fit.uncertainty:.3f} (Hertz: 1.5; the paper's linear gamma: 1)"),
        ("error", f"mean {fit.errors.mean_percent:.2f} %, largest {fit.errors.max_percent:.2f} %"),
    ]
    _emit(asdict(fit), out, as_json=as_json, table=lambda: key_table("gamma's exponent", rows))


def _require_toml(out: Path | None) -> None:
    if out is not None and out.suffix != ".toml":
        raise ConfigError(f"{out}: a fragment is a TOML file; name it *.toml")


def _write_fragment(
    path: Path, section: str, keys: Mapping[str, str], what: str, beside: Mapping[str, bytes] = MappingProxyType({})
) -> None:
    """TOML that a cell's ``include`` takes: what was found, and from what; with the files that it names, or nothing."""
    if not keys:
        raise ConfigError(f"{path}: nothing to write: the measurements determine nothing new")
    when = datetime.now(UTC).isoformat(timespec="seconds")
    lines = [f"# polishd calibrate, {when}: {what}", f"[{section}]", *(f"{k} = {v}" for k, v in keys.items())]
    try:
        write_together(path.parent, {**beside, path.name: ("\n".join(lines) + "\n").encode()})
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}; name another file with --out") from error


def _emit(
    answer: Mapping[str, Any], out: Path | None, *, as_json: bool, table: Callable[[], Table], lines: Sequence[str] = ()
) -> None:
    """What was found, and where the fragment is."""
    written = [] if out is None else [f'written to {out}; the cell takes it with include = ["{out.name}"]']
    result = {**answer, "fragment": None if out is None else str(out)}
    emit(result, as_json=as_json, table=table, lines=[*lines, *written])
