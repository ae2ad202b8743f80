"""The header that Zygo's two text formats share: 14 lines (13 in some XYZ files), ended by a line of ``#``.

Line 4 is the phase frame (x, y, columns, rows), 6 and 7 serial number and part, 8 source, IntfScaleFactor, wavelength
(m), aperture, obliquity, magnification, CameraRes (m a pixel), time; 9 the camera and system; 11 starts with PhaseRes
and has the data's sign as its eighth number.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from polishd.api import BadMap
from polishd.plugins.interferometer.formats.common import require_optics, require_size, time_of
from polishd.plugins.interferometer.formats.metropro import RESOLUTION, pitch_mm

HASH = re.compile(rb"^[ \t]*#[ \t\r]*$", re.MULTILINE)
MOST_HEADER = 16_384


@dataclass(frozen=True, slots=True)
class Header:
    """What a header says, as it stands in the file; ``end`` is where the data start."""

    origin: tuple[int, int]
    columns: int
    rows: int
    part: str
    serial: str
    scale: float
    wavelength_m: float
    obliquity: float
    camera_res_m: float
    timestamp: float
    system: str
    resolution: int
    sign: int
    end: int

    @property
    def nm_per_count(self) -> float:
        """Height of one count, sign included."""
        size = self.scale * self.wavelength_m * self.obliquity / RESOLUTION[self.resolution] * 1e9
        return -size if self.sign else size

    def common(self, path: Path) -> dict[str, object]:
        """The fields of a SurfaceMap that both formats take from the header."""
        pitch, warnings = pitch_mm(path, self.camera_res_m)
        return {
            "pitch_mm": pitch,
            "part_id": self.serial or self.part,
            "instrument": f"Zygo, system {self.system}",
            "taken_at": time_of(self.timestamp),
            "path": path,
            "unsaid": frozenset({"pitch"}) if pitch is None else frozenset(),
            "warnings": warnings,
        }


def header_of(path: Path, content: bytes, smallest: int) -> Header:
    """Read the header. ``smallest``: bytes of the shortest sample, by which the frame must fit into the file.

    BadMap where it is no such header, or a factor or size is out of range.
    """
    end = HASH.search(content, 0, MOST_HEADER)
    if end is None:
        raise BadMap(f"{path}: its header does not end in a line of '#': torn, or another format")
    lines = [line.strip() for line in content[: end.start()].decode("latin-1").split("\n")][:-1]
    if len(lines) not in (13, 14):
        raise BadMap(f"{path}: its header has {len(lines)} lines, not 14")
    try:
        header = _fields(lines, end.end())
    except (ValueError, IndexError, OverflowError) as error:
        raise BadMap(f"{path}: its header is not Zygo's: {error}") from error
    require_size(path, header.rows, header.columns, (len(content) - header.end) / smallest)
    optics = {"IntfScaleFactor": header.scale, "Wavelength (m)": header.wavelength_m, "Obliquity": header.obliquity}
    require_optics(path, optics)
    if header.resolution not in RESOLUTION:
        raise BadMap(f"{path}: PhaseRes is {header.resolution}, not 0, 1 or 2: the height's scale is not known")
    return header


def _fields(lines: list[str], end: int) -> Header:
    frame = [int(word) for word in lines[3].split()]
    if len(frame) != 4:
        raise ValueError(f"line 4 has {len(frame)} numbers, not 4")
    optics = [float(word) for word in lines[7].split()]
    if len(optics) != 8:
        raise ValueError(f"line 8 has {len(optics)} numbers, not 8")
    phase = [float(word) for word in lines[10].split()]
    return Header(
        origin=(frame[0], frame[1]),
        columns=frame[2],
        rows=frame[3],
        serial=lines[5].strip('"').strip(),
        part=lines[6].strip('"').strip(),
        scale=optics[1],
        wavelength_m=optics[2],
        obliquity=optics[4],
        camera_res_m=optics[6],
        timestamp=optics[7],
        system=lines[8].split()[4],
        resolution=int(phase[0]),
        sign=int(phase[7]),
        end=end,
    )
