"""Damaged programs of every NC dialect: read and rewritten without a byte astray, or refused; never a crash."""

from __future__ import annotations

from random import Random

import numpy as np
import pytest

from polishd.api import Program, ProgramError
from polishd.plugins.rnc_robot import formats
from polishd.plugins.rnc_robot.dialect import dialect
from polishd.plugins.rnc_robot.nc import compiled, stream
from tests.corpus.changes import quanta_s, strayed
from tests.corpus.fuzz import GRAMMARS, program
from tests.corpus.table import reason

SMALL, LARGE = 3_000, 10_000
"""Lines of each dialect in the quick run, and of each of its ten parts in the long one."""
NEVER = WHOLE = 1 << 60
PIECE = 97
"""Bytes: a program of any length has many pieces of these, and lines that are longer than one."""


def outcome(name: str, text: bytes, patch: pytest.MonkeyPatch, size: int = NEVER, piece: int = WHOLE) -> Program | str:
    """The program, or why it is refused; compiled from ``size`` bytes on, in pieces of so many."""
    patch.setattr(compiled, "LARGE_BYTES", size)
    patch.setattr(stream, "PIECE_BYTES", piece)
    try:
        return formats.read(dialect(name), text, "f.nc")
    except ProgramError as error:
        return str(error)


def check(name: str, text: bytes, rng: Random, patch: pytest.MonkeyPatch) -> bool:
    """Whether it was read; every promise is kept either way."""
    piece = max(PIECE, len(text) // 20)
    in_pieces = outcome(name, text, patch, piece=piece)
    found = outcome(name, text, patch)
    same(found, outcome(name, text, patch, size=0))
    if isinstance(found, str):
        assert isinstance(in_pieces, str)  # perhaps for another line: binary bytes are looked for piece by piece
        assert "To do: " in found
        line, why = reason(found)
        assert 0 <= line <= text.count(b"\n") + 1
        assert why
        return False
    assert found.text == text
    asked = np.array([time * rng.choice([1.0, rng.uniform(0.2, 3)]) + rng.choice([0, 0.01]) for time in found.time_s])
    if found.encoding != "dwell":
        asked = np.maximum(asked, 1e-3)
    same(found, in_pieces)
    written = set()
    for size, cut in ((0, WHOLE), (NEVER, WHOLE), (NEVER, piece)):
        patch.setattr(compiled, "LARGE_BYTES", size)
        patch.setattr(stream, "PIECE_BYTES", cut)
        assert formats.rewrite(dialect(name), found, found.time_s) == text
        written.add(formats.rewrite(dialect(name), found, asked))
    assert len(written) == 1
    rewritten(found, asked, written.pop())
    return True


def rewritten(old: Program, asked: np.ndarray, text: bytes) -> None:
    assert strayed(old, text) == []
    new = formats.read(dialect(old.dialect), text, "f.nc")
    np.testing.assert_array_equal(new.line, old.line)
    np.testing.assert_array_equal(new.end_mm, old.end_mm)
    quanta = quanta_s(old, text, asked)
    assert (np.abs(new.time_s - asked) <= quanta * 1.001 + 1e-12).all()
    assert abs(new.time_s.sum() - asked.sum()) <= quanta.max() * 1.001 + 1e-9


def same(one: Program | str, other: Program | str) -> None:
    if isinstance(one, str) or isinstance(other, str):
        assert one == other
        return
    for field in ("encoding", "unit", "lines", "warnings"):
        assert getattr(one, field) == getattr(other, field)
    for field in ("line", "block", "start_mm", "end_mm", "axis", "time_s", "feed_mm_min"):
        np.testing.assert_array_equal(getattr(one, field), getattr(other, field), err_msg=field)


def campaign(name: str, lines: int, seed: int, patch: pytest.MonkeyPatch) -> tuple[int, int]:
    """Programs read and refused in so many lines."""
    rng = Random(f"{name} {seed}")
    counts = [0, 0]
    while lines > 0:
        size = min(1000 if rng.random() < 0.02 else rng.choice([3, 10, 10, 20, 40, 100]), max(lines, 3))
        damage = rng.choice([0, 0, 1 / size, 1 / size, 0.3])
        text = program(name, rng, size, damage)
        lines -= text.count(b"\n")
        try:
            counts[check(name, text, rng, patch)] += 1
        except Exception as error:
            raise AssertionError(f"{name}, seed {seed}: {text[:3000]!r}") from error
    return counts[1], counts[0]


@pytest.mark.parametrize("name", GRAMMARS)
def test_small_share(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    read, refused = campaign(name, SMALL, 0, monkeypatch)
    # a generator that is only refused, or never, tests nothing
    assert read >= 5
    assert refused >= 5


@pytest.mark.slow
@pytest.mark.parametrize("part", range(1, 11))
@pytest.mark.parametrize("name", GRAMMARS)
def test_million_lines(name: str, part: int, monkeypatch: pytest.MonkeyPatch) -> None:
    campaign(name, LARGE, part, monkeypatch)


@pytest.mark.parametrize("name", GRAMMARS)
def test_clean_programs_are_read(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the generator calls valid is: else the fuzz would only meet refusals."""
    rng = Random(name)
    for _ in range(10):
        text = program(name, rng, 30, 0.0)
        found = outcome(name, text, monkeypatch)
        assert isinstance(found, Program), (found, text)
