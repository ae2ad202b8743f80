"""CODE V interferogram files of grid data (``.int``): a title, one line of parameters, integers row by row.

Sources: the format as reference/metrology gives it, and prysm's reader, which divides by the wavelength instead of
multiplying. The file gives no lateral size.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from polishd.api import MapError, SurfaceMap
from polishd.plugins.interferometer.formats.common import (
    Pitch,
    block,
    checked,
    content_of,
    require_optics,
    require_size,
)
from polishd.plugins.interferometer.formats.format import Format

FORMAT = Format("codev", 1)
MISSING = 32767
"""Of files that state no ``NDA``."""
HEADER_LINES = 100
"""So many lines of comments, title and parameters are looked through."""
GRID = re.compile(rb"^[ \t]*GRD[ \t]+\d+[ \t]+\d+[ \t]", re.IGNORECASE | re.MULTILINE)
COMMENT = re.compile(rb"^[ \t]*![^\n]*\n?", re.MULTILINE)
WITH_NUMBER = {"WVL", "SSZ", "NDA", "XSC"}
CUT = "ends without a blank or line end: if the file is torn inside its last number, that one is wrong"
NO_PITCH = "a CODE V file has no lateral scale"
WAVEFRONT = "holds a wavefront (WFR), shown as it is: half of it is surface only in reflection at normal incidence"


@dataclass(slots=True)
class CodeVHeader:
    """The line of parameters."""

    rows: int = 0
    columns: int = 0
    kind: str = ""
    number: dict[str, float] = field(default_factory=dict)


def sniff(head: bytes, path: Path) -> bool:
    """True where a line starts like a grid's parameters, or for a text called ``.int``."""
    return b"\0" not in head and (GRID.search(head) is not None or path.suffix.lower() == ".int")


def read(path: Path) -> SurfaceMap:
    """Read a grid of surface or wavefront values. MapError for whatever is torn, of another kind, or out of range."""
    content = content_of(path)
    line, start = _parameters(path, content)
    header = _header(path, line)
    require_size(path, header.rows, header.columns, (len(content) - start + 1) / 2)  # a digit and a blank each
    body = COMMENT.sub(b"", content[start:]) if content.find(b"!", start) >= 0 else content
    span = (start, len(content)) if body is content else (0, len(body))
    values = block(path, body, span, (header.rows, header.columns))
    nm = header.number["WVL"] * 1e3 / header.number["SSZ"]
    no_data = header.number.get("NDA", MISSING)
    missing = values == no_data
    values *= nm
    values[missing] = np.nan
    cut = () if content[-1:].isspace() else _cut(path, content[-32:].split()[-1], b"%d" % no_data)
    return FORMAT.surface(
        path,
        content,
        checked(path, values, nm),
        lateral=_pitch(header),
        factors={"nm_per_count": nm, "kind": header.kind, "x_over_y": header.number.get("XSC", 1.0)},
        warnings=cut,
        orientation="the file's first row is the top (it does not say: prove it with an artefact)",
    )


def _parameters(path: Path, content: bytes) -> tuple[bytes, int]:
    """The parameters' line, continuations ("&") joined, and where the values start."""
    start, line = 0, b""
    for _ in range(HEADER_LINES):
        end = content.find(b"\n", start)
        if end < 0:
            break
        text = content[start:end].strip()
        start = end + 1
        if text.startswith(b"!"):
            continue
        line = line.removesuffix(b"&") + b" " + text if line.endswith(b"&") else text
        word = line.upper().split(None, 1)[:1]
        if word in ([b"ZFR"], [b"ZRN"]):
            raise MapError(f"{path}: holds Zernike coefficients, not a grid: write it out of CODE V as GRD")
        if word == [b"GRD"] and GRID.match(line + b" ") and not line.endswith(b"&"):
            return line, start
    raise MapError(f"{path}: no CODE V grid: no line 'GRD columns rows SUR|WFR WVL um SSZ counts' at its start")


def _header(path: Path, line: bytes) -> CodeVHeader:
    words = line.decode("latin-1").upper().split()
    header = CodeVHeader(columns=int(words[1]), rows=int(words[2]))
    rest = iter(words[3:])
    for word in rest:
        if word in ("SUR", "WFR") and not header.kind:
            header.kind = word
        elif word in WITH_NUMBER and word not in header.number:
            header.number[word] = _number(path, word, next(rest, ""))
        elif word != "NNB":  # nearest neighbour: how CODE V interpolates
            raise MapError(f"{path}: {word!r} in its parameters is not known, or stands there twice")
    if not header.kind or not {"WVL", "SSZ"} <= header.number.keys():
        raise MapError(f"{path}: needs SUR or WFR, WVL and SSZ in its parameters, and has {' '.join(words[3:])!r}")
    require_optics(path, {"Wavelength (m)": header.number["WVL"] / 1e6})
    if not 1e-3 <= header.number["SSZ"] <= 1e12:
        raise MapError(f"{path}: SSZ is {header.number['SSZ']:g} counts a wave: the height's scale is not known")
    return header


def _number(path: Path, word: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value) or (word == "XSC" and value <= 0):
        raise MapError(f"{path}: {word} is {text!r} in its parameters")
    return value


def _cut(path: Path, last: bytes, no_data: bytes) -> tuple[str, ...]:
    """What to warn of where nothing follows the last number; MapError where it is the first part of "no data"."""
    if last != no_data and no_data.startswith(last):
        raise MapError(f"{path}: ends inside a number: {last.decode()} of {no_data.decode()}: torn")
    return () if last == no_data else (CUT,)


def _pitch(header: CodeVHeader) -> Pitch:
    """None, and what else is left open."""
    doubts = {"pitch": NO_PITCH}
    if header.kind == "WFR":
        doubts["surface"] = WAVEFRONT
    if header.number.get("XSC", 1.0) != 1.0:
        doubts["square pixels"] = f"XSC is {header.number['XSC']:g}: its pixels are not square"
    return Pitch(None, doubts)


CODEV = FORMAT.reader(read, ".int", sniff=sniff, dates=False)
