"""What Zygo's files say of their counts, in MetroPro's binary ones as in texts."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from polishd.api import MapError
from polishd.plugins.interferometer.formats.common import require_optics, require_size, time_of
from polishd.plugins.interferometer.formats.scales import Pitch

RESOLUTION = {0: 4096, 1: 32768, 2: 131072}
"""Counts a wave by PhaseRes."""
MISSING = 2147483640
NOT_CALIBRATED = "CameraRes is 0: the instrument was not calibrated, the map has no lateral scale"


@dataclass(frozen=True, slots=True, kw_only=True)
class ZygoHeader:
    """The fields of a header that decide correctness, as they stand in the file."""

    origin: tuple[int, int]
    columns: int
    rows: int
    timestamp: float
    scale: float
    wavelength_m: float
    obliquity: float
    camera_res_m: float
    resolution: int
    sign: int
    instrument: str
    part: str
    serial: str
    start: int
    """Where the header ends, or the phase begins."""
    fiducials: tuple[float, ...] = ()
    """x, y, x, y ... of up to seven marks, on the camera."""

    @property
    def nm_per_count(self) -> float:
        """Height of one count, sign included."""
        size = self.scale * self.wavelength_m * self.obliquity / RESOLUTION[self.resolution] * 1e9
        return -size if self.sign else size

    @property
    def factors(self) -> dict[str, Any]:
        """What was applied, once."""
        return {
            "scale": self.scale,
            "wavelength_nm": self.wavelength_m * 1e9,
            "obliquity": self.obliquity,
            "counts_per_wave": RESOLUTION[self.resolution],
            "negated": bool(self.sign),
            "nm_per_count": self.nm_per_count,
            "origin_px": self.origin,
        }

    def about(self, path: Path) -> dict[str, Any]:
        """Pitch, part, instrument and time. BadMap for a pitch that no camera has."""
        metres = self.camera_res_m
        if metres != 0 and not (math.isfinite(metres) and 1e-8 <= metres <= 0.1):
            raise MapError(f"{path}: CameraRes is {metres:g} m a pixel")
        return {
            "lateral": Pitch(metres * 1e3) if metres else Pitch(None, {"pitch": NOT_CALIBRATED}),
            "part_id": self.serial or self.part,
            "instrument": self.instrument,
            "taken_at": time_of(self.timestamp),
        }

    def check(self, path: Path, most: float) -> None:
        """BadMap where a factor or a side is out of range, or the file can hold no more than ``most`` samples."""
        require_size(path, self.rows, self.columns, most)
        if self.resolution not in RESOLUTION:
            raise MapError(f"{path}: PhaseRes is {self.resolution}, not 0, 1 or 2: the height's scale is not known")
        optics = {"IntfScaleFactor": self.scale, "Wavelength (m)": self.wavelength_m, "Obliquity": self.obliquity}
        require_optics(path, optics)
