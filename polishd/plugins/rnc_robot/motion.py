"""All that a program moves, and where its times stand: what two programs are compared by."""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO

import numpy as np

from polishd.api import Program
from polishd.model.program import IntArray
from polishd.model.surface import FloatArray
from polishd.plugins.rnc_robot import formats
from polishd.plugins.rnc_robot.dialect import AnyDialect, GcodeDialect
from polishd.plugins.rnc_robot.languages.columns import numbers
from polishd.plugins.rnc_robot.languages.profile import LanguageProfile
from polishd.plugins.rnc_robot.languages.scan import scan
from polishd.plugins.rnc_robot.nc import codes as c
from polishd.plugins.rnc_robot.nc.checks import Checks
from polishd.plugins.rnc_robot.nc.pieces import ProgramChunk
from polishd.plugins.rnc_robot.nc.points import Points
from polishd.plugins.rnc_robot.nc.stream import look_through

COLUMNS = ("x", "y", "z", "a", "b", "c", "i", "j", "k")
"""Of NC text: mm, degrees, and the tool vector as written."""


@dataclass(frozen=True, slots=True)
class ProgramMotion:
    """A program's moves in order, m of them."""

    program: Program
    line: IntArray
    """(m,) 1-based."""
    kind: IntArray
    """(m,) rapid, straight, arc: what the dialect tells apart; the same numbers for both programs."""
    places: FloatArray
    """(m, k) where each move ends, as far as the program has said it (NaN)."""
    point: IntArray
    """(n,) 0-based move that each timed point belongs to."""
    spans: IntArray
    """(s, 2) byte offsets of the numbers that carry the points' time, rising."""


def motion(dialect: AnyDialect, text: bytes, name: str) -> ProgramMotion:
    """Read a program. ProgramError names the line and the reason."""
    program = formats.read(dialect, text, name)
    return _of_nc(program, dialect) if isinstance(dialect, GcodeDialect) else _of_language(program, dialect)


def _of_nc(program: Program, dialect: GcodeDialect) -> ProgramMotion:
    moves, places, spans, owners = [], [], [], []
    begin = 0

    def keep(piece: ProgramChunk, timed: Points, _checks: Checks) -> None:
        nonlocal begin
        moves.append(piece.moves)
        places.append(piece.places[:, : c.AXES])
        mine = timed.start >= 0  # an F of an earlier line carries no time of its own
        spans.append(np.column_stack([timed.start, timed.end])[mine] + begin)
        owners.append(piece.dwells[piece.dwells[:, c.D_MOVE] >= 0, c.D_MOVE])
        begin += len(piece.text)

    look_through(dialect, BytesIO(program.text), program.name, each=keep)
    line = np.concatenate([rows[:, c.M_LINE] for rows in moves])
    return ProgramMotion(
        program=program,
        line=line,
        kind=np.concatenate([rows[:, c.M_KIND] for rows in moves]) & ~c.K_INVERSE,
        places=np.vstack(places),
        point=np.concatenate(owners) if program.encoding == "dwell" else np.searchsorted(line, program.line),
        spans=np.vstack(spans),
    )


def _of_language(program: Program, profile: LanguageProfile) -> ProgramMotion:
    """Moves without a dwell are left to the text: what they say may stand in positions declared elsewhere."""
    timed = scan(profile, program.text, program.name).points
    return ProgramMotion(
        program=program,
        line=program.line,
        kind=np.zeros(program.n, dtype=np.int64),
        places=np.hstack([program.end_mm, program.axis]),
        point=np.arange(program.n),
        spans=np.column_stack([numbers(timed.start), numbers(timed.end)]),
    )
