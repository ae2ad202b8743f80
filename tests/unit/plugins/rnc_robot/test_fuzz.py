"""Damaged programs of every profile: read and rewritten without a byte astray, or refused; never a crash."""

from __future__ import annotations

import re
from functools import cache
from random import Random

import numpy as np
import pytest

from polishd.api import Program, ProgramError
from polishd.plugins.rnc_robot import formats
from polishd.plugins.rnc_robot.dialect import DIALECTS
from polishd.plugins.rnc_robot.dialect import dialect as load
from polishd.plugins.rnc_robot.gcode import jit, rewrite
from tests.corpus.changes import quanta_s, strayed
from tests.corpus.fuzz import GRAMMARS, LANGUAGES, program
from tests.corpus.table import reason

dialect = cache(load)
SMALL, LARGE = 2_150, 7_200
"""Lines of each profile in the quick run (30,000 in all), and of each of its ten parts in the long one (10^6)."""
NEVER, WHOLE = 1 << 60, 1 << 20
PIECE = 97
"""Bytes: a program of any length has many pieces of these, and lines that are longer than one."""


def run_with(patch: pytest.MonkeyPatch, size: int, piece: int) -> None:
    """Compiled code reads NC text from ``size`` bytes on, in pieces of a given size."""
    patch.setattr(jit, "LARGE_BYTES", size)
    patch.setattr(rewrite, "PIECE_BYTES", piece)


def outcome(name: str, text: bytes) -> Program | str:
    """The program, or why it is refused."""
    try:
        return formats.read(dialect(name), text, "f.nc")
    except ProgramError as error:
        return str(error)


def check(name: str, text: bytes, rng: Random, patch: pytest.MonkeyPatch) -> bool:
    """Whether it was read; every promise is kept either way."""
    run_with(patch, NEVER, WHOLE)
    found = outcome(name, text)
    if name in GRAMMARS:
        otherwise(name, found, text, rng, patch)
    if isinstance(found, str):
        refused(found, text)
        return False
    assert found.text == text
    assert formats.rewrite(dialect(name), found, found.time_s) == text
    asked = asked_of(found, rng)
    new = written(name, found, asked)
    if isinstance(new, bytes):
        rewritten(found, asked, new)
    return True


UNWRITABLE = re.compile(
    r"longer than \d+ bytes once|cannot be written|no number that the controller takes|a timed move takes|"
    r"speeds are written in steps|below the resolution|behind another statement|states its (?:speed|time)"
)


def written(name: str, found: Program, times: np.ndarray) -> bytes | str:
    """The program with these times, or why it cannot have them: its line, its word or its feed is full."""
    try:
        return formats.rewrite(dialect(name), found, times)
    except ProgramError as error:
        refused(str(error), found.text)
        assert UNWRITABLE.search(str(error)), error  # noqa: PT017  it may also be written
        return str(error)


def otherwise(name: str, found: Program | str, text: bytes, rng: Random, patch: pytest.MonkeyPatch) -> None:
    """Compiled, or in pieces, NC text is the same program."""
    size, piece = rng.choice([(0, WHOLE), (NEVER, max(PIECE, len(text) // 20))])
    run_with(patch, size, piece)
    again = outcome(name, text)
    if isinstance(found, str):
        # in pieces perhaps for another line: binary bytes are looked for piece by piece
        assert again == found if size == 0 else isinstance(again, str)
        run_with(patch, NEVER, WHOLE)
        return
    same(found, again)
    asked = asked_of(found, rng)
    new = written(name, found, asked)
    assert formats.rewrite(dialect(name), found, found.time_s) == text
    run_with(patch, NEVER, WHOLE)
    assert written(name, found, asked) == new


def refused(message: str, text: bytes) -> None:
    assert "To do: " in message
    line, why = reason(message)
    assert 0 <= line <= text.count(b"\n") + 1
    assert why


def asked_of(found: Program, rng: Random) -> np.ndarray:
    """Other times, some as they are."""
    asked = np.array([time * rng.choice([1.0, rng.uniform(0.2, 3)]) + rng.choice([0, 0.01]) for time in found.time_s])
    return asked if found.encoding == "dwell" else np.maximum(asked, 1e-3)


def rewritten(old: Program, asked: np.ndarray, text: bytes) -> None:
    assert (language_strayed if old.dialect in LANGUAGES else strayed)(old, text) == []
    new = formats.read(dialect(old.dialect), text, "f.nc")
    np.testing.assert_array_equal(new.end_mm, old.end_mm)
    if old.dialect in LANGUAGES and old.encoding != "dwell":
        assert (np.abs(new.time_s - asked) <= 0.0151 * asked + 2 * QUANTUM_S[old.dialect]).all()
        return
    np.testing.assert_array_equal(new.line, old.line)
    quanta = np.full(old.n, QUANTUM_S[old.dialect]) if old.dialect in LANGUAGES else quanta_s(old, text, asked)
    assert (np.abs(new.time_s - asked) <= quanta * 1.001 + 1e-9).all()
    assert abs(new.time_s.sum() - asked.sum()) <= quanta.max() * 1.001 + 1e-9


QUANTUM_S = {
    "rapid": 0.001, "krl": 0.001, "fanuc-tp": 0.01, "urscript": 0.002, "inform": 0.01, "val3": 0.001,
    "heidenhain": 0.001, "melfa-basic": 0.01, "kawasaki-as": 0.01,
}  # fmt: skip
_NUMBER = rb"[-+]?(?:[0-9][0-9.]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"
TIME = {
    "rapid": re.compile(rb"(?i)(\bWaitTime\s*(?:\\InPos\s*,\s*)?)" + _NUMBER),
    "krl": re.compile(rb"(?i)(\bWAIT\s+SEC\s*)" + _NUMBER),
    "fanuc-tp": re.compile(rb"(:\s*WAIT\s*)" + _NUMBER),
    "urscript": re.compile(rb"(\bsleep\s*\(\s*)" + _NUMBER),
    "inform": re.compile(rb"(\bTIMER\s*T=\s*)" + _NUMBER),
    "val3": re.compile(rb"(\bdelay\s*\(\s*)" + _NUMBER),
    "heidenhain": re.compile(rb"(?i)(\bFUNCTION\s+DWELL\s+TIME\s*|\bCYCL\s+DEF\s+9\.1\D*?)" + _NUMBER),
    "melfa-basic": re.compile(rb"(?i)(\bDly\s*)" + _NUMBER),
    "kawasaki-as": re.compile(rb"(?i)(\bTWAIT\s*)" + _NUMBER),
}
SPEED = {
    "rapid": re.compile(
        rb"\\\s*[VT]\s*:\s*=\s*" + _NUMBER + rb"|(?<=\[)" + _NUMBER + rb"(?=(?:,[-+.\d]+){3}\])", re.IGNORECASE
    ),
    "krl": re.compile(
        rb"(?im)^[ \t]*\$VEL\.CP[ \t]*=[ \t]*" + _NUMBER + rb"[ \t]*\r?\n"
        rb"|(?:CP\s*=|SVEL_CP\(|CP_PARAMS,)\s*" + _NUMBER
    ),
    "fanuc-tp": re.compile(_NUMBER + rb"\s*(?:mm/sec|cm/min|inch/min|sec)"),
    "urscript": re.compile(rb",\s*[vt]\s*=\s*" + _NUMBER + rb"|(?<=[,\s])" + _NUMBER),
    "inform": re.compile(rb"\bVR?\s*=\s*" + _NUMBER),
    "val3": re.compile(rb"(?m)^[ \t]*\w+(?:\[\d+\])?\.tvel=" + _NUMBER + rb"[ \t]*\r?\n|(?<=tvel=)" + _NUMBER),
    "heidenhain": re.compile(rb"(?i)\s*\bF\s*" + _NUMBER),
    "melfa-basic": re.compile(rb"(?im)^[ \t]*(?:\d+[ \t]+)?Spd[ \t]*" + _NUMBER + rb"[ \t]*\r?\n|(?<=Spd )" + _NUMBER),
    "kawasaki-as": re.compile(
        rb"(?im)^[ \t]*SPEED[ \t]+" + _NUMBER + rb"[ \t]+MM/\w+[ \t]+ALWAYS[ \t]*\r?\n|(?<=SPEED )" + _NUMBER
    ),
}
"""What states the speed or time of a move, said independently of the profiles."""


def language_strayed(program: Program, new: bytes) -> list[str]:
    """Lines of a robot language's program that differ by more than the number of a dwell."""
    if program.encoding != "dwell":
        bare = [SPEED[program.dialect].sub(b"", text) for text in (program.text, new)]
        return [] if bare[0] == bare[1] else ["something else than the speed or time of a move"]
    old_lines, new_lines, points = program.text.split(b"\n"), new.split(b"\n"), set(program.line.tolist())
    bare = [[TIME[program.dialect].sub(rb"\1", line) for line in lines] for lines in (old_lines, new_lines)]
    if bare[0] != bare[1]:
        return ["something else than a number of a dwell"]
    pairs = enumerate(zip(old_lines, new_lines, strict=True), 1)
    return [f"line {number}: no point" for number, (one, other) in pairs if one != other and number not in points]


def same(one: Program | str, other: Program | str) -> None:
    if isinstance(one, str) or isinstance(other, str):
        assert one == other
        return
    for field in ("encoding", "unit", "lines", "warnings"):
        assert getattr(one, field) == getattr(other, field)
    for field in ("line", "block", "start_mm", "end_mm", "axis", "time_s", "feed_mm_min"):
        np.testing.assert_array_equal(getattr(one, field), getattr(other, field), err_msg=field)


def campaign(name: str, lines: int, seed: int, patch: pytest.MonkeyPatch) -> tuple[int, int]:
    """Number of programs read and refused, for a number of lines."""
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


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize("name", DIALECTS)
def test_small_share(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    read, refused = campaign(name, SMALL, 0, monkeypatch)
    # a generator that is only refused, or never, tests nothing
    assert read >= 5
    assert refused >= 5


@pytest.mark.slow
@pytest.mark.parametrize("part", range(1, 11))
@pytest.mark.parametrize("name", DIALECTS)
def test_million_lines(name: str, part: int, monkeypatch: pytest.MonkeyPatch) -> None:
    campaign(name, LARGE, part, monkeypatch)


def test_every_profile_is_fuzzed() -> None:
    assert sorted([*GRAMMARS, *LANGUAGES]) == sorted(DIALECTS)
    assert len(DIALECTS) * SMALL >= 30_000
    assert len(DIALECTS) * LARGE * 10 >= 1_000_000


@pytest.mark.one_of_each
@pytest.mark.parametrize("name", DIALECTS)
def test_clean_programs_are_read(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the generator calls valid is: else the fuzz would only meet refusals."""
    rng = Random(name)
    run_with(monkeypatch, NEVER, WHOLE)
    for _ in range(10):
        text = program(name, rng, 30, 0.0)
        found = outcome(name, text)
        assert isinstance(found, Program), (found, text)
