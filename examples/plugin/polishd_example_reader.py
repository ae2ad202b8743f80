"""Read surface maps from ``.xyz`` text: a line ``x_mm y_mm height_nm`` per sample of a square grid."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from polishd.api import MapError, SurfaceMap, SurfaceReader, hookimpl

POLISHD_API = 1

# Coordinates written with few digits may be off the grid by this part of the pitch.
OFF_GRID = 0.05
# A grid emptier than this is no measured part, but a wrong guess of the pitch.
MIN_FILL = 0.1


def sniff(head: bytes, path: Path) -> bool:  # noqa: ARG001  any table of three columns would look alike
    """Recognize the format by the file's extension."""
    return path.suffix.lower() == ".xyz"


def read(path: Path) -> SurfaceMap:
    """Put the samples on their grid, row 0 the largest y; NaN where the file has none."""
    try:
        content = path.read_bytes()
        lines = [line.split() for line in content.decode("ascii").splitlines() if line.strip() and line[0] != "#"]
        x_mm, y_mm, height_nm = np.array(lines, dtype=float).T
    except (OSError, ValueError) as error:
        raise MapError(f"{path.name}: not a table of x_mm y_mm height_nm: {error}") from error
    columns_mm = np.unique(x_mm)
    if columns_mm.size < 2 or not np.isfinite([x_mm, y_mm, height_nm]).all():
        raise MapError(f"{path.name}: a map needs two columns at least, and finite numbers")
    pitch_mm = float(np.diff(columns_mm).min())
    exact = np.array([y_mm.max() - y_mm, x_mm - x_mm.min()]) / pitch_mm
    place = np.rint(exact)
    ny_nx = place.max(axis=1) + 1
    if np.abs(exact - place).max() > OFF_GRID or ny_nx.prod() * MIN_FILL > place.shape[1]:
        raise MapError(f"{path.name}: the samples are not on a square grid of {pitch_mm:g} mm")
    if np.unique(place, axis=1).shape != place.shape:
        raise MapError(f"{path.name}: two samples have the same position")
    grid_nm = np.full(ny_nx.astype(int), np.nan)
    grid_nm[tuple(place.astype(int))] = height_nm
    return SurfaceMap(grid_nm, pitch_mm, sha256=hashlib.sha256(content).hexdigest(), path=path, format="xyz")


@hookimpl
def polishd_surface_readers() -> list[SurfaceReader]:
    """Declare the format."""
    return [SurfaceReader("xyz", sniff, read)]
