"""The effect of dwelling along a program with any spot: from the request to the answer of a removal model."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from polishd.api import ComputeError, Effect, Grid, MachineEstimates, Program, RemovalAnswer, RemovalRequest
from polishd.model.surface import FloatArray
from polishd.process.checks import require_number
from polishd.process.identification.forward_model import ParameterAction
from polishd.process.removal.contact import contact_on_curved_part, contact_radius_mm, hertz_depth_mm
from polishd.process.removal.convolution import are_on_nodes
from polishd.process.removal.dynamic_tif import CorrectedSpot, lean_azimuth_rad, tif_at_point
from polishd.process.removal.path_tif import SpotPath, levelled_axes
from polishd.process.removal.tif import HertzSpot, Spot
from polishd.process.removal.transfer_function import spot_transfer_function
from polishd.process.robot.compliance import depth_ratio, path_compliance

NEWTON_S = 7e-9
"""CPU seconds that a solve with a matrix takes, over entries^2 / points: 4e-9 to 1.2e-8 from 100 to 300 mm.

A product costs as its entries, and conjugate gradients take the more of them, the more samples a spot covers."""
WORTH_S = 2.0
"""CPU seconds of such a solve, above which an effect without a matrix is tried: making that takes as long."""
WIDE = 100
"""Entries to a point, below which it is not. Such spots are refused (65 and 93 entries to a point: off by 2.5e-3 and
more), or the steps without a matrix stall: 300 mm of R 800, 65 entries to a point, 90 s; with the matrix 1.8 s."""
MOST_ENTRIES = 100_000_000
"""Of a matrix: with its transpose, which the solver needs, 2.4 GB."""
NEAR = 1e-3, 2e-3
"""How far off the removal may be without a matrix, over its peak, where that only saves time; tried in turn."""
LESS_NEAR = 5e-3
"""How far off the removal may be without a matrix, over its peak, where the matrix would be too large."""
MOST_CONVOLUTIONS = 6
"""A family of higher rank (the azimuth turns over the part) costs more as convolutions than as a matrix."""


@dataclass(frozen=True, slots=True)
class ProgramPath:
    """A spot along a request's program, as it is believed to act."""

    along: SpotPath
    spots: CorrectedSpot
    """With the rates of their places, but for the rate of all."""
    gamma: FloatArray
    """(n,) as the robot's compliance gives it."""
    compliance_um_per_n: FloatArray
    radius_mm: float
    """Of the circle that the rate's field is over: that of the grid's longer side."""
    notes: tuple[str, ...]


def path_of(request: RemovalRequest, spot: Spot, reference: float) -> ProgramPath:
    """The spot at each timed point: as the compliance sinks it, and as what was identified moves and scales it.

    ``reference`` is the depth ratio of the one spot that the corrections other than "exact" take for all points.
    Raises ComputeError that names what is impossible, its value with the unit, and the first point it happens at.
    """
    process, program = request.process, request.program
    depth = hertz_depth_mm(process)
    middle = (program.start_mm + program.end_mm)[:, :2] / 2
    curved = contact_on_curved_part(process, request.optic, middle, contact=isinstance(spot, HertzSpot))
    at = (request.robot, request.placement)
    path = path_compliance(program, process, *at, options=request.options, optic=request.optic)
    gamma = depth_ratio(path.compliance_mm_per_n, process, depth if curved is None else depth * curved.deeper)
    acting, pass_h = _acting(request)
    level = levelled_axes(program, request.optic)
    along = SpotPath(_laid(level, acting), acting.spot(spot), process, request.rim, curved)
    sunk = acting.sunk(gamma)
    spots, how = along.on_part(tif_at_point(request.correction, sunk, process.depth_exponent, reference))
    radius = max(request.grid.shape) * request.grid.pitch_mm / 2
    hours = pass_h * (np.arange(program.n) + 0.5) / max(program.n, 1)
    own = np.exp(acting.log_rate(sunk, hours) + acting.log_field(middle, radius))
    notes = [f"rigid contact: depth {depth:.5f} mm, radius {float(contact_radius_mm(process, depth)):.4f} mm"]
    if gamma.size:
        notes.append(f"gamma {gamma.min():.4f} to {gamma.max():.4f}, mean {gamma.mean():.4f}")
    return ProgramPath(
        along,
        replace(spots, factor=spots.factor * own),
        gamma,
        path.compliance_mm_per_n * 1e3,
        radius,
        (*notes, *how, *path.notes),
    )


def effect_along_path(request: RemovalRequest, spot: Spot, reference: float) -> RemovalAnswer:
    """Effect matrix, compliance and gamma along the request's program (paper eq. 43-49); errors as of `path_of`."""
    _check(request.grid, request.rate)
    path = path_of(request, spot, reference)
    spots = replace(path.spots, factor=path.spots.factor * request.rate)
    effect, how = _effect(path.along, request.grid, spots)
    return RemovalAnswer(
        effect=effect,
        compliance_um_per_n=path.compliance_um_per_n,
        gamma=path.gamma,
        divide_by=spots.divide_by,
        notes=(*path.notes, *how),
        transfer=spot_transfer_function(spot, float(path.gamma.mean())) if path.gamma.size else None,
    )


def _acting(request: RemovalRequest) -> tuple[ParameterAction, float]:
    """What was identified, and the hours of contact that the pass is taken to last."""
    known = request.beliefs
    return (
        (ParameterAction(known.applied), known.pass_h)
        if isinstance(known, MachineEstimates)
        else (ParameterAction({}), 0.0)
    )


def _laid(program: Program, acting: ParameterAction) -> Program:
    """The program where it really runs."""
    if not acting.moves:
        return program
    lean = lean_azimuth_rad(program)
    start, _ = acting.laid(program.start_mm[:, :2], lean)
    end, azimuth = acting.laid(program.end_mm[:, :2], lean)
    tilt = np.hypot(program.axis[:, 0], program.axis[:, 1])
    return replace(
        program,
        start_mm=np.column_stack([start, program.start_mm[:, 2]]),
        end_mm=np.column_stack([end, program.end_mm[:, 2]]),
        axis=np.column_stack([tilt * np.cos(azimuth), tilt * np.sin(azimuth), program.axis[:, 2]]),
    )


def _effect(along: SpotPath, grid: Grid, spots: CorrectedSpot) -> tuple[Effect, tuple[str, ...]]:
    """Few convolutions where all points rest on nodes of the grid, else a matrix while that is quick; and which it is.

    Which is quicker follows from its entries and points, before either is made. Where no effect without a matrix is
    near enough it is a matrix, while that fits a computer's memory; beyond, one that is less near, whose certificate
    says how far off it is. ComputeError where that is too far.
    """
    if are_on_nodes(grid, along.program):
        found = along.convolutions(grid, spots)
        if found.rank <= MOST_CONVOLUTIONS:
            note = (
                f"the TIF's family is a sum of {found.rank} convolutions, truncated to {found.truncation:.1e} of a spot"
            )
            return found, (note,)
    entries = along.entries(grid, spots)
    if gives_way(entries, along.program.n):
        why = ""
        for tolerance in NEAR if entries <= MOST_ENTRIES else (NEAR[0], LESS_NEAR):
            try:
                spread = along.without_matrix(grid, spots, tolerance)
            except ComputeError as error:
                why = str(error)
            else:
                return spread, (spread.note,)
        if entries > MOST_ENTRIES:
            raise ComputeError(why)
        return along.matrix(grid, spots), (f"the effect is a matrix: {why}",)
    return along.matrix(grid, spots), ()


def newton_s(entries: float, points: int) -> float:
    """About the CPU seconds of a solve with a matrix of so many entries and points."""
    return NEWTON_S * entries**2 / max(points, 1)


def gives_way(entries: float, points: int) -> bool:
    """Whether an effect without a matrix is tried in the place of such a matrix: where it saves time, or memory."""
    slow = newton_s(entries, points) > WORTH_S and entries > WIDE * points
    return slow or entries > MOST_ENTRIES


def _check(grid: Grid, rate: float) -> None:
    require_number("the learned removal rate", rate, "(relative)", above=0.0)
    require_number("the grid's pitch", grid.pitch_mm, "mm", above=0.0)
    if grid.ny < 1 or grid.nx < 1:
        raise ComputeError(f"the grid has {grid.ny} rows and {grid.nx} columns, it needs one of each")
