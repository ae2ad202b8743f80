"""The device type ``handover``: a robot whose controller loads a file and is ordered by its variables."""

from __future__ import annotations

from collections.abc import Sequence

from polishd.api import DeviceType, hookimpl
from polishd.plugins.handover.options import HandoverOptions

POLISHD_API = 1


@hookimpl
def polishd_device_types() -> Sequence[DeviceType]:
    """``handover``."""
    from polishd.plugins.handover.build import build, own_lines

    return [DeviceType("handover", "robot", HandoverOptions, build, own_lines=own_lines)]
