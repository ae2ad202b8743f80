"""Zygo ASCII data files: header, intensities, phase in the integer code of ``.dat``; blocks end in a line of ``#``."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from polishd.api import BadMap, SurfaceMap
from polishd.plugins.interferometer.formats.common import require_data
from polishd.plugins.interferometer.formats.numbers import block
from polishd.plugins.interferometer.formats.zygo import MISSING
from polishd.plugins.interferometer.formats.zygo_text import HASH, TextFormat, require_end

FORMAT = TextFormat("zygo_ascii", 1, (b"Zygo ASCII Data File",))


def read(path: Path) -> SurfaceMap:
    """Read a map. BadMap with path and reason for whatever is torn, broken or absurd."""
    content, header = FORMAT.opened(path, smallest=2)
    counts = block(path, content, _phase(path, content, header.start), (header.rows, header.columns))
    if (counts != np.trunc(counts)).any():
        raise BadMap(f"{path}: its phase holds numbers that are no integers")
    missing = counts >= MISSING
    counts *= header.nm_per_count
    counts[missing] = np.nan
    height_nm = require_data(path, counts)
    return FORMAT.surface(path, content, height_nm, factors=header.factors, **header.about(path))


def _phase(path: Path, content: bytes, start: int) -> tuple[int, int]:
    """Where the phase stands: between the line that ends the intensities and the one that ends the file."""
    intensity = HASH.search(content, start)
    phase = HASH.search(content, intensity.end()) if intensity else None
    if intensity is None or phase is None:
        raise BadMap(f"{path}: its phase does not end in a line of '#': torn, or still being written")
    require_end(path, content, phase.end(), "phase")
    return intensity.end(), phase.start()


ZYGO_ASCII = FORMAT.reader(read, ".asc")
