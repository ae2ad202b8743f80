"""X3P (ISO 25178-72, formerly ISO 5436-2) through x3pio; heights and increments are metres.

The standard's coordinates are right-handed with y growing along the rows, so the first row is the lowest: it is turned.
"""

from __future__ import annotations

import io
import math
import zipfile
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from polishd.api import MapError, SurfaceMap
from polishd.model.surface import FloatArray
from polishd.plugins.interferometer.formats.common import (
    Pitch,
    checked,
    content_of,
    members_of,
    parsing,
    pitch,
    require_size,
    require_stated,
    scaled,
)
from polishd.plugins.interferometer.formats.format import Format, found_in, line_of
from polishd.plugins.interferometer.formats.points import ORIENTATION, grid_points

FORMAT = Format("x3p", 1)
MOST_XML_BYTES = 2**26
NO_DATE, NOT_KNOWN = datetime.fromtimestamp(0, UTC), "not known"
"""Placeholders for required fields: other readers fail on an empty field."""
ROTATED = "its layer is rotated, which is not undone here: how the rows lie is left open"
TURNED = "rows turned upside down: the standard's y grows with the row"


def sniff(head: bytes, path: Path) -> bool:
    """True for a zip archive that is called ``.x3p`` or starts with a member of that format."""
    return head[:4] == b"PK\x03\x04" and (path.suffix.lower() == ".x3p" or head[30:38] == b"main.xml")


def read(path: Path) -> SurfaceMap:
    """Read the one layer of a surface, checksums verified. MapError for profiles, point clouds, several layers."""
    import x3pio

    content = content_of(path)
    _check_sizes(path, content)
    with parsing(path, "x3pio"):
        about = x3pio.info(io.BytesIO(content))
        require_size(path, about.layer_count * about.shape[0], math.prod(about.shape[1:]))
        file = x3pio.read(io.BytesIO(content))
        if not isinstance(file, x3pio.Surface) or len(file.layers) != 1:
            raise MapError(f"{path}: holds a {type(file).__name__} of {len(file.layers)} layers, not one surface")
        height_nm, scale, orientation = _surface(path, file.layers[0])
    rotated = file.layers[0].placement.has_rotation
    made = file.metadata
    history, odd = found_in((made.comment if made else None) or "")
    return FORMAT.surface(
        path,
        content,
        checked(path, height_nm),
        lateral=scale,
        instrument=_instrument(made.instrument) if made else "",
        taken_at=made.date if made and made.date and made.date != NO_DATE else None,
        factors={"nm_per_unit": 1e9, "z_increment": file.header.z.increment},
        doubts={"orientation": ROTATED} if rotated else {},
        warnings=odd,
        orientation=orientation,
        history=history,
    )


def write(surface: SurfaceMap) -> bytes:
    """X3P of float64 metres, NaN where there is no data; MapError for a map that leaves anything open."""
    import x3pio

    require_stated(surface, "pitch", "square pixels")
    if surface.pitch_mm is None:
        raise MapError("an X3P file needs a lateral scale, and this map has none: say it in the instrument's profile")
    comments = [f"part {surface.part_id}" if surface.part_id else None, line_of(surface)]
    metadata = x3pio.Metadata(
        date=surface.measured_at or NO_DATE,
        creator="polishd",
        instrument=x3pio.Instrument(surface.instrument or NOT_KNOWN, *[NOT_KNOWN] * 3),
        probing_system=x3pio.ProbingSystem(x3pio.ProbingType.NON_CONTACTING, "interferometer"),
        comment="\n".join(filter(None, comments)) or None,
    )
    file = io.BytesIO()
    metres = surface.pitch_mm / 1e3
    with parsing(surface.path or Path("the map"), "x3pio"):
        x3pio.write(
            file,
            surface.height_nm[::-1] / 1e9,
            x_scale=metres,
            y_scale=metres,
            metadata=metadata,
            revision=x3pio.Revision.ISO5436_2000,  # which others read too
        )
    return file.getvalue()


def _check_sizes(path: Path, content: bytes) -> None:
    """Refuse what would unpack to more than any map."""
    with parsing(path, "zipfile"), zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = members_of(path, archive)
    text = sum(member.file_size for member in members if not member.filename.endswith(".bin"))
    if text > MOST_XML_BYTES:
        raise MapError(
            f"{path}: unpacks to {text} bytes of text, more than {MOST_XML_BYTES}: write it with binary data"
        )


def _surface(path: Path, layer: object) -> tuple[FloatArray, Pitch, str]:
    """Heights, pitch, and what was done to the rows, of a layer with incremental axes or with coordinates."""
    import x3pio

    if not isinstance(layer, x3pio.SurfaceLayer):
        raise MapError(f"{path}: holds no surface")
    if layer.x is None and layer.y is None:
        scale = pitch(path, layer.header.x.increment * 1e3, layer.header.y.increment * 1e3)
        return scaled(layer.z[::-1], 1e9), scale, TURNED
    points = layer.points().reshape(-1, 3)
    points = points[np.isfinite(points).all(axis=1)]
    found = grid_points(path, points[:, 0], points[:, 1], points[:, 2])
    return scaled(found.z, 1e9), pitch(path, found.pitch_x * 1e3, found.pitch_y * 1e3), ORIENTATION


def _instrument(instrument: object) -> str:
    fields = (getattr(instrument, name, "") for name in ("manufacturer", "model", "serial"))
    return " ".join(field for field in fields if field and field not in {"not available", NOT_KNOWN})


X3P = FORMAT.reader(read, ".x3p", sniff=sniff, write=write)
