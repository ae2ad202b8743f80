"""Reads NC text byte by byte: words, modal state, moves, dwells. Plain Python that numba compiles for large programs.

Everything here works alike on bytes and lists (interpreted) and on arrays (compiled): see ``compiled.py``. It says why
it stops by raising ProgramError(reason, advice); ``at[LINE]`` says where. ``t`` are a dialect's tables, ``at`` and
``now`` the state, which goes from one piece of a program to the next; ``line`` is scratch for the words of a line.
"""

from __future__ import annotations

from typing import Any

from polishd.model.errors import ProgramError
from polishd.plugins.rnc_robot.nc import codes as c
from polishd.plugins.rnc_robot.nc.block import take_block
from polishd.plugins.rnc_robot.nc.words import read_words


def scan(text: Any, stop: int, t: Any, at: Any, now: Any, line: Any, out: Any) -> None:
    """Read whole lines of ``text[:stop]`` until the program ends; ``at[NEXT]`` says where it stopped."""
    begin = 0
    while begin < stop and at[c.ENDED] == 0:
        end = begin
        while end < stop and text[end] != 10:
            end += 1
        at[c.LINE] += 1
        last = end - 1 if end > begin and text[end - 1] == 13 else end
        if end - begin > t.flags[c.LONGEST]:
            raise ProgramError("the line is longer than the controller takes", "split the line")
        if not _tape(text, begin, last, t, at):
            count = read_words(text, begin, last, t, at, now, line)
            if count > 0:
                take_block(count, t, at, now, line, out)
        begin = end + 1
    at[c.NEXT] = min(begin, stop)


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
        raise ProgramError("% stands alone on its line or not at all", "put it on a line of its own")
    if not fresh and at[c.OPENED] == 0:
        raise ProgramError("a % that ends a program which none has opened", "put a % before it, or end it with M2")
    at[c.OPENED] = 1
    if not fresh:
        at[c.ENDED] = at[c.LINE]
    return True
