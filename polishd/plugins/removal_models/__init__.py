"""Plugin: the removal model ``hertz_preston``, Hertz pressure and Preston's law with the robot's compliance."""

from __future__ import annotations

from collections.abc import Sequence

from polishd.api import RemovalModel, hookimpl
from polishd.plugins.removal_models.hertz_preston import path_effect

POLISHD_API = 1


@hookimpl
def polishd_removal_models() -> Sequence[RemovalModel]:
    """Declare ``hertz_preston``."""
    return [RemovalModel("hertz_preston", path_effect)]
