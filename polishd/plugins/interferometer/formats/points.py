"""Lists of points, one x y z a line: .csv, .xyz, .txt; separated by commas, semicolons, tabs or blanks.

A line of names before the first point may give the order and units: ``x_mm,y_mm,z_nm`` or ``X [mm]; Y [mm]; Z [um]``.
"""

from __future__ import annotations

import io
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from polishd.api import MapError, SurfaceMap
from polishd.model.surface import IN_UNITS, FloatArray
from polishd.plugins.interferometer.formats.common import (
    NO_PITCH,
    Pitch,
    checked,
    content_of,
    height_unit,
    nm_per,
    pitch,
    require_size,
    scaled,
    sha256_of,
)
from polishd.plugins.interferometer.formats.format import Format

# Points in any order onto the regular grid that they lie on.

SAME_WITHIN = 1e-4
"""Coordinates closer than this part of the mean spacing are one row or column: rounding, not a step."""
OFF_GRID_PX = 0.1
AGAIN = "Export the map on the instrument's own pixels"
CELLS_PER_POINT = 4
"""A grid of more places than so many per point is no measured map (and would be allocated)."""
ORIENTATION = "by the file's own coordinates: row 0 is the largest y, column 0 the smallest x"


class GridResult(NamedTuple):
    """Values on the grid (row 0 = largest y) and its two pitches, in the units of the coordinates."""

    z: FloatArray
    pitch_x: float
    pitch_y: float


def grid_points(path: Path, x: FloatArray, y: FloatArray, z: FloatArray, *, in_lines: bool = False) -> GridResult:
    """Put (n,) points on the grid that x and y span; places without a point are NaN.

    MapError where the coordinates are not finite, lie more than 0.1 pixel off any regular grid, fall on one another, or
    leave most of the grid empty. ``in_lines``: the file lists them one a line, and errors name the line; also refused
    is a list that stops short in the last of its rows or columns.
    """
    known = np.isfinite(x) & np.isfinite(y)
    if not known.all():
        where = _where(path, int(np.argmin(known)), in_lines=in_lines)
        raise MapError(f"{where}: a point has no coordinates, {np.count_nonzero(~known)} in all. {AGAIN}")
    if x.size < 4 or not (np.ptp(x) > 0 and np.ptp(y) > 0):
        raise MapError(f"{path}: its {x.size} points make no grid of at least two rows and columns. {AGAIN}")
    spacing = float(np.sqrt(np.ptp(x) / x.size) * np.sqrt(np.ptp(y)))
    columns, pitch_x = _places(path, "x", x, spacing, in_lines=in_lines)
    rows, pitch_y = _places(path, "y", y, spacing, in_lines=in_lines)
    ny, nx = int(rows.max()) + 1, int(columns.max()) + 1
    if ny * nx > CELLS_PER_POINT * x.size + 64:
        raise MapError(f"{path}: {x.size} points for {ny} x {nx} places: not on a regular grid. {AGAIN}")
    require_size(path, ny, nx)
    place = (ny - 1 - rows) * nx + columns
    counts = np.bincount(place, minlength=ny * nx)
    if counts.max() > 1:
        again = int(np.flatnonzero(place == np.argmax(counts > 1))[1])
        raise MapError(
            f"{_where(path, again, in_lines=in_lines)}: a point lies on an earlier one, at {int((counts > 1).sum())} "
            "places in all: not one map. Export each map to its own file"
        )
    if in_lines:
        _require_end(path, np.argwhere(counts.reshape(ny, nx) == 0), divmod(int(place[-1]), nx))
    grid = np.full(ny * nx, np.nan)
    grid[place] = z
    return GridResult(grid.reshape(ny, nx), pitch_x, pitch_y)


def _where(path: Path, point: int, *, in_lines: bool) -> str:
    """The file, and the line of a point of it (from 0), where it lists one a line. It reads the file again."""
    if not in_lines:
        return str(path)
    _, first_line, body = _split(path, content_of(path))
    lines = COMMENT.sub(b"", body).splitlines()
    return f"{path}:{[number for number, line in enumerate(lines, first_line) if line.strip()][point]}"


def _require_end(path: Path, empty: NDArray[np.int64], last: tuple[int, int]) -> None:
    """MapError where all (n, 2) empty places are of the row, or of the column, of the point that was listed last."""
    for axis, name in enumerate(("row", "column")):
        if len(empty) and (empty[:, axis] == last[axis]).all() and np.ptp(empty[:, 1 - axis]) == len(empty) - 1:
            raise MapError(f"{path}: its last {name} lacks {len(empty)} points: torn, or still being written")


def _places(
    path: Path, axis: str, values: FloatArray, spacing: float, *, in_lines: bool
) -> tuple[NDArray[np.int64], float]:
    """Index of each value on the axis, (n,), and the axis' pitch."""
    order = np.argsort(values, kind="stable")
    gaps = np.diff(values[order])
    new = gaps > SAME_WITHIN * spacing
    steps = gaps[new]
    if not steps.size:
        raise MapError(f"{path}: all points have nearly the same {axis}: no grid. {AGAIN}")
    with np.errstate(over="ignore"):  # what is infinite is no grid
        index = np.concatenate([[0.0], np.cumsum(np.round(steps / np.median(steps[steps < 1.5 * steps.min()])))])
    levels = values[order][np.concatenate([[True], new])]
    if index[-1] > CELLS_PER_POINT * values.size or (np.diff(index) < 1).any():
        raise MapError(f"{path}: {axis} is not evenly spaced: not on a regular grid. {AGAIN}")
    pitch = float((levels[-1] - levels[0]) / index[-1])
    place = (values - levels[0]) / pitch
    nearest = np.round(place)
    off = np.abs(place - nearest)
    if (worst := float(off.max())) > OFF_GRID_PX:
        where = _where(path, int(off.argmax()), in_lines=in_lines)
        raise MapError(
            f"{where}: {axis} lies {worst:.2f} pixel off a regular grid of {pitch:.6g} (in the unit of {axis}), and "
            f"{OFF_GRID_PX:g} is allowed. {AGAIN}"
        )
    return nearest.astype(np.int64), pitch


FORMAT = Format("points", 3)
SUFFIXES = (".xyz", ".csv", ".txt", ".asc", ".pts")
MOST_HEADER_LINES = 64
MOST_TITLE_BYTES = 256
"""A longer line before the first point is text, not titles or units."""
# Possessive: a broken line of any length is gone over a few times, not once for each of its characters
NUMBER = rb"[-+]?(?:\d++(?:[.,]\d*+)?|[.,]\d++)(?:[eE][-+]?\d++)?"
POINT = re.compile(rb"[ \t]*+" + NUMBER + rb"[ \t]*+(?:[,;][ \t]*+|(?<=[ \t]))" + NUMBER + rb"(?:[ \t,;]|$)")
TITLE = re.compile(r"\W*+([a-z]++)[\s\"'\[\](){}/:.|=_-]*+([a-z\u00b5\u03bc\u00c5]*+)\W*+", re.IGNORECASE)
"""A name and its unit, with blanks, underscores, brackets or a slash between: ``x_mm``, ``X [mm]``, ``"Y / mm"``.

Nothing else may stand there: ``z [?m]`` was written by a program that lacks the micro sign, and is no metre.
"""
NO_DATA = re.compile(
    rb"no[ _]?data|#?n/?a(?=[\s,;]|$)|bad|null|none|-{2,}|\*+|[-+]?1[.,]#[a-z]+\d*|[-+]?nan\(\w+\)", re.IGNORECASE
)
"""What programs write where there is no height; C libraries' spellings of NaN too ("-1.#IND", "nan(ind)")."""
COMMENT = re.compile(rb"^[ \t]*[#!%][^\n]*", re.MULTILINE)
DECIMAL_COMMA = re.compile(rb"(?:[ \t]*+[^\s,]*+(?:,[^\s,]++)?+)?(?:[ \t]++[^\s,]++(?:,[^\s,]++)?+){2}[ \t]*+\r?$")
"""Three words between blanks, a comma at most inside each."""
WAVEFRONT = re.compile(r"wave|opd|phase", re.IGNORECASE)
CAMERA = {"col": "x", "column": "x", "row": "y", "line": "y"}
"""Titles of pixels' numbers: rows count from the top."""
UTF_16 = (b"\xff\xfe", b"\xfe\xff")
CUT = "ends without a line end: if the file is torn inside its last number, that one is wrong"
ODD_TITLES = "its titles are not x, y and z: its columns are taken in this order"


class PointListHeader(NamedTuple):
    """Where x, y and z stand, their units, and what else the titles say."""

    order: tuple[int, int, int] = (0, 1, 2)
    units: tuple[str, str, str] = ("", "", "")
    wavefront: bool = False
    from_top: bool = False
    unknown: bool = False


def sniff(head: bytes, path: Path) -> bool:
    """True for text of the usual names whose first lines come to two numbers at the start of one, and for UTF-16."""
    if path.suffix.lower() in SUFFIXES and head.startswith(UTF_16):
        return True
    if path.suffix.lower() not in SUFFIXES or b"\0" in head or head.startswith((b"Zygo", b"Wyko")):
        return False
    return any(POINT.match(line) for line in head.splitlines()[:MOST_HEADER_LINES])


def read(path: Path) -> SurfaceMap:
    """Read points on a regular grid, in any order, with holes. MapError where they are on none, or no such list."""
    content = content_of(path)
    sha256, whole = sha256_of(content), content[-1:] == b"\n"
    header, first_line, body = _split(path, content)
    del content
    table = _table(path, body, first_line)[:, header.order]
    del body
    if (infinite := np.isinf(table[:, 2])).any():
        where = _where(path, int(infinite.argmax()), in_lines=True)
        raise MapError(f"{where}: an infinite height, {np.count_nonzero(infinite)} in all. Write nan for missing data")
    found = grid_points(path, table[:, 0], -table[:, 1] if header.from_top else table[:, 1], table[:, 2], in_lines=True)
    lateral = _pitch(path, header, found)
    height = height_unit(header.units[2])
    height_nm = scaled(found.z, height.nm)
    doubts = {"surface": "its heights are a wavefront's"} if header.wavefront else {}
    doubts |= {"orientation": ODD_TITLES} if header.unknown else {}
    return FORMAT.surface(
        path,
        sha256,
        checked(path, height_nm, height.nm),
        height=height,
        lateral=lateral,
        factors={"nm_per_unit": height.nm, "points": len(table), **_unscaled(lateral, found)},
        doubts=doubts,
        warnings=() if whole else (CUT,),
        orientation=ORIENTATION,
    )


def _split(path: Path, content: bytes) -> tuple[PointListHeader, int, bytes]:
    """The header, and everything from the first point on, with the number of its first line."""
    header, at = PointListHeader(), 3 if content.startswith(b"\xef\xbb\xbf") else 0
    if content.startswith(UTF_16):
        raise MapError(f"{path}: is UTF-16 text. Save it as UTF-8")
    if b"\0" in content:
        raise MapError(f"{path}: is no text")
    for number in range(1, MOST_HEADER_LINES + 1):
        end = content.find(b"\n", at)
        line = content[at : end if end >= 0 else len(content)].rstrip(b"\r")
        if POINT.match(line):
            return header, number, content[at:]
        text = _text(line) if len(line) <= MOST_TITLE_BYTES else ""
        titles, units = _header(text), _units(text)
        if units:
            x, y, z = header.order
            header = header._replace(units=(units[x], units[y], units[z]))
        elif titles and not (titles.unknown and header.units != ("", "", "")):
            header = titles
        if end < 0:
            break
        at = end + 1
    raise MapError(f"{path}: no line of its first {MOST_HEADER_LINES} is a point: x y z")


def _text(line: bytes) -> str:
    """A line of titles, in UTF-8 or Latin-1; in capitals only, they are as small letters."""
    try:
        text = line.decode()
    except UnicodeDecodeError:
        text = line.decode("latin-1")
    return text.lower() if text.isupper() else text


def _units(line: str) -> tuple[str, str, str] | None:
    """The units that a line of nothing else is: ``mm mm nm``, ``[mm],[mm],[um]``, ``# units: mm, mm, nm``."""
    text = re.sub(r"^[\s#%!\"'\[(]*(?:units?\W)?", "", line.strip(), flags=re.IGNORECASE)
    words = text.replace(",", " ").replace(";", " ").split()
    found = tuple(word.strip("[]()") for word in words)
    return found if len(found) == 3 and all(nm_per(word) is not None for word in found) else None


def _paired(text: str) -> str:
    """Titles between commas, where names and units are words between blanks: ``x mm y mm z nm``, ``x y z mm mm nm``."""
    words = text.replace("[", " ").replace("]", " ").replace("(", " ").replace(")", " ").split()
    for names, units in ((words[::2], words[1::2]), (words[:3], words[3:])):
        known = len(words) == 6 and all(nm_per(unit) is not None for unit in units)
        if known and not any(nm_per(name) is not None for name in names):
            return ",".join(f"{name}_{unit}" for name, unit in zip(names, units, strict=True))
    return text


def _header(line: str) -> PointListHeader | None:
    """The header that a line of three titles is; None for any other line."""
    text = line.strip().lstrip("#%! ")
    text = text if re.search(r"[,;\t]", text) else _paired(text)
    between = r"[,;\t]" if re.search(r"[,;\t]", text) else r"\s+(?![\[(])"
    titles = [title for title in re.split(between, text) if title]
    found = [TITLE.fullmatch(title.strip()) for title in titles]
    if len(titles) != 3 or None in found:
        return None
    names, units = zip(*((match[1], match[2]) for match in found if match), strict=True)
    axes = [CAMERA.get(name.lower(), name[:1].lower()) for name in names]
    if not {"x", "y"} <= set(axes):  # of a table, or any three words
        return PointListHeader(unknown=True) if "," in between and text[0] == line.strip()[0] else None
    x, y = axes.index("x"), axes.index("y")
    z = 3 - x - y
    from_top = names[y].lower() in CAMERA
    return PointListHeader((x, y, z), (units[x], units[y], units[z]), bool(WAVEFRONT.search(names[z])), from_top)


def _table(path: Path, body: bytes, first_line: int) -> FloatArray:
    """(n, 3) numbers, missing heights NaN."""
    require_size(path, 1 + max(body.count(b"\n"), body.count(b"\r")), 1)
    first = body[: body.find(b"\n") if b"\n" in body else len(body)]
    body = NO_DATA.sub(b"nan", COMMENT.sub(b"", body))
    if b";" in first or DECIMAL_COMMA.match(first):  # then a comma is a decimal one
        if b"," in body and b"." in body:
            line = first_line + body[: body.index(b",")].count(b"\n")
            raise MapError(
                f"{path}:{line}: a number has a comma, and other numbers have a point: it is not clear which is the "
                "decimal one. Export the map without separators of thousands"
            )
        body = body.replace(b",", b".").replace(b";", b",")
    if b"," in first or b";" in first:
        body = re.sub(rb",[ \t]*(?=[\r\n]|$)", b",nan", body).replace(b",", b" ")
    lines = io.TextIOWrapper(io.BytesIO(body), encoding="latin-1")
    try:
        table: FloatArray = np.loadtxt(lines, dtype=np.float64, ndmin=2, comments=None)
    except ValueError as error:
        raise MapError(_first_wrong(path, body, first_line)) from error
    if table.shape[1] != 3:
        raise MapError(f"{path}: has {table.shape[1]} columns, not x, y and z")
    return table


def _first_wrong(path: Path, body: bytes, first_line: int) -> str:
    """What is wrong with the first line that is no point."""
    lines = body.splitlines()
    for number, line in enumerate(lines, start=first_line):
        words = line.split()
        if words and not (len(words) == 3 and all(map(_is_number, words))):
            torn = number == first_line + len(lines) - 1 and not body.endswith((b"\n", b"\r"))
            what = "the file is torn" if torn else f"{line.strip()[:60].decode('latin-1')!r} is no point x y z"
            return f"{path}:{number}: {what}. Export the map again"
    return f"{path}: is no list of points x y z. Export the map again"


def _is_number(word: bytes) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return b"_" not in word


def _pitch(path: Path, header: PointListHeader, found: GridResult) -> Pitch:
    units = [nm_per(unit) for unit in header.units[:2]]
    if units[0] is None or units[1] is None:
        return NO_PITCH
    return pitch(path, found.pitch_x * units[0] / 1e6, found.pitch_y * units[1] / 1e6)


def _unscaled(lateral: Pitch, found: GridResult) -> dict[str, tuple[float, float]]:
    """What the pitches are in the file's own unit, where that is not known: ``--units`` may say it."""
    return {IN_UNITS: (found.pitch_x, found.pitch_y)} if lateral is NO_PITCH else {}


POINTS = FORMAT.reader(read, *SUFFIXES, sniff=sniff, dates=False)
