"""``polishd map convert``: write a map in another format, and read it back before the file appears."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import typer

from polishd.maps.map_files import MapSource, history_step, mask_lines, mask_records, printable, uncertainty_nm
from polishd.maps.options import WriteOptions
from polishd.model.errors import ConfigError, MapError, SurfaceError
from polishd.model.surface import SurfaceMap
from polishd.process.metrology.instrument import same_system
from polishd.rendering.terminal import emit
from polishd.util.files import require_new_file, require_writable_file, write_atomic

WITHIN_NM = 0.01
"""Largest change of a height by the rounding of a format ..."""
WITHIN = 1e-6
"""... or this share of the PV, where that is more. A pitch may change by the same share."""


def convert_verb(file: Path, target: Path, asked: WriteOptions, *, as_json: bool) -> None:
    """Write a map to ``target``, in the format of its ending; write nothing where anything is refused."""
    source = MapSource.by(asked)
    require_target(target, [file], source, force=asked.force)
    surface = source.read(file)
    answer = {"path": str(file), "format": surface.format, "masks": mask_records(surface)}
    answer |= store(
        history_step(surface, "convert", [("map", surface)], source, uncertainty_nm(surface)), target, source
    )
    lines = [*mask_lines([printable(file.name)], [answer]), *stored_lines(answer)]
    emit(answer, as_json=as_json, lines=lines)


def require_target(target: Path, files: Sequence[Path], source: MapSource, *, force: bool) -> None:
    """Refuse an invalid ``target`` before anything is read.

    Raises:
        BadParameter: its ending is of no format that can be written.
        ConfigError: it is one of the files that are read, is there and may not be replaced, or cannot be written.
    """
    _writer(target, source)
    if target.exists() and any(file.exists() and target.samefile(file) for file in files):
        raise ConfigError(f"{target}: is the map that is read; name another file")
    require_new_file(target, force=force)
    require_writable_file(target)


def _writer(target: Path, source: MapSource) -> tuple[str, Callable[[SurfaceMap], bytes]]:
    """Format of a file's ending, and its writer."""
    asked = reversed([*source.readers.values()])  # as in reading, the first of two formats for one ending counts
    writers = {suffix: (reader.name, reader.write) for reader in asked if reader.write for suffix in reader.suffixes}
    writer = writers.get(target.suffix.lower())
    if writer is None:
        raise typer.BadParameter(
            f"{printable(target)}: the ending says the format, one of {', '.join(sorted(writers))}"
        )
    return writer


def store(surface: SurfaceMap, target: Path, source: MapSource) -> dict[str, Any]:
    """Write a map completely or not at all, after a read-back check; return notes."""
    name, write = _writer(target, source)
    try:
        content = write(surface)
    except SurfaceError as error:
        raise MapError(f"{target}: {name} cannot hold this map: {error}") from error
    back = _read_back(content, target, source)
    change_nm = require_same(surface, back, target)
    try:
        write_atomic(target, content)
    except OSError as error:
        raise ConfigError(f"{target}: cannot be written: {error.strerror}; name another file") from error
    return {
        "out": str(target),
        "out_format": back.format,
        "bytes": len(content),
        "sha256": back.sha256,
        "largest_change_nm": change_nm,
        "notes": _notes(surface, back, profiled=source.instrument is not None),
    }


def require_same(surface: SurfaceMap, back: SurfaceMap, target: Path) -> float:
    """Largest change of a height, nm; MapError where the written file reads back as another map or states more."""
    if back.height_nm.shape != surface.height_nm.shape or not np.array_equal(back.valid, surface.valid):
        raise MapError(f"{target}: the format does not hold the map's shape or its missing samples; take another")
    pitch, other = surface.pitch_mm, back.pitch_mm
    if (pitch is None) != (other is None) or not np.isclose(pitch or 0.0, other or 0.0, rtol=WITHIN, atol=0.0):
        raise MapError(f"{target}: the format does not hold a pitch of {pitch} mm, but {other}; take another")
    invented = sorted(surface.unsaid - back.unsaid)
    if invented:
        raise MapError(
            f"{target}: the map does not say its {' and '.join(invented)}, and in this format would seem to; "
            "give the instrument's --profile"
        )
    heights = surface.height_nm[surface.valid]
    change = float(np.abs(back.height_nm[surface.valid] - heights).max())
    if not change <= max(WITHIN_NM, WITHIN * float(np.ptp(heights))):
        raise MapError(f"{target}: heights would change by up to {change:.3g} nm in this format; take another")
    return change


def _read_back(content: bytes, target: Path, source: MapSource) -> SurfaceMap:
    """Read the file that is about to be written."""
    with tempfile.TemporaryDirectory(prefix="polishd-map-") as scratch:
        trial = Path(scratch) / f"map{target.suffix.lower()}"
        trial.write_bytes(content)
        try:
            return MapSource(source.readers, tuple(source.readers.values())).read(trial)
        except SurfaceError as error:
            raise MapError(f"{target}: what would be written does not read back: {error}") from error


def _notes(surface: SurfaceMap, back: SurfaceMap, *, profiled: bool) -> list[str]:
    named = {
        "part": "part_id",
        "instrument": "instrument",
        "time of measurement": "measured_at",
        "fiducials": "fiducials_px",
        "history": "history",
    }
    lost = [word for word, key in named.items() if getattr(surface, key) and not _alike(surface, back, key)]
    notes = [f"the format does not keep the {', '.join(lost)}"] if lost else []
    if profiled:
        notes.append("the profile is in it now: applied once more it would turn and scale the map twice")
    return notes


def _alike(surface: SurfaceMap, back: SurfaceMap, key: str) -> bool:
    before, after = getattr(surface, key), getattr(back, key)
    if key == "instrument":
        return same_system(before, after)
    if key == "measured_at":
        return after is not None and abs((after - before).total_seconds()) < 1
    if key == "fiducials_px":
        return len(before) == len(after) and bool(np.allclose(before, after, atol=0.01))
    return bool(before == after)


def stored_lines(answer: Mapping[str, Any]) -> list[str]:
    """Lines about the file, for people."""
    changed = f"heights within {answer['largest_change_nm']:.2g} nm" if answer["largest_change_nm"] else "heights exact"
    return [
        f"written to {printable(answer['out'])} ({answer['out_format']}, {answer['bytes']} bytes); read back: "
        + changed,
        *(f"note: {note}" for note in answer["notes"]),
    ]
