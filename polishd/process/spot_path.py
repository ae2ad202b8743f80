"""A spot laid down along a program: how it sinks over the part's rim, and its effect. Cells and studies share it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from polishd.model.outline import Outline
from polishd.model.process import Optic, Placement, ToolProcess
from polishd.model.program import Program
from polishd.model.surface import Grid
from polishd.process.convolution import ConvolutionEffect, convolution_effect
from polishd.process.curved import CurvedContact
from polishd.process.dynamic_tif import CorrectedSpot, effect_matrix
from polishd.process.edge.edge_tif import rim_depth_mm
from polishd.process.effect import SparseEffect
from polishd.process.frames import surface_normals, upright
from polishd.process.spot import Spot, WiderSpot
from polishd.process.spreading.effect import TOLERANCE, SpreadEffect, spread_effect


@dataclass(frozen=True, slots=True)
class SpotPath:
    """Where a tool dwells or moves on a part, and what of it removes there."""

    program: Program
    """n timed points in the part's frame, the axes as seen where the surface lies level (`levelled_axes`)."""
    spot: Spot
    """The rigid robot's."""
    process: ToolProcess
    rim: Outline | None
    """The part's, where it is free."""
    curved: CurvedContact | None
    """What the part's curvature makes of the spot at each point; None on a flat."""

    @property
    def even(self) -> Spot:
        """The spot of all points, where each cannot have its own: as wide as they are in the mean."""
        if self.curved is None:
            return self.spot
        return WiderSpot(self.spot, float(np.sqrt(self.curved.wider.mean(axis=0).prod())))

    def on_part(self, spots: CorrectedSpot) -> tuple[CorrectedSpot, tuple[str, ...]]:
        """The spots as a map sees them where the part slopes, and as they sink over a free rim; and notes on both."""
        notes: tuple[str, ...] = ()
        if self.curved is not None:
            spots, notes = replace(spots, factor=spots.factor * self.curved.seen), (self.curved.note,)
        if self.rim is not None:
            spots, note = rim_depth_mm(spots, self.rim, self.process, self.spot, self.program)
            notes = (*notes, note)
        return spots, notes

    def matrix(self, grid: Grid, spots: CorrectedSpot) -> SparseEffect:
        """The effect of these spots, each laid down on its own."""
        own = {} if self.curved is None else {"wider": self.curved.wider, "correlation": self.curved.askew}
        return SparseEffect(grid, effect_matrix(grid, self.spot, self.program, spots.depth_ratio, spots.factor, **own))

    def entries(self, grid: Grid, spots: CorrectedSpot) -> float:
        """About how many the matrix has: samples under each disc, and under what it sweeps."""
        width = 2 * self.spot.half_width_mm(spots.depth_ratio) + grid.pitch_mm
        return float((np.pi / 4 * width**2 + width * self.program.length_mm).sum()) / grid.pitch_mm**2

    def without_matrix(self, grid: Grid, spots: CorrectedSpot, tolerance: float = TOLERANCE) -> SpreadEffect:
        """The same in memory that goes with points and samples. ComputeError where its error is above the tolerance."""
        bent = None if self.curved is None else np.column_stack([self.curved.wider, self.curved.askew])
        return spread_effect(
            grid, self.spot, self.program, spots.depth_ratio, spots.factor, tolerance=tolerance, bent=bent
        )

    def convolutions(self, grid: Grid, spots: CorrectedSpot) -> ConvolutionEffect:
        """The same as a sum of convolutions. ComputeError unless all points rest on nodes of the grid."""
        return convolution_effect(grid, self.even, self.program, spots.depth_ratio, spots.factor)


def levelled_axes(program: Program, optic: Optic) -> Program:
    """The program, in the part's frame, with its axes as seen where the surface lies level."""
    here = Placement((0.0, 0.0, 0.0), np.eye(3))
    return replace(program, axis=upright(program.axis, surface_normals(here, program.end_mm, optic)))
