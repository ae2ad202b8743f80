"""Numbers for new times, and the text with them in it. Plain Python that numba compiles for large programs."""

from __future__ import annotations

import math
from typing import Any

from polishd.plugins.rnc_robot.nc import codes as c

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
        decimals = own if style[k] & c.S_KEEP and not style[k] & c.S_POINT else max(own, usual)
        asked = times[k] / scale[k]
        while decimals > 0 and asked * c.POW10[decimals] > HIGHEST:
            decimals -= 1
        power = c.POW10[decimals]
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
    its last digit can hold. A block whose F is that of before needs none of its own.
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
        while decimals > 0 and c.POW10[decimals] * feed > HIGHEST:
            decimals -= 1
        while decimals < most and c.POW10[decimals] * feed * RELATIVE < 1.0:
            decimals += 1
        power = c.POW10[decimals]
        if changed:
            half_s = 0.5 * times[k] / feed / power
            feed = scale[k] / (times[k] + max(-half_s, min(half_s, state[0])))
        if feed > c.LARGEST or feed * power < FEWEST:
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
    if style & c.S_PLUS:
        out[n] = 43
        n += 1
    places = 1
    while places < 19 and c.TEN[places] <= mantissa:
        places += 1
    places = max(places, decimals + 1, min(decimals + style // c.S_WIDTH, 19))
    if style & c.S_BARE and places == decimals + 1 and mantissa < c.TEN[decimals] and mantissa > 0:
        places = decimals
    for place in range(places - 1, -1, -1):
        if place == decimals - 1:
            out[n] = 46
            n += 1
        out[n] = 48 + (mantissa // c.TEN[place]) % 10
        n += 1
    if decimals == 0 and style & c.S_POINT:
        out[n] = 46
        n += 1
    return n
