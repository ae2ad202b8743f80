"""Plugin: the removal models ``hertz_preston`` and ``measured_tif``, with the robot's compliance along the path.

Both believe in the removal rate and learn it; or, with ``process.learns = "machine"``, all that identification finds.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from polishd.api import (
    ComputeError,
    Estimates,
    EstimateUpdate,
    Grid,
    Learner,
    MachineEstimates,
    MapPixels,
    PassEvidence,
    RemovalAnswer,
    RemovalModel,
    RemovalRequest,
    hookimpl,
    learn_rate,
)
from polishd.model.surface import FloatArray
from polishd.plugins.removal_along_path import ProgramPath, effect_along_path, path_of
from polishd.process.identification.decision import LOOK, beliefs_of, decide, knowledge_of, on_the_next_part
from polishd.process.identification.identify import IdentificationResult, identify
from polishd.process.identification.parameters import ExecutedBlocks, MapPixelData, RemovalMap, RemovalNoise
from polishd.process.metrology.resampling import Registration, averaging
from polishd.process.removal.dynamic_tif import lean_azimuth_rad
from polishd.process.removal.tif import HertzSpot, Spot, hertz_spot, measured_spot

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
    """Identify the machine from a pass (docs/identification.md); only the rate where that does not converge."""
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
    after = beliefs_of(found.learned, taken, contact_h, evidence.rates, found.volume)
    how = {**rate_alone.found, "rate": after.rate.value / beliefs.rate.value, "parameters": _table(found)}
    said = tuple(f"{one.words}: corrected" for one in decision.corrected if one.name != "rate")
    said += tuple(f"{one.words}: found, and not certain" for one in decision.left if one.name != "rate")
    return EstimateUpdate(after, how, said, "; ".join(decision.stops))


def machine_on_the_next_part(beliefs: Estimates, days: float) -> MachineEstimates:
    """Return the initial estimates of a job on another part. ComputeError for estimates of another model."""
    if not isinstance(beliefs, MachineEstimates):
        raise ComputeError(f"identification needs estimates of type MachineEstimates, not {type(beliefs).__name__}")
    return on_the_next_part(beliefs, days)


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
    prior = knowledge_of(beliefs, turns=not isinstance(spot, HertzSpot))
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
    return MapPixelData(at, averaging(at.grid, grid, Registration(at.rotation_deg, at.shift_mm)))


def _table(found: IdentificationResult) -> dict[str, dict[str, float | str | bool]]:
    """Each parameter for ``learned.json``."""
    return {
        one.parameter.name: {
            "value": one.value,
            "sigma": one.sigma,
            "unit": one.parameter.unit,
            "decided": one.told.decided,
            "confounded_with": ", ".join(one.told.confounded_with),
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
