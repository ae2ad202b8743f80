"""A dialect of ISO-like NC text as strict data: what a controller's words mean."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import BaseModel, ConfigDict, Field, model_validator

from polishd.plugins.rnc_robot.gcode import kernels as c

Unit = Literal["s", "ms", "refuse"]
Codes = dict[str, list[float]]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)


class DwellWord(_Strict):
    """The unit of a dwell's number, as it is written."""

    whole: Unit
    """Without a decimal point."""
    decimal: Unit
    """With one."""


class DwellRules(_Strict):
    """How a dwell is written."""

    codes: list[float]
    words: dict[str, DwellWord]
    """By letter, by name as it stands in the text (``TIME=``), or ``number`` for a bare one."""
    refused: dict[str, str]
    """Letters that mean something else beside the dwell code, and what."""
    decimals: Annotated[int, Field(ge=0, le=9)]
    """Of new numbers in seconds, where the program's own have fewer."""
    most_decimals: Annotated[int, Field(ge=0, le=12)]
    resolution_s: Annotated[float, Field(ge=0, le=1e3)] = 0.0
    """What the controller really resolves, where that is coarser than what can be written."""
    longest_s: Annotated[float, Field(ge=1e-6, le=1e12)]
    written: str
    """How a new dwell block begins; the number follows."""
    own_block: bool


class FeedRules(_Strict):
    """What F means."""

    unit: Literal["mm/min", "mm/s"]
    g93: Literal["1/min", "s", "refuse"]
    whole: Literal["as_is", "unsure"]
    """F without a decimal point: as it stands, or up to a machine parameter. In inches it always is."""
    most_decimals: Annotated[int, Field(ge=0, le=12)]


class TextRules(_Strict):
    """How text becomes words."""

    comments: list[Literal["()", ";"]]
    end_of_block: bool
    blanks_in_numbers: bool
    assign: bool
    block_delete: Literal["refuse", "run", "skip"]
    whole_positions: Literal["mm", "um", "unsure"]
    commands: list[str]
    """What comments begin with that the controller runs, before a comma."""
    realtime: str
    """Characters that the controller acts on wherever they stand; with any, bytes beyond ASCII are such, too."""
    longest_line: Annotated[int, Field(ge=20, le=4096)]
    tape: Literal["percent", "name"]
    program_number: bool
    end: Literal["required", "optional"]


class AxisRules(_Strict):
    """Which words turn the tool, or the part beneath it."""

    rotary: list[Literal["CA", "CB", "AB", "BA", "AC", "BC"]]
    """Pairs that a program may use, outermost rotation first: CA is Rz(C) Rx(A)."""
    turns: Literal["tool", "table"]
    """What they turn. The tool axis in the frame of a part on a table is the table's rotation undone."""
    vector: list[str]
    """Three words of a tool vector from the tip into the spindle; empty: none."""


class WordRules(_Strict):
    """Words that change neither time nor place."""

    neutral: list[str]
    keywords: list[str]


class GcodeDialect(_Strict):
    """A profile of ISO-like NC text (``kind = "nc"``)."""

    kind: Literal["nc"]
    name: str
    title: str
    dwell: DwellRules
    feed: FeedRules
    text: TextRules
    axes: AxisRules
    words: WordRules
    g: Codes
    """G codes by what they do; what stands nowhere is refused."""
    m: Codes
    refused_g: dict[str, str]
    """Why a G code is refused."""
    refused_words: dict[str, str]

    @model_validator(mode="after")
    def _usable(self) -> GcodeDialect:
        """A dialect whose words or codes make no sense is refused before a program is read."""
        tables(self)
        return self


# A dialect as the scanner looks things up: lists for the interpreter, arrays once it is compiled.

_ACTIONS = {
    "neutral": c.NEUTRAL, "rapid": c.RAPID, "line": c.LINE_TO, "arc_cw": c.ARC_CW, "arc_ccw": c.ARC_CCW,
    "cancel": c.CANCEL, "plane_xy": c.PLANE_XY, "plane_zx": c.PLANE_ZX, "plane_yz": c.PLANE_YZ, "inch": c.INCH,
    "mm": c.MM, "inch_lengths": c.INCH_LENGTHS, "absolute": c.ABSOLUTE, "incremental": c.INCREMENTAL,
    "inverse": c.INVERSE, "per_minute": c.PER_MINUTE, "offset": c.OFFSET, "machine": c.MACHINE, "home": c.HOME,
    "path": c.PATH, "vectors_on": c.VECTORS_ON, "vectors_off": c.VECTORS_OFF,
}  # fmt: skip
_M_ACTIONS = {"neutral": c.M_NEUTRAL, "ends": c.M_ENDS, "stops": c.M_STOPS}
_UNITS = {"s": c.U_S, "ms": c.U_MS, "refuse": c.U_REFUSE}
_WHOLE = {"mm": c.WHOLE_MM, "um": c.WHOLE_UM, "unsure": c.WHOLE_UNSURE}
_DELETE = {"refuse": c.DELETE_REFUSE, "run": c.DELETE_RUN, "skip": c.DELETE_SKIP}
_G93 = {"refuse": c.G93_REFUSE, "1/min": c.G93_PER_MINUTE, "s": c.G93_SECONDS}
_AXES = "XYZABC"


class Tables(NamedTuple):
    """See ``kernels.py`` for what the numbers mean."""

    flags: Sequence[int]
    g: Sequence[int]
    """Action by G code times ten."""
    m: Sequence[int]
    role: Sequence[int]
    """By word code, as are ``whole`` and ``decimal``, the units of a dwell's number."""
    whole: Sequence[int]
    decimal: Sequence[int]
    axis_word: Sequence[int]
    """Word code of each axis x y z a b c i j k; -1: the dialect has none."""
    longest_s: float
    names: int
    name_at: Sequence[int]
    name_bytes: Sequence[int]


def tables(dialect: GcodeDialect) -> Tables:
    """The dialect's tables; ValueError, ``KEY: PROBLEM``, for a key that makes no sense."""
    _check_words(dialect)
    names = _names(dialect)
    role = [c.R_UNKNOWN] * c.WORDS
    for letter, what in {"N": c.R_N, "G": c.R_G, "M": c.R_M, "F": c.R_F, "R": c.R_ARC}.items():
        role[_code(letter, names)] = what
    vector = dialect.axes.vector
    axes = [*_AXES[:3], *(_AXES[k] if any(_AXES[k] in pair for pair in dialect.axes.rotary) else "" for k in (3, 4, 5))]
    axes += vector or ["", "", ""]
    if len(axes) != c.AXES:
        raise ValueError("axes.vector: needs three words; name them, or none")
    axis_word = [_code(word, names, "axes.vector") if word else -1 for word in axes]
    for axis in axis_word:
        if axis >= 0:
            role[axis] = c.R_AXIS
    for letter in "IJK":
        role[_code(letter, names)] = c.R_ARC
    for letter in "PQ" if dialect.g.get("path") else ():
        role[_code(letter, names)] = c.R_P
    for word in dialect.words.neutral:
        role[_code(word, names, "words.neutral")] = c.R_NEUTRAL
    for word in dialect.words.keywords:
        role[_code(word, names, "words.keywords")] = c.R_CALL if word.endswith("(") else c.R_KEYWORD
    if dialect.text.program_number:
        role[_code("O", names)] = c.R_PROGRAM
    whole, decimal = _dwell_words(dialect, names, role)
    return Tables(
        _flags(dialect), _g_codes(dialect), _m_codes(dialect), role, whole, decimal, axis_word,
        dialect.dwell.longest_s, len(names), *_packed(names),
    )  # fmt: skip


def _check_words(dialect: GcodeDialect) -> None:
    """ValueError for words that no text can hold, or that mean something else already."""
    named = {"axes.vector": dialect.axes.vector, "words.neutral": dialect.words.neutral,
             "words.keywords": dialect.words.keywords, "dwell.words": [*dialect.dwell.words],
             "dwell.written": [dialect.dwell.written], "text.realtime": [dialect.text.realtime],
             "text.commands": dialect.text.commands}  # fmt: skip
    for key, words in named.items():
        for word in words:
            if not word.isascii():
                raise ValueError(f"{key}: {word!r} is no ASCII text; correct it")
    taken = {*"NGMFXYZ", *(letter for pair in dialect.axes.rotary for letter in pair)}
    for key in ("words.neutral", "words.keywords"):
        for word in named[key]:
            if word.upper() in taken:
                raise ValueError(f"{key}: {word!r} means something already; take it out")
    if written_dwell_word(dialect) not in dialect.dwell.words:
        raise ValueError("dwell.written: ends in no word of dwell.words; end it as in 'G4 P'")


def written_dwell_word(dialect: GcodeDialect) -> str:
    """The word of a new dwell's time: ``number`` where the number stands bare."""
    return re.sub(r"^.*[Gg]0*[0-9]+\.?[0-9]*\s*", "", dialect.dwell.written).strip() or "number"


def _names(dialect: GcodeDialect) -> list[str]:
    """Words of more than one letter, the longest first."""
    words = [*dialect.dwell.words, *dialect.axes.vector, *dialect.words.neutral, *dialect.words.keywords]
    found = {word.upper() for word in words if len(word) > 1 and word != "number"}
    if len(found) > c.WORDS - c.NAMES:
        raise ValueError(f"words: more than {c.WORDS - c.NAMES} names of several letters in all; name fewer")
    return sorted(found, key=len, reverse=True)


def _code(word: str, names: list[str], key: str = "words") -> int:
    """The code of a word; ValueError at ``key`` where it is none."""
    if word == "number":
        return c.BARE
    upper = word.upper()
    if upper in names:
        return c.NAMES + names.index(upper)
    if len(upper) != 1 or not "A" <= upper <= "Z":
        raise ValueError(f"{key}: {word!r} is no word; give a letter, or a name")
    return ord(upper) - 65


def _dwell_words(dialect: GcodeDialect, names: list[str], role: list[int]) -> tuple[list[int], list[int]]:
    whole, decimal = [c.U_NONE] * c.WORDS, [c.U_NONE] * c.WORDS
    for letter in dialect.dwell.refused:
        code = _code(letter, names, "dwell.refused")
        whole[code] = decimal[code] = c.U_REFUSE
        if role[code] == c.R_UNKNOWN:
            role[code] = c.R_TIME
    for word, unit in dialect.dwell.words.items():
        code = _code(word, names, "dwell.words")
        whole[code], decimal[code] = _UNITS[unit.whole], _UNITS[unit.decimal]
        if role[code] == c.R_UNKNOWN:
            role[code] = c.R_STATEMENT if word.startswith("#") else c.R_TIME
    return whole, decimal


def _flags(dialect: GcodeDialect) -> list[int]:
    flags, text = [0] * c.FLAGS, dialect.text
    flags[c.PARENS] = "()" in text.comments
    flags[c.SEMICOLON] = ";" in text.comments
    flags[c.EOB] = text.end_of_block
    flags[c.BLANKS] = text.blanks_in_numbers
    flags[c.ASSIGN] = text.assign
    flags[c.DELETE] = _DELETE[text.block_delete]
    flags[c.WHOLE] = _WHOLE[text.whole_positions]
    flags[c.TAPE_NAME] = text.tape == "name"
    flags[c.NUMBERED] = text.program_number
    flags[c.OWN_BLOCK] = dialect.dwell.own_block
    flags[c.LONGEST] = text.longest_line
    flags[c.FEED_UNSURE] = dialect.feed.whole == "unsure"
    flags[c.G93] = _G93[dialect.feed.g93]
    return [int(flag) for flag in flags]


def _g_codes(dialect: GcodeDialect) -> list[int]:
    listed = [(f"g.{does}", numbers, _ACTIONS.get(does)) for does, numbers in dialect.g.items()]
    return _codes([("dwell.codes", dialect.dwell.codes, c.DWELL), *listed], 10, 1000, _ACTIONS)


def _m_codes(dialect: GcodeDialect) -> list[int]:
    listed = [(f"m.{does}", numbers, _M_ACTIONS.get(does)) for does, numbers in dialect.m.items()]
    return _codes(listed, 1, 1000, _M_ACTIONS)


def _codes(
    listed: Iterable[tuple[str, list[float], int | None]], steps: int, end: int, known: Iterable[str]
) -> list[int]:
    """Actions by code times ``steps``, below ``end``, from keys with their numbers and their action."""
    found, keys = [0] * (end * steps), dict[int, str]()
    for key, numbers, does in listed:
        if does is None:
            raise ValueError(f"{key}: is not known; use one of {', '.join(known)}")
        for number in numbers:
            code = round(number * steps) if math.isfinite(number) else -1
            if abs(code - number * steps) > 1e-6 or not 0 <= code < len(found):
                raise ValueError(f"{key}: {number:g} is no code; correct it")
            if found[code] not in (0, does):
                raise ValueError(f"{key}: {number:g} is in {keys[code]} too; take it out of one of them")
            found[code], keys[code] = does, key
    return found


def _packed(names: list[str]) -> tuple[list[int], list[int]]:
    """Where each name begins among all names' bytes, and the bytes."""
    starts = [0]
    for name in names:
        starts.append(starts[-1] + len(name))
    return starts, list("".join(names).encode("ascii")) or [0]


Row = Any
"""A list, or an array."""


class WordBuffer(NamedTuple):
    """The words of a line."""

    i: Row
    f: Row
    at: Row
    """By word code: which word of the line it is; -1: not in it."""


class ScanColumns(NamedTuple):
    """Columns to fill, row by row, flat."""

    moves: Row
    places: Row
    dwells: Row
    times: Row
    modes: Row
