"""A line of NC text as words. Plain Python that numba compiles for large programs: see ``compiled.py``."""

from __future__ import annotations

from typing import Any

from polishd.model.errors import ProgramError
from polishd.plugins.rnc_robot.nc import codes as c


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
                    raise ProgramError("text behind the end of the block (;)", "put it on a line of its own")
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
    mantissa, kept, digits, decimals, point, after = 0, 0, 0, 0, 0, i
    at[c.GAPPED] = at[c.PADDED] = 0
    while i < end:
        byte = text[i]
        if byte >= 48 and byte <= 57:
            if kept < 17 and decimals < c.MOST_DECIMALS:
                mantissa = mantissa * 10 + (byte - 48)
                decimals += point
                kept += int(mantissa > 0)
            elif point == 0:
                raise ProgramError("a number beyond any machine", "correct it")
            at[c.PADDED] |= int(digits == 0 and byte == 48)
            digits += 1 - point
            at[c.GAPPED] += int(i > after and digits + decimals > 1)
            after = i + 1
        elif byte == 46 and point == 0:
            point, after = 1, i + 1
        elif not (blanks and (byte == 32 or byte == 9)):
            break
        i += 1
    return mantissa, digits, decimals, point, after
