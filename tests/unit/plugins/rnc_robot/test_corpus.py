"""The trap corpus: each program is read as its dialect means it, or refused by line and reason."""

from __future__ import annotations

import re
from collections import Counter

import numpy as np
import pytest

from polishd.api import Program, ProgramError
from polishd.plugins.rnc_robot import formats
from polishd.plugins.rnc_robot.dialect import dialect
from tests.corpus.changes import milliseconds, numbers, quanta_s, strayed
from tests.corpus.table import FOLDER, Case, cases, reason

CASES = cases()
READ = [case for case in CASES if case.refused is None]
REFUSED = [case for case in CASES if case.refused is not None]


def read(case: Case, text: bytes | None = None) -> Program:
    return formats.read(dialect(case.dialect), case.text if text is None else text, "t.nc")


def rewrite(case: Case, program: Program, time_s: np.ndarray) -> bytes:
    return formats.rewrite(dialect(case.dialect), program, time_s)


def test_table_and_files_agree() -> None:
    assert sorted(case.path for case in CASES) == sorted(FOLDER.glob("*/*.nc"))
    count = Counter(case.dialect for case in CASES)
    assert len(CASES) >= 100
    assert len(count) == 10
    assert min(count.values()) >= 15


def test_bytes_are_as_they_were_written() -> None:
    """Git or an editor may have changed line ends."""
    texts = {str(case): case.text for case in CASES}
    assert b"\r\n" in texts["rs274/crlf"]
    assert re.search(rb"[^\r]\n", texts["rs274/crlf"]) is None
    assert re.search(rb"[^\r]\n", texts["rs274/mixed_newlines"])
    assert texts["rs274/no_final_newline"].endswith(b"M2")
    assert texts["rs274/utf16"].startswith(b"\xff\xfe")
    assert b"\xa0" in texts["rs274/non_breaking_space"]


@pytest.mark.one_of_each("case.dialect")
@pytest.mark.parametrize("case", REFUSED, ids=str)
def test_refused(case: Case) -> None:
    with pytest.raises(ProgramError) as caught:
        read(case)
    message = str(caught.value)
    line, why = reason(message)
    assert case.refused is not None
    assert re.search(case.refused, why, re.IGNORECASE), message
    assert line == case.said["line"], message
    assert "To do: " in message


@pytest.mark.one_of_each("case.dialect")
@pytest.mark.parametrize("case", READ, ids=str)
def test_read(case: Case) -> None:
    said = case.said
    program = read(case)
    np.testing.assert_allclose(program.time_s, said["time_s"], rtol=1e-7, atol=1e-12)
    assert program.encoding == said.get("encoding", "dwell")
    assert program.text == case.text
    assert program.dialect == case.dialect
    if "at" in said:
        assert program.line.tolist() == said["at"]
    if "end_mm" in said:
        np.testing.assert_allclose(program.end_mm, said["end_mm"], atol=1e-9)
    if "axis" in said:
        np.testing.assert_allclose(program.axis, said["axis"], atol=1e-9)
    if "feed" in said:
        np.testing.assert_allclose(program.feed_mm_min, said["feed"], rtol=1e-9)
    if "unit" in said:
        assert program.unit == said["unit"]
    if "warns" in said:
        assert any(re.search(said["warns"], warning) for warning in program.warnings), program.warnings


@pytest.mark.one_of_each("case.dialect")
@pytest.mark.parametrize("case", READ, ids=str)
def test_identity_rewrite_changes_nothing(case: Case) -> None:
    program = read(case)
    assert rewrite(case, program, program.time_s) == case.text
    assert rewrite(case, program, program.time_s.copy()) == case.text


@pytest.mark.one_of_each("case.dialect")
@pytest.mark.parametrize("case", READ, ids=str)
def test_other_times_change_numbers_only(case: Case) -> None:
    program = read(case)
    rng = np.random.default_rng(len(case.text))
    for low, high in ((0.3, 0.9), (1.1, 7.0)):
        asked = np.minimum(program.time_s * rng.uniform(low, high, program.n) + 0.0513, 900.0)
        if "unwritable" in case.said:
            with pytest.raises(ProgramError, match=case.said["unwritable"]):
                rewrite(case, program, asked)
        else:
            check_rewrite(case, program, asked, rewrite(case, program, asked))


def check_rewrite(case: Case, program: Program, asked: np.ndarray, new: bytes) -> None:
    assert strayed(program, new) == []
    again = read(case, new)
    assert again.line.tolist() == program.line.tolist()
    np.testing.assert_array_equal(again.end_mm, program.end_mm)
    np.testing.assert_array_equal(again.axis, program.axis)
    quanta = quanta_s(program, new, asked)
    assert (np.abs(again.time_s - asked) <= quanta * 1.001).all(), (asked, again.time_s, quanta)
    assert abs(again.time_s.sum() - asked.sum()) <= quanta.max() * 1.001
    # a point that comes or goes is a factor of 1000
    if program.encoding == "dwell":
        for old, now in zip(numbers(program.text, program), numbers(new, program), strict=True):
            assert old is not None
            assert now is not None
            assert milliseconds(case.dialect, now) == milliseconds(case.dialect, old)


ASKED = [case for case in READ if "asked" in case.said]


@pytest.mark.parametrize("case", ASKED, ids=str)
def test_written_as_asked(case: Case) -> None:
    program = read(case)
    asked = np.array(case.said["asked"])
    new = rewrite(case, program, asked)
    check_rewrite(case, program, asked, new)
    lines = new.decode("latin-1").splitlines()
    for number, text in case.said.get("written", {}).items():
        assert lines[int(number) - 1] == text
