"""The effect of dwelling along a program: from the request to the effect matrix, and what it was derived from."""

from __future__ import annotations

from polishd.api import ComputeError, Grid, RemovalAnswer, RemovalRequest, SparseEffect
from polishd.process.compliance import depth_ratio
from polishd.process.contact import contact_radius_mm, hertz_depth_mm
from polishd.process.dynamic_tif import corrected_spot, effect_matrix, path_compliance
from polishd.process.robot.refusal import require_number


def path_effect(request: RemovalRequest) -> RemovalAnswer:
    """Effect matrix, compliance and gamma along the request's program (paper eq. 43-49).

    Raises ComputeError that names what is impossible, its value with the unit, and the first point it happens at.
    """
    _check(request.grid, request.rate)
    process = request.process
    depth = hertz_depth_mm(process)
    compliance, jumps = path_compliance(request.program, process, request.robot, request.placement)
    gamma = depth_ratio(compliance, process, depth)
    depths, factor = corrected_spot(request.correction, depth, gamma)
    matrix = effect_matrix(request.grid, process, request.program, depths, factor * request.rate)
    notes = [f"rigid contact: depth {depth:.5f} mm, radius {float(contact_radius_mm(process, depth)):.4f} mm"]
    if gamma.size:
        notes.append(f"gamma {gamma.min():.4f} to {gamma.max():.4f}, mean {gamma.mean():.4f}")
    if jumps:
        notes.append(f"the linear equivalent compliance jumps {jumps} times by over 5 % where the robot's does not")
    return RemovalAnswer(SparseEffect(request.grid, matrix), compliance * 1e3, gamma, tuple(notes))


def _check(grid: Grid, rate: float) -> None:
    require_number("the learned removal rate", rate, "(relative)", above=0.0)
    require_number("the grid's pitch", grid.pitch_mm, "mm", above=0.0)
    if grid.ny < 1 or grid.nx < 1:
        raise ComputeError(f"the grid has {grid.ny} rows and {grid.nx} columns, it needs one of each")
