"""Plugin: the removal models ``hertz_preston`` and ``measured_tif``, with the robot's compliance along the path.

Both estimate the removal rate; with ``process.estimates = "machine"`` all that identification finds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from polishd.api import (
    ComputeError,
    Effect,
    Estimates,
    EstimateUpdate,
    Grid,
    Learner,
    MachineEstimates,
    MapPixels,
    PassEvidence,
    Program,
    RemovalAnswer,
    RemovalModel,
    RemovalRequest,
    hookimpl,
    learn_rate,
)
from polishd.model.surface import FloatArray
from polishd.process.checks import require_number
from polishd.process.identification.decision import (
    LOOK,
    decide,
    estimates_after_pass,
    estimates_for_next_part,
    knowledge_from_estimates,
)
from polishd.process.identification.forward_model import ParameterAction
from polishd.process.identification.identify import IdentificationResult, identify
from polishd.process.identification.parameters import ExecutedBlocks, MapPixelData, RemovalMap, RemovalNoise
from polishd.process.metrology.resampling import Registration, averaging_matrix
from polishd.process.removal.contact import contact_on_curved_part, contact_radius_mm, hertz_depth_mm
from polishd.process.removal.convolution import are_on_nodes
from polishd.process.removal.dynamic_tif import CorrectedSpot, lean_azimuth_rad, tif_at_point
from polishd.process.removal.path_tif import SpotPath, levelled_axes
from polishd.process.removal.ripple import ActingSpots
from polishd.process.removal.tif import HertzSpot, MeasuredSpot, Spot, WiderSpot, hertz_spot, measured_spot
from polishd.process.removal.tif_family import blocks_of
from polishd.process.removal.transfer_function import spot_transfer_function
from polishd.process.robot.compliance import depth_ratio, path_compliance

# Effect of dwelling along a program with any spot.

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
    shown = _acting(request)[0].spot(spot_of_ripple(spot))
    return RemovalAnswer(
        effect=effect,
        compliance_um_per_n=path.compliance_um_per_n,
        gamma=path.gamma,
        divide_by=spots.divide_by,
        notes=(*path.notes, *how),
        transfer=spot_transfer_function(spot, float(path.gamma.mean())) if path.gamma.size else None,
        acting=_acting_spots(shown, path.along, spots),
    )


RESOLVED = 8.0
"""Samples of a measured spot to the radius of its core, from which they show what lines leave: four to a line distance
or more (0.57 of the contact's radius in the paper's process)."""
RIPPLE_SQUARES = 128
"""Squares across a measured spot, at least: their width must not show beside a patch's cells."""


@dataclass(frozen=True, slots=True)
class EqualVolume:
    """A Hertz contact that is as wide as a measured spot and removes as much, at each depth ratio."""

    measured: MeasuredSpot
    modelled: Spot

    def half_width_mm(self, depth_ratio: FloatArray) -> FloatArray:
        """(n,) mm."""
        return self.modelled.half_width_mm(depth_ratio)

    def step_mm(self, depth_ratio: FloatArray) -> FloatArray:
        """(n,) mm."""
        return self.modelled.step_mm(depth_ratio)

    def offset_mm(self, depth_ratio: FloatArray, azimuth_rad: FloatArray) -> FloatArray:
        """(n, 2) mm, of the measured one."""
        return self.measured.offset_mm(depth_ratio, azimuth_rad)

    def patch(self, depth_ratio: FloatArray, azimuth_rad: FloatArray) -> FloatArray:
        """(n, squares, squares) nm mm^2/s."""
        patch = self.modelled.patch(depth_ratio, azimuth_rad)
        volume = self.measured.patch(depth_ratio, azimuth_rad).sum(axis=(1, 2))
        return np.asarray(patch * (volume / patch.sum(axis=(1, 2)))[:, None, None], dtype=np.float64)


def spot_of_ripple(spot: Spot) -> Spot:
    """Return the spot for the forecast of what lines leave.

    A measured spot is squares of its map's samples. Their steps have a spectrum of their own: samples of 0.5 mm left
    4.4 nm of ripple at 0.46 mm that the spot does not leave (a modelled one: 0.1 nm). Where the samples are fine, the
    spot is drawn smoothly through them; where they are not, they cannot show ripple, and a Hertz contact of the same
    core and volume takes its place.
    """
    if not isinstance(spot, MeasuredSpot):
        return spot
    if spot.core_mm >= RESOLVED * spot.tif.pitch_mm:
        times = int(np.ceil(RIPPLE_SQUARES / len(spot.squares)))
        fine = scipy.ndimage.zoom(spot.squares, times, order=3, mode="grid-constant", grid_mode=True)
        fine = np.clip(fine, 0.0, None)
        return replace(spot, squares=fine * (spot.squares.sum() / fine.sum()))
    hertz = HertzSpot(spot.process, RIPPLE_SQUARES)
    there = np.array([spot.tif.depth_ratio])
    rate = hertz.patch(there, np.zeros(1))[0]
    side = 2 * float(hertz.half_width_mm(there)[0]) / RIPPLE_SQUARES
    core = side * float(np.sqrt(np.count_nonzero(rate > rate.max() / 2) / np.pi))
    return EqualVolume(spot, WiderSpot(hertz, spot.core_mm / core))


def _acting_spots(spot: Spot, along: SpotPath, spots: CorrectedSpot) -> ActingSpots:
    factor = spots.factor if spots.divide_by is None else spots.factor * spots.divide_by
    curved = along.curved
    bent = None if curved is None else np.column_stack([curved.wider, curved.askew])
    return ActingSpots(spot, blocks_of(along.program, spots.depth_ratio, factor, bent))


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
    if prefers_no_matrix(entries, along.program.n):
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


def prefers_no_matrix(entries: float, points: int) -> bool:
    """Whether an effect without a matrix is tried in the place of such a matrix: where it saves time, or memory."""
    slow = newton_s(entries, points) > WORTH_S and entries > WIDE * points
    return slow or entries > MOST_ENTRIES


def _check(grid: Grid, rate: float) -> None:
    require_number("the learned removal rate", rate, "(relative)", above=0.0)
    require_number("the grid's pitch", grid.pitch_mm, "mm", above=0.0)
    if grid.ny < 1 or grid.nx < 1:
        raise ComputeError(f"the grid has {grid.ny} rows and {grid.nx} columns, it needs one of each")


# The learner ``machine``: what a pass's removal says of rate, its field, wear, spot, compliance and seat.

NOISE_NM = 0.2
"""Noise of a difference of two maps where the profile states none; a larger fit residual replaces it."""
FINE = 1.25
"""Samples are this much of the spot's step apart, at most, or as fine as they are."""
COARSE = 0.25
"""Of the grid's pitch: a map's sample that counts with its own place and size."""
BELIEVED = "believed"
"""The projection of the compliance that the cell is configured with."""


def learn_machine(
    request: RemovalRequest, evidence: PassEvidence, spot_of: Callable[[RemovalRequest], tuple[Spot, float]]
) -> EstimateUpdate:
    """Identify the machine from a pass (docs/explanation/identification.md); only the rate if it does not converge."""
    beliefs = request.beliefs
    if not isinstance(beliefs, MachineEstimates):
        raise ComputeError(f"identification needs estimates of type MachineEstimates, not {type(beliefs).__name__}")
    rate_alone = learn_rate(request, evidence)
    try:
        found = _identified(request, evidence, beliefs, *spot_of(request))
    except ComputeError as error:
        reason = f"the machine was not identified: {error}"
        kept = replace(beliefs, rate=rate_alone.beliefs.rate)
        stop = f"{reason}; this pass was made for identification: {LOOK}" if evidence.must_tell else ""
        return replace(rate_alone, beliefs=kept, notes=(*rate_alone.notes, reason), stop=stop)
    decision = decide(found, misses_mm=evidence.most_miss_mm)
    taken = [one.name for one in decision.corrected if one.name != "rate"]
    contact_h = float(evidence.executed_s.sum()) / 3600
    after = estimates_after_pass(found.learned, taken, contact_h, evidence.rates, found.volume)
    how = {**rate_alone.found, "rate": after.rate.value / beliefs.rate.value, "parameters": _table(found)}
    said = tuple(f"{one.words}: corrected" for one in decision.corrected if one.name != "rate")
    said += tuple(f"{one.words}: found, and not certain" for one in decision.left if one.name != "rate")
    return EstimateUpdate(after, how, said, "; ".join(decision.stops))


def machine_on_the_next_part(beliefs: Estimates, days: float) -> MachineEstimates:
    """Return the initial estimates of a job on another part. ComputeError for estimates of another model."""
    if not isinstance(beliefs, MachineEstimates):
        raise ComputeError(f"identification needs estimates of type MachineEstimates, not {type(beliefs).__name__}")
    return estimates_for_next_part(beliefs, days)


def _identified(
    request: RemovalRequest, evidence: PassEvidence, beliefs: MachineEstimates, spot: Spot, reference: float
) -> IdentificationResult:
    path = path_of(replace(request, beliefs=replace(beliefs, applied={})), spot, reference)  # as configured
    blocks = blocks_along(path, evidence.executed_s, evidence.acted_s)
    noise = RemovalNoise(NOISE_NM if evidence.noise_nm is None else evidence.noise_nm)
    measured = np.nan_to_num(evidence.measured_nm)
    removed = RemovalMap(request.grid, measured, evidence.mask, noise, _pixels(evidence.pixels, request.grid))
    step = float(np.median(spot.step_mm(path.spots.depth_ratio)))
    odd = max(int(FINE * step / request.grid.pitch_mm) - 1, 0) // 2 * 2 + 1
    prior = knowledge_from_estimates(beliefs, turns=not isinstance(spot, HertzSpot))
    return identify(
        removed.coarser(odd),
        blocks,
        spot,
        request.process,
        prior,
        projection=BELIEVED,
        radius_mm=path.radius_mm,
        counted=beliefs.applied,
    )


def blocks_along(path: ProgramPath, executed_s: FloatArray, acted_s: FloatArray | None = None) -> ExecutedBlocks:
    """A path's blocks as identification takes them: (n,) s executed, and at the process's own force and speed."""
    acted = executed_s if acted_s is None else acted_s
    share = np.divide(acted, executed_s, out=np.ones_like(executed_s), where=executed_s > 0)
    program = path.along.program
    ends, lean = (program.start_mm[:, :2], program.end_mm[:, :2]), lean_azimuth_rad(program)
    curved = path.along.curved
    wider = None if curved is None else np.sqrt(curved.wider.prod(axis=1))
    by_projection = {BELIEVED: path.spots.depth_ratio}
    return ExecutedBlocks(*ends, executed_s, lean, by_projection, path.spots.factor * share, wider=wider)


def _pixels(at: MapPixels | None, grid: Grid) -> MapPixelData | None:
    """The map's pixels; None where they are so fine that their mean equals the cell's (at 0.4 of the pitch not yet)."""
    if at is None or at.grid.pitch_mm < COARSE * grid.pitch_mm:
        return None
    return MapPixelData(at, averaging_matrix(at.grid, grid, Registration(at.rotation_deg, at.shift_mm)))


def _table(found: IdentificationResult) -> dict[str, dict[str, float | str | bool]]:
    """Each parameter for ``learned.json``."""
    return {
        one.parameter.name: {
            "value": one.value,
            "sigma": one.sigma,
            "unit": one.parameter.unit,
            "decided": one.confounding.decided,
            "confounded_with": ", ".join(one.confounding.confounded_with),
            "detection_limit": one.detection_limit,
            "probability": one.probability,
            "said": one.sentence,
        }
        for one in found.estimates
    }


POLISHD_API = 1


def modelled_spot_of(request: RemovalRequest) -> tuple[Spot, float]:
    """The rigid robot's spot, and the depth ratio that it is of."""
    return hertz_spot(request.process, request.grid.pitch_mm), 1.0


def measured_spot_of(request: RemovalRequest) -> tuple[Spot, float]:
    """The measured spot, and the depth ratio that it was measured at. ComputeError."""
    if request.tif is None:
        raise ComputeError("the removal model measured_tif needs a measured TIF, and the cell's process has none")
    return measured_spot(request.tif, request.process), request.tif.depth_ratio


def hertz_preston(request: RemovalRequest) -> RemovalAnswer:
    """Hertz pressure and Preston's law (paper eq. 16-33) along the path. ComputeError.

    Corrections other than "exact" start from the rigid robot's spot.
    """
    return effect_along_path(request, *modelled_spot_of(request))


def measured_tif(request: RemovalRequest) -> RemovalAnswer:
    """A removal rate that was measured, at the depth ratio that it was measured at. ComputeError.

    Corrections other than "exact" start from the spot as it is.
    """
    return effect_along_path(request, *measured_spot_of(request))


def _identify_hertz(request: RemovalRequest, evidence: PassEvidence) -> EstimateUpdate:
    return learn_machine(request, evidence, modelled_spot_of)


def _identify_measured(request: RemovalRequest, evidence: PassEvidence) -> EstimateUpdate:
    return learn_machine(request, evidence, measured_spot_of)


@hookimpl
def polishd_removal_models() -> Sequence[RemovalModel]:
    """Declare both."""
    both = ((hertz_preston, _identify_hertz), (measured_tif, _identify_measured))
    return [
        RemovalModel(
            effect.__name__, effect, learners={"machine": Learner(MachineEstimates(), learn, machine_on_the_next_part)}
        )
        for effect, learn in both
    ]
