"""Shared by all readers: bounded reading of a file, refusals, and a guard around third-party libraries."""

from __future__ import annotations

import hashlib
import importlib
import math
import os
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple
from zipfile import ZipFile, ZipInfo

import numpy as np
from numpy.typing import NDArray

from polishd.api import MapError, SurfaceMap
from polishd.model.surface import DateFrom, FloatArray
from polishd.process.metrology.conditioning import EARLIEST, is_square, not_square_warning
from polishd.util.extras import missing_message

MOST_BYTES = 2**30
"""No map of a camera is larger."""
MOST_SAMPLES = 64_000_000
ZERO_TAIL, MOST_ZEROS = 16, 0.05
"""So many samples of exactly zero at the very end are not measured where hardly any other is zero: preallocated."""
OPTICS = {"IntfScaleFactor": (0.01, 100.0), "Wavelength (m)": (1e-7, 2e-5), "Obliquity": (0.01, 100.0)}
"""Range of each factor of an interferometer's heights."""
QUOTES = " \t\r\n\0\"'`"


def content_of(path: Path) -> bytes:
    """All bytes of a file; MapError where it cannot be read, is empty, or is larger than any map."""
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
    """The heights, where at least one is a number and none is infinite; MapError otherwise."""
    if height_nm.ndim != 2 or not height_nm.size:
        raise MapError(f"{path}: holds an array of shape {height_nm.shape}, not rows and columns")
    if np.isinf(height_nm).any():
        infinite = np.argwhere(np.isinf(height_nm))
        raise MapError(
            f"{path}: an infinite height in row {infinite[0][0]}, column {infinite[0][1]}, {len(infinite)} in all. "
            "Mark missing data as the format does, and export the map again"
        )
    if np.isnan(height_nm).all():
        raise MapError(f"{path}: no sample holds data")
    return height_nm


def require_end(path: Path, values: NDArray[Any]) -> None:
    """MapError where the last samples, as they lie in memory, are all exactly zero, and hardly any other is.

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
    """MapError where one of the named factors (``OPTICS``) is no number or out of its range."""
    for name, value in factors.items():
        low, high = OPTICS[name]
        if not low <= value <= high:
            raise MapError(f"{path}: {name} is {value:g}, outside {low:g} to {high:g}: the height's scale is not known")


def require_size(path: Path, rows: int, columns: int, most: float = MOST_SAMPLES) -> None:
    """MapError where an array is empty, larger than a camera, or larger than the file can hold (``most`` samples)."""
    if rows <= 0 or columns <= 0:
        raise MapError(f"{path}: has no phase data ({rows} rows x {columns} columns)")
    if rows * columns > MOST_SAMPLES:
        raise MapError(f"{path}: {rows} rows x {columns} columns is no interferometer's camera")
    if rows * columns > most:
        raise MapError(f"{path}: is too short for {rows} rows x {columns} columns: torn, or still being written")


def require_stated(surface: SurfaceMap, *also: str) -> None:
    """MapError where a written file would state an unknown value; ``also`` names values that the format can omit."""
    open_ones = sorted(surface.unsaid - set(also))
    if surface.unscaled_pitches is not None and not is_square(*surface.unscaled_pitches):
        raise MapError(
            f"{surface.path}: its pixels are not square, and the file to be written has no place for that without a "
            "scale. Give the unit of its coordinates (--units, or coordinate_unit_mm in the profile)"
        )
    if "square pixels" in open_ones:
        raise MapError(
            f"{surface.path}: its pixels are not square, and those of the file to be written would be: resample it"
        )
    if open_ones:
        raise MapError(f"{surface.path}: does not state its {' and '.join(open_ones)}, which the new file needs: "
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
    """The members of an archive; MapError where they would unpack to more than any map."""
    members = archive.infolist()
    if sum(member.file_size for member in members) > MOST_BYTES:
        raise MapError(f"{path}: unpacks to more than {MOST_BYTES} bytes: no map of a camera")
    return members


@contextmanager
def parsing(path: Path, library: str) -> Iterator[None]:
    """Turn every error of a third-party library in this block into MapError, and suppress its warnings.

    The readers check lengths, units and checksums themselves.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except MapError:
        raise
    except Exception as error:  # a parser may raise anything at all on a broken file
        reason = str(error).partition("; use `usecols`")[0].strip().rstrip(".") or type(error).__name__
        raise MapError(f"{path}: {library} cannot read it: {reason[:300]}. Export the map again") from error


def extra(path: Path, module: str, name: str) -> Any:
    """Import a module of an optional extra. Raise MapError with the command that installs it where it is missing."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise MapError(f"{path}: {missing_message(f'the format {name}', name)} ({error})") from error


# Units of heights and pitches, and warnings about a map whose file does not state them.

NM_PER = {
    name: nm
    for names, nm in (
        ("m meter metre", 1e9),
        ("cm", 1e7),
        ("mm millimeter millimetre", 1e6),
        ("um micrometer micrometre micron", 1e3),
        ("nm nanometer nanometre", 1.0),
        ("angstrom", 0.1),
        ("pm", 1e-3),
        ("in inch", 2.54e7),
    )
    for name in names.split()
}
MOST_NM = 1e9
"""A metre: a larger value is in another unit, or is an undeclared marker of missing data."""
MARKERS = {9999.0, 99999.0, 999999.0, 32767.0, 32768.0, 2147483647.0, 2147483648.0}
"""Numbers that programs write for missing data, in the unit of their file."""


NOTHING: Mapping[str, str] = {}


class Pitch(NamedTuple):
    """A pitch, or None, and the warnings for each value that the instrument's profile has to supply."""

    mm: float | None
    doubts: Mapping[str, str] = NOTHING
    both_mm: tuple[float, float] | None = None
    """Width and height of a pixel that is not square."""


class HeightUnit(NamedTuple):
    """Size of the height unit in nm, and the warnings for each value that the instrument's profile has to supply."""

    nm: float
    doubts: Mapping[str, str] = NOTHING


SAID = HeightUnit(1.0)
"""Unit of heights whose format or file states it."""
NO_PITCH = Pitch(None, {"pitch": "the file gives no lateral scale"})


def nm_per(unit: str) -> float | None:
    """Size of a length unit in nm, by its usual names; None for an unknown unit."""
    name = unit.strip().strip("[]()").replace("\N{MICRO SIGN}", "u").replace("\N{GREEK SMALL LETTER MU}", "u")
    if name in {"\N{LATIN CAPITAL LETTER A WITH RING ABOVE}", "A", "\N{ANGSTROM SIGN}"}:
        return NM_PER["angstrom"]
    known = NM_PER.get(name)  # as it is first: Mm is no mm
    if known is None and len(name) > 2:
        known = NM_PER.get(name.lower()) or NM_PER.get(name.lower().removesuffix("s"))
    return known


def height_unit(unit: str) -> HeightUnit:
    """The unit of heights. For an unknown or missing unit: 1.0 and a warning; the profile has to supply it."""
    factor = nm_per(unit)
    if factor is not None:
        return HeightUnit(factor)
    found = f"the unit of heights, {unit.strip()!r}, is not known" if unit.strip() else "the heights have no unit"
    return HeightUnit(1.0, {"unit": f"{found}: shown as if nm"})


def pitch(path: Path, x_mm: float, y_mm: float) -> Pitch:
    """The one pitch of square pixels. MapError where either is no length.

    Pixels that are not square keep both: "square pixels" is unsaid until the map is resampled, as conditioning does.
    """
    for axis, value in (("x", x_mm), ("y", y_mm)):
        if not (math.isfinite(value) and value > 0):
            raise MapError(f"{path}: the pitch in {axis} is {value:g} mm, no length")
    if not is_square(x_mm, y_mm):
        return Pitch(None, {"square pixels": not_square_warning(x_mm, y_mm)}, (x_mm, y_mm))
    return Pitch(x_mm / 2 + y_mm / 2)


def is_level(height_nm: FloatArray) -> bool:
    """Whether all valid heights are equal, to the last bit: no instrument measures that."""
    return bool(np.nanmin(height_nm) == np.nanmax(height_nm))


def oddities(height_nm: FloatArray, lateral: Pitch) -> tuple[str, ...]:
    """Warnings of heights that no instrument measures: all are equal, or a slope of neighbours is more than 45 deg."""
    if is_level(height_nm):
        return (f"all {np.count_nonzero(np.isfinite(height_nm))} heights are equal: nothing was measured",)
    pitches_mm = lateral.both_mm or (lateral.mm, lateral.mm)
    for axis, pitch_mm in zip((1, 0), pitches_mm, strict=True):
        if pitch_mm is None or np.nanmax(height_nm) - np.nanmin(height_nm) <= pitch_mm * 1e6:
            continue  # no two can be so far apart
        steps_mm = np.abs(np.diff(height_nm, axis=axis)) / 1e6
        if (worst_mm := float(np.max(steps_mm, where=np.isfinite(steps_mm), initial=0.0))) > pitch_mm:
            found = f"neighbours {pitch_mm:.4g} mm apart differ by up to {worst_mm:.4g} mm"
            return (f"{found}: check the unit of heights, the order of bytes, and how missing data is marked",)
    return ()


def checked(path: Path, height_nm: FloatArray, nm: float = 1.0) -> FloatArray:
    """Return plausible heights; MapError otherwise.

    Heights above ``MOST_NM`` are not plausible, nor is an extreme value that occurs more than once and is one of
    ``MARKERS`` in the file's unit of ``nm``.
    """
    require_data(path, height_nm)
    for worst in (float(np.nanmin(height_nm)), float(np.nanmax(height_nm))):
        marks = abs(round(worst / nm, 6)) in MARKERS and np.count_nonzero(height_nm == worst) > 1
        if marks or abs(worst) > MOST_NM:
            found = f"has heights of {worst / nm:.7g} x {nm:g} nm"
            raise MapError(f"{path}: {found}: a marker of missing data that the file does not declare?")
    return height_nm


# Dates as text, and dates that a library has read; only an exact instant dates a map.

TIMES = ("%H:%M:%S", "%H:%M", "%I:%M:%S %p", "%I:%M %p")
DAYS = ("%m/%d/%Y", "%d/%m/%Y", "%Y/%m/%d", "%d.%m.%Y", "%d %b %Y", "%d-%b-%Y", "%b %d %Y", "%b %d, %Y")
FORMATS = ("%a %b %d %H:%M:%S %Y", *DAYS, *(f"{day} {time}" for day in DAYS for time in TIMES))
"""Both orders of month and day: what only one of them fits is meant."""
NOT_DATED = "its date, {}, {}: the map counts as not dated"


REPEATED = "has no zone, and lies in an hour that the local clocks repeat or leave out"


class Date(NamedTuple):
    """A date, its source, and warnings about it."""

    at: datetime | None = None
    by: DateFrom = "header"
    warnings: tuple[str, ...] = ()


def date_of(text: str, *, utc: bool = False) -> Date:
    """Read a header's date, with a zone; no date where the text is empty.

    A date without a time of day, with two readings, or in an hour that the local clocks repeat, is "guessed"; an
    unreadable date is None. ``utc``: the format defines a date without a zone as UTC.
    """
    words = " ".join(text.split())
    if not words:
        return Date()
    found = {at for form in (None, *FORMATS) if (at := _parsed(words, form))}
    if not found:
        return Date(warnings=(NOT_DATED.format(repr(words[:40]), "is not understood"),))
    first = min(found)
    at = first.replace(tzinfo=UTC) if utc and first.tzinfo is None else _zoned(first)
    if len(found) > 1:
        why = "may have the month or the day first"
    elif ":" not in words:
        why = "gives no time of day"
    elif _is_twice(first) and not utc:
        why = REPEATED
    else:
        return Date(at)
    return Date(at, "guessed", (NOT_DATED.format(repr(words[:40]), why),))


def instant(at: datetime, now: datetime) -> Date:
    """A date read by a library that fills in missing fields: today, midnight and the future count as "guessed".

    ``now``: with the local zone.
    """
    known = _zoned(at)
    if at.date() in {now.date(), now.astimezone(UTC).date()}:
        why = "is today's, as if filled in"
    elif known > now:
        why = "is in the future, as if filled in"
    elif (at.hour, at.minute, at.second) == (0, 0, 0):
        why = "gives no time of day"
    elif _is_twice(at):
        why = REPEATED
    else:
        return Date(known)
    return Date(known, "guessed", (NOT_DATED.format(known.isoformat(), why),))


def _parsed(words: str, form: str | None) -> datetime | None:
    """As it stands; ``form`` None: ISO 8601."""
    try:
        return datetime.fromisoformat(words) if form is None else datetime.strptime(words, form)  # noqa: DTZ007
    except ValueError:
        return None


def _is_twice(at: datetime) -> bool:
    """Whether the local clocks show that time twice, or never: in autumn an hour is repeated."""
    return at.tzinfo is None and _zoned(at) != _zoned(at.replace(fold=1))


def _zoned(at: datetime) -> datetime:
    try:
        return at if at.tzinfo else at.astimezone()
    except (OverflowError, ValueError, OSError):  # at the ends of what a date can hold: none of a map
        return at.replace(tzinfo=UTC)


# Numbers in a text, piece by piece, to limit the memory to the array that they fill.

PIECE = 2**16
LONGEST = 4096
"""No number, and no line of a point, is longer."""
OF_NUMBERS = b"0123456789+-.eE \t\r\n"


def pieces(path: Path, content: bytes, span: tuple[int, int], ends: tuple[bytes, ...]) -> Iterator[bytes]:
    """Parts of ``content[span]`` of about ``PIECE`` bytes, each ended by one of ``ends``; MapError where none comes."""
    start, stop = span
    while start < stop:
        near = min(start + PIECE, stop)
        found = [content.find(end, near, near + LONGEST) for end in ends]
        cuts = [cut + 1 for cut in found if cut >= 0]
        if not cuts and near + LONGEST < stop:
            raise MapError(f"{path}: holds {LONGEST} bytes in a row that are no number: not this format, or broken")
        cut = min(cuts) if cuts and near < stop else stop
        yield content[start:cut]
        start = cut


def floats(path: Path, text: bytes, but: bytes = b"") -> FloatArray:
    """The numbers of a piece, (n,); MapError for anything else. ``but``: further bytes that may stand there ("nan")."""
    foreign = text.translate(None, OF_NUMBERS + but)
    if foreign:
        raise MapError(f"{path}: {foreign[:20]!r} stands among its numbers")
    try:
        return np.array(text.split(), dtype=np.float64)
    except ValueError as error:
        raise MapError(f"{path}: {error}") from error


def block(path: Path, content: bytes, span: tuple[int, int], shape: tuple[int, int]) -> FloatArray:
    """The ``shape`` numbers of a span of the text, however they are wrapped; MapError for more, fewer or infinite."""
    values = np.empty(shape[0] * shape[1])
    filled = 0
    for piece in pieces(path, content, span, (b"\n", b" ", b"\t")):
        found = floats(path, piece)
        if filled + found.size <= values.size:
            values[filled : filled + found.size] = found
        filled += found.size
    if filled != values.size:
        state = "torn, or still being written" if filled < values.size else "more than its header asks for"
        raise MapError(f"{path}: has {filled} values of {shape[0]} rows x {shape[1]} columns: {state}")
    if not np.isfinite(values).all():
        raise MapError(f"{path}: {np.count_nonzero(~np.isfinite(values))} values are no numbers")
    return values.reshape(shape)
