"""Part, robot and path of a study, and gamma along the path."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polishd.config.study import PartStudy
from polishd.model.program import Program
from polishd.model.surface import BoolArray, FloatArray, Grid
from polishd.process.compliance import depth_ratio
from polishd.process.contact import hertz_depth_mm
from polishd.process.curved import on_curved
from polishd.process.dynamic_tif import CorrectedSpot, tif_at_point
from polishd.process.effect import SparseEffect
from polishd.process.path_compliance import path_compliance
from polishd.process.paths.spacing import on_optic
from polishd.process.paths.wrist import tool_axes
from polishd.process.spot import HertzSpot
from polishd.process.spot_path import SpotPath, levelled_axes
from polishd.workbench.studies.surface import study_grid


@dataclass(frozen=True, slots=True)
class Scene(SpotPath):
    """A path of dwell points at rest on the optic, and what the robot makes of the contact there."""

    grid: Grid
    gamma: FloatArray
    """(n,) depth ratio (eq. 48)."""
    compliance_um_per_n: FloatArray
    """(n,) linear equivalent compliance."""
    lattice: Grid
    """The dwell points are its nodes, those that the path goes to."""
    on_nodes: bool
    """Whether the dwell points are nodes of the grid: then a convolution is exact but for its truncation."""
    notes: tuple[str, ...]

    def on_lattice(self, values: FloatArray) -> FloatArray:
        """(n,) values of the dwell points as a map of the lattice, NaN where there is no point."""
        found = np.full(self.lattice.shape, np.nan)
        column = (self.program.end_mm[:, 0] - self.lattice.x_mm[0]) / self.lattice.pitch_mm
        row = (self.lattice.y_mm[0] - self.program.end_mm[:, 1]) / self.lattice.pitch_mm
        found[np.rint(row).astype(np.intp), np.rint(column).astype(np.intp)] = values
        return found

    def effect(self, corrected: CorrectedSpot) -> SparseEffect:
        """The effect matrix of these spots, each laid down on its own; deeper over a free rim."""
        return self.matrix(self.grid, self.on_part(corrected)[0])


def make_scene(study: PartStudy) -> Scene:
    """Dwell points, tool axes and gamma of a study; ConfigError where the robot cannot do it."""
    process, robot = study.tool_process(), study.robot_model()
    placement, options, optic = study.placement(), study.compliance_options(), study.optic()
    lattice = study_grid(study, study.path.step_mm)
    reached = study.outline().contains(*lattice.axes_mm, -study.path.extension_mm)
    with study.blame("part"):
        points = on_optic(optic, lattice_points(lattice, reached)[:, :2])
        program = dwells(points, tool_axes(points, optic, process.dip_deg, options, placement), study.title)
        found = path_compliance(program, process, robot, placement, options=options, optic=optic)
    with study.blame("process"):
        depth = hertz_depth_mm(process)
        curved = on_curved(process, optic, points)
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
    """(n, 3) mm: the lattice's nodes that lie inside, (ny, nx), row by row to and fro, as a tool would visit them."""
    rows = [
        [(x, y, 0.0) for x in (lattice.x_mm[row] if k % 2 == 0 else lattice.x_mm[row][::-1])]
        for k, (y, row) in enumerate(zip(lattice.y_mm, inside, strict=True))
    ]
    return np.array([point for row in rows for point in row], dtype=np.float64).reshape(-1, 3)


def dwells(points_mm: FloatArray, axis: FloatArray, name: str) -> Program:
    """A program of dwells at rest: (n, 3) points and (n, 3) unit tool axes, part frame."""
    count = np.arange(len(points_mm))
    return Program(
        text=b"",
        sha256="",
        name=name,
        dialect="study",
        encoding="dwell",
        line=count + 1,
        block=count,
        start_mm=points_mm,
        end_mm=points_mm,
        axis=axis,
        time_s=np.zeros(len(count)),
        lines=len(count),
        max_feed_mm_min=0.0,
    )
