"""Moves: where a block takes the tool. Compiled for large programs."""

from __future__ import annotations

import math
from typing import Any

from polishd.model.errors import ProgramError
from polishd.plugins.rnc_robot.nc import codes as c


def move(t: Any, at: Any, now: Any, line: Any, out: Any) -> None:
    """Go where the block says, and note how."""
    if (at[c.GROUPS] >> c.HOME) & 1 or (at[c.GROUPS] >> c.MACHINE) & 1:
        leave(t, at, now, line, out)
        return
    kind = at[c.MOTION]
    arc = kind == c.ARC_CW or kind == c.ARC_CCW
    if kind == 0:
        raise ProgramError("axes before any G0 or G1", "write G0 or G1 into the block")
    if at[c.LETTERS] & c.HAS_ARC and not arc and (at[c.VECTORING] == 0 or t.axis_word[6] != c.I_WORD):
        raise ProgramError("I, J, K or R without an arc", "have it posted with A and C, or say vector in the dialect")
    if arc:
        _check_arc(t, at, now, line)
    _go(t, at, now, line)
    at[c.DWELLS_FOR], at[c.DWELLED] = -1, 0
    inverse = at[c.FEED_MODE] == c.SAID_INVERSE
    if kind != c.RAPID:
        if math.isnan(now[c.FEED]) or (inverse and at[c.F_LINE] != at[c.LINE]):
            raise ProgramError("a feed move without F", "write F into the block (in G93 into every block)")
        at[c.FED], at[c.DWELLS_FOR] = 1, at[c.MOVES]
        if inverse:
            kind += c.K_INVERSE
    _add_move(kind, at, now, line, out)


def _add_move(kind: int, at: Any, now: Any, line: Any, out: Any) -> None:
    row, own = at[c.N_MOVES] * c.MOVE_INTS, at[c.F_LINE] == at[c.LINE]
    word = line.at[c.L_F] * c.W_INTS
    out.moves[row + c.M_LINE] = at[c.LINE]
    out.moves[row + c.M_KIND] = kind
    out.moves[row + c.M_START] = line.i[word + c.W_START] if own else -1
    out.moves[row + c.M_END] = line.i[word + c.W_END] if own else -1
    out.moves[row + c.M_STYLE] = at[c.F_STYLE]
    out.moves[row + c.M_TAIL] = at[c.TAIL]
    out.moves[row + c.M_F_LINE] = at[c.F_LINE]
    out.moves[row + c.M_LOWER] = at[c.LOWER]
    row = at[c.N_MOVES] * c.MOVE_FLOATS
    for axis in range(c.AXES):
        out.places[row + axis] = now[axis]
    out.places[row + c.V_FEED] = now[c.FEED]
    out.places[row + c.V_UNIT] = now[c.FEED_UNIT_MM]
    at[c.N_MOVES] += 1
    at[c.MOVES] += 1


def _go(t: Any, at: Any, now: Any, line: Any) -> None:
    """Move the axes that the block names."""
    for axis in range(c.AXES):
        word = line.at[t.axis_word[axis]] if t.axis_word[axis] >= 0 else -1
        if word < 0 or (axis >= 6 and at[c.VECTORING] == 0):
            continue
        at[c.CODE] = t.axis_word[axis]
        at[c.NAMED] |= 1 << axis
        value = line.f[word]
        if axis < 3:
            value = _length_mm(word, t, at, now, line)
        elif axis < 6:
            value = _as_meant(value, line.i[word * c.W_INTS + c.W_STYLE], 1.0, t, at)
        if axis < 6 and at[c.DISTANCE] == c.SAID_INCREMENTAL:
            value += now[axis]
            if math.isnan(value):
                raise ProgramError("G91, and nobody said where the axis is", "start with an absolute move (G90)")
        now[axis] = value


def _as_meant(value: float, style: int, unit_mm: float, t: Any, at: Any) -> float:
    """A length or an angle as the dialect takes one without a decimal point: 0.001 mm or deg, 0.0001 inch, unsure."""
    if style & c.S_POINT or t.flags[c.WHOLE] == c.WHOLE_MM or value == 0:
        return value
    if t.flags[c.WHOLE] == c.WHOLE_UM:
        return value / (1000.0 if unit_mm == 1.0 else 10000.0)
    if abs(value) >= c.FAR:
        raise ProgramError(
            "a position without a decimal point, too far for a machine in mm", "say whole_positions in the dialect"
        )
    if at[c.UNSURE] == 0:
        at[c.UNSURE] = at[c.LINE]
    return value


def leave(t: Any, at: Any, now: Any, line: Any, out: Any) -> None:
    """To the reference point, or to machine coordinates: where that is, the program does not say."""
    if (at[c.GROUPS] >> c.MACHINE) & 1 and at[c.MOTION] != c.RAPID:
        raise ProgramError("a feed move in machine coordinates", "have it posted in work coordinates")
    everything = not at[c.LETTERS] & c.HAS_AXIS
    for axis in range(6):
        if everything or (t.axis_word[axis] >= 0 and line.at[t.axis_word[axis]] >= 0):
            now[axis] = math.nan
    at[c.DWELLS_FOR], at[c.DWELLED] = -1, 0
    _add_move(c.RAPID, at, now, line, out)


def _check_arc(t: Any, at: Any, now: Any, line: Any) -> None:
    """Refuse an arc whose centre does not fit its ends."""
    if at[c.VECTORING] and t.axis_word[6] == c.I_WORD:
        raise ProgramError("an arc while I, J, K are a tool vector", "have it posted with straight moves")
    first, second = 0, 1
    if at[c.PLANE] == c.PLANE_ZX:
        first, second = 2, 0
    elif at[c.PLANE] == c.PLANE_YZ:
        first, second = 1, 2
    ends = (_end(first, t, at, now, line), _end(second, t, at, now, line))
    chord = math.hypot(ends[0], ends[1])
    if math.isnan(chord):
        raise ProgramError("an arc from nobody knows where", "go to its start with G0 or G1 first")
    word = line.at[c.L_R]
    if word >= 0:
        if line.at[c.I_WORD] >= 0 or line.at[c.I_WORD + 1] >= 0 or line.at[c.I_WORD + 2] >= 0:
            raise ProgramError("an arc with R and a centre", "leave one of them")
        if abs(_length_mm(word, t, at, now, line)) * 2 < chord - c.ARC_TOLERANCE_MM or chord == 0:
            raise ProgramError("an arc whose R does not reach its end", "correct it")
        return
    centre = (_offset(first, t, at, now, line), _offset(second, t, at, now, line))
    radius = math.hypot(centre[0], centre[1])
    if radius == 0:
        raise ProgramError("an arc without a centre", "write I, J, K or R into the block")
    if abs(radius - math.hypot(ends[0] - centre[0], ends[1] - centre[1])) > max(c.ARC_TOLERANCE_MM, radius * 1e-3):
        raise ProgramError("an arc whose centre does not fit its ends", "correct it")


def _end(axis: int, t: Any, at: Any, now: Any, line: Any) -> float:
    """The arc's end from its start along an axis, mm."""
    word = line.at[c.X_WORD + axis]
    start: float = now[axis]
    if word < 0:
        return 0.0 * start  # NaN where the start is not said
    end = _length_mm(word, t, at, now, line)
    return end if at[c.DISTANCE] == c.SAID_INCREMENTAL else end - start


def _offset(axis: int, t: Any, at: Any, now: Any, line: Any) -> float:
    """The arc's centre from its start along an axis, mm."""
    word = line.at[c.I_WORD + axis]
    if word < 0:
        return 0.0
    return _length_mm(word, t, at, now, line)


def _length_mm(word: int, t: Any, at: Any, now: Any, line: Any) -> float:
    """The length that a word says."""
    unit_mm: float = now[c.UNIT_MM]
    return _as_meant(line.f[word], line.i[word * c.W_INTS + c.W_STYLE], unit_mm, t, at) * unit_mm
