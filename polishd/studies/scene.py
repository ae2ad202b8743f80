"""Part, robot and path of a study, and gamma along the path."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from polishd.config.study import CorrectionsStudy, PartStudy, PathsStudy
from polishd.model.program import program_of_points
from polishd.model.surface import BoolArray, FloatArray, Grid, SurfaceMap
from polishd.process.metrology.conditioning import MARGIN_MM, MIN_SAMPLES, ConditionedMap, condition, process_grid
from polishd.process.metrology.resampling import Registration
from polishd.process.metrology.statistics import fit_terms
from polishd.process.metrology.tolerance import subtract_nominal
from polishd.process.removal.contact import contact_on_curved_part, hertz_depth_mm
from polishd.process.removal.dynamic_tif import CorrectedSpot, tif_at_point
from polishd.process.removal.effect import SparseEffect
from polishd.process.removal.path_tif import SpotPath, levelled_axes
from polishd.process.removal.tif import HertzSpot
from polishd.process.robot.compliance import depth_ratio, path_compliance
from polishd.process.toolpath.apertures import on_optic, tool_axes

# The initial surface of a study: drawn from a seed, or a measured map.

WAVES = 96
"""Plane waves of a drawn surface: enough for nearly normal heights."""

ReadMap = Callable[[Path], SurfaceMap]


def study_grid(study: PartStudy, pitch_mm: float) -> Grid:
    """Return the grid of this pitch over the aperture, its extension and a margin, for samples and dwell points."""
    return process_grid(study.outline(), pitch_mm, max(MARGIN_MM, study.path.extension_mm))


def start_surface(study: CorrectionsStudy | PathsStudy, read: ReadMap) -> ConditionedMap:
    """Return the surface on the process grid with its masks; ConfigError where the map is invalid."""
    part, wanted = study.part, study.surface
    if wanted.rms_nm is not None and wanted.period_mm is not None:
        return drawn_surface(study, wanted.rms_nm, wanted.period_mm)
    with study.blame("surface.file"):
        surface = read(study.resolve(wanted.file or ""))
        if part.form is not None:
            with study.blame("part.form"):
                surface = subtract_nominal(surface, read(study.resolve(part.form)), Registration())
        return condition(
            surface,
            outline=study.outline(),
            edge_mm=part.edge_mm,
            grid_mm=study.process.grid_mm,
            removal=part.alignment,
            margin_mm=max(MARGIN_MM, study.path.extension_mm),
        )


def drawn_surface(
    study: CorrectionsStudy | PathsStudy, rms_nm: float, period_mm: tuple[float, float]
) -> ConditionedMap:
    """Draw a surface of this RMS over the clear aperture, without the terms that the part's maps are levelled by."""
    part = study.part
    grid = study_grid(study, study.process.grid_mm)
    solve, metric = (study.outline().contains(*grid.axes_mm, edge) for edge in (0.0, part.edge_mm))
    if np.count_nonzero(metric) < MIN_SAMPLES:
        samples = f"{np.count_nonzero(metric)} samples of process.grid_mm = {grid.pitch_mm:g}"
        raise study.error("part", f"the clear aperture has {samples}; at least {MIN_SAMPLES} are needed")
    height = random_waves(grid, period_mm, study.surface.seed)
    height -= fit_terms(height, metric, part.alignment)
    height *= rms_nm / height[metric].std()
    return ConditionedMap(grid, np.where(solve, height, np.nan), solve, metric)


def random_waves(grid: Grid, period_mm: tuple[float, float], seed: int) -> FloatArray:
    """(ny, nx) sum of plane waves with periods in the band, longer ones higher: amplitude as the period.

    A function of position alone: a finer grid samples the same surface.
    """
    rng = np.random.default_rng(seed)
    period = np.exp(rng.uniform(np.log(period_mm[0]), np.log(period_mm[1]), WAVES))
    direction, phase = rng.uniform(0, 2 * np.pi, (2, WAVES))
    x, y = grid.x_mm[None, :], grid.y_mm[:, None]
    height = np.zeros(grid.shape)
    for length, way, start in zip(period, direction, phase, strict=True):
        height += length * np.cos(2 * np.pi / length * (np.cos(way) * x + np.sin(way) * y) + start)
    return height


@dataclass(frozen=True, slots=True)
class Scene(SpotPath):
    """A path of dwell points at rest on the optic, and the contact that the robot gives there."""

    grid: Grid
    gamma: FloatArray
    """(n,) depth ratio (eq. 48)."""
    compliance_um_per_n: FloatArray
    """(n,) linear equivalent compliance."""
    lattice: Grid
    """The dwell points are nodes of this lattice."""
    on_nodes: bool
    """True if the dwell points are nodes of the grid: a convolution is exact then, except for its truncation."""
    notes: tuple[str, ...]

    def on_lattice(self, values: FloatArray) -> FloatArray:
        """Return (n,) values of the dwell points as a map of the lattice, NaN without a point."""
        found = np.full(self.lattice.shape, np.nan)
        column = (self.program.end_mm[:, 0] - self.lattice.x_mm[0]) / self.lattice.pitch_mm
        row = (self.lattice.y_mm[0] - self.program.end_mm[:, 1]) / self.lattice.pitch_mm
        found[np.rint(row).astype(np.intp), np.rint(column).astype(np.intp)] = values
        return found

    def effect(self, corrected: CorrectedSpot) -> SparseEffect:
        """Return the effect matrix of these spots, each one exact; deeper over a free rim."""
        return self.matrix(self.grid, self.on_part(corrected)[0])


def make_scene(study: PartStudy) -> Scene:
    """Return dwell points, tool axes and gamma of a study; ConfigError out of the robot's reach."""
    process, robot = study.tool_process(), study.robot_model()
    placement, options, optic = study.placement(), study.compliance_options(), study.optic()
    lattice = study_grid(study, study.path.step_mm)
    reached = study.outline().contains(*lattice.axes_mm, -study.path.extension_mm)
    with study.blame("part"):
        points = on_optic(optic, lattice_points(lattice, reached)[:, :2])
        axes = tool_axes(points, optic, process.dip_deg, options, placement)
        program = program_of_points(study.title, "dwell", points, points, axes)
        found = path_compliance(program, process, robot, placement, options=options, optic=optic)
    with study.blame("process"):
        depth = hertz_depth_mm(process)
        curved = contact_on_curved_part(process, optic, points)
    with study.blame("kinematics"):
        gamma = depth_ratio(found.compliance_mm_per_n, process, depth if curved is None else depth * curved.deeper)
    words = f"gamma {gamma.min():.4f} to {gamma.max():.4f}, mean {gamma.mean():.4f}, at {len(gamma)} dwell points"
    path = SpotPath(levelled_axes(program, optic), HertzSpot(process), process, study.free_rim(), curved)
    return Scene(
        path.program,
        path.spot,
        process,
        path.rim,
        path.curved,
        grid=study_grid(study, study.process.grid_mm),
        gamma=gamma,
        compliance_um_per_n=found.compliance_mm_per_n * 1e3,
        lattice=lattice,
        on_nodes=study.path.step_mm == study.process.grid_mm,
        notes=(words, *found.notes, *path.on_part(tif_at_point("exact", gamma))[1]),
    )


def lattice_points(lattice: Grid, inside: BoolArray) -> FloatArray:
    """(n, 3) mm: the lattice's nodes inside, (ny, nx), row by row in alternating direction."""
    rows = [
        [(x, y, 0.0) for x in (lattice.x_mm[row] if k % 2 == 0 else lattice.x_mm[row][::-1])]
        for k, (y, row) in enumerate(zip(lattice.y_mm, inside, strict=True))
    ]
    return np.array([point for row in rows for point in row], dtype=np.float64).reshape(-1, 3)
