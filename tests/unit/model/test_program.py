"""Blocks cut out of a program's text are those that the text has."""

from __future__ import annotations

import pickle

import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.model import program
from polishd.model.program import Segment, Segments


@given(st.lists(st.sampled_from([b"G1 X1", b"", b"%", b"M2\r"]), min_size=1, max_size=9))
def test_they_are_the_lines(lines: list[bytes]) -> None:
    found = Segments(b"\n".join(lines))
    expected = [Segment(seq, line.rstrip(b"\r")) for seq, line in enumerate(lines)]
    assert list(found) == expected
    assert len(found) == len(expected)
    assert [found[at] for at in range(len(lines))] == expected
    assert found[1:3] == expected[1:3]
    assert found[::-2] == expected[::-2]
    assert found[-1] == expected[-1]


def test_beyond_the_last_there_is_none() -> None:
    with pytest.raises(IndexError):
        Segments(b"G1")[1]


def test_lines_run_over_the_pieces_that_are_searched(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(program, "_PIECE", 4)
    text = b"G1 X1\nG1 X22\n\nM2\n"
    assert [segment.text for segment in Segments(text)] == text.split(b"\n")


def test_another_process_gets_the_text_once() -> None:
    text = b"G1 X1 Y2\n" * 1000
    both = pickle.dumps((text, Segments(text)))
    assert len(both) < len(text) + 1000
    again = pickle.loads(both)[1]
    assert again == Segments(text)
    assert again != Segments(b"M2")
    assert hash(again) == hash(Segments(text))
