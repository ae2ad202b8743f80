"""All program formats: what a dialect's profile is, decides who reads it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import cast

import numpy as np

from polishd.api import DataFileFormat, OwnLines, Program, ProgramError, ProgramFormat
from polishd.model.program import Encoding
from polishd.model.surface import BoolArray, FloatArray
from polishd.plugins.rnc_robot import languages
from polishd.plugins.rnc_robot.dialect import (
    DEFAULT,
    DIALECTS,
    HEAD_BYTES,
    LANGUAGES,
    AnyDialect,
    GcodeDialect,
    dialect,
    require_language,
)
from polishd.plugins.rnc_robot.dialect import dialect as profile_of
from polishd.plugins.rnc_robot.gcode import rewrite as nc
from polishd.plugins.rnc_robot.gcode.recode import recode
from polishd.plugins.rnc_robot.languages.make import PathTimes, language_program
from polishd.plugins.rnc_robot.languages.profile import LanguageProfile
from polishd.process.frames import angles_from_axis

# Dialects that read one program with different times.

COMPARED_BYTES = 1 << 18
"""Beginning of a program that is read in every dialect."""
_TIME = 1e-6
"""Relative difference of times that are another unit, and not a rounding."""


def require_one_reading(head: bytes, name: str) -> None:
    """ProgramError where shipped dialects of G-code read the program without a refusal, but with different times."""
    text = head
    if len(head) > COMPARED_BYTES:
        text = head[: head.rfind(b"\n", 0, COMPARED_BYTES) + 1] + b"M2\n"
    readings: list[tuple[Program, list[str]]] = []
    for profile in (dialect(one) for one in DIALECTS if one not in LANGUAGES):
        with suppress(ProgramError):
            program = nc.read(cast(GcodeDialect, profile), text, name)
            same = next((names for one, names in readings if _first_other_time(one, program) is None), None)
            if same is None:
                readings.append((program, [profile.name]))
            else:
                same.append(profile.name)
    if len(readings) < 2:
        return
    (one, names), (other, others) = readings[:2]
    at = _first_other_time(one, other) or 0
    line = one.line[min(at, one.n - 1)]
    words = " and ".join(
        f"{program.time_s[at]:.6g} s ({', '.join(by)})" if at < program.n else f"no time ({', '.join(by)})"
        for program, by in ((one, names), (other, others))
    )
    raise ProgramError(
        f"{name}:{line}: several dialects fit, and read the time of this line as {words}. "
        "To do: which controller is it for? Say --dialect and its name."
    )


def _first_other_time(one: Program, other: Program) -> int | None:
    """Index of the first point whose time is not the same in both readings; None: there is none."""
    count = min(one.n, other.n)
    same = np.isclose(one.time_s[:count], other.time_s[:count], rtol=_TIME, atol=0.0, equal_nan=True)
    same &= one.line[:count] == other.line[:count]
    if same.all():
        return None if one.n == other.n else count
    return int(np.argmin(same))


# Lines that a robot's driver adds to a program, read in the program's dialect.

_UNIT_S = {"s": 1.0, "ms": 1e-3}
_OFF_S = 1e-6
_WORD = r"[A-Z]\s*+[-+]?(?:\d++(?:\.\d*+)?|\.\d++)"
_NC = re.compile(rf"(?:\s*{_WORD})+\s*|%", re.IGNORECASE)
"""A block of letters with numbers."""
_STOP = re.compile(r"(?:N\d+\s*)?M0*(?:0|2|30)|%", re.IGNORECASE)
_DWELL = re.compile(
    r"(?:N\d+\s*)?G\s*(?P<code>\d++(?:\.\d++)?)\s*(?P<word>[A-Z#=]++)\s*(?P<number>\d++(?:\.\d*+)?|\.\d++)",
    re.IGNORECASE,
)


def find_misread_line(dialect: AnyDialect, lines: OwnLines) -> str:
    """Return the first line that means something else in this dialect, and what; empty where none does."""
    for seconds, line in lines.dwells.items():
        rests = _nc_dwell_s(dialect, line) if isinstance(dialect, GcodeDialect) else _language_dwell_s(dialect, line)
        if rests is None:
            return f"{line!r} is no dwell in {dialect.name}"
        if abs(rests - seconds) > _OFF_S:
            return f"{line!r} rests for {rests:g} s in {dialect.name}, not for {seconds:g} s"
    for line in filter(None, lines.stops):
        if isinstance(dialect, GcodeDialect):
            if not _STOP.fullmatch(_bare(dialect, line)):
                return f"{line!r} is no stop and no end of a program in {dialect.name}"
        elif _NC.fullmatch(line) or _NC.fullmatch(re.sub(r"\(.*?\)|;.*", "", line)):
            return f"{line!r} is G-code, and {dialect.name} is none"
    return ""


def _bare(dialect: GcodeDialect, line: str) -> str:
    """Return the line without the comments that this dialect knows."""
    for comment in dialect.text.comments:
        line = re.sub(r"\([^()]*\)" if comment == "()" else r";.*", "", line)
    return line.strip()


def _nc_dwell_s(dialect: GcodeDialect, line: str) -> float | None:
    """Seconds of a block that is nothing but a dwell; None: it is something else."""
    if (found := _DWELL.fullmatch(_bare(dialect, line))) is None or float(found["code"]) not in dialect.dwell.codes:
        return None
    word = dialect.dwell.words.get(found["word"].upper())
    unit = None if word is None else word.decimal if "." in found["number"] else word.whole
    return None if unit is None or unit not in _UNIT_S else float(found["number"]) * _UNIT_S[unit]


def _language_dwell_s(profile: LanguageProfile, line: str) -> float | None:
    """Seconds of a statement that is a dwell of this language; None: it is something else."""
    for pattern in profile.patterns:
        if pattern.kind.startswith("dwell") and (found := pattern.regex.fullmatch(line.strip().encode())):
            return float(found["time"]) * profile.dwell.unit_s
    return None


# Writes a program from points and tool axes: for tests, the demo, and users without a planner.

SAFE_Z_MM = 20.0
LETTERS = "XYZAC"
DECIMALS = (4, 4, 4, 5, 5)
FEED_DECIMALS = 3
INVERSE_DECIMALS = 6
CHUNK = 50_000
"""Blocks that are formatted at a time."""


def path_program(
    points_mm: FloatArray,
    axis: FloatArray,
    feed_mm_min: FloatArray | float,
    name: str,
    *,
    encoding: Encoding = "feed",
    dwell_s: FloatArray | float = 0.0,
    to: AnyDialect | str = DEFAULT,
) -> bytes:
    """A program through these points.

    NC text has tool axes as ``Rz(C) Rx(A) (0, 0, 1)``, or with A and C negative for a table.

    Args:
        points_mm: (n, 3) tool tip, mm, program frame; the first is the landing point and has no time.
        axis: (n, 3) unit tool axis at each point, from the tip into the spindle.
        feed_mm_min: Feed of the block that ends at each point but the first: one value, or (n - 1,).
        name: Goes into the header's comment.
        encoding: Time as F of each block, as time ("inverse", in a robot language "time") of each block, or as a
            dwell after each block.
        dwell_s: For "dwell": seconds at each point but the first, one value or (n - 1,). What rounding leaves is
            carried on, so that the total is exact to one quantum.
        to: The dialect, or its name.

    Returns:
        ASCII text; of NC text: G0 above the first point and down to it, one G1 a point, G0 up, M2.

    Raises:
        ProgramError: points, axes or times that cannot be written so.
    """
    points, axes = _path(name, points_mm, axis)
    moves = (len(points) - 1,)
    feeds, dwells = (np.broadcast_to(np.asarray(time, dtype=np.float64), moves) for time in (feed_mm_min, dwell_s))
    if not (np.isfinite(feeds).all() and np.isfinite(dwells).all() and (feeds > 0).all()):
        raise ProgramError(f"{name}: feeds must be finite and above zero, and dwells finite.")
    profile = dialect(to) if isinstance(to, str) else to
    if isinstance(profile, LanguageProfile):
        return language_program(profile, points, axes, PathTimes(encoding, feeds, dwells), name)
    asked = _Asked(name, _profile(name, profile), _nc_encoding(encoding), points, axes, feeds, dwells)
    places = _places(asked)
    times = _times(asked)
    comment = f"({_comment(name)}: {len(places)} points)"
    tail = f"G0 Z{_above(places[-1])}\nM{asked.profile.m['ends'][0]:g}\n".encode("ascii")
    return b"".join([_head(asked, comment, places[0]), *_blocks(places, times), tail])


@dataclass(frozen=True, slots=True)
class _Asked:
    """What was asked for, checked as far as the dialect does not matter."""

    name: str
    profile: GcodeDialect
    encoding: Encoding
    points_mm: FloatArray
    axis: FloatArray
    feed_mm_min: FloatArray
    dwell_s: FloatArray


@dataclass(frozen=True, slots=True)
class _Times:
    """The numbers of a block that carry time, and how they are written."""

    feed: FloatArray
    """(n - 1,) as written behind F."""
    feed_template: str
    feed_written: BoolArray
    """(n - 1,)"""
    dwell: FloatArray | None = None
    dwell_template: str = ""


def _path(name: str, points_mm: FloatArray, axis: FloatArray) -> tuple[FloatArray, FloatArray]:
    points, axes = np.asarray(points_mm, dtype=np.float64), np.asarray(axis, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 2 or axes.shape != points.shape:
        raise ProgramError(f"{name}: a path needs at least two points (n, 3), and as many axes.")
    if not np.isfinite(points).all():
        raise ProgramError(f"{name}: point {int(np.argmin(np.isfinite(points).all(axis=1)))} is not finite.")
    off = np.nan_to_num(np.abs(np.linalg.norm(axes, axis=1) - 1), nan=1.0)
    if off.max() > 1e-6:
        raise ProgramError(f"{name}: the tool axis at point {int(np.argmax(off > 1e-6))} is no unit vector.")
    return points, axes


def _nc_encoding(encoding: Encoding) -> Encoding:
    """A time of each block is inverse time in NC text."""
    return "inverse" if encoding == "time" else encoding


def _profile(name: str, profile: GcodeDialect) -> GcodeDialect:
    if profile.axes.rotary and _pair(profile) not in profile.axes.rotary:
        raise ProgramError(f"{name}: {profile.title} has no A and C axes. To do: take another dialect.")
    return profile


def _pair(profile: GcodeDialect) -> str:
    """The rotary pair that programs are made with: of the head, C turns A; of a table, A tilts C."""
    return "AC" if profile.axes.turns == "table" else "CA"


def _places(asked: _Asked) -> FloatArray:
    """(n, 5) X Y Z A C as they are written."""
    angles = np.stack(angles_from_axis(asked.axis), axis=1)
    if asked.profile.axes.turns == "table":
        angles = -angles
    columns = zip(np.hstack([asked.points_mm, angles]).T, DECIMALS, strict=True)
    places = np.stack([np.round(column, n) + 0.0 for column, n in columns], axis=1)  # + 0.0: "-0.0000" is "0.0000"
    if not asked.profile.axes.rotary and (places[:, 3:] != 0).any():
        raise ProgramError(f"{asked.name}: {asked.profile.title} does not turn the tool. To do: leave it upright.")
    return places


def _times(asked: _Asked) -> _Times:
    """How each block says its time, in the dialect's units and words."""
    rules, encoding = asked.profile.feed, asked.encoding
    decimals, feed = FEED_DECIMALS, asked.feed_mm_min / (60 if rules.unit == "mm/s" else 1)
    if encoding == "inverse":
        if rules.g93 == "refuse":
            raise ProgramError(f"{asked.name}: {asked.profile.title} has no inverse time. To do: take feed or dwell.")
        decimals, time_s = INVERSE_DECIMALS, 60 * _lengths_mm(asked) / asked.feed_mm_min
        feed = time_s if rules.g93 == "s" else 60 / time_s
    elif encoding == "feed":
        _lengths_mm(asked)
    decimals = min(decimals, rules.most_decimals)
    feed = np.round(feed, decimals)
    if not (feed > 0).all():
        raise ProgramError(f"{asked.name}: {decimals} decimals leave a feed of 0. To do: ask for a higher one.")
    written = np.ones(len(feed), dtype=np.bool_)
    if encoding != "dwell":
        return _Times(feed, f" F%.{decimals}f", written)
    written[1:] = feed[1:] != feed[:-1]
    return _Times(feed, f" F%.{decimals}f", written, *_dwells(asked))


def _lengths_mm(asked: _Asked) -> FloatArray:
    length = np.linalg.norm(np.diff(asked.points_mm, axis=0), axis=1)
    if not (length > 0).all():
        at = int(np.argmin(length))
        raise ProgramError(f"{asked.name}: points {at} and {at + 1} are one place: no feed says how long that takes.")
    return np.asarray(length, dtype=np.float64)


def _dwells(asked: _Asked) -> tuple[FloatArray, str]:
    """(n - 1,) numbers of the dwells, and how one is written: all that depends on the dialect's dwell word."""
    rules, wanted = asked.profile.dwell, asked.dwell_s
    unit = rules.words[rules.written.split()[-1]]
    decimals, per_s = (rules.decimals, 1.0) if unit.decimal == "s" else (0, 1000.0)
    quantum = max(10.0**-decimals, rules.resolution_s * per_s)
    steps = np.diff(np.rint(np.cumsum(wanted * per_s) / quantum), prepend=0.0)
    if not (steps > 0).all() or wanted.max() > rules.longest_s:
        raise ProgramError(
            f"{asked.name}: dwells of {wanted.min():g} to {wanted.max():g} s: {asked.profile.title} takes "
            f"{quantum / per_s:g} to {rules.longest_s:g} s. To do: ask for such."
        )
    return steps * quantum, f"\n{rules.written}%.{decimals}f"


def _head(asked: _Asked, comment: str, first: FloatArray) -> bytes:
    """The lines up to the first point."""
    profile, timing = asked.profile, "inverse" if asked.encoding == "inverse" else "per_minute"
    codes = [*profile.g["mm"][-1:], *profile.g["absolute"][:1], *profile.g[timing][:1]]
    x, y, z, *wrist = [f"{letter}{value:.{n}f}" for letter, value, n in zip(LETTERS, first, DECIMALS, strict=True)]
    above = " ".join([f"Z{_above(first)}", x, y, *(wrist if profile.axes.rotary else [])])
    note = comment if "()" in profile.text.comments else f";{comment[1:-1]}"
    return "\n".join([note, " ".join(f"G{code:g}" for code in codes), f"G0 {above}", f"G0 {z}", ""]).encode("ascii")


def _above(point: FloatArray) -> str:
    return f"{max(SAFE_Z_MM, point[2] + SAFE_Z_MM):.4f}"


def _blocks(places: FloatArray, times: _Times) -> Iterator[bytes]:
    """The feed moves, a chunk at a time: of each place what changed, F, and the dwell."""
    written = np.ones((len(places) - 1, 7), dtype=np.bool_)
    written[:, :5] = places[1:] != places[:-1]
    written[:, 0] |= ~written[:, :5].any(axis=1)
    written[:, 5] = times.feed_written
    written[:, 6] = times.dwell is not None
    dwell = np.zeros(len(times.feed)) if times.dwell is None else times.dwell
    numbers = np.column_stack([places[1:], times.feed, dwell])
    words = [f" {letter}%.{n}f" for letter, n in zip(LETTERS, DECIMALS, strict=True)]
    words += [times.feed_template, times.dwell_template]
    patterns = [
        "G1" + "".join(word for bit, word in enumerate(words) if pattern >> bit & 1) + "\n" for pattern in range(128)
    ]
    pattern = written @ (1 << np.arange(7))
    for first in range(0, len(numbers), CHUNK):
        part = slice(first, first + CHUNK)
        template = "".join([patterns[p] for p in pattern[part].tolist()])
        yield (template % tuple(numbers[part][written[part]].tolist())).encode("ascii")


def _comment(name: str) -> str:
    """The name as a comment can hold it."""
    return "".join(char if char.isascii() and char.isprintable() and char not in "()" else "_" for char in name)[:80]


@cache
def shipped(name: str) -> AnyDialect:
    """The profile of a shipped dialect, once one is wanted: the expressions of them all take a tenth of a check."""
    return profile_of(name)


def read(dialect: AnyDialect, text: bytes, name: str, beside: bytes = b"") -> Program:
    """Read a program; ``name`` is for messages, ``beside`` the file that declares its positions.

    ProgramError names the line and the reason.
    """
    require_language(dialect, text[:HEAD_BYTES], name)
    if isinstance(dialect, GcodeDialect):
        return nc.read(dialect, text, name)
    return languages.read(dialect, text, name, beside)


def beside_of(dialect: AnyDialect, path: Path) -> bytes:
    """Content of the file beside a program that declares its positions; empty: none. ProgramError."""
    return b"" if isinstance(dialect, GcodeDialect) else languages.beside_of(dialect, path)


def rewrite(dialect: AnyDialect, program: Program, time_s: FloatArray, encoding: Encoding | None = None) -> bytes:
    """The program with (n,) seconds at its points; only numbers that carry time change. ProgramError.

    ``encoding``: where the time is to sit; as in the program by default.
    """
    if isinstance(dialect, GcodeDialect):
        if encoding in (None, program.encoding):
            return nc.rewrite(dialect, program, time_s)
        return recode(dialect, program, time_s, _nc_encoding(encoding))
    if encoding in (None, program.encoding):
        return languages.rewrite(dialect, program, time_s)
    return languages.recode_moves(dialect, program, time_s, encoding)


def make(dialect: AnyDialect, points_mm: FloatArray, axis: FloatArray, feed_mm_min: float, name: str) -> bytes:
    """A program along (n, 3) points with (n, 3) tool axes, time in its feeds. ProgramError."""
    return path_program(points_mm, axis, feed_mm_min, name, to=dialect)


INDEX = re.compile(r"[A-Za-z_$#]*[\[,]?(\d+)\]?")
"""A tool or a frame as a number of the controller: ``3``, ``TOOL_DATA[3]``, ``#TOOL,3``, ``P_Tool3``."""


def made_like(profile: LanguageProfile, text: bytes, name: str) -> LanguageProfile:
    """The profile whose programs are made for the tool and the frame of the program ``text``.

    ProgramError where the program names none, or where a program that is made cannot name them.
    """
    if profile.make is None:
        return profile
    wanted = languages.tool_and_frame(profile, text, name)
    points, axes = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), np.array([[0.0, 0.0, 1.0]] * 2)
    for written in (_name, _index):  # as it is, or where a made program has the number only
        names = {key: written(value) for key, value in zip(("tool", "frame"), wanted, strict=True) if value}
        made = profile.model_copy(update={"make": profile.make.model_copy(update=names)})
        sample = languages.tool_and_frame(made, make(made, points, axes, 600.0, name), name)
        if [*map(written, sample)] == [*map(written, wanted)]:
            return made
    tool, frame = (value or "none" for value in wanted)
    raise ProgramError(
        f"{name}: its moves name tool {tool} and frame {frame}; a program made in {profile.name} cannot name the same. "
        "To do: name both in the program, as a made program does."
    )


def _name(written: str | None) -> str:
    return written or ""


def _index(written: str | None) -> str:
    """The number of a tool or a frame; its name where it has none."""
    found = INDEX.fullmatch(written or "")
    return found[1] if found else written or ""


def made_like_shipped(name: str, text: bytes, of: str) -> ProgramFormat:
    """As `format_made_like`, in the shipped dialect of that name."""
    if isinstance(profile := shipped(name), LanguageProfile):
        return format_of(made_like(profile, text, of))
    return next(known for known in shipped_formats() if known.name == name)


def read_shipped(name: str, text: bytes, of: str) -> Program:
    """As `read`, in the shipped dialect of that name."""
    return read(shipped(name), text, of)


def read_shipped_beside(name: str, text: bytes, of: str, beside: bytes) -> Program:
    """As `read`, in the shipped dialect of that name."""
    return read(shipped(name), text, of, beside)


def beside_of_shipped(name: str, path: Path) -> bytes:
    """As `beside_of`, in the shipped dialect of that name."""
    return beside_of(shipped(name), path)


def rewrite_shipped(name: str, program: Program, time_s: FloatArray, encoding: Encoding | None = None) -> bytes:
    """As `rewrite`, in the shipped dialect of that name."""
    return rewrite(shipped(name), program, time_s, encoding)


def make_shipped(name: str, points_mm: FloatArray, axis: FloatArray, feed_mm_min: float, of: str) -> bytes:
    """As `make`, in the shipped dialect of that name."""
    return make(shipped(name), points_mm, axis, feed_mm_min, of)


def find_misread_line_shipped(name: str, lines: OwnLines) -> str:
    """As `find_misread_line`, in the shipped dialect of that name."""
    return find_misread_line(shipped(name), lines)


def shipped_formats() -> list[ProgramFormat]:
    """Return the program format of each shipped dialect."""
    return [
        ProgramFormat(
            name,
            partial(read_shipped, name),
            partial(rewrite_shipped, name),
            partial(make_shipped, name),
            partial(find_misread_line_shipped, name),
            partial(made_like_shipped, name),
            DataFileFormat(partial(beside_of_shipped, name), partial(read_shipped_beside, name))
            if name in LANGUAGES
            else None,
        )
        for name in DIALECTS
    ]


def format_made_like(dialect: AnyDialect, text: bytes, name: str) -> ProgramFormat:
    """As `made_like`; NC text names no tool and no frame."""
    return format_of(made_like(dialect, text, name) if isinstance(dialect, LanguageProfile) else dialect)


def format_of(dialect: AnyDialect) -> ProgramFormat:
    """Return the program format of a dialect."""
    made = partial(make, dialect) if isinstance(dialect, GcodeDialect) or dialect.make is not None else None
    return ProgramFormat(
        dialect.name,
        partial(read, dialect),
        partial(rewrite, dialect),
        made,
        partial(find_misread_line, dialect),
        partial(format_made_like, dialect),
        DataFileFormat(partial(beside_of, dialect), partial(read, dialect)),
    )
