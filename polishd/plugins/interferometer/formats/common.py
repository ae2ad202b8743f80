"""What all readers share: a file's whole content within bounds, refusals, and somebody else's library within them."""

from __future__ import annotations

import hashlib
import importlib
import os
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from zipfile import ZipFile, ZipInfo

import numpy as np
from numpy.typing import NDArray

from polishd.api import MapError, SurfaceMap
from polishd.model.surface import FloatArray
from polishd.process.plausible import EARLIEST

MOST_BYTES = 2**30
"""No map of a camera is larger."""
MOST_SAMPLES = 64_000_000
ZERO_TAIL, MOST_ZEROS = 16, 0.05
"""So many samples of exactly zero at the very end are not measured where hardly any other is zero: preallocated."""
OPTICS = {"IntfScaleFactor": (0.01, 100.0), "Wavelength (m)": (1e-7, 2e-5), "Obliquity": (0.01, 100.0)}
"""What the factors of an interferometer's heights may be."""
QUOTES = " \t\r\n\0\"'`"


def content_of(path: Path) -> bytes:
    """All bytes of a file; BadMap where it cannot be read, is empty, or is larger than any map."""
    try:
        with path.open("rb") as file:
            # what is asked for is allocated first: no more than there is
            content = file.read(min(os.fstat(file.fileno()).st_size, MOST_BYTES) + 1)
    except OSError as error:
        raise MapError(f"{path}: cannot be read: {error.strerror}") from error
    if not content:
        raise MapError(f"{path}: the file is empty")
    if len(content) > MOST_BYTES:
        raise MapError(f"{path}: is larger than {MOST_BYTES} bytes: no map of a camera")
    return content


def sha256_of(content: bytes) -> str:
    """Hash under which a map is known."""
    return hashlib.sha256(content).hexdigest()


def require_data(path: Path, height_nm: FloatArray) -> FloatArray:
    """The heights, where at least one is a number and none is infinite; BadMap otherwise."""
    if height_nm.ndim != 2 or not height_nm.size:
        raise MapError(f"{path}: holds an array of shape {height_nm.shape}, not rows and columns")
    if np.isinf(height_nm).any():
        raise MapError(f"{path}: {np.count_nonzero(np.isinf(height_nm))} samples are infinite")
    if np.isnan(height_nm).all():
        raise MapError(f"{path}: no sample holds data")
    return height_nm


def require_end(path: Path, values: NDArray[Any]) -> None:
    """BadMap where the last samples, as they lie in memory, are all exactly zero, and hardly any other is.

    A map on a background of zeros, as programs make them, has zeros elsewhere too.
    """
    flat = values.ravel("K")
    if flat.size <= ZERO_TAIL or flat[-ZERO_TAIL:].any():
        return
    end = flat.size - int(np.argmax(flat[::-1] != 0)) if flat.any() else 0
    if end - np.count_nonzero(flat) <= MOST_ZEROS * end:
        raise MapError(f"{path}: ends in a tail of zeros: preallocated, and not written to its end")


def scaled(values: NDArray[Any], nm_per_unit: float) -> FloatArray:
    """A float64 copy of the values in nm; what is too large for it is infinite, and refused by ``require_data``."""
    with np.errstate(over="ignore", invalid="ignore"):
        height_nm: FloatArray = np.array(values, dtype=np.float64, order="C")
        height_nm *= nm_per_unit
    return height_nm


def require_optics(path: Path, factors: Mapping[str, float]) -> None:
    """BadMap where one of the named factors (``OPTICS``) is no number or out of its range."""
    for name, value in factors.items():
        low, high = OPTICS[name]
        if not low <= value <= high:
            raise MapError(f"{path}: {name} is {value:g}, outside {low:g} to {high:g}: the height's scale is not known")


def require_size(path: Path, rows: int, columns: int, most: float = MOST_SAMPLES) -> None:
    """BadMap where an array is empty, larger than a camera, or larger than the file can hold (``most`` samples)."""
    if rows <= 0 or columns <= 0:
        raise MapError(f"{path}: has no phase data ({rows} rows x {columns} columns)")
    if rows * columns > MOST_SAMPLES:
        raise MapError(f"{path}: {rows} rows x {columns} columns is no interferometer's camera")
    if rows * columns > most:
        raise MapError(f"{path}: is too short for {rows} rows x {columns} columns: torn, or still being written")


def require_stated(surface: SurfaceMap, *also: str) -> None:
    """BadMap where a written file would say what nobody knows; ``also`` names what that format can leave open."""
    open_ones = sorted(surface.unsaid - set(also))
    if "square pixels" in open_ones:
        raise MapError(
            f"{surface.path}: its pixels are not square, and those of the file to be written would be: resample it"
        )
    if open_ones:
        raise MapError(f"{surface.path}: does not say its {' and '.join(open_ones)}, and the file to be written would: "
                     "read it with the instrument's profile")  # fmt: skip


def time_of(seconds: float) -> datetime | None:
    """The instant of a time stamp in seconds since 1970; None for what is no time a map was measured at."""
    try:
        return datetime.fromtimestamp(seconds, UTC) if seconds >= EARLIEST.timestamp() else None
    except (OverflowError, ValueError, OSError):
        return None


def named(text: str) -> str:
    """A name as it stands, without blanks around it; "" for one of nothing but quotation marks and blanks."""
    return text.strip() if text.strip(QUOTES) else ""


def members_of(path: Path, archive: ZipFile) -> list[ZipInfo]:
    """The members of an archive; BadMap where they would unpack to more than any map."""
    members = archive.infolist()
    if sum(member.file_size for member in members) > MOST_BYTES:
        raise MapError(f"{path}: unpacks to more than {MOST_BYTES} bytes: no map of a camera")
    return members


@contextmanager
def parsing(path: Path, library: str) -> Iterator[None]:
    """Turn everything that somebody else's library raises in this block into BadMap; its warnings go unheard.

    What a warning would be about (lengths, units, checksums) the readers check themselves.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except MapError:
        raise
    except Exception as error:  # a parser may raise anything at all on a broken file
        reason = str(error).strip() or type(error).__name__
        raise MapError(f"{path}: {library} cannot read it: {reason[:300]}") from error


def extra(path: Path, module: str, name: str) -> Any:
    """The module of an optional extra; BadMap with the command that installs it where it is not there."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise MapError(f"{path}: needs the extra: pip install 'polishd[{name}]' ({error})") from error
