"""The verifier over the trap corpus: all that the rewriter writes is proved, and what was lost is seen."""

from __future__ import annotations

import numpy as np
import pytest

from polishd.api import ProgramError
from polishd.model.program import Encoding
from polishd.plugins.rnc_robot.dialect import DIALECTS, AnyDialect, dialect
from polishd.plugins.rnc_robot.formats import read, rewrite
from polishd.plugins.rnc_robot.verify import motion, verify
from tests.corpus.table import cases
from tests.unit.plugins.rnc_robot.languages.robot_programs import PROGRAMS

ENCODINGS: tuple[Encoding | None, ...] = (None, "dwell", "feed", "inverse")


def programs(name: str) -> list[tuple[str, bytes]]:
    """All readable programs of a dialect, by name."""
    found = [(str(case), case.text) for case in cases() if case.refused is None and case.dialect == name]
    return [*found, (name, PROGRAMS[name].text)] if name in PROGRAMS else found


def wrong(profile: AnyDialect, text: bytes, encoding: Encoding | None) -> str | None:
    """What is wrong with the proof of a rewritten program, in words."""
    program = read(profile, text, "t")
    times = np.maximum(program.time_s, 0.1) * 1.37
    try:
        new = rewrite(profile, program, times, encoding)
    except ProgramError:
        return None  # it does not write what it cannot
    found = verify(text, new, profile)
    if not found.identical_motion:
        return found.difference
    if found.changed_points != program.n:
        return f"{found.changed_points} of {program.n} points changed"
    if encoding not in {None, program.encoding}:
        return None
    if found.time_after_s != pytest.approx(times.sum(), rel=1e-3, abs=0.011):
        return f"{found.time_after_s} s, not {times.sum()}"
    return next((str(change) for change in found.other_changes if change.kind != "timing"), None)


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize("name", DIALECTS)
def test_whatever_the_rewriter_writes_is_proved(name: str) -> None:
    profile, said = dialect(name), programs(name)
    assert said
    bad = {(case, encoding): wrong(profile, text, encoding) for case, text in said for encoding in ENCODINGS}
    assert {key: words for key, words in bad.items() if words} == {}


@pytest.mark.one_of_each
@pytest.mark.parametrize("name", DIALECTS)
def test_a_lost_line_is_seen(name: str) -> None:
    """The last line that moves is taken out: refused, or never the same motion."""
    profile = dialect(name)
    for case, text in programs(name):
        lines = text.split(b"\n")
        last = motion(profile, text, "t").line[-1]
        try:
            found = verify(text, b"\n".join(lines[: last - 1] + lines[last:]), profile)
        except ProgramError:
            continue
        assert not found.identical_motion, case
