"""Zygo ASCII data files: header, intensities, phase in the integer code of ``.dat``; blocks end in a line of ``#``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from polishd.api import BadMap, SurfaceMap, SurfaceReader
from polishd.plugins.interferometer.formats.common import content_of, require_data, sha256_of
from polishd.plugins.interferometer.formats.metropro import MISSING, RESOLUTION
from polishd.plugins.interferometer.formats.numbers import block
from polishd.plugins.interferometer.formats.zygo_text import HASH, Header, header_of

NAME = "zygo_ascii"
VERSION = 1
MAGIC = b"Zygo ASCII Data File"


def sniff(head: bytes, path: Path) -> bool:  # noqa: ARG001  a reader may also judge by name
    """True where the first line is the format's name."""
    return head.lstrip().startswith(MAGIC)


def read(path: Path) -> SurfaceMap:
    """Read a map. BadMap with path and reason for whatever is torn, broken or absurd."""
    content = content_of(path)
    if not sniff(content[:4096], path):
        raise BadMap(f"{path}: no Zygo ASCII file: its first line is not '{MAGIC.decode()} ...'")
    header = header_of(path, content, smallest=2)
    counts = block(path, content, _phase(path, content, header.end), (header.rows, header.columns))
    if (counts != np.trunc(counts)).any():
        raise BadMap(f"{path}: its phase holds numbers that are no integers")
    missing = counts >= MISSING
    counts *= header.nm_per_count
    counts[missing] = np.nan
    common: dict[str, Any] = header.common(path)
    return SurfaceMap(
        height_nm=require_data(path, counts),
        sha256=sha256_of(content),
        format=NAME,
        factors=factors(header),
        reader_version=VERSION,
        **common,
    )


def factors(header: Header) -> dict[str, Any]:
    """What was applied, once."""
    return {
        "scale": header.scale,
        "wavelength_nm": header.wavelength_m * 1e9,
        "obliquity": header.obliquity,
        "counts_per_wave": RESOLUTION[header.resolution],
        "negated": bool(header.sign),
        "nm_per_count": header.nm_per_count,
        "origin_px": header.origin,
    }


def _phase(path: Path, content: bytes, start: int) -> tuple[int, int]:
    """Where the phase stands: between the line that ends the intensities and the one that ends the file."""
    intensity = HASH.search(content, start)
    phase = HASH.search(content, intensity.end()) if intensity else None
    if intensity is None or phase is None:
        raise BadMap(f"{path}: its phase does not end in a line of '#': torn, or still being written")
    if content[phase.end() :].strip():
        raise BadMap(f"{path}: something follows the end of its phase: {content[phase.end() :].strip()[:20]!r}")
    return intensity.end(), phase.start()


ZYGO_ASCII = SurfaceReader(name=NAME, sniff=sniff, read=read, suffixes=(".asc",))
