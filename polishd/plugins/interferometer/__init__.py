"""The interferometer: the map format ``metropro``, and the device type ``watched_folder``."""

from __future__ import annotations

from collections.abc import Sequence

from polishd.api import DeviceType, SurfaceReader, hookimpl
from polishd.plugins.interferometer.folder import WATCHED_FOLDER
from polishd.plugins.interferometer.metropro import METROPRO

POLISHD_API = 1


@hookimpl
def polishd_surface_readers() -> Sequence[SurfaceReader]:
    """``metropro``."""
    return [METROPRO]


@hookimpl
def polishd_device_types() -> Sequence[DeviceType]:
    """``watched_folder``."""
    return [WATCHED_FOLDER]
