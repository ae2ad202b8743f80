"""Only the numbers of dwells change: within one quantum each, the sum too, written as they were written."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.api import ProgramError
from polishd.plugins.rnc_robot.languages import read, rewrite
from polishd.plugins.rnc_robot.languages.program import styled
from polishd.plugins.rnc_robot.verify import verify
from tests.unit.plugins.rnc_robot.languages.robot_programs import LANGUAGES, PROGRAMS, around, many, profile

DWELLS = {
    "rapid": rb"^\s*WaitTime (?:\\InPos,)?([-+.0-9eE]+);",
    "krl": rb"^WAIT SEC ([-+.0-9eE]+)",
    "fanuc-tp": rb"^\s*\d*:\s*WAIT\s+([-+.0-9eE]+)\(sec\) ;",
    "urscript": rb"^\s*sleep\(([-+.0-9eE]+)\)",
    "inform": rb"^TIMER T=([-+.0-9eE]+)",
    "val3": rb"^delay\(([-+.0-9eE]+)\)",
    "heidenhain": rb"^2 FUNCTION DWELL TIME([-+.0-9eE]+)",
    "melfa-basic": rb"^Dly ([-+.0-9eE]+)",
    "kawasaki-as": rb"^TWAIT ([-+.0-9eE]+)",
}
"""Positions of the times in programs of ``many``, independent of the profiles."""


def numbers(name: str, text: bytes) -> list[bytes]:
    """The dwells' numbers as they are written."""
    return re.findall(DWELLS[name], text, re.MULTILINE)


def blanked(name: str, text: bytes) -> bytes:
    """The program without the dwells' numbers."""
    return re.sub(
        DWELLS[name],
        lambda match: text[match.start() : match.start(1)] + b"#" + text[match.end(1) : match.end()],
        text,
        flags=re.MULTILINE,
    )


written = st.one_of(
    st.integers(0, 300).map(str),
    st.decimals(0, 300, places=2).map(str),
    st.decimals(0, 300, places=6).map(str),
    st.integers(0, 999).map(lambda value: f".{value:03d}"),
    st.integers(0, 99).map(lambda value: f"{value}."),
    st.integers(0, 99).map(lambda value: f"+{value:04d}.50"),
    st.integers(1, 99).map(lambda value: f"{value}e-1"),
)
times = st.floats(0, 300, allow_nan=False)


@pytest.mark.one_of_each
@pytest.mark.parametrize("name", LANGUAGES)
@given(pairs=st.lists(st.tuples(written, times, st.booleans()), min_size=1, max_size=30))
def test_each_dwell_and_their_sum_are_within_one_quantum_and_nothing_else_changes(
    name: str, pairs: list[tuple[str, float, bool]]
) -> None:
    language = profile(name)
    quantum_s = language.dwell.quantum_s
    text = many(name, [old for old, _, _ in pairs])
    program = read(language, text, "part.txt")
    wanted = np.array([float(old) if stays else new for old, new, stays in pairs])
    new = rewrite(language, program, wanted)
    assert blanked(name, new) == blanked(name, text)
    found = [float(number) for number in numbers(name, new)]
    assert len(found) == len(pairs)
    np.testing.assert_allclose(found, wanted, atol=quantum_s * (1 + 1e-6))
    assert abs(math.fsum(found) - math.fsum(wanted)) <= quantum_s * (0.5 + 1e-6)
    for (old, _, stays), number in zip(pairs, numbers(name, new), strict=True):
        assert not stays or number == old.encode()
    again = read(language, new, "part.txt")
    assert again.time_s.tolist() == found
    assert again.line.tolist() == program.line.tolist()
    assert (again.end_mm == program.end_mm).all()


@pytest.mark.full
@pytest.mark.parametrize("name", LANGUAGES)
def test_the_residue_is_carried_over_thousands_of_dwells(name: str) -> None:
    language = profile(name)
    count = 5_000
    program = read(language, many(name, ["0.5"] * count), "part.txt")
    third = np.full(count, 1 / 3)
    found = [float(number) for number in numbers(name, rewrite(language, program, third))]
    assert abs(math.fsum(found) - count / 3) <= language.dwell.quantum_s / 2 * (1 + 1e-6)
    assert len(set(found)) == 2  # one third is written now shorter, now longer


@pytest.mark.full
@given(st.lists(st.floats(0.0, 5.0), min_size=1, max_size=200))
def test_a_dwell_is_a_multiple_of_the_controllers_cycle(wanted: list[float]) -> None:
    """An older UR: otherwise each lasts up to 8 ms longer than written, by an unknown time."""
    newer = profile("urscript")
    older = newer.model_copy(update={"dwell": newer.dwell.model_copy(update={"quantum_s": 0.008})})
    program = read(older, many("urscript", ["0.5001"] * len(wanted)), "part.txt")
    text = rewrite(older, program, np.array(wanted))
    written_ms = np.rint(1000.0 * read(older, text, "part.txt").time_s)
    assert [float(number) * 1000.0 for number in numbers("urscript", text)] == pytest.approx(written_ms.tolist())
    assert not np.any(written_ms % 8)
    assert np.abs(np.cumsum(written_ms / 1000.0) - np.cumsum(wanted)).max() <= 0.004 + 1e-9
    assert verify(program.text, text, older).identical_motion


@pytest.mark.parametrize("name", LANGUAGES)
def test_realistic_programs_change_in_their_dwells_only(name: str) -> None:
    language, said = profile(name), PROGRAMS[name]
    program = read(language, said.text, "part.txt")
    new = rewrite(language, program, program.time_s + 1.0)
    assert read(language, new, "part.txt").time_s == pytest.approx([time + 1 for time in said.time_s])
    before, after = said.text.split(b"\n"), new.split(b"\n")
    changed = [index + 1 for index, line in enumerate(before) if line != after[index]]
    assert changed == said.line
    assert len(after) == len(before)


STYLES = [
    (b"0.5", 1250, 3, b"1.25"),
    (b"0.50", 1250, 3, b"1.25"),
    (b"0.500", 1250, 3, b"1.250"),
    (b"0.50000", 1250, 3, b"1.25000"),
    (b"500", 1250, 3, b"1.25"),
    (b"5", 2000, 3, b"2"),
    (b"5.", 2000, 3, b"2."),
    (b"5.", 2500, 3, b"2.5"),
    (b"5.0", 2000, 3, b"2.0"),
    (b".5", 250, 3, b".25"),
    (b".5", 1250, 3, b"1.25"),
    (b".50", 0, 2, b".00"),
    (b".5", 0, 3, b".0"),
    (b"0", 0, 3, b"0"),
    (b"0.5", 1, 3, b"0.001"),
    (b"+0.5", 250, 3, b"+0.25"),
    (b"000.50", 1250, 3, b"001.25"),
    (b"5e-1", 250, 3, b"0.25"),
    (b"500", 1250, 0, b"1250"),
    (b"500.", 1250, 0, b"1250."),
]


@pytest.mark.parametrize(("old", "quanta", "decimals", "new"), STYLES)
def test_a_number_is_written_as_the_old_one_was(old: bytes, quanta: int, decimals: int, new: bytes) -> None:
    assert styled(quanta, decimals, old) == new


@pytest.mark.full
@given(
    st.from_regex(r"[+]?([0-9]{1,6}\.?[0-9]{0,6}|\.[0-9]{1,6})(e-?[0-3])?", fullmatch=True),
    st.integers(0, 10**9),
    st.integers(0, 6),
)
def test_whatever_the_style_the_value_is_right(old: str, quanta: int, decimals: int) -> None:
    new = styled(quanta, decimals, old.encode()).decode()
    assert re.fullmatch(r"[+]?(\d+\.?\d*|\.\d+)", new)
    assert float(new) == pytest.approx(quanta * 10.0**-decimals, rel=1e-12)


@pytest.mark.parametrize("name", LANGUAGES)
@pytest.mark.parametrize("time_s", [-0.001, math.nan, math.inf, -math.inf])
def test_a_time_that_is_none_is_refused_by_line(name: str, time_s: float) -> None:
    program = read(profile(name), around(name, b""), "part.txt")
    with pytest.raises(ProgramError, match=r"part\.txt, line 5: a dwell of .* To do: solve again"):
        rewrite(profile(name), program, np.array([time_s]))


@pytest.mark.parametrize("name", LANGUAGES)
def test_another_number_of_times_is_refused(name: str) -> None:
    program = read(profile(name), around(name, b""), "part.txt")
    for count in (0, 2):
        with pytest.raises(ProgramError, match="1 points need as many times"):
            rewrite(profile(name), program, np.ones(count))


def test_the_range_of_tp_ends_at_327_67_seconds() -> None:
    language = profile("fanuc-tp")
    program = read(language, many("fanuc-tp", ["1.00"] * 3), "part.ls")
    new = rewrite(language, program, np.array([327.67, 327.67, 0.004]))
    assert numbers("fanuc-tp", new) == [b"327.67", b"327.67", b"0.00"]
    with pytest.raises(ProgramError, match=r"line 5: a dwell of 327\.68 s cannot be written, only one from 0 to 327"):
        rewrite(language, program, np.array([327.68, 1, 1]))
    # the residue never pushes a dwell over the end of the range
    new = rewrite(language, program, np.array([0.004, 327.668, 1.0]))
    assert numbers("fanuc-tp", new) == [b"0.00", b"327.67", b"1.00"]


def test_a_unit_other_than_seconds_is_kept() -> None:
    rules = profile("rapid").dwell.model_copy(update={"unit_s": 0.001, "quantum_s": 0.001})
    language = profile("rapid").model_copy(update={"dwell": rules})
    program = read(language, many("rapid", ["500"]), "part.txt")
    assert program.time_s.tolist() == [0.5]
    assert program.unit == "ms"
    assert numbers("rapid", rewrite(language, program, np.array([1.25]))) == [b"1250"]
