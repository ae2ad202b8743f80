"""The effect of dwelling along a program with any spot: from the request to the answer of a removal model."""

from __future__ import annotations

from dataclasses import replace

from polishd.api import ComputeError, Effect, Grid, RemovalAnswer, RemovalRequest
from polishd.process.compliance import depth_ratio
from polishd.process.contact import contact_radius_mm, hertz_depth_mm
from polishd.process.convolution import on_nodes
from polishd.process.dwell.sampled_tif import MATRIX_ENTRIES
from polishd.process.dynamic_tif import CorrectedSpot, corrected_spot
from polishd.process.edge.correctable import transfer
from polishd.process.path_compliance import path_compliance
from polishd.process.robot.refusal import require_number
from polishd.process.spot import Spot
from polishd.process.spot_path import SpotPath, levelled_axes

MOST_CONVOLUTIONS = 6
"""A family of higher rank (the azimuth turns over the part) costs more as convolutions than as a matrix."""


def effect_along_path(request: RemovalRequest, spot: Spot, reference: float) -> RemovalAnswer:
    """Effect matrix, compliance and gamma along the request's program (paper eq. 43-49).

    ``reference`` is the depth ratio of the one spot that the corrections other than "exact" take for all points.
    Raises ComputeError that names what is impossible, its value with the unit, and the first point it happens at.
    """
    _check(request.grid, request.rate)
    process, program = request.process, request.program
    depth = hertz_depth_mm(process)
    at = (request.robot, request.placement)
    path = path_compliance(program, process, *at, options=request.options, optic=request.optic)
    gamma = depth_ratio(path.compliance_mm_per_n, process, depth)
    along = SpotPath(levelled_axes(program, request.optic), spot, process, request.rim)
    spots, edge = along.at_rim(corrected_spot(request.correction, gamma, process.depth_exponent, reference))
    effect, how = _effect(along, request.grid, replace(spots, factor=spots.factor * request.rate))
    notes = [f"rigid contact: depth {depth:.5f} mm, radius {float(contact_radius_mm(process, depth)):.4f} mm"]
    if gamma.size:
        notes.append(f"gamma {gamma.min():.4f} to {gamma.max():.4f}, mean {gamma.mean():.4f}")
    return RemovalAnswer(
        effect=effect,
        compliance_um_per_n=path.compliance_mm_per_n * 1e3,
        gamma=gamma,
        divide_by=spots.divide_by,
        notes=(*notes, *how, *edge, *path.notes),
        transfer=transfer(spot, float(gamma.mean())) if gamma.size else None,
    )


def _effect(along: SpotPath, grid: Grid, spots: CorrectedSpot) -> tuple[Effect, tuple[str, ...]]:
    """Few convolutions where all points rest on nodes of the grid, else a matrix while it is small; and which it is.

    Where no effect without a matrix is near enough it is a matrix, however large.
    """
    if on_nodes(grid, along.program):
        found = along.convolutions(grid, spots)
        if found.rank <= MOST_CONVOLUTIONS:
            note = (
                f"the TIF's family is a sum of {found.rank} convolutions, truncated to {found.truncation:.1e} of a spot"
            )
            return found, (note,)
    if along.entries(grid, spots) > MATRIX_ENTRIES:
        try:
            spread = along.without_matrix(grid, spots)
        except ComputeError as error:
            return along.matrix(grid, spots), (f"the effect is a matrix: {error}",)
        return spread, (spread.note,)
    return along.matrix(grid, spots), ()


def _check(grid: Grid, rate: float) -> None:
    require_number("the learned removal rate", rate, "(relative)", above=0.0)
    require_number("the grid's pitch", grid.pitch_mm, "mm", above=0.0)
    if grid.ny < 1 or grid.nx < 1:
        raise ComputeError(f"the grid has {grid.ny} rows and {grid.nx} columns, it needs one of each")
