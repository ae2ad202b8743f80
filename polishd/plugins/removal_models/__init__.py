"""Plugin: the removal models ``hertz_preston`` and ``measured_tif``, with the robot's compliance along the path."""

from __future__ import annotations

from collections.abc import Sequence

from polishd.api import RemovalModel, hookimpl
from polishd.plugins.removal_models import hertz_preston, measured_tif

POLISHD_API = 1


@hookimpl
def polishd_removal_models() -> Sequence[RemovalModel]:
    """Declare both."""
    return [
        RemovalModel("hertz_preston", hertz_preston.path_effect),
        RemovalModel("measured_tif", measured_tif.path_effect),
    ]
