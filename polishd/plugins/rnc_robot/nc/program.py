"""A whole program of ISO-like NC text in memory: read as columns of points, and written with other times."""

from __future__ import annotations

from io import BytesIO

import numpy as np

from polishd.api import Program, ProgramError
from polishd.model.surface import FloatArray
from polishd.plugins.rnc_robot.nc.checks import Checks
from polishd.plugins.rnc_robot.nc.dialect import GcodeDialect
from polishd.plugins.rnc_robot.nc.pieces import ProgramChunk
from polishd.plugins.rnc_robot.nc.points import Points
from polishd.plugins.rnc_robot.nc.stream import look_through, rewrite_stream


def read(dialect: GcodeDialect, text: bytes, name: str) -> Program:
    """Read a program; ``name`` is for messages. ProgramError names the line and the reason."""
    columns = []

    def keep(_piece: ProgramChunk, points: Points, checks: Checks) -> None:
        start, end = (np.nan_to_num(places[:, :3], nan=0.0) for places in (points.before, points.after))
        columns.append((points.line, start, end, checks.tool_axes(points), points.time_s, points.feed_mm_min))

    passed = look_through(dialect, BytesIO(text), name, each=keep)
    line, start_mm, end_mm, axis, time_s, feed_mm_min = map(np.concatenate, zip(*columns, strict=True))
    return Program(
        text=text,
        sha256=passed.sha256,
        name=name,
        dialect=dialect.name,
        encoding=passed.encoding,
        line=line,
        block=line - 1,
        start_mm=start_mm,
        end_mm=end_mm,
        axis=axis,
        time_s=time_s,
        lines=passed.lines,
        max_feed_mm_min=max(passed.feed_mm_min[1], 0.0),
        warnings=passed.warnings,
        feed_mm_min=feed_mm_min,
        unit=passed.unit,
    )


def rewrite(dialect: GcodeDialect, program: Program, time_s: FloatArray) -> bytes:
    """The program with ``time_s`` (n,) seconds at its points, as ``stream.rewrite_stream`` writes it.

    ProgramError for times that cannot be written.
    """
    out = BytesIO()
    rewrite_stream(dialect, BytesIO(program.text), program.name, ProgramRow(program, time_s), out)
    return out.getvalue()


class ProgramRow:
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
