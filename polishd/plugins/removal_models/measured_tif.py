"""The model ``measured_tif``: a removal rate that was measured, at the depth ratio that it was measured at."""

from __future__ import annotations

from polishd.api import ComputeError, RemovalAnswer, RemovalRequest
from polishd.plugins.removal_models.along_path import effect_along_path
from polishd.process.measured_spot import measured_spot


def path_effect(request: RemovalRequest) -> RemovalAnswer:
    """The measured spot along the path; corrections other than "exact" start from it as it is. ComputeError."""
    tif = request.tif
    if tif is None:
        raise ComputeError("the removal model measured_tif needs a measured TIF, and the cell's process has none")
    return effect_along_path(request, measured_spot(tif, request.process), reference=tif.depth_ratio)
