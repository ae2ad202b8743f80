"""A line of NC text as words. Plain Python that numba compiles for large programs: see ``jit.py``."""

from __future__ import annotations

import math
from typing import Any

from polishd.model.errors import ProgramError
from polishd.plugins.rnc_robot.gcode import kernels as c
from polishd.plugins.rnc_robot.gcode.kernels import leave, move


def read_words(text: Any, begin: int, end: int, t: Any, at: Any, now: Any, line: Any) -> int:
    """The words of text[begin:end] into ``line``; how many."""
    count = 0
    i = _gap(text, begin, end, t, at)
    if i < end and text[i] == 47:
        if t.flags[c.DELETE] == c.DELETE_REFUSE:
            raise ProgramError(
                "block delete: whether the block runs is up to a switch",
                "delete the block or its /, or say block_delete in the dialect",
            )
        i = end if t.flags[c.DELETE] == c.DELETE_SKIP else _gap(text, i + 1, end, t, at)
    while i < end:
        if count == c.MOST_WORDS:
            raise ProgramError("too many words in a block", "split the block")
        i = _identifier(text, i, end, t, at)
        code = at[c.CODE]
        line.i[count * c.W_INTS + c.W_CODE] = code
        if t.role[code] == c.R_CALL:
            i = _arguments(text, i, end)
        elif t.role[code] != c.R_KEYWORD:
            i = _number(text, i, end, t, at, now, line, count * c.W_INTS)
            line.f[count] = now[c.VALUE]
            if at[c.GAPPED] and (t.role[code] == c.R_G or t.role[code] == c.R_M):
                raise ProgramError("a blank inside a G or M code: one code, or a code and a number", "take it out")
        at[c.TAIL] = i
        count += 1
        i = _gap(text, i, end, t, at)
    return count


def _gap(text: Any, i: int, end: int, t: Any, at: Any) -> int:
    """Past blanks and comments."""
    while i < end:
        byte = text[i]
        if byte == 32 or byte == 9:
            i += 1
        elif byte == 40 and t.flags[c.PARENS]:
            i = _comment(text, i + 1, end, at)
        elif byte == 59 and t.flags[c.SEMICOLON]:
            return end
        elif byte == 59 and t.flags[c.EOB]:
            while i + 1 < end:
                i += 1
                if text[i] != 32 and text[i] != 9:
                    at[c.COLUMN] = i
                    raise ProgramError("text behind the end of the block (;)", "put it on a separate line")
            return end
        else:
            break
    return i


def _comment(text: Any, i: int, end: int, at: Any) -> int:
    while i < end and text[i] != 41:
        if text[i] == 40:
            break
        i += 1
    if i == end or text[i] == 40:
        at[c.COLUMN] = i
        raise ProgramError("a comment is not closed, or holds another", "close it with ) on the same line")
    return i + 1


def _identifier(text: Any, i: int, end: int, t: Any, at: Any) -> int:
    """The word's code into ``at[CODE]``; where its number begins."""
    byte = text[i]
    at[c.COLUMN] = i
    for name in range(t.names):
        size: int = t.name_at[name + 1] - t.name_at[name]
        if i + size <= end and _is_name(text, i, end, t, name):
            at[c.CODE] = c.NAMES + name
            return i + size
    letter = (byte & 0xDF) - 65
    if byte >= 65 and letter >= 0 and letter < 26:
        at[c.CODE] = letter
        at[c.LOWER] = byte >> 5 & 1
        i += 1
        if letter == 14 and t.flags[c.NUMBERED] == 0:
            raise ProgramError("the word O is not known", "")
        while i < end and (text[i] == 32 or text[i] == 9):
            i += 1
        if t.flags[c.ASSIGN] and i < end and text[i] == 61:
            i += 1
        return i
    if t.whole[c.BARE] == c.U_NONE or not (byte == 43 or byte == 45 or byte == 46 or (byte >= 48 and byte <= 57)):
        raise ProgramError("is no word", "")
    at[c.CODE] = c.BARE
    return i


def _is_name(text: Any, i: int, end: int, t: Any, name: int) -> bool:
    """Whether a name of the dialect stands here, and ends here."""
    first, last = t.name_at[name], t.name_at[name + 1]
    for k in range(first, last):
        byte = text[i + k - first]
        if byte >= 97 and byte <= 122:
            byte -= 32
        if byte != t.name_bytes[k]:
            return False
    after = i + last - first
    if t.name_bytes[last - 1] == 61 or t.name_bytes[last - 1] == 40 or after == end:
        return True
    byte = text[after] & 0xDF
    return not (text[after] >= 65 and byte >= 65 and byte <= 90) and text[after] != 95


def _arguments(text: Any, i: int, end: int) -> int:
    """Past the ) of a call; one in quotes is text."""
    quoted = False
    while i < end and (quoted or text[i] != 41):
        quoted = quoted != (text[i] == 34)
        i += 1
    if i == end:
        raise ProgramError("a call is not closed", "close it with ) on the same line")
    return i + 1


def _number(text: Any, i: int, end: int, t: Any, at: Any, now: Any, line: Any, word: int) -> int:
    """The number at ``i`` into ``now[VALUE]``, its place and style into the word; past its last digit."""
    while i < end and (text[i] == 32 or text[i] == 9):
        i += 1
    start = i
    style, sign = 0, 1.0
    if i < end and (text[i] == 43 or text[i] == 45):
        if text[i] == 43:
            style = c.S_PLUS
        else:
            sign = -1.0
        i += 1
    mantissa, digits, decimals, point, after = _digits(text, i, end, t.flags[c.BLANKS], at)
    if digits + decimals == 0:
        raise ProgramError("is a word without a number", "")
    value = sign * mantissa / c.POW10[decimals]
    if value > c.LARGEST or value < -c.LARGEST:
        raise ProgramError("a number beyond any machine", "correct it")
    now[c.VALUE] = value
    line.i[word + c.W_START] = start
    line.i[word + c.W_END] = after
    width = digits if at[c.PADDED] and 1 < digits < 12 else 0
    line.i[word + c.W_STYLE] = style + decimals + c.S_POINT * point + c.S_BARE * (digits == 0) + c.S_WIDTH * width
    return after


def _digits(text: Any, i: int, end: int, blanks: int, at: Any) -> tuple[int, int, int, int, int]:
    """Mantissa, digits before the point, decimals, whether there is a point, and where the last of these ends."""
    mantissa, digits, decimals, point, after = 0, 0, 0, 0, i
    at[c.GAPPED] = at[c.PADDED] = 0
    while i < end:
        byte = text[i]
        if byte >= 48 and byte <= 57:
            if mantissa < c.LARGEST_MANTISSA and decimals < c.MOST_DECIMALS:
                mantissa = mantissa * 10 + (byte - 48)
                decimals += point
            elif point == 0:
                raise ProgramError("a number beyond any machine", "correct it")
            if digits == 0 and byte == 48:
                at[c.PADDED] = 1
            digits += 1 - point
            if i > after and digits + decimals > 1:
                at[c.GAPPED] += 1
            after = i + 1
        elif byte == 46 and point == 0:
            point, after = 1, i + 1
        elif not (blanks and (byte == 32 or byte == 9)):
            break
        i += 1
    return mantissa, digits, decimals, point, after


# What a block of NC words does to the modal state, and its dwell. Compiled for large programs.


def take_block(count: int, t: Any, at: Any, now: Any, line: Any, out: Any) -> None:
    """What a line of words does."""
    at[c.GROUPS] = at[c.LETTERS] = at[c.CODE] = 0
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
    for word in range(count):
        line.at[line.i[word * c.W_INTS + c.W_CODE]] = -1


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
    _keep_kind(code, role, line.f[word], at)


def _keep_kind(code: int, role: int, value: float, at: Any) -> None:
    """Keep that the block has a word of this kind, and the number of a tool offset."""
    if role == c.R_AXIS:
        at[c.LETTERS] |= c.HAS_AXIS
    elif role == c.R_TIME:
        at[c.LETTERS] |= c.HAS_TIME
    elif role == c.R_P:
        at[c.LETTERS] |= c.HAS_P
    elif role == c.R_ARC:
        at[c.LETTERS] |= c.HAS_ARC
    elif role == c.R_NEUTRAL and code == c.L_D:
        at[c.D_NUMBER] = int(value)
    elif role == c.R_NEUTRAL and code == c.L_H:
        at[c.H_NUMBER] = int(value)


def _add_g(value: float, t: Any, at: Any, now: Any) -> None:
    code = int(math.floor(value * 10 + 0.5))
    at[c.CODE] = code
    if code < 0 or code > 9999 or abs(value * 10 - code) > 1e-6 or t.g[code] == 0:
        raise ProgramError("the G code is not known", "")
    does = t.g[code]
    if does == c.NEUTRAL:
        return
    if at[c.GROUPS]:
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
        raise ProgramError("another word beside a dwell", "put the dwell into a separate block")
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
        raise ProgramError("another word beside a dwell", "put the dwell into a separate block")


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


# Reads NC text byte by byte: words, modal state, moves, dwells. Plain Python that numba compiles for large programs.


def scan(text: Any, ends: Any, t: Any, at: Any, now: Any, line: Any, out: Any) -> None:
    """Read lines of ``text``, which have these ``ends``, until the program ends; ``at[NEXT]`` says where it stopped."""
    begin = 0
    for end in ends:
        if at[c.ENDED]:
            break
        at[c.LINE] += 1
        last = end - 1 if end > begin and text[end - 1] == 13 else end
        if end - begin > t.flags[c.LONGEST]:
            raise ProgramError("the line is longer than the controller takes", "split the line")
        if not _tape(text, begin, last, t, at):
            count = read_words(text, begin, last, t, at, now, line)
            if count > 0:
                take_block(count, t, at, now, line, out)
        begin = end + 1
    at[c.NEXT] = min(begin, len(text))


def _tape(text: Any, begin: int, end: int, t: Any, at: Any) -> bool:
    """Whether the line is a tape mark: the first opens a program, another ends it."""
    while begin < end and (text[begin] == 32 or text[begin] == 9):
        begin += 1
    if begin == end or text[begin] != 37:
        return False
    while end > begin + 1 and (text[end - 1] == 32 or text[end - 1] == 9):
        end -= 1
    fresh = at[c.OPENED] == 0 and at[c.MOVES] == 0 and at[c.DWELL_COUNT] == 0
    if end - begin > 1 and (t.flags[c.TAPE_NAME] == 0 or not fresh):
        raise ProgramError("% is not alone on its line", "put it on a separate line")
    if not fresh and at[c.OPENED] == 0:
        raise ProgramError("a closing % without an opening %", "put a % before the program, or end it with M2")
    at[c.OPENED] = 1
    if not fresh:
        at[c.ENDED] = at[c.LINE]
    return True
