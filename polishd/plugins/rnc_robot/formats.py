"""All program formats: what a dialect's profile is, decides who reads it."""

from __future__ import annotations

from functools import cache, partial
from typing import cast

from polishd.api import OwnLines, Program, ProgramError, ProgramFormat
from polishd.model.program import Encoding
from polishd.model.surface import FloatArray
from polishd.plugins.rnc_robot import languages
from polishd.plugins.rnc_robot.detect import HEAD_BYTES, require_language
from polishd.plugins.rnc_robot.dialect import DIALECTS, LANGUAGES, AnyDialect, GcodeDialect
from polishd.plugins.rnc_robot.dialect import dialect as profile_of
from polishd.plugins.rnc_robot.make import path_program
from polishd.plugins.rnc_robot.nc import program as nc
from polishd.plugins.rnc_robot.nc.recode import recode
from polishd.plugins.rnc_robot.own_lines import misread


@cache
def shipped(name: str) -> AnyDialect:
    """The profile of a shipped dialect, once one is wanted: the expressions of them all take a tenth of a check."""
    return profile_of(name)


def read(dialect: AnyDialect, text: bytes, name: str) -> Program:
    """Read a program; ``name`` is for messages. ProgramError names the line and the reason."""
    require_language(dialect, text[:HEAD_BYTES], name)
    return nc.read(dialect, text, name) if isinstance(dialect, GcodeDialect) else languages.read(dialect, text, name)


def rewrite(dialect: AnyDialect, program: Program, time_s: FloatArray, encoding: Encoding | None = None) -> bytes:
    """The program with (n,) seconds at its points; only numbers that carry time change. ProgramError.

    ``encoding``: where the time is to sit; as in the program by default.
    """
    if isinstance(dialect, GcodeDialect):
        if encoding in (None, program.encoding):
            return nc.rewrite(dialect, program, time_s)
        return recode(dialect, program, time_s, encoding)
    if encoding not in (None, "dwell"):
        raise ProgramError(f"{program.name}: in {dialect.name} time sits in dwells. To do: leave the encoding away.")
    return languages.rewrite(dialect, program, time_s)


def make(dialect: GcodeDialect, points_mm: FloatArray, axis: FloatArray, feed_mm_min: float, name: str) -> bytes:
    """A program along (n, 3) points with (n, 3) tool axes, time in its feeds. ProgramError."""
    return path_program(points_mm, axis, feed_mm_min, name, to=dialect)


def read_shipped(name: str, text: bytes, of: str) -> Program:
    """As `read`, in the shipped dialect of that name."""
    return read(shipped(name), text, of)


def rewrite_shipped(name: str, program: Program, time_s: FloatArray, encoding: Encoding | None = None) -> bytes:
    """As `rewrite`, in the shipped dialect of that name."""
    return rewrite(shipped(name), program, time_s, encoding)


def make_shipped(name: str, points_mm: FloatArray, axis: FloatArray, feed_mm_min: float, of: str) -> bytes:
    """As `make`, in the shipped dialect of that name, which is none of the robots' languages."""
    return make(cast(GcodeDialect, shipped(name)), points_mm, axis, feed_mm_min, of)


def misread_shipped(name: str, lines: OwnLines) -> str:
    """As `misread`, in the shipped dialect of that name."""
    return misread(shipped(name), lines)


def shipped_formats() -> list[ProgramFormat]:
    """What the daemon knows of the shipped dialects."""
    return [
        ProgramFormat(
            name,
            partial(read_shipped, name),
            partial(rewrite_shipped, name),
            None if name in LANGUAGES else partial(make_shipped, name),
            partial(misread_shipped, name),
        )
        for name in DIALECTS
    ]


def format_of(dialect: AnyDialect) -> ProgramFormat:
    """What the daemon knows of a dialect."""
    made = partial(make, dialect) if isinstance(dialect, GcodeDialect) else None
    return ProgramFormat(
        dialect.name, partial(read, dialect), partial(rewrite, dialect), made, partial(misread, dialect)
    )
