"""Input files of the physics: tables of numbers, measured TIFs. Each error names file, line and column."""

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
from polishd.util.files import read_input

PLACE = ("x_mm", "y_mm", "z_mm")
TIF_KEYS = ("rate_nm_s", "pitch_mm", "azimuth_deg", "depth_ratio", "rotates")


def read_columns(path: Path, names: Sequence[str], optional: Sequence[str] = ()) -> dict[str, FloatArray]:
    """Read columns (n,) of a CSV file with a header line; ``#`` starts a comment line. Other columns are ignored.

    Raises ConfigError ``FILE:LINE: ...`` for a file that cannot be read, a missing or repeated column, or an entry that
    is not a finite number.
    """
    entries = _entries(path, names, optional)
    wanted = [*names, *(name for name in optional if any(name in given for _, given in entries))]
    values = [[_number(place, name, given.get(name)) for name in wanted] for place, given in entries]
    return dict(zip(wanted, np.array(values, dtype=np.float64).T, strict=True))


def read_positions(path: Path) -> dict[str, tuple[float, float]]:
    """Read positions of maps on a part: CSV with ``file`` (its name, without folders), ``x_mm, y_mm``.

    Raises ConfigError ``FILE:LINE: ...`` as ``read_columns`` does, and for an empty or repeated name.
    """
    return {name: (x, y) for name, (x, y) in _by_file(path, PLACE[:2]).items()}


def read_poses(path: Path) -> dict[str, tuple[float, float, float]]:
    """Read poses of a part in maps: CSV with ``file``, ``angle_deg`` and, if it was shifted, ``x_mm, y_mm``.

    Raises ConfigError as ``read_positions`` does.
    """
    found = _by_file(path, ("angle_deg",), PLACE[:2])
    return {name: (angle, x, y) for name, (angle, x, y) in found.items()}


def _by_file(path: Path, names: Sequence[str], optional: Sequence[str] = ()) -> dict[str, list[float]]:
    """Return the numbers of each line by its ``file``; a missing or empty optional column is 0."""
    found: dict[str, list[float]] = {}
    for place, given in _entries(path, ("file", *names), optional):
        file = (given.get("file") or "").strip()
        if not file or file in found:
            problem = f"{file} is repeated" if file else "file is empty"
            raise ConfigError(f"{place}: {problem}; write each map's file name once")
        found[file] = [_number(place, name, given.get(name)) for name in names]
        found[file] += [_number(place, name, given.get(name) or "0") for name in optional]
    return found


def _entries(path: Path, names: Sequence[str], optional: Sequence[str] = ()) -> list[tuple[str, dict[str, str]]]:
    """Return ``FILE:LINE`` and the entries by column of each line after the header, which has all ``names``."""
    try:
        text = read_input(path).decode("utf-8-sig")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}; name a CSV file") from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: is not UTF-8 text (byte {error.start}); save it as UTF-8") from error
    rows = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip(" ,;\t")]
    rows = [(number, line) for number, line in rows if not line.lstrip().startswith("#")]
    if len(rows) < 2:
        raise ConfigError(f"{path}: has no table; write a line of column names ({', '.join(names)}), then numbers")
    header = [name.strip() for name in next(csv.reader([rows[0][1]]))]
    for name in (*names, *optional):
        if header.count(name) > 1:
            raise ConfigError(f"{path}:{rows[0][0]}: there are {header.count(name)} columns {name!r}; keep one")
    for name in names:
        if name not in header:
            raise ConfigError(
                f"{path}:{rows[0][0]}: the column {name!r} is missing{did_you_mean(name, header)} There are: "
                f"{join_words(header)}. Add the column, or correct its name"
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
        shown = "missing" if given is None else repr(given.strip())
        raise ConfigError(f"{place}: {name} is {shown}; write a finite number")
    return value


def read_polygon(path: Path, names: tuple[str, str] = PLACE[:2]) -> Polygon:
    """Read a polygon: CSV of corners in order around it, in the columns ``names``. Raise ConfigError if it is none."""
    columns = read_columns(path, names)
    try:
        return polygon(np.column_stack([columns[name] for name in names]))
    except ComputeError as error:
        raise ConfigError(f"{path}: {error}") from error


def read_compliance_table(path: Path) -> MeasuredCompliance:
    """Read a measured compliance map: CSV, ``x_mm, y_mm, z_mm`` (robot's base frame) and ``compliance_um_per_n``."""
    columns = read_columns(path, (*PLACE, "compliance_um_per_n"))
    place = np.column_stack([columns[name] for name in PLACE])
    return MeasuredCompliance(place, columns["compliance_um_per_n"], str(path))


def read_tif(path: Path) -> MeasuredTif:
    """Read a TIF as ``tif_bytes`` makes it; raise ConfigError for any other file."""
    try:
        with np.load(io.BytesIO(read_input(path)), allow_pickle=False) as stored:
            rate, *rest = (stored[key] for key in TIF_KEYS)
            pitch, azimuth, ratio, rotates = (value.item() for value in rest)
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise ConfigError(f"{path}: is not a measured TIF ({error}); make one with polishd calibrate tif") from error
    tif = MeasuredTif(np.asarray(rate, dtype=np.float64), float(pitch), float(azimuth), float(ratio), bool(rotates))
    whole = tif.rate_nm_s.ndim == 2 and np.isfinite(tif.rate_nm_s).all() and tif.rate_nm_s.sum() > 0
    if not (whole and tif.pitch_mm > 0 and tif.depth_ratio > 0 and math.isfinite(tif.azimuth_deg)):
        raise ConfigError(f"{path}: the TIF is zero or not finite; make a new one with polishd calibrate tif")
    return tif


def tif_bytes(tif: MeasuredTif) -> bytes:
    """Return the content of a TIF file."""
    buffer = io.BytesIO()
    np.savez(buffer, **{key: getattr(tif, key) for key in TIF_KEYS})
    return buffer.getvalue()
