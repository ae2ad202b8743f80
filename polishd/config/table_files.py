"""Files that the physics is fed with: tables of numbers, measured TIFs. Each fault names file, line and column."""

from __future__ import annotations

import csv
import io
import math
import zipfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from polishd.config.toml_loader import did_you_mean, join_words
from polishd.model.errors import ComputeError, ConfigError
from polishd.model.outline import Polygon, polygon
from polishd.model.process import MeasuredCompliance, MeasuredTif
from polishd.model.surface import FloatArray
from polishd.util.files import write_atomic

PLACE = ("x_mm", "y_mm", "z_mm")
TIF_KEYS = ("rate_nm_s", "pitch_mm", "azimuth_deg", "depth_ratio", "rotates")


def read_columns(path: Path, names: Sequence[str], optional: Sequence[str] = ()) -> dict[str, FloatArray]:
    """Columns (n,) of a CSV file with a header line; ``#`` starts a comment line. Others of its columns are ignored.

    Raises ConfigError ``FILE:LINE: ...`` for a file that cannot be read, a column that is missing or stands twice, or
    an entry that is no finite number.
    """
    entries = _entries(path, names, optional)
    wanted = [*names, *(name for name in optional if any(name in given for _, given in entries))]
    values = [[_number(place, name, given.get(name)) for name in wanted] for place, given in entries]
    return dict(zip(wanted, np.array(values, dtype=np.float64).T, strict=True))


def read_positions(path: Path) -> dict[str, tuple[float, float]]:
    """Where files lie on a part: CSV with ``file`` (its name, without folders), ``x_mm, y_mm``.

    Raises ConfigError ``FILE:LINE: ...`` as ``read_columns`` does, and for a name that is empty or stands twice.
    """
    return {name: (x, y) for name, (x, y) in _by_file(path, PLACE[:2]).items()}


def read_poses(path: Path) -> dict[str, tuple[float, float, float]]:
    """How a part lay in files: CSV with ``file``, ``angle_deg`` and, where it was shifted, ``x_mm, y_mm``.

    Raises ConfigError as ``read_positions`` does.
    """
    found = _by_file(path, ("angle_deg",), PLACE[:2])
    return {name: (angle, x, y) for name, (angle, x, y) in found.items()}


def _by_file(path: Path, names: Sequence[str], optional: Sequence[str] = ()) -> dict[str, list[float]]:
    """Numbers of each line by its ``file``; an optional column that is not there, or empty, is 0."""
    found: dict[str, list[float]] = {}
    for place, given in _entries(path, ("file", *names), optional):
        file = (given.get("file") or "").strip()
        if not file or file in found:
            told = f"{file} stands there a second time" if file else "file is empty"
            raise ConfigError(f"{place}: {told}; write each map's file name once")
        found[file] = [_number(place, name, given.get(name)) for name in names]
        found[file] += [_number(place, name, given.get(name) or "0") for name in optional]
    return found


def _entries(path: Path, names: Sequence[str], optional: Sequence[str] = ()) -> list[tuple[str, dict[str, str]]]:
    """Of each line behind the header ``FILE:LINE`` and its entries by column; the header has all ``names``."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}; name a CSV file") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: is not UTF-8 text (byte {error.start}); save it as UTF-8") from error
    rows = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip(" ,;\t")]
    rows = [(number, line) for number, line in rows if not line.lstrip().startswith("#")]
    if len(rows) < 2:
        raise ConfigError(f"{path}: holds no table; write a line of column names ({', '.join(names)}), then numbers")
    header = [name.strip() for name in next(csv.reader([rows[0][1]]))]
    for name in (*names, *optional):
        if header.count(name) > 1:
            raise ConfigError(
                f"{path}:{rows[0][0]}: the column {name!r} stands there {header.count(name)} times; keep one"
            )
    for name in names:
        if name not in header:
            raise ConfigError(
                f"{path}:{rows[0][0]}: the column {name!r} is missing{did_you_mean(name, header)} There are: "
                f"{join_words(header)}"
            )
    return [
        (f"{path}:{number}", dict(zip(header, next(csv.reader([line])), strict=False))) for number, line in rows[1:]
    ]


def _number(place: str, name: str, given: str | None) -> float:
    try:
        value = float(given or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        told = "nothing" if given is None else repr(given.strip())
        raise ConfigError(f"{place}: {name} is {told}, it must be a finite number")
    return value


def read_polygon(path: Path, names: tuple[str, str] = PLACE[:2]) -> Polygon:
    """Corners in order around it: CSV with ``x_mm, y_mm``, or what else ``names`` has; ConfigError where it is none."""
    columns = read_columns(path, names)
    try:
        return polygon(np.column_stack([columns[name] for name in names]))
    except ComputeError as error:
        raise ConfigError(f"{path}: {error}") from error


def read_compliance_table(path: Path) -> MeasuredCompliance:
    """A measured compliance map: CSV with ``x_mm, y_mm, z_mm`` (robot's base frame) and ``compliance_um_per_n``."""
    columns = read_columns(path, (*PLACE, "compliance_um_per_n"))
    place = np.column_stack([columns[name] for name in PLACE])
    return MeasuredCompliance(place, columns["compliance_um_per_n"], str(path))


def read_tif(path: Path) -> MeasuredTif:
    """A TIF as ``write_tif`` writes it; ConfigError where it is not one."""
    try:
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as stored:
            rate, *rest = (stored[key] for key in TIF_KEYS)
            pitch, azimuth, ratio, rotates = (value.item() for value in rest)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise ConfigError(f"{path}: is no measured TIF ({error}); make one with polishd calibrate tif") from error
    tif = MeasuredTif(np.asarray(rate, dtype=np.float64), float(pitch), float(azimuth), float(ratio), bool(rotates))
    whole = tif.rate_nm_s.ndim == 2 and np.isfinite(tif.rate_nm_s).all() and tif.rate_nm_s.sum() > 0
    if not (whole and tif.pitch_mm > 0 and tif.depth_ratio > 0 and math.isfinite(tif.azimuth_deg)):
        raise ConfigError(f"{path}: this TIF removes nothing or is not finite; make it anew with polishd calibrate tif")
    return tif


def write_tif(path: Path, tif: MeasuredTif) -> None:
    """Write a TIF whole: an npz file of arrays, readable with numpy alone."""
    write_atomic(path, tif_bytes(tif))


def tif_bytes(tif: MeasuredTif) -> bytes:
    """What stands in such a file."""
    buffer = io.BytesIO()
    np.savez(buffer, **{key: getattr(tif, key) for key in TIF_KEYS})
    return buffer.getvalue()
