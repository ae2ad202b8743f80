"""What the numbers of the scanner mean: actions, roles of words, columns and slots of its state."""

from __future__ import annotations

import math
from typing import Any

from polishd.model.errors import ProgramError

# What a G code does.
NEUTRAL, RAPID, LINE_TO, ARC_CW, ARC_CCW, CANCEL, DWELL = 1, 2, 3, 4, 5, 6, 7
PLANE_XY, PLANE_ZX, PLANE_YZ, INCH, MM, INCH_LENGTHS = 8, 9, 10, 11, 12, 13
ABSOLUTE, INCREMENTAL, INVERSE, PER_MINUTE, OFFSET = 14, 15, 16, 17, 18
MACHINE, HOME, PATH, VECTORS_ON, VECTORS_OFF = 19, 20, 21, 22, 23
# G codes of one group exclude each other in a block. Indexed by what they do.
GROUP = (0, 0, 1, 1, 1, 1, 10, 2, 3, 3, 3, 4, 4, 4, 5, 5, 6, 6, 7, 2, 2, 8, 9, 9)
M_NEUTRAL, M_ENDS, M_STOPS = 1, 2, 3

# What a word is.
(
    R_UNKNOWN, R_N, R_G, R_M, R_F, R_AXIS, R_NEUTRAL, R_ARC, R_P, R_TIME, R_PROGRAM, R_KEYWORD, R_STATEMENT, R_CALL,
) = range(14)  # fmt: skip
WORDS = 64
BARE, NAMES = 26, 27
"""Code of a number without a letter, and of the first name; letters are 0 to 25."""
L_D, L_F, L_H, L_N, L_R = 3, 5, 7, 13, 17

# Units of a dwell's number.
U_NONE, U_S, U_MS, U_REFUSE = 0, 1, 2, 3

# A dialect's flags.
(
    PARENS, SEMICOLON, EOB, BLANKS, ASSIGN, DELETE, WHOLE, TAPE_NAME, NUMBERED, OWN_BLOCK, LONGEST, G93, FEED_UNSURE,
    FLAGS,
) = range(14)  # fmt: skip
DELETE_REFUSE, DELETE_RUN, DELETE_SKIP = 0, 1, 2
WHOLE_MM, WHOLE_UM, WHOLE_UNSURE = 0, 1, 2
G93_REFUSE, G93_PER_MINUTE, G93_SECONDS = 0, 1, 2

# State between lines: ``at``.
(
    LINE, MOTION, FEED_MODE, DISTANCE, UNIT, PLANE, WCS, F_LINE, F_STYLE, DWELLS_FOR, DWELLED, MOVES, DWELL_COUNT,
    OPENED, ENDED, VECTORING, NAMED, FED, PROGRAM, UNSURE, UNSURE_FEED, COLUMN, CODE, NEXT, N_MOVES, N_DWELLS, N_MODES,
    GROUPS, LETTERS, TAIL, GAPPED, PADDED, LOWER, D_NUMBER, H_NUMBER, D_FED, H_FED, AT_SIZE,
) = range(38)  # fmt: skip
SAID_INVERSE, SAID_PER_MINUTE = 1, 2
SAID_ABSOLUTE, SAID_INCREMENTAL = 1, 2
# Which slot an action sets, and to what; -1: what it does is more than that. Indexed by action.
SLOT = (
    -1, -1, MOTION, MOTION, MOTION, MOTION, -1, -1, PLANE, PLANE, PLANE, -1, -1, -1, DISTANCE, DISTANCE, -1, -1, -1,
    -1, -1, -1, VECTORING, VECTORING,
)  # fmt: skip
VALUE_OF = (
    0, 0, RAPID, LINE_TO, ARC_CW, ARC_CCW, 0, 0, PLANE_XY, PLANE_ZX, PLANE_YZ, 0, 0, 0, SAID_ABSOLUTE, SAID_INCREMENTAL,
    0, 0, 0, 0, 0, 0, 1, 0,
)  # fmt: skip
# ``now``: x y z mm, a b c deg, i j k; then F as written, and mm per unit of lengths and of feeds.
AXES, FEED, UNIT_MM, FEED_UNIT_MM, VALUE = 9, 9, 10, 11, 12

# Columns of what is found.
M_LINE, M_KIND, M_START, M_END, M_STYLE, M_TAIL, M_F_LINE, M_LOWER, MOVE_INTS = range(8 + 1)
V_FEED, V_UNIT, MOVE_FLOATS = 9, 10, 11
D_LINE, D_START, D_END, D_STYLE, D_MOVE, D_OTHERS, DWELL_INTS = range(7)
D_SECONDS, D_SCALE, DWELL_FLOATS = 0, 1, 2
E_START, E_END, E_CODE, MODE_INTS = 0, 1, 2, 3
K_ARC, K_INVERSE = 4, 8
"""Kind of a move: 2 rapid, 3 line, 4 and 5 arcs, and 8 more where F is the time."""

# Which kinds of words a block has.
HAS_AXIS, HAS_TIME, HAS_P, HAS_ARC = 1, 2, 4, 8

# A number's style: decimals, then flags (KEEP: with and without a point it means something else), and the width of its
# whole part where that is padded with zeros.
MOST_DECIMALS, S_POINT, S_PLUS, S_BARE, S_KEEP, S_WIDTH = 15, 16, 32, 64, 128, 256

W_CODE, W_START, W_END, W_STYLE, W_INTS, MOST_WORDS = 0, 1, 2, 3, 4, 48
X_WORD, I_WORD = 23, 8
"""Letters of the first axis and the first arc offset; the others follow."""
ARC_TOLERANCE_MM = 0.02
POW10 = tuple(10.0**digits for digits in range(19))
LARGEST_MANTISSA = 10**16
"""It takes another digit below this: 17 in all."""
LARGEST = 1e9
FAR = 1e4
"""mm or degrees; no position without a decimal point is so far off."""
TEN = tuple(10**digits for digits in range(19))


# Moves: where a block takes the tool. Compiled for large programs.


def move(t: Any, at: Any, now: Any, line: Any, out: Any) -> None:
    """Go where the block says, and note how."""
    if (at[GROUPS] >> HOME) & 1 or (at[GROUPS] >> MACHINE) & 1:
        leave(t, at, now, line, out)
        return
    kind = at[MOTION]
    arc = kind == ARC_CW or kind == ARC_CCW
    if kind == 0:
        raise ProgramError("axes before any G0 or G1", "write G0 or G1 into the block")
    if at[LETTERS] & HAS_ARC and not arc and (at[VECTORING] == 0 or t.axis_word[6] != I_WORD):
        raise ProgramError("I, J, K or R without an arc", "have it posted with A and C, or say vector in the dialect")
    if arc:
        _check_arc(t, at, now, line)
    _go(t, at, now, line)
    at[DWELLS_FOR], at[DWELLED] = -1, 0
    inverse = at[FEED_MODE] == SAID_INVERSE
    if kind != RAPID:
        if math.isnan(now[FEED]) or (inverse and at[F_LINE] != at[LINE]):
            raise ProgramError("a feed move without F", "write F into the block (in G93 into every block)")
        _require_one_offset(at)
        at[FED], at[DWELLS_FOR] = 1, at[MOVES]
        if inverse:
            kind += K_INVERSE
    _add_move(kind, at, now, line, out)


def _require_one_offset(at: Any) -> None:
    """Refuse a feed move with another tool offset (D, H) than at the first one: it moves the path."""
    if at[FED] == 0:
        at[D_FED], at[H_FED] = at[D_NUMBER], at[H_NUMBER]
    elif at[D_FED] != at[D_NUMBER] or at[H_FED] != at[H_NUMBER]:
        raise ProgramError("the tool offset changes in mid-program", "have it posted with one tool and one offset")


def _add_move(kind: int, at: Any, now: Any, line: Any, out: Any) -> None:
    row, own = at[N_MOVES] * MOVE_INTS, at[F_LINE] == at[LINE]
    word = line.at[L_F] * W_INTS
    out.moves[row + M_LINE] = at[LINE]
    out.moves[row + M_KIND] = kind
    out.moves[row + M_START] = line.i[word + W_START] if own else -1
    out.moves[row + M_END] = line.i[word + W_END] if own else -1
    out.moves[row + M_STYLE] = at[F_STYLE]
    out.moves[row + M_TAIL] = at[TAIL]
    out.moves[row + M_F_LINE] = at[F_LINE]
    out.moves[row + M_LOWER] = at[LOWER]
    row = at[N_MOVES] * MOVE_FLOATS
    for axis in range(AXES):
        out.places[row + axis] = now[axis]
    out.places[row + V_FEED] = now[FEED]
    out.places[row + V_UNIT] = now[FEED_UNIT_MM]
    at[N_MOVES] += 1
    at[MOVES] += 1


def _go(t: Any, at: Any, now: Any, line: Any) -> None:
    """Move the axes that the block names.

    A tool vector is stated whole: Siemens (A3, B3, C3) and Fanuc (I, J, K under G43.5) take a component that the block
    leaves out as 0. A block without any keeps the vector, and one that turns a rotary axis leaves it unknown.
    """
    if _names_any(6, AXES, t, line):
        if at[VECTORING]:
            now[6] = now[7] = now[8] = 0.0
    elif _names_any(3, 6, t, line):
        now[6] = now[7] = now[8] = math.nan
    for axis in range(AXES):
        word = line.at[t.axis_word[axis]] if t.axis_word[axis] >= 0 else -1
        if word < 0 or (axis >= 6 and at[VECTORING] == 0):
            continue
        at[CODE] = t.axis_word[axis]
        at[NAMED] |= 1 << axis
        value = line.f[word]
        if axis < 3:
            value = _length_mm(word, t, at, now, line)
        elif axis < 6:
            value = _as_meant(value, line.i[word * W_INTS + W_STYLE], 1.0, t, at)
        if axis < 6 and at[DISTANCE] == SAID_INCREMENTAL:
            value += now[axis]
            if math.isnan(value):
                raise ProgramError("G91 before any absolute position of the axis", "start with an absolute move (G90)")
        now[axis] = value


def _names_any(first: int, end: int, t: Any, line: Any) -> bool:
    """Whether the block names one of the axes ``first`` to ``end`` - 1."""
    found = False
    for axis in range(first, end):
        found = found or (t.axis_word[axis] >= 0 and line.at[t.axis_word[axis]] >= 0)
    return found


def _as_meant(value: float, style: int, unit_mm: float, t: Any, at: Any) -> float:
    """A length or an angle as the dialect takes one without a decimal point: 0.001 mm or deg, 0.0001 inch, unsure."""
    if style & S_POINT or t.flags[WHOLE] == WHOLE_MM or value == 0:
        return value
    if t.flags[WHOLE] == WHOLE_UM:
        return value / (1000.0 if unit_mm == 1.0 else 10000.0)
    if abs(value) >= FAR:
        raise ProgramError(
            "a position without a decimal point, too far for a machine in mm", "say whole_positions in the dialect"
        )
    if at[UNSURE] == 0:
        at[UNSURE] = at[LINE]
    return value


def leave(t: Any, at: Any, now: Any, line: Any, out: Any) -> None:
    """To the reference point, or to machine coordinates: where that is, the program does not say."""
    if (at[GROUPS] >> MACHINE) & 1 and at[MOTION] != RAPID:
        raise ProgramError("a feed move in machine coordinates", "have it posted in work coordinates")
    everything = not at[LETTERS] & HAS_AXIS
    turned = everything or _names_any(3, AXES, t, line)
    for axis in range(AXES):
        if everything or (turned and axis >= 6) or (t.axis_word[axis] >= 0 and line.at[t.axis_word[axis]] >= 0):
            now[axis] = math.nan
    at[DWELLS_FOR], at[DWELLED] = -1, 0
    _add_move(RAPID, at, now, line, out)


def _check_arc(t: Any, at: Any, now: Any, line: Any) -> None:
    """Refuse an arc whose centre does not fit its ends."""
    if at[VECTORING] and t.axis_word[6] == I_WORD:
        raise ProgramError("an arc while I, J, K are a tool vector", "have it posted with straight moves")
    first, second = 0, 1
    if at[PLANE] == PLANE_ZX:
        first, second = 2, 0
    elif at[PLANE] == PLANE_YZ:
        first, second = 1, 2
    ends = (_end(first, t, at, now, line), _end(second, t, at, now, line))
    chord = math.hypot(ends[0], ends[1])
    if math.isnan(chord):
        raise ProgramError("an arc from an unknown position", "go to its start with G0 or G1 first")
    word = line.at[L_R]
    if word >= 0:
        if line.at[I_WORD] >= 0 or line.at[I_WORD + 1] >= 0 or line.at[I_WORD + 2] >= 0:
            raise ProgramError("an arc with R and a centre", "leave one of them")
        if abs(_length_mm(word, t, at, now, line)) * 2 < chord - ARC_TOLERANCE_MM or chord == 0:
            raise ProgramError("an arc whose R does not reach its end", "correct it")
        return
    centre = (_offset(first, t, at, now, line), _offset(second, t, at, now, line))
    radius = math.hypot(centre[0], centre[1])
    if radius == 0:
        raise ProgramError("an arc without a centre", "write I, J, K or R into the block")
    if abs(radius - math.hypot(ends[0] - centre[0], ends[1] - centre[1])) > max(ARC_TOLERANCE_MM, radius * 1e-3):
        raise ProgramError("an arc whose centre does not fit its ends", "correct it")


def _end(axis: int, t: Any, at: Any, now: Any, line: Any) -> float:
    """The arc's end from its start along an axis, mm."""
    word = line.at[X_WORD + axis]
    start: float = now[axis]
    if word < 0:
        return 0.0 * start  # NaN where the start is not said
    end = _length_mm(word, t, at, now, line)
    return end if at[DISTANCE] == SAID_INCREMENTAL else end - start


def _offset(axis: int, t: Any, at: Any, now: Any, line: Any) -> float:
    """The arc's centre from its start along an axis, mm."""
    word = line.at[I_WORD + axis]
    if word < 0:
        return 0.0
    return _length_mm(word, t, at, now, line)


def _length_mm(word: int, t: Any, at: Any, now: Any, line: Any) -> float:
    """The length that a word says."""
    unit_mm: float = now[UNIT_MM]
    return _as_meant(line.f[word], line.i[word * W_INTS + W_STYLE], unit_mm, t, at) * unit_mm


# Numbers for new times, and the text with them in it. Plain Python that numba compiles for large programs.

RELATIVE = 1e-4
"""Largest relative error of a feed, as long as the controller takes the digits."""
HIGHEST = 9e15
"""Largest mantissa: up to here doubles know every whole number."""
FEWEST = 50
"""A feed of fewer units of its last digit would be off by more than 1 %."""
UNWRITABLE = -2
"""``decimals`` of a time that no number of the dialect says."""


def direct(times: Any, old: Any, scale: Any, style: Any, usual: int, least: int, residue: float, out: Any) -> float:
    """Numbers that count the time: mantissas and decimals for those times that change.

    What rounding leaves is carried to the next number, half a quantum at most. Returns what is left after the last, s.
    ``least``: the smallest mantissa, 1 where a number may not be zero. Times of old digits beyond a double's get fewer.
    """
    for k in range(len(times)):
        if times[k] == old[k]:
            out.decimals[k] = -1
            continue
        own = style[k] & 15
        decimals = own if style[k] & S_KEEP and not style[k] & S_POINT else max(own, usual)
        asked = times[k] / scale[k]
        while decimals > 0 and asked * POW10[decimals] > HIGHEST:
            decimals -= 1
        power = POW10[decimals]
        if asked * power > HIGHEST:
            out.decimals[k] = UNWRITABLE
            continue
        carried = max(-0.5 / power, min(0.5 / power, residue / scale[k]))
        mantissa = int(math.floor((asked + carried) * power + 0.5))
        mantissa = max(mantissa, least)
        residue += times[k] - mantissa / power * scale[k]
        out.mantissa[k] = mantissa
        out.decimals[k] = decimals
    return residue


def reciprocal(
    times: Any, old: Any, scale: Any, style: Any, lines: Any, number: Any, most: int, state: Any, out: Any
) -> None:
    """Numbers that the time is divided by (``scale / number`` s): feeds.

    ``lines`` (n, 2): line of each move and of its F. ``state``: what rounding left so far in s, the F that holds, and
    the line of the program's F that it came from. A block takes of the residue what half a unit of
    its last digit can hold. A block whose F is unchanged needs none.
    """
    for k in range(len(times)):
        own = lines[k, 0] == lines[k, 1]
        if lines[k, 1] != state[2]:
            state[1], state[2] = number[k], lines[k, 1]
        out.decimals[k] = -1
        if times[k] == old[k] and state[1] == number[k]:
            continue
        changed = times[k] != old[k]
        feed = scale[k] / times[k] if changed else number[k]
        decimals = style[k] & 15
        while decimals > 0 and POW10[decimals] * feed > HIGHEST:
            decimals -= 1
        while decimals < most and POW10[decimals] * feed * RELATIVE < 1.0:
            decimals += 1
        power = POW10[decimals]
        if changed:
            half_s = 0.5 * times[k] / feed / power
            feed = scale[k] / (times[k] + max(-half_s, min(half_s, state[0])))
        if feed > LARGEST or feed * power < FEWEST:
            out.decimals[k] = UNWRITABLE
            continue
        mantissa = int(math.floor(feed * power + 0.5))
        written = mantissa / power
        if changed:
            state[0] += times[k] - scale[k] / written
        if own or written != state[1]:
            out.mantissa[k] = mantissa
            out.decimals[k] = decimals
        state[1] = written


def splice(text: Any, edits: Any, prefixes: Any, out: Any) -> int:
    """The text with numbers put into places; how many bytes that is.

    ``edits`` has columns start, end (of what is replaced), prefix (bytes before the number), mantissa, decimals (-1: no
    number), style; starts never fall.
    """
    at, n = 0, 0
    for k in range(len(edits.start)):
        while at < edits.start[k]:
            out[n] = text[at]
            at += 1
            n += 1
        at = max(at, edits.end[k])
        prefix = edits.prefix[k]
        for i in range(prefixes.at[prefix], prefixes.at[prefix + 1]):
            out[n] = prefixes.bytes[i]
            n += 1
        if edits.decimals[k] >= 0:
            n = _digits(edits.mantissa[k], edits.decimals[k], edits.style[k], out, n)
    while at < len(text):
        out[n] = text[at]
        at += 1
        n += 1
    return n


def _digits(mantissa: int, decimals: int, style: int, out: Any, n: int) -> int:
    """Write a number as its style is: its trailing zeros, its point, its plus, its bare ``.5``, its leading zeros."""
    while decimals > (style & 15) and mantissa % 10 == 0:
        mantissa //= 10
        decimals -= 1
    if style & S_PLUS:
        out[n] = 43
        n += 1
    places = 1
    while places < 19 and TEN[places] <= mantissa:
        places += 1
    places = max(places, decimals + 1, min(decimals + style // S_WIDTH, 19))
    if style & S_BARE and places == decimals + 1 and mantissa < TEN[decimals] and mantissa > 0:
        places = decimals
    for place in range(places - 1, -1, -1):
        if place == decimals - 1:
            out[n] = 46
            n += 1
        out[n] = 48 + (mantissa // TEN[place]) % 10
        n += 1
    if decimals == 0 and style & S_POINT:
        out[n] = 46
        n += 1
    return n
