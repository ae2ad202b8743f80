"""The interferometer: its map formats, and the device type ``watched_folder``."""

from __future__ import annotations

from collections.abc import Sequence

from polishd.api import DeviceType, SurfaceReader, hookimpl
from polishd.plugins.interferometer.formats.codev import CODEV
from polishd.plugins.interferometer.formats.datx import DATX
from polishd.plugins.interferometer.formats.fits import FITS
from polishd.plugins.interferometer.formats.fourd import FOURD
from polishd.plugins.interferometer.formats.gwyddion import GWY
from polishd.plugins.interferometer.formats.metropro import METROPRO
from polishd.plugins.interferometer.formats.numpy import NPY
from polishd.plugins.interferometer.formats.points import POINTS
from polishd.plugins.interferometer.formats.sdf import SDF
from polishd.plugins.interferometer.formats.surface_topography import TAIL
from polishd.plugins.interferometer.formats.tiff import TIFF
from polishd.plugins.interferometer.formats.wyko_text import WYKO_TEXT
from polishd.plugins.interferometer.formats.x3p import X3P
from polishd.plugins.interferometer.formats.zygo_text import ZYGO_ASCII, ZYGO_XYZ
from polishd.plugins.interferometer.watched_folder import WATCHED_FOLDER

POLISHD_API = 1
READERS = (
    METROPRO,
    DATX,
    FOURD,
    X3P,
    SDF,
    GWY,
    FITS,
    TIFF,
    NPY,
    ZYGO_ASCII,
    ZYGO_XYZ,
    WYKO_TEXT,
    CODEV,
    POINTS,
    TAIL,
)
"""Formats with a magic number first, then texts, then those that judge by name."""


@hookimpl
def polishd_surface_readers() -> Sequence[SurfaceReader]:
    """All map formats."""
    return READERS


@hookimpl
def polishd_device_types() -> Sequence[DeviceType]:
    """``watched_folder``."""
    return [WATCHED_FOLDER]
