"""Families of paths against spots, lines and lags that differ from the model: the ripple that each leaves.

Each family's dwell is solved on the process grid within the machine's limits. The true removal is a direct sum on fine
cells: the tool's position every few milliseconds, each with the spot at that depth and lean.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy

from polishd.config.study import PathFamilySection, PathsStudy
from polishd.model.errors import ComputeError
from polishd.model.program import Envelope, Program, program_of_points
from polishd.model.surface import FloatArray, Grid
from polishd.process.dwell import newton_cg
from polishd.process.dwell.problem import DwellProblem
from polishd.process.dwell.quadratic import choose_piston_nm
from polishd.process.metrology.conditioning import ConditionedMap
from polishd.process.metrology.spectra import RadialPsd, radial_psd, split_bands
from polishd.process.removal.contact import contact_on_curved_part, hertz_depth_mm
from polishd.process.removal.dynamic_tif import CorrectedSpot, lean_azimuth_rad, tif_at_point
from polishd.process.removal.path_tif import SpotPath, levelled_axes
from polishd.process.removal.ripple import ActingSpots
from polishd.process.removal.ripple_forecast import ripple_of
from polishd.process.removal.spread_effect import WIDTH, damping, spline
from polishd.process.removal.tif import HertzSpot, Spot, WiderSpot
from polishd.process.removal.tif_family import blocks_of, reach_cells, windows
from polishd.process.robot import motion
from polishd.process.robot.compliance import depth_ratio, path_compliance
from polishd.process.toolpath.apertures import Aperture, largest_turn_deg, over_outline, tool_axes
from polishd.process.toolpath.bent_rasters import LineDensity, adaptive_raster, random_raster
from polishd.process.toolpath.paths import crossed_raster, raster, spiral
from polishd.studies.corrections import ProgressReport
from polishd.studies.scene import ReadMap, start_surface, study_grid

LANDING_MM = 6.0
SAMPLE_S = 0.005
"""Time between two positions of the true tool; 0.25 mm at 50 mm/s."""
SQUARES = 128
"""Squares across the true spot."""
RATIO_STEP, AZIMUTH_STEP = 0.002, np.radians(1.0)
"""True spots that differ by less share one window: a tenth of a percent of the radius."""
NOISE_MM = 10.0
"""Length of path over which the tool's distance from it is about the same."""
LINE_SHARE = 0.1
"""Half the width in which the line of a path is looked for, of its frequency."""
BACKGROUND = 1.5
"""The background of a ring is the median within this factor of its frequency."""
ROUNDS = 2
"""Solves with what acceleration delivers as the lower bound."""
SHOWN_MM = 14.0
"""Half the side of what the picture of the paths shows."""
PLAIN = "as modeled"


@dataclass(frozen=True, slots=True)
class PathRow:
    """A family with one disturbance; figures over the clear aperture."""

    family: str
    disturbance: str
    rms_nm: float
    low_nm: float
    """RMS of periods above the band of `msf_nm`."""
    msf_nm: float
    forecast_nm: float
    """Ripple that the plan forecasts, with a spot whose radius is off by up to 3 %."""
    convergence: float
    """Share of the start's low orders that is removed."""
    line_peak: float
    """Highest density of the rings within a tenth of 1 / pitch, over the median within a factor of 1.5."""
    highest_peak: float
    """The same of all rings in the band."""
    mean_removal_nm: float
    time_s: float
    path_mm: float
    acceleration_mm_s2: float
    """Largest one across the path, in the clear aperture: speed squared times curvature."""
    largest_turn_deg: float
    """Of the wrist in a move."""


@dataclass(frozen=True, slots=True)
class PathComparison:
    """All rows of a study, and what its pictures show."""

    rows: tuple[PathRow, ...]
    paths: Mapping[str, FloatArray] = field(repr=False)
    """(n, 3) points of the first pass by family."""
    spectra: Mapping[str, RadialPsd] = field(repr=False)
    """Of the residual with the last disturbance of the spot."""
    spectra_of: str
    nyquist_per_mm: float
    notes: tuple[str, ...]

    @property
    def shown_mm(self) -> tuple[float, float]:
        """Limits of a picture of the paths."""
        return -SHOWN_MM, SHOWN_MM

    def msf_ratio(self, row: PathRow) -> float:
        """Return the row's MSF over that of the first family with the same disturbance."""
        first = next(one for one in self.rows if one.disturbance == row.disturbance)
        return row.msf_nm / first.msf_nm


@dataclass(frozen=True, slots=True)
class _Disturbance:
    """What differs from the model."""

    name: str
    factor: float = 1.0
    """On the radius of the spot."""
    lag_s: float = 0.0
    noise_um: float = 0.0

    @property
    def is_of_spot(self) -> bool:
        return not self.lag_s and not self.noise_um


@dataclass(frozen=True, slots=True)
class _Path:
    """A family's path on the part, with what acts along it."""

    points: tuple[FloatArray, ...]
    """Of each pass, (n + 1, 3)."""
    path: SpotPath
    spots: CorrectedSpot
    largest_turn_deg: float

    @property
    def program(self) -> Program:
        return self.path.program


def compare_paths(study: PathsStudy, read: ReadMap, report_progress: ProgressReport) -> PathComparison:
    """Solve each family once, and remove with the true spots. ConfigError for invalid input."""
    start = start_surface(study, read)
    fine = study_grid(study, study.cell_mm)
    clear = study.outline().contains(*fine.axes_mm, study.part.edge_mm)
    height = _on_fine(start, fine)
    edges_mm = study.msf_period_mm[::-1]
    before = split_bands(np.where(clear, height, 0.0), clear, fine.pitch_mm, edges_mm)[0]
    low_start = float(before[clear].std())
    rows: list[PathRow] = []
    paths: dict[str, FloatArray] = {}
    spectra: dict[str, RadialPsd] = {}
    notes: list[str] = []
    cases = _disturbances(study)
    shown = [case.name for case in cases if case.is_of_spot][-1]
    for name, family in study.families.items():
        report_progress(f"{name}: path and compliance")
        with study.blame(f"families.{name}"):
            made = _make_path(study, family, start)
        report_progress(f"{name}: solving")
        with study.blame("solve"):
            time_s, note = _solve(study, made, start)
        notes += [f"{name}: {note}"] if note else []
        paths[name] = made.points[0]
        blocks = blocks_of(made.program, made.spots.depth_ratio, made.spots.factor)
        forecast = ripple_of(ActingSpots(made.path.spot, blocks), time_s, start.grid, start.metric_mask)
        for case in cases:
            report_progress(f"{name}: {case.name}")
            removal = _true_removal(fine, made, time_s, case)
            residual = np.where(clear, height - removal, 0.0)
            low, band, _ = split_bands(residual, clear, fine.pitch_mm, edges_mm)
            psd = radial_psd(residual, clear, fine.pitch_mm, "taper")
            if case.name == shown:
                spectra[name] = psd
            low_nm = float(low[clear].std())
            peaks = _peaks(psd)
            in_band = (psd.frequency_per_mm > 1 / edges_mm[0]) & (psd.frequency_per_mm < 1 / edges_mm[1])
            line = np.abs(psd.frequency_per_mm * family.pitch_mm - 1) <= LINE_SHARE
            rows.append(
                PathRow(
                    family=name,
                    disturbance=case.name,
                    rms_nm=float(residual[clear].std()),
                    low_nm=low_nm,
                    msf_nm=float(band[clear].std()),
                    forecast_nm=forecast.rms_high_nm,
                    convergence=1 - low_nm / low_start,
                    line_peak=float(peaks[line].max(initial=0.0)),
                    highest_peak=float(peaks[in_band].max(initial=0.0)),
                    mean_removal_nm=float(removal[clear].mean()),
                    time_s=float(time_s.sum()),
                    path_mm=float(made.program.length_mm.sum()),
                    acceleration_mm_s2=_across_mm_s2(study, made, time_s),
                    largest_turn_deg=made.largest_turn_deg,
                )
            )
    return PathComparison(tuple(rows), paths, spectra, shown, 0.5 / fine.pitch_mm, tuple(notes))


def _disturbances(study: PathsStudy) -> list[_Disturbance]:
    """Return one for each row of a family."""
    found = [_Disturbance(f"radius {100 * one:+g} %" if one else PLAIN, 1.0 + one) for one in study.radius_errors]
    if study.lag_s:
        found.append(_Disturbance(f"lag {1e3 * study.lag_s:g} ms", lag_s=study.lag_s))
    if study.line_noise_um:
        found.append(_Disturbance(f"lines {study.line_noise_um:g} um", noise_um=study.line_noise_um))
    return found


def _on_fine(start: ConditionedMap, fine: Grid) -> FloatArray:
    """(ny, nx) of the fine grid: the start, cubic between its samples; beyond them the nearest one."""
    nearest = scipy.ndimage.distance_transform_edt(~start.solve_mask, return_distances=False, return_indices=True)
    known = start.height_nm[tuple(nearest)]
    grid = start.grid
    row = (grid.y_mm[0] - fine.y_mm) / grid.pitch_mm
    column = (fine.x_mm - grid.x_mm[0]) / grid.pitch_mm
    places = np.meshgrid(row, column, indexing="ij")
    return np.asarray(scipy.ndimage.map_coordinates(known, places, order=3, mode="nearest"))


def _make_path(study: PathsStudy, family: PathFamilySection, start: ConditionedMap) -> _Path:
    """Path, tool axes and spots of a family. ComputeError."""
    process, robot, placement = study.tool_process(), study.robot_model(), study.placement()
    options, optic = study.compliance_options(), study.optic()
    passes = tuple(_points(study, family, phase, start) for phase in family.phases)
    axes = [tool_axes(points, optic, process.dip_deg, options, placement) for points in passes]
    turn = max(largest_turn_deg(axis) for axis in axes)
    program = program_of_points(
        "path",
        "feed",
        np.concatenate([one[:-1] for one in passes]),
        np.concatenate([one[1:] for one in passes]),
        np.concatenate([one[1:] for one in axes]),
    )
    found = path_compliance(program, process, robot, placement, options=options, optic=optic)
    depth = hertz_depth_mm(process)
    curved = contact_on_curved_part(process, optic, program.end_mm)
    gamma = depth_ratio(found.compliance_mm_per_n, process, depth if curved is None else depth * curved.deeper)
    path = SpotPath(levelled_axes(program, optic), HertzSpot(process), process, study.free_rim(), curved)
    return _Path(passes, path, path.on_part(tif_at_point("exact", gamma))[0], turn)


def _points(study: PathsStudy, family: PathFamilySection, phase: float, start: ConditionedMap) -> FloatArray:
    aperture: Aperture = over_outline(study.outline())
    lengths = (family.pitch_mm, study.path.step_mm)
    beyond: dict[str, Any] = {
        "optic": study.optic(),
        "overrun_mm": study.path.extension_mm,
        "landing_mm": LANDING_MM,
    }
    lines = beyond | {"direction_deg": family.direction_deg}
    if family.shape == "raster" and family.cross_deg is not None:
        return crossed_raster(aperture, *lengths, **lines, phase=phase, cross_deg=family.cross_deg)
    if family.shape == "raster":
        return raster(aperture, *lengths, **lines, phase=phase)
    if family.shape in ("spiral", "concentric"):
        return spiral(aperture, *lengths, **beyond, phase=phase, rings=family.shape == "concentric")
    radius_mm = study.machine.max_feed_mm_s**2 / study.machine.accel_mm_s2
    wanted = np.where(start.solve_mask, start.height_nm, np.nan)
    low = float(np.nanquantile(wanted, study.solve.unreachable or 0.0))
    density = LineDensity.of_removal(start.grid, wanted - low, start.solve_mask)
    if family.shape == "adaptive":
        return adaptive_raster(aperture, *lengths, density, **lines, min_radius_mm=radius_mm)
    follow = density if family.follows_removal else None
    return random_raster(
        aperture, *lengths, **lines, seed=family.seed + round(1000 * phase), min_radius_mm=radius_mm,
        density=follow,
    )  # fmt: skip


def _envelope(study: PathsStudy) -> Envelope:
    anywhere = (-np.inf, np.inf)
    return Envelope(
        **study.machine.model_dump(),
        block_overhead_s=0.0,
        corner_deg=30.0,
        x_mm=anywhere,
        y_mm=anywhere,
        z_mm=anywhere,
        max_removal_nm=np.inf,
        max_pass_s=np.inf,
    )


def _solve(study: PathsStudy, made: _Path, start: ConditionedMap) -> tuple[FloatArray, str]:
    """(n,) s that the machine delivers for the solved dwell, and a note where it is no minimum. ComputeError."""
    program, envelope = made.program, _envelope(study)
    effect = made.path.matrix(start.grid, made.spots)
    lower, upper = motion.least_time_s(program, envelope), motion.most_time_s(program, envelope)
    warm: FloatArray | None = None
    rounds = 0
    while True:
        piston = choose_piston_nm(start.height_nm, start.solve_mask, effect.removal_nm(lower), study.solve.unreachable)
        problem = DwellProblem(
            effect=effect,
            target_nm=np.where(start.solve_mask, start.height_nm + piston, 0.0),
            solve_mask=start.solve_mask,
            metric_mask=start.metric_mask,
            lower_s=lower,
            upper_s=np.maximum(upper, lower),
            regularisation=study.solve.regularisation_nm2_s2,
        )
        found = newton_cg.solve(problem, study.solve.cpu_limit_s, study.solve.kkt_tolerance, warm)
        delivered = motion.delivered_time_s(program, motion.asked_time_s(program, found.time_s, envelope), envelope)
        late = delivered > found.time_s * 1.001 + 1e-4
        rounds += 1
        if rounds > ROUNDS or not late.any():
            break
        lower, warm = np.maximum(lower, np.where(late, delivered, 0.0)), found.time_s
    stopped = found.certificate.stopped
    return delivered, "" if stopped == "converged" else f"stopped at the {stopped}: no minimum"


def _across_mm_s2(study: PathsStudy, made: _Path, time_s: FloatArray) -> float:
    """Largest speed squared times curvature between two blocks in the clear aperture."""
    program = made.program
    move = program.end_mm - program.start_mm
    speed = program.length_mm / time_s
    unit = move / program.length_mm[:, None]
    turn = np.arccos(np.clip(np.einsum("ni,ni->n", unit[1:], unit[:-1]), -1.0, 1.0))
    curvature = turn / ((program.length_mm[1:] + program.length_mm[:-1]) / 2)
    joined = np.linalg.norm(program.start_mm[1:] - program.end_mm[:-1], axis=1) < 1e-6
    x_mm, y_mm = program.end_mm[:-1, :2].T
    here = joined & study.outline().contains(x_mm, y_mm, study.part.edge_mm)
    return float((np.maximum(speed[1:], speed[:-1]) ** 2 * curvature)[here].max(initial=0.0))


def _true_removal(fine: Grid, made: _Path, time_s: FloatArray, case: _Disturbance) -> FloatArray:
    """(ny, nx) nm: the tool's position at even times, with the lag of a first-order filter and a noise of its lines."""
    if made.path.curved is not None:
        raise ComputeError("a study of paths needs a flat part. Remove part.curvature_radius_mm")
    program = made.program
    end_s = np.cumsum(time_s)
    at_s = np.arange(SAMPLE_S / 2, end_s[-1], SAMPLE_S)
    block = np.minimum(np.searchsorted(end_s, at_s, side="right"), program.n - 1)
    share = 1 - (end_s[block] - at_s) / time_s[block]
    place = program.start_mm[block, :2] + share[:, None] * (program.end_mm - program.start_mm)[block, :2]
    if case.lag_s:
        follow = 1 - np.exp(-SAMPLE_S / case.lag_s)
        place = place[0] + scipy.signal.lfilter([follow], [1, follow - 1], place - place[0], axis=0)
    if case.noise_um:
        way = np.cumsum(program.length_mm)[block]
        knots = np.random.default_rng(0).normal(size=(int(way[-1] / NOISE_MM) + 3, 2)) * case.noise_um / 1e3
        place = place + scipy.interpolate.CubicSpline(NOISE_MM * np.arange(len(knots)), knots)(way)
    spot: Spot = HertzSpot(made.path.process, SQUARES)
    spot = spot if case.factor == 1.0 else WiderSpot(spot, case.factor)
    weight_s = made.spots.factor[block] * SAMPLE_S
    spots = np.column_stack([made.spots.depth_ratio[block], lean_azimuth_rad(program)[block]])
    return _laid_down(fine, spot, place, spots, weight_s)


def _laid_down(grid: Grid, spot: Spot, place_mm: FloatArray, spots: FloatArray, weight_s: FloatArray) -> FloatArray:
    """(ny, nx) nm: the sum of spots at rest at (m, 2) places; ``spots`` (m, 2) depth ratio and azimuth."""
    ratio, azimuth = spots.T
    reach = reach_cells(spot, grid.pitch_mm, ratio, azimuth)
    rows, columns = grid.ny + 2 * reach, grid.nx + 2 * reach
    size = tuple(scipy.fft.next_fast_len(side + 2 * reach, real=True) for side in (rows, columns))
    row, down = spline((grid.y_mm[0] - place_mm[:, 1]) / grid.pitch_mm + reach)
    column, across = spline((place_mm[:, 0] - grid.x_mm[0]) / grid.pitch_mm + reach)
    held = (row >= 0) & (row + WIDTH <= rows) & (column >= 0) & (column + WIDTH <= columns)
    near = np.arange(WIDTH)
    kinds = np.round(np.column_stack([np.log(ratio) / RATIO_STEP, azimuth / AZIMUTH_STEP])).astype(np.int64)
    _, first, kind = np.unique(kinds[held], axis=0, return_index=True, return_inverse=True)
    of = np.flatnonzero(held)
    total = np.zeros((size[0], size[1] // 2 + 1), dtype=np.complex128)
    for number in range(len(first)):
        mine = of[kind.ravel() == number]
        node = (row[mine, None, None] + near[:, None]) * columns + column[mine, None, None] + near
        share = weight_s[mine, None, None] * down[mine][:, :, None] * across[mine][:, None, :]
        dwell = np.bincount(node.ravel(), share.ravel(), rows * columns).reshape(rows, columns)
        middle = slice(of[first[number]], of[first[number]] + 1)
        window = windows(spot, grid.pitch_mm, ratio[middle], azimuth[middle], reach)[0]
        total += scipy.fft.rfft2(dwell, size) * scipy.fft.rfft2(window.reshape(2 * reach + 1, -1), size)
    total /= damping(scipy.fft.fftfreq(size[0]))[:, None] * damping(scipy.fft.rfftfreq(size[1]))
    removal = scipy.fft.irfft2(total, size)
    return np.asarray(removal[2 * reach : 2 * reach + grid.ny, 2 * reach : 2 * reach + grid.nx], dtype=np.float64)


def _peaks(psd: RadialPsd) -> FloatArray:
    """(k,) density of each ring over the median of the rings within a factor of its frequency."""
    f, density = psd.frequency_per_mm, psd.density_nm2_mm2
    low, high = np.searchsorted(f, f / BACKGROUND), np.searchsorted(f, f * BACKGROUND)
    return np.array([density[k] / max(np.median(density[low[k] : high[k]]), 1e-300) for k in range(len(f))])
