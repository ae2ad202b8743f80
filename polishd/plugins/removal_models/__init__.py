"""Plugin: the removal models ``hertz_preston`` and ``measured_tif``, with the robot's compliance along the path.

Both believe in the removal rate and learn it; or, with ``process.learns = "machine"``, all that identification finds.
"""

from __future__ import annotations

from collections.abc import Sequence

from polishd.api import (
    ComputeError,
    EstimateUpdate,
    Learner,
    MachineEstimates,
    PassEvidence,
    RemovalAnswer,
    RemovalModel,
    RemovalRequest,
    hookimpl,
)
from polishd.plugins.removal_models.along_path import effect_along_path
from polishd.plugins.removal_models.machine import learn_machine, machine_on_the_next_part
from polishd.process.measured_spot import measured_spot
from polishd.process.spot import Spot, hertz_spot

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
