"""The model ``hertz_preston``: Hertz pressure and Preston's law (paper eq. 16-33)."""

from __future__ import annotations

from polishd.api import RemovalAnswer, RemovalRequest
from polishd.plugins.removal_models.along_path import effect_along_path
from polishd.process.spot import HertzSpot


def path_effect(request: RemovalRequest) -> RemovalAnswer:
    """The modelled spot along the path; corrections other than "exact" start from the rigid robot's. ComputeError."""
    return effect_along_path(request, HertzSpot(request.process), reference=1.0)
