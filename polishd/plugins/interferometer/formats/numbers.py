"""Numbers in a text, piece by piece: no more is held than the array that they fill."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from polishd.api import MapError
from polishd.model.surface import FloatArray

PIECE = 2**16
LONGEST = 4096
"""No number, and no line of a point, is longer."""
OF_NUMBERS = b"0123456789+-.eE \t\r\n"


def pieces(path: Path, content: bytes, span: tuple[int, int], ends: tuple[bytes, ...]) -> Iterator[bytes]:
    """Parts of ``content[span]`` of about ``PIECE`` bytes, each ended by one of ``ends``; BadMap where none comes."""
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
    """The numbers of a piece, (n,); BadMap for anything else. ``but``: further bytes that may stand there ("nan")."""
    foreign = text.translate(None, OF_NUMBERS + but)
    if foreign:
        raise MapError(f"{path}: {foreign[:20]!r} stands among its numbers")
    try:
        return np.array(text.split(), dtype=np.float64)
    except ValueError as error:
        raise MapError(f"{path}: {error}") from error


def block(path: Path, content: bytes, span: tuple[int, int], shape: tuple[int, int]) -> FloatArray:
    """The ``shape`` numbers of a span of the text, however they are wrapped; BadMap for more, fewer or infinite."""
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
