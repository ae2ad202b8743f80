"""Gwyddion's .gwy: the first channel's data field, and its mask, through gwyfile.

gwyfile copies what is left of a file for every component and recurses into objects. So the top level is walked here,
in place and within bounds, and only the two objects that are wanted are handed to it.
"""

from __future__ import annotations

import re
import struct
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from polishd.api import MapError, SurfaceMap
from polishd.plugins.interferometer.formats.common import (
    MOST_SAMPLES,
    NO_PITCH,
    Pitch,
    checked,
    content_of,
    extra,
    height_unit,
    nm_per,
    parsing,
    pitch,
    scaled,
)
from polishd.plugins.interferometer.formats.format import Format

FORMAT = Format("gwy", 1, (b"GWYPGwyContainer\0",))
FIXED = {"b": 1, "c": 1, "i": 4, "q": 8, "d": 8}
ITEM = {"C": 1, "I": 4, "Q": 8, "D": 8}
MOST_COMPONENTS = 4096
MOST_IN_FIELD = 64
MOST_SMALL = 4096
"""Bytes that a data field holds besides its samples: numbers, and two units."""


class GwyComponent(NamedTuple):
    """A component: its type letter and where its value stands in the file."""

    type: str
    start: int
    end: int


def read(path: Path) -> SurfaceMap:
    """Read the channel of the lowest number. MapError without gwyfile, and for whatever is torn or holds no channel."""
    gwyfile = extra(path, "gwyfile.objects", "gwy")
    content = content_of(path)
    if not FORMAT.sniff(content, path):
        raise MapError(f"{path}: no Gwyddion file: it starts with {content[:4].hex(' ')}")
    parts = _components(path, content, 4, len(content), MOST_COMPONENTS)
    channels = sorted(int(found[1]) for name in parts if (found := re.fullmatch(r"/(\d{1,6})/data", name)))
    if not channels:
        raise MapError(f"{path}: holds no channel: {', '.join(list(parts)[:10]) or 'nothing'}")
    key = f"/{channels[0]}"
    field = _field(path, gwyfile, content, parts[f"{key}/data"])
    height = height_unit(_unit(field, "si_unit_z"))
    lateral = _pitch(path, field)
    height_nm = scaled(field.data, height.nm)
    warnings = []
    if len(channels) > 1:
        warnings.append(f"channel {channels[0]} of {', '.join(map(str, channels))} is taken")
    if f"{key}/mask" in parts:
        mask = _field(path, gwyfile, content, parts[f"{key}/mask"]).data
        if mask.shape != height_nm.shape:
            raise MapError(f"{path}: the mask is {mask.shape}, the data {height_nm.shape}")
        height_nm[mask > 0] = np.nan
        warnings.append(f"{int((mask > 0).sum())} samples under Gwyddion's mask are taken as missing")
    return FORMAT.surface(
        path,
        content,
        checked(path, height_nm, height.nm),
        height=height,
        lateral=lateral,
        factors={"nm_per_unit": height.nm, "channel": channels[0]},
        warnings=tuple(warnings),
        orientation="as stored: Gwyddion's row 0 is the top",
    )


def _components(path: Path, content: bytes, start: int, end: int, most: int) -> dict[str, GwyComponent]:
    """The components of the object at ``start`` by name; MapError unless they fill it exactly."""
    name_end = content.find(b"\0", start, start + 64)
    if name_end < 0 or name_end + 5 > end:
        raise MapError(f"{path}: torn at byte {start}: no object")
    (size,) = struct.unpack_from("<I", content, name_end + 1)
    at, stop = name_end + 5, name_end + 5 + size
    if stop != end:
        raise MapError(f"{path}: an object of {size} bytes where there are {end - at}: torn, or still being written")
    parts: dict[str, GwyComponent] = {}
    while at < stop:
        name_end = content.find(b"\0", at, min(at + 1024, stop))
        if name_end < 0 or len(parts) == most:
            raise MapError(f"{path}: broken at byte {at}: no component, or more than {most}")
        kind = content[name_end + 1 : name_end + 2].decode("latin-1")
        value_end = _value_end(content, kind, name_end + 2, stop)
        if value_end is None:
            raise MapError(f"{path}: broken at byte {name_end + 2}: a value of type {kind!r} ends outside its object")
        parts[content[at:name_end].decode("utf-8", "replace")] = GwyComponent(kind, name_end + 2, value_end)
        at = value_end
    return parts


def _value_end(content: bytes, kind: str, at: int, stop: int) -> int | None:
    """Where a value ends; None where it is of no known type or not inside its object."""
    if kind in FIXED:
        end = at + FIXED[kind]
    elif kind == "s":
        end = content.find(b"\0", at, stop) + 1
    elif kind in ITEM and at + 4 <= stop:
        end = at + 4 + ITEM[kind] * struct.unpack_from("<I", content, at)[0]
    elif kind == "o" and (name_end := content.find(b"\0", at, min(at + 64, stop))) >= 0 and name_end + 5 <= stop:
        end = name_end + 5 + struct.unpack_from("<I", content, name_end + 1)[0]
    elif kind in {"S", "O"} and at + 4 <= stop:
        end = at + 4
        for _ in range(min(struct.unpack_from("<I", content, at)[0], stop - at)):
            following = _value_end(content, kind.lower(), end, stop)
            if following is None:
                return None
            end = following
    else:
        return None
    return end if at < end <= stop else None


def _field(path: Path, gwyfile: Any, content: bytes, part: GwyComponent) -> Any:
    """The data field, by gwyfile, of a component whose numbers were checked."""
    if part.type != "o" or not content.startswith(b"GwyDataField\0", part.start):
        raise MapError(f"{path}: its channel is no data field")
    inner = _components(path, content, part.start, part.end, MOST_IN_FIELD)
    samples = inner.get("data")
    if samples is None or samples.type != "D":
        raise MapError(f"{path}: its data field has no samples")
    small = part.end - part.start - (samples.end - samples.start)
    # gwyfile does not look where a value ends: a broken one sends it round and round
    nested = [value for value in inner.values() if value.type == "o"]
    units = [_components(path, content, unit.start, unit.end, MOST_IN_FIELD) for unit in nested]
    lists = {value.type for value in inner.values()} & {"S", "O"}
    if small > MOST_SMALL or lists or {value.type for unit in units for value in unit.values()} - {"s"}:
        raise MapError(f"{path}: its data field holds more than its samples and their units")
    with parsing(path, "gwyfile"):
        field = gwyfile.GwyObject.frombuffer(content[part.start : part.end])
        size = (int(field["yres"]), int(field["xres"]))
        if min(size) < 1 or size[0] * size[1] > MOST_SAMPLES or size[0] * size[1] != field["data"].size:
            raise MapError(f"{path}: {size[0]} x {size[1]} samples are stated, and {field['data'].size} there")
        return field


def _unit(field: Any, name: str) -> str:
    unit = field.get(name)
    text = unit.get("unitstr", "") if hasattr(unit, "get") else ""
    if not isinstance(text, str):
        return ""
    return "ampere" if text.strip() == "A" else text  # elsewhere it is the angstrom


def _pitch(path: Path, field: Any) -> Pitch:
    factor = nm_per(_unit(field, "si_unit_xy"))
    sizes = (field.get("xreal"), field.get("yreal"))
    if factor is None or not all(isinstance(size, float) for size in sizes):
        return NO_PITCH
    return pitch(path, sizes[0] / field["xres"] * factor / 1e6, sizes[1] / field["yres"] * factor / 1e6)


GWY = FORMAT.reader(read, ".gwy", dates=False)
