"""Zygo's two text formats: a header of 14 lines (13 in some XYZ files), and data, each ended by a line of ``#``.

Zygo's ASCII files are read here: intensities, then the phase in the integer code of ``.dat``.

Line 4 is the phase frame (x, y, columns, rows), 6 and 7 serial number and part, 8 source, IntfScaleFactor, wavelength
(m), aperture, obliquity, magnification, CameraRes (m a pixel), time; 9 the camera and system; 11 starts with PhaseRes
and has the data's sign as its eighth number.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from polishd.api import MapError, SurfaceMap
from polishd.plugins.interferometer.formats.common import content_of, named, require_data
from polishd.plugins.interferometer.formats.format import Format
from polishd.plugins.interferometer.formats.numbers import block
from polishd.plugins.interferometer.formats.zygo import MISSING, ZygoHeader

HASH = re.compile(rb"^[ \t]*#[ \t\r]*$", re.MULTILINE)
MOST_HEADER = 16_384


@dataclass(frozen=True, slots=True)
class TextFormat(Format):
    """A format whose first line is its magic."""

    def sniff(self, head: bytes, path: Path) -> bool:  # noqa: ARG002  a reader may also judge by name
        """True where the first line is the format's name."""
        return head.lstrip().startswith(self.magic)

    def opened(self, path: Path, smallest: int) -> tuple[bytes, ZygoHeader]:
        """The whole content, and its header. ``smallest``: bytes of the shortest sample, which the frame's must fit.

        BadMap where it is no such file, or a factor or size is out of range.
        """
        content = content_of(path)
        name = self.magic[0].decode()
        if not self.sniff(content[:4096], path):
            kind = name.removesuffix(" Data File")
            raise MapError(f"{path}: no {kind} file: its first line is not '{name} ...'")
        end = HASH.search(content, 0, MOST_HEADER)
        if end is None:
            raise MapError(f"{path}: its header does not end in a line of '#': torn, or another format")
        lines = [line.strip() for line in content[: end.start()].decode("latin-1").split("\n")][:-1]
        if len(lines) not in (13, 14):
            raise MapError(f"{path}: its header has {len(lines)} lines, not 14")
        try:
            header = _fields(lines, end.end())
        except (ValueError, IndexError, OverflowError) as error:
            raise MapError(f"{path}: its header is not Zygo's: {error}") from error
        header.check(path, (len(content) - header.start) / smallest)
        return content, header


def _fields(lines: list[str], end: int) -> ZygoHeader:
    frame = [int(word) for word in lines[3].split()]
    if len(frame) != 4:
        raise ValueError(f"line 4 has {len(frame)} numbers, not 4")
    optics = [float(word) for word in lines[7].split()]
    if len(optics) != 8:
        raise ValueError(f"line 8 has {len(optics)} numbers, not 8")
    phase = [float(word) for word in lines[10].split()]
    return ZygoHeader(
        origin=(frame[0], frame[1]),
        columns=frame[2],
        rows=frame[3],
        serial=named(lines[5].strip('"')),
        part=named(lines[6].strip('"')),
        scale=optics[1],
        wavelength_m=optics[2],
        obliquity=optics[4],
        camera_res_m=optics[6],
        timestamp=optics[7],
        instrument=f"Zygo, system {lines[8].split()[4]}",
        resolution=int(phase[0]),
        sign=int(phase[7]),
        start=end,
    )


def require_end(path: Path, content: bytes, end: int, what: str) -> None:
    """BadMap where anything but blanks follows."""
    if content[end:].strip():
        raise MapError(f"{path}: something follows the end of its {what}: {content[end:].strip()[:20]!r}")


ASCII = TextFormat("zygo_ascii", 1, (b"Zygo ASCII Data File",))


def read(path: Path) -> SurfaceMap:
    """Read a map. BadMap with path and reason for whatever is torn, broken or absurd."""
    content, header = ASCII.opened(path, smallest=2)
    counts = block(path, content, _phase(path, content, header.start), (header.rows, header.columns))
    if (counts != np.trunc(counts)).any():
        raise MapError(f"{path}: its phase holds numbers that are no integers")
    missing = counts >= MISSING
    counts *= header.nm_per_count
    counts[missing] = np.nan
    height_nm = require_data(path, counts)
    return ASCII.surface(path, content, height_nm, factors=header.factors, **header.about(path))


def _phase(path: Path, content: bytes, start: int) -> tuple[int, int]:
    """Where the phase stands: between the line that ends the intensities and the one that ends the file."""
    intensity = HASH.search(content, start)
    phase = HASH.search(content, intensity.end()) if intensity else None
    if intensity is None or phase is None:
        raise MapError(f"{path}: its phase does not end in a line of '#': torn, or still being written")
    require_end(path, content, phase.end(), "phase")
    return intensity.end(), phase.start()


ZYGO_ASCII = ASCII.reader(read, ".asc")
