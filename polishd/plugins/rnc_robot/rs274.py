"""The format ``rs274``: LinuxCNC-like NC text, G21 G90 G94 where the program does not say.

Time sits in ``G4 P`` seconds after a feed move, else in F (G94) or 1/F (G93) of the feed moves. Block delete (``/``),
variables, O-words, arcs, I/J/K, offsets, revolutions and all that is not known is refused: nothing is guessed.
"""

from __future__ import annotations

import hashlib

import numpy as np

from polishd.api import Program, ProgramFormat
from polishd.model.surface import FloatArray
from polishd.plugins.rnc_robot.interpreter import interpret
from polishd.plugins.rnc_robot.rewriter import rewritten
from polishd.plugins.rnc_robot.timing import points


def read(text: bytes, name: str) -> Program:
    """Read a program; ``name`` is for messages. ProgramError names the line and the reason."""
    reader, lines, warnings = interpret(text, name)
    encoding, found = points(name, reader, warnings)
    start = np.nan_to_num(np.array([point.start for point in found]), nan=0.0)
    end = np.nan_to_num(np.array([point.end for point in found]), nan=0.0)
    line = np.array([point.place.number for point in found], dtype=np.int64)
    return Program(
        text=text,
        sha256=hashlib.sha256(text).hexdigest(),
        name=name,
        dialect="rs274",
        encoding=encoding,
        line=line,
        block=line - 1,
        start_mm=start[:, :3],
        end_mm=end[:, :3],
        axis=tool_axis(end[:, 3], end[:, 4]),
        time_s=np.array([point.time_s for point in found]),
        lines=len(lines) - (not lines[-1]),
        max_feed_mm_min=max(point.feed_mm_min for point in found),
        warnings=tuple(warnings),
    )


def rewrite(program: Program, time_s: FloatArray) -> bytes:
    """The program with ``time_s`` (n,) seconds at its points; no byte changed outside numbers that carry time.

    Where F still holds from an earlier block and must differ, an F word is added. What rounding leaves is carried
    to the next point, so that the total is exact to one quantum. ProgramError for times that cannot be written.
    """
    reader, lines, warnings = interpret(program.text, program.name)
    encoding, found = points(program.name, reader, warnings)
    return rewritten(program, lines, encoding, found, time_s)


def tool_axis(a_deg: FloatArray, c_deg: FloatArray) -> FloatArray:
    """Unit tool axis (n, 3), from the tip into the spindle, of wrist angles A and C (n,): (0, 0, 1) at A = 0."""
    a, c = np.radians(a_deg), np.radians(c_deg)
    return np.stack([np.sin(c) * np.sin(a), -np.cos(c) * np.sin(a), np.cos(a)], axis=-1)


RS274 = ProgramFormat(name="rs274", read=read, rewrite=rewrite)
