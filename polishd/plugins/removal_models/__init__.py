"""Plugin: the removal models ``hertz_preston`` and ``measured_tif``, with the robot's compliance along the path.

Both believe in the removal rate, and learn it.
"""

from __future__ import annotations

from collections.abc import Sequence

from polishd.api import ComputeError, RemovalAnswer, RemovalModel, RemovalRequest, hookimpl
from polishd.plugins.removal_models.along_path import effect_along_path
from polishd.process.measured_spot import measured_spot
from polishd.process.spot import hertz_spot

POLISHD_API = 1


def hertz_preston(request: RemovalRequest) -> RemovalAnswer:
    """Hertz pressure and Preston's law (paper eq. 16-33) along the path. ComputeError.

    Corrections other than "exact" start from the rigid robot's spot.
    """
    return effect_along_path(request, hertz_spot(request.process, request.grid.pitch_mm), reference=1.0)


def measured_tif(request: RemovalRequest) -> RemovalAnswer:
    """A removal rate that was measured, at the depth ratio that it was measured at. ComputeError.

    Corrections other than "exact" start from the spot as it is.
    """
    tif = request.tif
    if tif is None:
        raise ComputeError("the removal model measured_tif needs a measured TIF, and the cell's process has none")
    return effect_along_path(request, measured_spot(tif, request.process), reference=tif.depth_ratio)


@hookimpl
def polishd_removal_models() -> Sequence[RemovalModel]:
    """Declare both."""
    return [RemovalModel(model.__name__, model) for model in (hertz_preston, measured_tif)]
