"""What a block of NC words does to the modal state, and its dwell. Compiled for large programs."""

from __future__ import annotations

import math
from typing import Any

from polishd.model.errors import ProgramError
from polishd.plugins.rnc_robot.nc import codes as c
from polishd.plugins.rnc_robot.nc.moves import leave, move


def take_block(count: int, t: Any, at: Any, now: Any, line: Any, out: Any) -> None:
    """What a line of words does."""
    at[c.GROUPS] = at[c.LETTERS] = at[c.CODE] = 0
    for code in range(c.WORDS):
        line.at[code] = -1
    ends, dwell = 0, False
    for word in range(count):
        code = line.i[word * c.W_INTS + c.W_CODE]
        role = t.role[code]
        if role == c.R_G:
            _add_g(line.f[word], t, at, now)
        elif role == c.R_M:
            ends += _ends(line.f[word], t, at)
        else:
            _add_word(code, role, word, count, at, line)
        dwell = dwell or role == c.R_STATEMENT
    at[c.CODE] = 0
    dwell = dwell or (at[c.GROUPS] >> c.DWELL) & 1 == 1
    _modes(count, t, at, now, line, out)
    if dwell:
        _dwell(count, t, at, now, line, out)
    else:
        _no_stray(at)
        _feed_word(t, at, now, line)
        if at[c.LETTERS] & (c.HAS_AXIS | c.HAS_ARC):
            move(t, at, now, line, out)
        elif (at[c.GROUPS] >> c.HOME) & 1:
            leave(t, at, now, line, out)
    if ends:
        at[c.ENDED] = at[c.LINE]


def _add_word(code: int, role: int, word: int, count: int, at: Any, line: Any) -> None:
    at[c.CODE] = code
    if role == c.R_UNKNOWN:
        raise ProgramError("the word is not known", "")
    if line.at[code] >= 0:
        raise ProgramError("stands twice in one block", "split the block")
    if role == c.R_N and word > 0:
        raise ProgramError("N is not the first word", "put it first")
    if role == c.R_PROGRAM:
        if at[c.PROGRAM] or at[c.MOVES] or at[c.DWELL_COUNT] or count > 1:
            raise ProgramError("the word is not known", "")
        at[c.PROGRAM] = 1
    line.at[code] = word
    if role == c.R_AXIS:
        at[c.LETTERS] |= c.HAS_AXIS
    elif role == c.R_TIME:
        at[c.LETTERS] |= c.HAS_TIME
    elif role == c.R_P:
        at[c.LETTERS] |= c.HAS_P
    elif role == c.R_ARC:
        at[c.LETTERS] |= c.HAS_ARC


def _add_g(value: float, t: Any, at: Any, now: Any) -> None:
    code = int(math.floor(value * 10 + 0.5))
    at[c.CODE] = code
    if code < 0 or code > 9999 or abs(value * 10 - code) > 1e-6 or t.g[code] == 0:
        raise ProgramError("the G code is not known", "")
    does = t.g[code]
    if does == c.NEUTRAL:
        return
    for other in range(len(c.GROUP)):
        if c.GROUP[other] == c.GROUP[does] and (at[c.GROUPS] >> other) & 1:
            raise ProgramError("two G codes of one group in a block contradict each other", "split the block")
    at[c.GROUPS] |= 1 << does
    if does == c.OFFSET:
        if at[c.WCS] != code and at[c.FED]:
            raise ProgramError("the work offset changes in mid-program", "have it posted with one work offset")
        if at[c.WCS] not in (0, code):
            for axis in range(6):  # where the tool is in the other offset, the program does not say
                now[axis] = math.nan
        at[c.WCS] = code


def _ends(value: float, t: Any, at: Any) -> int:
    code = int(value)
    at[c.CODE] = code
    if code != value or code < 0 or code > 999 or t.m[code] == 0:
        raise ProgramError("the M code is not known", "")
    if t.m[code] == c.M_STOPS:
        raise ProgramError("the M code waits for a person, and the cell is unattended", "take it out")
    return 1 if t.m[code] == c.M_ENDS else 0


def _modes(count: int, t: Any, at: Any, now: Any, line: Any, out: Any) -> None:
    """Take over the modal codes of the block."""
    groups = at[c.GROUPS]
    if groups == 0:
        return
    if (groups >> c.INVERSE) & 1 or (groups >> c.PER_MINUTE) & 1:
        _feed_mode((groups >> c.INVERSE) & 1, count, t, at, now, line, out)
    if (groups >> c.INCH) & 1 or (groups >> c.MM) & 1 or (groups >> c.INCH_LENGTHS) & 1:
        _units(groups, at, now, line)
    if (groups >> c.CANCEL) & 1:  # a motion code beside it wins
        at[c.MOTION] = 0
    for does in range(len(c.GROUP)):
        if (groups >> does) & 1 and c.SLOT[does] >= 0:
            at[c.SLOT[does]] = c.VALUE_OF[does]


def _feed_mode(inverse: int, count: int, t: Any, at: Any, now: Any, line: Any, out: Any) -> None:
    """G93 or G94: F of the other one holds no longer."""
    if inverse and t.flags[c.G93] == c.G93_REFUSE:
        at[c.CODE] = 930
        raise ProgramError("the G code is not known", "")
    said = c.SAID_INVERSE if inverse else c.SAID_PER_MINUTE
    if inverse != (at[c.FEED_MODE] == c.SAID_INVERSE):
        now[c.FEED] = math.nan
    at[c.FEED_MODE] = said
    for word in range(count):
        base = word * c.W_INTS
        code = line.f[word] * 10
        if t.role[line.i[base + c.W_CODE]] == c.R_G and (code == 930 or code == 940):
            row = at[c.N_MODES] * c.MODE_INTS
            out.modes[row + c.E_START] = line.i[base + c.W_START]
            out.modes[row + c.E_END] = line.i[base + c.W_END]
            out.modes[row + c.E_CODE] = said
            at[c.N_MODES] += 1


def _units(groups: int, at: Any, now: Any, line: Any) -> None:
    """Inch or mm: F of the other one holds no longer."""
    unit_mm = 1.0 if (groups >> c.MM) & 1 else 25.4
    feed_unit_mm = 25.4 if (groups >> c.INCH) & 1 else 1.0
    if feed_unit_mm != now[c.FEED_UNIT_MM]:
        if line.at[c.L_F] >= 0:
            raise ProgramError("F beside a change of units: it counts in the old ones", "put F a block later")
        now[c.FEED] = math.nan
    at[c.UNIT] = 1
    now[c.UNIT_MM], now[c.FEED_UNIT_MM] = unit_mm, feed_unit_mm


def _no_stray(at: Any) -> None:
    if at[c.LETTERS] & c.HAS_TIME:
        raise ProgramError("a time without the dwell code (G4)", "write the dwell code into the block")
    if at[c.LETTERS] & c.HAS_P and not (at[c.GROUPS] >> c.PATH) & 1:
        raise ProgramError("P without G4 or G64: its meaning is not known", "take it out, or write G4 into the block")


def _feed_word(t: Any, at: Any, now: Any, line: Any) -> None:
    word = line.at[c.L_F]
    if word < 0:
        return
    if line.f[word] <= 0:
        raise ProgramError("F is not above zero", "correct it")
    style = line.i[word * c.W_INTS + c.W_STYLE]
    inch = now[c.FEED_UNIT_MM] != 1.0 and t.flags[c.WHOLE] == c.WHOLE_UNSURE
    if (not style & c.S_POINT and (t.flags[c.FEED_UNSURE] or inch)) or now[c.FEED_UNIT_MM] != now[c.UNIT_MM]:
        at[c.UNSURE_FEED] = at[c.UNSURE_FEED] or at[c.LINE]
    now[c.FEED] = line.f[word]
    at[c.F_LINE], at[c.F_STYLE] = at[c.LINE], style


def _dwell(count: int, t: Any, at: Any, now: Any, line: Any, out: Any) -> None:
    """A dwell: which word is its time, in which unit, and whose it is."""
    time = _time_word(count, t, at, line)
    if (at[c.GROUPS] >> c.PATH) & 1:
        raise ProgramError("G4 and G64 in one block: whose P it is, is not known", "split the block")
    code, style = line.i[time * c.W_INTS + c.W_CODE], line.i[time * c.W_INTS + c.W_STYLE]
    at[c.CODE] = code
    unit = t.decimal[code] if style & c.S_POINT else t.whole[code]
    if unit == c.U_REFUSE:
        raise ProgramError("the dwell's time is not known", "")
    if line.f[time] < 0:
        raise ProgramError("a dwell below zero", "correct it")
    if t.role[code] != c.R_F:
        _feed_word(t, at, now, line)
    keep = c.S_KEEP if t.decimal[code] != t.whole[code] else 0
    scale = 0.001 if unit == c.U_MS else 1.0
    if line.f[time] * scale > t.longest_s:
        raise ProgramError("a dwell longer than the controller takes", "correct it")
    # What else the block says, beside its number, the time and the dwell code
    others = count - 1 - int(line.at[c.L_N] >= 0) - ((at[c.GROUPS] >> c.DWELL) & 1)
    if others and t.flags[c.OWN_BLOCK]:
        raise ProgramError("another word beside a dwell", "give the dwell a block of its own")
    _add_dwell(time, scale, keep, others, at, line, out)


def _time_word(count: int, t: Any, at: Any, line: Any) -> int:
    """Which word of a dwell's block is the time; the others must be harmless beside it."""
    time, dwell = -1, count
    for word in range(count):
        code = line.i[word * c.W_INTS + c.W_CODE]
        at[c.CODE] = code
        if t.whole[code] != c.U_NONE or t.decimal[code] != c.U_NONE:
            if t.whole[code] == c.U_REFUSE and t.decimal[code] == c.U_REFUSE:
                raise ProgramError("the dwell's time is not known", "")
            if time >= 0:
                raise ProgramError("two times in one dwell", "leave one")
            time = word
        elif t.role[code] == c.R_G:
            if t.g[int(math.floor(line.f[word] * 10 + 0.5))] == c.DWELL:
                dwell = word
        else:
            _beside_dwell(t.role[code])
    if time < 0:
        raise ProgramError("a dwell without its time", "")
    role = t.role[line.i[time * c.W_INTS + c.W_CODE]]
    if time < dwell < count and (role == c.R_AXIS or role == c.R_TIME):
        raise ProgramError("a time before the dwell code (G4), or something else", "put the dwell code first")
    return time


def _beside_dwell(role: int) -> None:
    if role == c.R_AXIS or role == c.R_ARC:
        raise ProgramError(
            "dwell and axes in one block: some controllers dwell first, some take X for the time", "split the block"
        )
    if role == c.R_P:
        raise ProgramError("another word beside a dwell", "give the dwell a block of its own")


def _add_dwell(time: int, scale: float, keep: int, others: int, at: Any, line: Any, out: Any) -> None:
    if at[c.DWELLED] and at[c.DWELLS_FOR] < 0:
        raise ProgramError("two dwells at one point: which of them to change is not known", "make them one")
    row = at[c.N_DWELLS] * c.DWELL_INTS
    out.dwells[row + c.D_LINE] = at[c.LINE]
    out.dwells[row + c.D_START] = line.i[time * c.W_INTS + c.W_START]
    out.dwells[row + c.D_END] = line.i[time * c.W_INTS + c.W_END]
    out.dwells[row + c.D_STYLE] = line.i[time * c.W_INTS + c.W_STYLE] + keep
    out.dwells[row + c.D_MOVE] = at[c.DWELLS_FOR]
    out.dwells[row + c.D_OTHERS] = others
    out.times[at[c.N_DWELLS] * c.DWELL_FLOATS + c.D_SECONDS] = line.f[time] * scale
    out.times[at[c.N_DWELLS] * c.DWELL_FLOATS + c.D_SCALE] = scale
    at[c.N_DWELLS] += 1
    at[c.DWELL_COUNT] += 1
    at[c.DWELLED] = 1 if at[c.DWELLS_FOR] >= 0 else 0
    at[c.DWELLS_FOR] = -1
