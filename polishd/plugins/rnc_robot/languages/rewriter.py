"""Puts new times into a program in a robot language: new numbers in old places, the rounding residue carried on."""

from __future__ import annotations

import math
from io import BytesIO

import numpy as np

from polishd.api import Program, ProgramError
from polishd.model.surface import FloatArray
from polishd.plugins.rnc_robot.languages.profile import LanguageProfile
from polishd.plugins.rnc_robot.languages.reader import require_points
from polishd.plugins.rnc_robot.languages.scan import scan


def rewrite(profile: LanguageProfile, program: Program, time_s: FloatArray) -> bytes:
    """The program with ``time_s`` (n,) seconds at its points; no byte changed outside the numbers of its dwells.

    A time that stays keeps its number as it is. The others are written in whole quanta of the profile, and what
    rounding leaves is carried to the next, so that each is within one quantum and the sum is too. ProgramError for
    times that cannot be written.
    """
    found = scan(profile, program.text, program.name)
    require_points(found)
    points = found.points
    times = np.ascontiguousarray(time_s, dtype=np.float64)
    if times.shape != (len(points),):
        raise ProgramError(
            f"{program.name}: {len(points)} points need as many times, not an array of {times.shape}. "
            "To do: solve for this program."
        )
    dwell = profile.dwell
    out, text = BytesIO(), memoryview(program.text)
    at, residue = 0, 0.0
    columns = zip(points.time, times.data, points.start, points.end, points.dwell_line, strict=True)
    for old, new_s, start, end, line in columns:
        if new_s == old * dwell.unit_s:
            continue
        if not (math.isfinite(new_s) and 0 <= new_s <= dwell.max_s):
            bounds = f"from 0 to {dwell.max_s:g} s" if math.isfinite(dwell.max_s) else "from 0 s"
            raise found.refuse_line(
                line, f"a dwell of {new_s} s cannot be written, only one {bounds}", "solve again within that"
            )
        wanted = min(new_s + residue, dwell.max_s)
        quanta = max(round(wanted / dwell.quantum_s), 0)
        residue = new_s + residue - quanta * dwell.quantum_s
        out.write(text[at:start])
        out.write(styled(quanta * dwell.steps, dwell.decimals, program.text[start:end]))
        at = end
    out.write(text[at:])
    return out.getvalue()


def styled(steps: int, decimals: int, old: bytes) -> bytes:
    """``steps`` of 10^-decimals as ``old`` is written: its plus, its leading zeros or bare ``.5``, its decimals.

    Zeros at the end go as far as the old number had no digits there.
    """
    mantissa = old.lower().partition(b"e")[0].lstrip(b"+-")
    old_whole, point, old_fraction = mantissa.partition(b".")
    digits = str(steps).rjust(decimals + 1, "0").encode()
    whole, fraction = (digits[:-decimals], digits[-decimals:]) if decimals else (digits, b"")
    keep = len(old_fraction)
    fraction = (fraction[:keep] + fraction[keep:].rstrip(b"0")).ljust(keep, b"0")
    if not old_whole and whole == b"0" and fraction:
        whole = b""
    elif len(old_whole) > 1 and old_whole.startswith(b"0"):
        whole = whole.rjust(len(old_whole), b"0")
    sign = b"+" if old.startswith(b"+") else b""
    return sign + whole + (b"." + fraction if fraction or point else b"")
