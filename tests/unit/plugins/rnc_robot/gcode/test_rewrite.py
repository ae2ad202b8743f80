"""Programs piece by piece: the same figures and the same bytes wherever they are cut, and nothing left of a refusal."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from functools import cache
from io import BytesIO
from pathlib import Path
from random import Random
from typing import Self, cast

import numpy as np
import pytest

from polishd.api import Program, ProgramError
from polishd.plugins.rnc_robot.dialect import GcodeDialect
from polishd.plugins.rnc_robot.dialect import dialect as load
from polishd.plugins.rnc_robot.gcode import rewrite as nc
from polishd.plugins.rnc_robot.gcode.rewrite import StreamCounts, rewrite_stream, scan_program
from polishd.programs.rewrite import DwellTable, rewrite_file
from tests.corpus.fuzz import GRAMMARS, program
from tests.corpus.table import Case, cases, reason

dialect = cache(load)
WHOLE = 1 << 20
SIZES = (1, 3, 16, 37)
"""Bytes a piece: from cuts behind every byte to few cuts."""
RS274 = cast(GcodeDialect, dialect("rs274"))
HEAD = "G21 G90 G94\nG0 X0 Y0 Z0 A0 C0\n"

PROGRAMS = {
    "feed, F holds over many moves": "F77\nG1 X1\nX2\nX3\nX4 F50\nX5\nG0 Z1 F33\nG1 X6\nX7\nX8 F50\nX9\n",
    "feed, comments longer than pieces": f"G1 X1 F60 ({'G4 P9 ' * 20})\nX2 ;{' F9' * 30}\n",
    "feed, moves that go nowhere": "G1 X1 F60\nX1\nX2\nX2\nX3 F50\n",
    "feed, inches and back": "G1 X1 F60\nX2 F50\nG20\nF3\nX3\nX4\nG21\nG1 X9 F60\nX10\n",
    "feed, incremental": "G91\nG1 X1 F60\nY1\nX1 Y1 F90\nG90\nX9\n",
    "inverse": "G93\nG1 X1 F60\nX2 F12.5\nA5 F9\nX3 A6 F120\nG94\nG0 Z9\n",
    "dwell": "G1 X1 F60\nG4 P1\nX2\nG4 P.5 (P9)\n(between)\nX3 F90\n\nG4 P0.25\nG0 Z9\n",
    "dwell, strays and leads": "G4 P3\nG1 Z-1 F60\nX1\nG4 P1\nX2\nG4 P2\nG0 X5\nG4 P9\nG1 X6\nG4 P3\nX7\n",
    "dwell, behind inverse-time moves": "G93\nG1 X1 F60\nG4 P1\nX2 F30\nG4 P2\n",
    "dwell, lower case and blanks": "g 1 x 1 . 0 f 6 0\ng 4 p 0 . 7 5\nx 2\np . 5 g 4\n",
    "dwell, arcs": "G1 X1 F60\nG4 P1\nG2 X2 I0.5\nG4 P1\nG3 X1 R0.5\nG4 P2\n",
    "dwell, ends in its block": "G1 X1 F60\nG4 P1\nX2\nG4 P1 M2\n",
    "turned": "G1 X1 F60 A5\nG4 P1\nX2 A6 C90\nG4 P1\nX3 A7.5\nG4 P2\n",
}


def whole(body: str, newline: str = "\n", end: str = "M2\n") -> bytes:
    return (HEAD + body + end).replace("\n", newline).encode()


TEXTS = {name: whole(body) for name, body in PROGRAMS.items()}
TEXTS |= {f"{name}, CRLF": whole(PROGRAMS[name], "\r\n") for name in ("inverse", "dwell", "feed, inches and back")}
TEXTS |= {
    "no final newline": whole(PROGRAMS["dwell"], end="M2"),
    "text behind the end": whole(PROGRAMS["dwell"], end="M2\n%\n\nG1 X# [\nthe end"),
    "tape": b"%\n" + whole(PROGRAMS["inverse"], end="%\n"),
}


@pytest.fixture
def cut(monkeypatch: pytest.MonkeyPatch) -> Callable[[int], None]:
    """``cut(7)``: from here on pieces have 7 bytes, and what more their last line has."""
    return lambda size: monkeypatch.setattr(nc, "PIECE_BYTES", size)


class Given:
    """Times in memory; says how many were taken at once."""

    def __init__(self, times: np.ndarray) -> None:
        self.times, self.taken = times, [0]

    def take(self, count: int) -> np.ndarray:
        if sum(self.taken) + count > len(self.times):
            raise ProgramError("too few")
        self.taken.append(count)
        end = sum(self.taken)
        return self.times[end - count : end]

    def finish(self) -> None:
        if sum(self.taken) != len(self.times):
            raise ProgramError("too many")


def other_times(found: Program, seed: int = 0) -> np.ndarray:
    """Times of which some stay."""
    rng = np.random.default_rng(seed)
    return np.where(rng.random(found.n) < 0.3, found.time_s, found.time_s * rng.uniform(0.3, 3, found.n) + 0.013)


def check_figures(found: Program, passed: StreamCounts) -> None:
    assert passed.dialect == found.dialect
    assert passed.encoding == found.encoding
    assert passed.unit == found.unit
    assert passed.sha256 == found.sha256 == hashlib.sha256(found.text).hexdigest()
    assert passed.lines == found.lines
    assert passed.points == found.n
    assert passed.warnings == found.warnings
    assert passed.time_s == pytest.approx(found.time_s.sum(), rel=1e-12, abs=1e-12)
    assert passed.range_s == (found.time_s.min(), found.time_s.max())
    np.testing.assert_array_equal(passed.low_mm, found.end_mm.min(axis=0))
    np.testing.assert_array_equal(passed.high_mm, found.end_mm.max(axis=0))
    low, high = np.nanmin(found.feed_mm_min, initial=np.inf), np.nanmax(found.feed_mm_min, initial=-np.inf)
    assert passed.feed_mm_min == (low, high)


def same_program(one: Program, other: Program) -> None:
    for name in ("text", "encoding", "unit", "lines", "warnings", "max_feed_mm_min", "sha256"):
        assert getattr(one, name) == getattr(other, name), name
    for name in ("line", "block", "start_mm", "end_mm", "axis", "time_s", "feed_mm_min"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)


def streamed(name: GcodeDialect, text: bytes, times: np.ndarray) -> tuple[bytes, StreamCounts]:
    out = BytesIO()
    passed = rewrite_stream(name, BytesIO(text), "t.nc", Given(times), out)
    return out.getvalue(), passed


def check_all(name: str, text: bytes, sizes: tuple[int, ...], cut: Callable[[int], None]) -> None:
    """Wherever the program is cut, it is the one that is read in one piece."""
    profile = cast(GcodeDialect, dialect(name))
    cut(WHOLE)
    found = nc.read(profile, text, "t.nc")
    times = other_times(found)
    expected = nc.rewrite(profile, found, times)
    for size in sizes:
        cut(size)
        check_figures(found, scan_program(profile, BytesIO(text), "t.nc"))
        same_program(found, nc.read(profile, text, "t.nc"))
        new, passed = streamed(profile, text, times)
        assert new == expected, size
        assert nc.rewrite(profile, found, times) == expected
        assert passed.changed == np.count_nonzero(times != found.time_s)
        check_figures(found, passed)
        assert streamed(profile, text, found.time_s)[0] == text


@pytest.mark.parametrize("size", [*SIZES, WHOLE])
@pytest.mark.parametrize(
    ("name", "body", "unit"),
    [
        ("rs274", "F60\nG1 X1\nX2\n", "mm/min"),
        ("rs274", "G20\nF3\nG1 X1\nX2\n", "inch/min"),
        ("rs274", "G20\nF3\nG1 X1\nX2\nG21\nG1 X99 F60\n", "mm/min and inch/min"),
        ("rs274", "F25.4\nG1 X1\nF1\nX2\n", "mm/min"),
        ("rs274", "G20\nG93\nG1 X1 F60\nX2 F30\n", "1/min"),
        ("rs274", "G20\nG1 X1 F3\nG4 P1\nX2\nG4 P2\n", "s"),
        ("haas", "G1 X1. F60.\nG4 P500\nX2.\nG4 P0.5\n", "s and ms"),
    ],
)
def test_a_program_has_the_unit_that_is_written(
    cut: Callable[[int], None], size: int, name: str, body: str, unit: str
) -> None:
    """Whatever the sizes of the numbers are, and wherever the text is cut."""
    cut(size)
    head = "G21 G90 G94\nG0 X0. Y0. Z0.\n"
    assert nc.read(cast(GcodeDialect, dialect(name)), f"{head}{body}M30\n".encode(), "p.nc").unit == unit


@pytest.mark.one_of_each
@pytest.mark.parametrize("name", TEXTS)
def test_cut_anywhere(name: str, cut: Callable[[int], None]) -> None:
    check_all("rs274", TEXTS[name], SIZES, cut)


@pytest.mark.full
def test_cut_behind_every_byte(cut: Callable[[int], None]) -> None:
    """Each size of the first piece puts a cut between other two bytes: in words, in CR LF, before M2."""
    text = TEXTS["dwell, CRLF"]
    check_all("rs274", text, tuple(range(1, len(text) + 2)), cut)


WRITTEN = [case for case in cases() if case.refused is None and "unwritable" not in case.said]


@pytest.mark.one_of_each("case.dialect")
@pytest.mark.parametrize("case", WRITTEN, ids=str)
def test_the_corpus(case: Case, cut: Callable[[int], None]) -> None:
    check_all(case.dialect, case.text, (13,), cut)


@pytest.mark.one_of_each("case.dialect")
@pytest.mark.parametrize("case", [case for case in cases() if case.refused is not None], ids=str)
def test_the_corpus_is_refused(case: Case, cut: Callable[[int], None]) -> None:
    """In the stream as in memory; cut small, perhaps for another fault of the same program."""
    profile = cast(GcodeDialect, dialect(case.dialect))
    with pytest.raises(ProgramError) as caught:
        scan_program(profile, BytesIO(case.text), "t.nc")
    with pytest.raises(ProgramError) as same:
        nc.read(profile, case.text, "t.nc")
    assert str(caught.value) == str(same.value)
    cut(13)
    with pytest.raises(ProgramError, match=r"^t\.nc.*To do: "):
        scan_program(profile, BytesIO(case.text), "t.nc")


@pytest.mark.one_of_each
@pytest.mark.parametrize("name", GRAMMARS)
def test_programs_of_every_dialect(name: str, cut: Callable[[int], None]) -> None:
    rng = Random(name)
    for _ in range(2):
        check_all(name, program(name, rng, 60, 0.0), (rng.randrange(20, 60), rng.randrange(60, 600)), cut)


def test_rounding_is_carried_across_pieces(cut: Callable[[int], None]) -> None:
    """Each dwell loses 0.4 of a quantum: without the carry the total would be 80 quanta short."""
    body = "".join(f"G1 X{i % 9} F60\nG4 P0.100000\n" for i in range(200))
    cut(30)
    new, _ = streamed(RS274, whole(body), np.full(200, 0.2000004))
    found = nc.read(RS274, new, "t.nc")
    assert abs(found.time_s.sum() - 200 * 0.2000004) <= 1e-6


def test_the_feed_of_the_move_before_a_cut(cut: Callable[[int], None]) -> None:
    """A dwell that begins its piece takes the feed of a move in the piece before it."""
    text = whole("G1 X1 F60\n(" + "-" * 60 + ")\n\n\nG4 P1\nG1 X2 F90\nG4 P2\n")
    cut(8)
    assert scan_program(RS274, BytesIO(text), "t.nc").feed_mm_min == (60, 90)


# Where the time sits is guessed from the beginning.


@pytest.mark.one_of_each
@pytest.mark.parametrize("leads", [1, 4, 6, 30])
@pytest.mark.parametrize("size", [8, 64, WHOLE])
def test_dwells_that_begin_late(leads: int, size: int, cut: Callable[[int], None]) -> None:
    """A piece may end behind the first dwell, with more moves without a dwell than with one so far."""
    body = "".join(f"G1 Z{-i} F60\n" for i in range(1, leads + 1))
    body += "".join(f"G1 X{i} F60\nG4 P0.{i % 9 + 1}\n" for i in range(1, 40))
    check_all("rs274", whole(body), (size,), cut)


def test_dwells_that_begin_too_late(cut: Callable[[int], None], monkeypatch: pytest.MonkeyPatch) -> None:
    """Enough feed moves without a dwell and the time sits in the feed: what follows may not contradict."""
    monkeypatch.setattr(nc, "ENOUGH_MOVES", 20)
    cut(64)
    body = "".join(f"G1 Z{-i} F60\n" for i in range(1, 40))
    body += "".join(f"G1 X{i} F60\nG4 P0.5\n" for i in range(1, 60))
    with pytest.raises(ProgramError, match="its time sits in the feed at first, and in the dwell further on"):
        scan_program(RS274, BytesIO(whole(body)), "t.nc")


@pytest.mark.parametrize("size", [16, WHOLE])
@pytest.mark.parametrize(
    ("body", "line", "why"),
    [
        ("G1 X1 F60\nG4 P1\n" + "".join(f"G1 X{i}\n" for i in range(2, 12)), 5, "time sits in two places"),
        ("G0 X5\nF60\n", 0, "nothing in it carries time"),
        ("G1 X0 Y0 F60\nX0\n", 0, "all its feed moves go nowhere"),
        ("G1 X1 F60\nG93\nG1 X2 F60\n", 3, "G93 and G94 in one program"),
        ("G1 X1 F60\nG2 X2 I0.5\n", 4, "an arc, and time sits in the feed"),
        ("G93\nG1 X1 F60\nX2\n", 5, "a feed move without F"),
    ],
)
def test_refused_as_in_memory(body: str, line: int, why: str, size: int, cut: Callable[[int], None]) -> None:
    text = whole(body)
    cut(size)
    for go in (
        lambda: scan_program(RS274, BytesIO(text), "t.nc"),
        lambda: nc.read(RS274, text, "t.nc"),
    ):
        with pytest.raises(ProgramError) as caught:
            go()
        assert why in str(caught.value)
        if line:
            assert reason(str(caught.value))[0] == line


def test_the_line_of_the_first_move_without_a_dwell(cut: Callable[[int], None]) -> None:
    """A move whose dwell stands in the next piece has one."""
    text = whole("G1 X1 F60\nG4 P1\n" + "".join(f"G1 X{i}\n" for i in range(2, 12)))
    cut(len(HEAD) + len("G1 X1 F60\n"))
    with pytest.raises(ProgramError, match=r"t\.nc, line 5: 1 feed moves have a dwell .* and 10 have none"):
        scan_program(RS274, BytesIO(text), "t.nc")


# Times, and what is left of a refusal.


def test_a_time_that_stays_need_not_be_writable() -> None:
    """Longer than any time that a caller may request: without a requested change there is none."""
    text = whole("G93\nG1 X1 F0.00000001\nX2 F60\n")
    found = nc.read(RS274, text, "t.nc")
    assert found.time_s[0] == pytest.approx(6e9)
    new, _ = streamed(RS274, text, np.array([found.time_s[0], 2.0]))
    assert new == text.replace(b"F60", b"F30")


@pytest.mark.parametrize("size", [16, WHOLE])
@pytest.mark.parametrize(("count", "why"), [(1, "too few"), (2, "too few"), (4, "too many"), (9, "too many")])
def test_too_few_or_too_many_times(size: int, count: int, why: str, cut: Callable[[int], None]) -> None:
    cut(size)
    with pytest.raises(ProgramError, match=why):
        streamed(RS274, TEXTS["dwell"], np.ones(count))


def test_progress_hears_of_every_byte_once(cut: Callable[[int], None]) -> None:
    cut(10)
    text = TEXTS["dwell"]
    progress: list[int] = []
    scan_program(RS274, BytesIO(text), "t.nc", progress.append)
    assert sum(progress) == len(text)
    assert max(progress) == 10


def test_times_are_taken_as_their_piece_comes(cut: Callable[[int], None]) -> None:
    """Not all at once: the table of dwells is as long as the program."""
    cut(40)
    given = Given(np.full(200, 0.3))
    body = "".join(f"G1 X{i % 9} F60\nG4 P0.1\n" for i in range(200))
    rewrite_stream(RS274, BytesIO(whole(body)), "t.nc", given, BytesIO())
    assert max(given.taken) <= 4


def test_nothing_is_kept_of_what_went_by(cut: Callable[[int], None], monkeypatch: pytest.MonkeyPatch) -> None:
    """Pieces of 1 kB of a program of 100: never are there more than a few of them."""
    alive = [0, 0]

    class Counted(bytes):
        def __new__(cls, data: bytes) -> Self:
            alive[0] += 1
            alive[1] = max(alive)
            return super().__new__(cls, data)

        def __del__(self) -> None:
            alive[0] -= 1

    class File(BytesIO):
        def read(self, size: int | None = -1) -> bytes:
            return Counted(super().read(size))

    cut(1000)
    text = whole("".join(f"G1 X{i % 9} F60\nG4 P0.1\n" for i in range(5000)))
    scan_program(RS274, File(text), "t.nc")
    assert len(text) > 80_000
    assert alive[1] <= 4


BAD = [
    ("G1 X1 F60\nG4 P1\n" * 30 + "G1 X#5\n", 30, "line 63"),
    ("G1 X1 F60\nG4 P1\n" * 30 + "G1 X2 F\xff\n", 30, "line 63"),
    ("G1 X1 F60\nG4 P1\n" * 30 + "G4 P2\n", 30, "two dwells at one point"),
    ("G1 X1 F60\nG4 P1\n" * 30, 29, "row 30 is missing"),
    ("G1 X1 F60\nG4 P1\n" * 30, 31, "row 31 is one too many"),
]


@pytest.mark.parametrize(("body", "count", "why"), BAD)
@pytest.mark.parametrize("size", [16, WHOLE])
@pytest.mark.parametrize("before", [None, b"the old one"])
def test_a_refusal_leaves_nothing(
    tmp_path: Path, body: str, count: int, why: str, size: int, before: bytes | None, cut: Callable[[int], None]
) -> None:
    cut(size)
    (tmp_path / "p.nc").write_bytes((HEAD + body + "M2\n").encode("latin-1"))
    (tmp_path / "d.csv").write_text("0.5\n" * count)
    if before is not None:
        (tmp_path / "new.nc").write_bytes(before)
    there = sorted(path.name for path in tmp_path.iterdir())
    with pytest.raises(ProgramError, match=why):
        rewrite_file(tmp_path / "p.nc", DwellTable(tmp_path / "d.csv"), tmp_path / "new.nc", RS274)
    assert sorted(path.name for path in tmp_path.iterdir()) == there
    if before is not None:
        assert (tmp_path / "new.nc").read_bytes() == before


@pytest.mark.parametrize("size", [16, WHOLE])
def test_from_file_to_file(tmp_path: Path, size: int, cut: Callable[[int], None]) -> None:
    for name, text in TEXTS.items():
        cut(WHOLE)
        found = nc.read(RS274, text, "t.nc")
        times = other_times(found, 3)
        expected = nc.rewrite(RS274, found, times)
        (tmp_path / "p.nc").write_bytes(text)
        (tmp_path / "d.csv").write_text("".join(f"{time!r}\n" for time in times.tolist()))
        cut(size)
        done = rewrite_file(tmp_path / "p.nc", DwellTable(tmp_path / "d.csv"), tmp_path / "new.nc", RS274)
        assert (tmp_path / "new.nc").read_bytes() == expected, name
        assert done.points == found.n
        assert done.dwell_total_s == pytest.approx(times.sum(), rel=1e-4)


def test_a_line_longer_than_its_controller_takes_once_it_is_written() -> None:
    """Only lines that were read count: behind the program's end anything may stand."""
    text = whole("G1 X1 F60\nG4 P1\n", end="M2\n" + "x" * 400 + "\n")
    new, _ = streamed(RS274, text, np.array([1.25]))
    assert new == text.replace(b"P1\n", b"P1.25\n")
    text = whole("G1 X1 F60\nG4 P1 (" + "x" * 243 + ")\n")
    with pytest.raises(ProgramError, match=r"line 4: longer than 252 bytes once its time is changed"):
        streamed(RS274, text, np.array([1.125]))


@pytest.mark.full
def test_a_file_without_line_ends_is_not_kept() -> None:
    """Something else than a program, of any size: refused before it fills the memory."""

    class Endless(BytesIO):
        given = 0

        def read(self, size: int | None = -1) -> bytes:
            self.given += size or 0
            assert self.given < 1 << 26, "read on and on"
            return b"x" * (size or 0)

    with pytest.raises(ProgramError, match=r"t\.nc, line 1"):
        scan_program(RS274, Endless(), "t.nc")
