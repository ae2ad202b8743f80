"""A CSV of dwells: one number in seconds a row, no header, one row a point."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from itertools import chain, islice
from pathlib import Path

import numpy as np

from polishd.model.errors import ProgramError
from polishd.model.surface import FloatArray

_PIECE = 1 << 20
"""Bytes read at a time: a table of any length needs no more memory."""
_PLAIN = b"0123456789+-.eE \t\r\n"


class DwellTable:
    """The rows of a table of dwells, taken in order; never many more of them in memory than are asked for at once."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.total_s = 0.0
        """Sum of what was taken."""
        self._rows = chain.from_iterable(rows.tolist() for rows in dwell_rows(path))
        self._taken = 0

    def take(self, count: int) -> FloatArray:
        """The next so many, (count,) s. ProgramError where there are fewer, or where a row is no dwell."""
        rows = np.fromiter(islice(self._rows, count), np.float64)
        self._taken += len(rows)
        if len(rows) < count:
            raise ProgramError(f"{self.path}, row {self._taken + 1} is missing: the program has more points. {_COUNT}")
        self.total_s += math.fsum(rows)
        return rows

    def finish(self) -> None:
        """ProgramError where there are more rows."""
        if next(self._rows, None) is not None:
            raise ProgramError(
                f"{self.path}, row {self._taken + 1} is one too many: the program has {self._taken} points. {_COUNT}"
            )


_COUNT = "To do: write one row a point; polishd program inspect counts them."


def dwell_rows(path: Path) -> Iterator[FloatArray]:
    """The rows of a table of dwells, s, as arrays of (k,), in order. Lines end in LF or CRLF.

    Raises:
        ProgramError: The file cannot be read, or a row is not one number of seconds, 0 or more; names the row.
    """
    done = 0
    try:
        with path.open("rb") as file:
            rows = file.readlines(_PIECE)
            if rows:
                rows[0] = rows[0].removeprefix(b"\xef\xbb\xbf")
            while rows:
                yield _values(path, rows, done)
                done += len(rows)
                rows = file.readlines(_PIECE)
    except OSError as error:
        raise ProgramError(f"{path}: cannot be read: {error.strerror}. To do: check the path of the dwells.") from error
    if not done:
        raise ProgramError(f"{path}: the table of dwells is empty. To do: write one dwell in seconds a row.")


def _values(path: Path, rows: list[bytes], before: int) -> FloatArray:
    """The numbers of some rows, of which ``before`` rows came before."""
    with suppress(ValueError):  # whose fault it is, is found out below
        values = np.array(list(map(float, rows)), dtype=np.float64) + 0.0  # no -0.0
        if not b"".join(rows).translate(None, _PLAIN) and np.isfinite(values).all() and (values >= 0).all():
            return values
    for number, row in enumerate(rows, before + 1):
        reason = _reason(row, number)
        if reason is not None:
            shown = row.decode("utf-8", "backslashreplace").strip()[:60]
            raise ProgramError(
                f'{path}, row {number} {reason}: "{shown}". To do: write one dwell in seconds a row, and no header.'
            )
    raise ProgramError(f"{path}: cannot be read as numbers from row {before + 1} on.")


def _reason(row: bytes, number: int) -> str | None:
    """What is wrong with a row; None: nothing is."""
    text = row.strip()
    if not text:
        return "is empty"
    if b"," in text or b";" in text:
        return "holds a comma or semicolon: one number a row, with a decimal point"
    try:
        value = float(text)
    except ValueError:
        return "is a header" if number == 1 and text[:1].isalpha() else "is not a number"
    if not np.isfinite(value):
        return "is not finite"
    if value < 0:
        return "is below zero"
    return "is not a plain number" if text.translate(None, _PLAIN) else None
