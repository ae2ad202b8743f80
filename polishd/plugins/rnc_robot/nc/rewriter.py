"""Puts new times into a program in memory."""

from __future__ import annotations

from io import BytesIO

import numpy as np

from polishd.api import Program, ProgramError
from polishd.model.surface import FloatArray
from polishd.plugins.rnc_robot.nc.dialect import Dialect
from polishd.plugins.rnc_robot.nc.stream import rewrite_stream


def rewrite(dialect: Dialect, program: Program, time_s: FloatArray) -> bytes:
    """The program with ``time_s`` (n,) seconds at its points, as ``stream.rewrite_stream`` writes it.

    ProgramError for times that cannot be written.
    """
    out = BytesIO()
    rewrite_stream(dialect, BytesIO(program.text), program.name, Row(program, time_s), out)
    return out.getvalue()


class Row:
    """Times of a program's points, taken one after the other."""

    def __init__(self, program: Program, time_s: FloatArray) -> None:
        self.times = np.array(time_s, dtype=np.float64)
        self._taken = 0
        if self.times.shape != (program.n,):
            raise ProgramError(
                f"{program.name}: {program.n} points need as many times, not an array of {self.times.shape}."
            )

    def take(self, count: int) -> FloatArray:
        """The next so many."""
        self._taken += count
        return self.times[self._taken - count : self._taken]

    def finish(self) -> None:
        """All are taken: the program was read with as many points."""
