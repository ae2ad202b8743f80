"""Rewriting RS274 programs: new times, every other byte untouched, the total kept."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from polishd.api import Program, ProgramError
from polishd.plugins.rnc_robot.formats import path_program
from tests.rs274 import read, rewrite

HEAD = b"G21 G90 G94\nG0 X0 Y0 Z0\n"
Times = NDArray[np.float64]


def rewritten(body: bytes, times: list[float]) -> bytes:
    """The body after rewriting."""
    text = HEAD + body + b"M2\n"
    new = rewrite(read(text, "t.rnc"), np.array(times))
    assert new.startswith(HEAD)
    assert new.endswith(b"M2\n")
    return new[len(HEAD) : -3]


STYLES = [
    (b"G1 X1 F60\n", [2.0], b"G1 X1 F30\n"),
    (b"G1 X1 F60.\n", [2.0], b"G1 X1 F30.\n"),
    (b"G1 X1 F60.00\n", [2.0], b"G1 X1 F30.00\n"),
    (b"G1 X1 F+60.0 (F60)\r\n", [2.0], b"G1 X1 F+30.0 (F60)\r\n"),
    (b"G1 F60 X1 ; F60\n", [2.0], b"G1 F30 X1 ; F60\n"),
    (b"g 1 x 1 f 6 0 . 0 ; x\n", [2.0], b"g 1 x 1 f 30.0 ; x\n"),
    (b"G1 X1 F60\nX2\n", [2.0, 2.0], b"G1 X1 F30\nX2\n"),
    (b"G1 X1 F60\nX2\n", [2.0, 4.0], b"G1 X1 F30\nX2 F15\n"),
    (b"G1 X1 F60\nX2\n", [2.0, 1.0], b"G1 X1 F30\nX2 F60\n"),
    (b"G1 X1 F60\nX2\nX3\nX4\n", [1.0, 2.0, 1.0, 1.0], b"G1 X1 F60\nX2 F30\nX3 F60\nX4\n"),
    (b"f60\ng1 x1 (c) \nx2 ; c\r\n", [2.0, 4.0], b"f60\ng1 x1 f30 (c) \nx2 f15 ; c\r\n"),
    (b"F60\nG1 X1\nG0 Z1 F60\nG1 X2\n", [2.0, 2**0.5], None),
    (b"G93 G1 X1 F60\nX2 F120\n", [2.0, 0.5], b"G93 G1 X1 F30\nX2 F120\n"),
    (b"G20\nG1 X1 F60\n", [2.0], b"G20\nG1 X1 F30\n"),
    (b"G1 X1 F60\nG4 P0.5\n", [0.25], b"G1 X1 F60\nG4 P0.25\n"),
    (b"G1 X1 F60\nG4 P.50 (P.5)\n", [0.25], b"G1 X1 F60\nG4 P.25 (P.5)\n"),
    (b"G1 X1 F60\nG4 P.5\n", [1.25], b"G1 X1 F60\nG4 P1.25\n"),
    (b"G1 X1 F60\nG4 P2\n", [3.0], b"G1 X1 F60\nG4 P3\n"),
    (b"G1 X1 F60\nG4 P2\n", [0.0], b"G1 X1 F60\nG4 P0\n"),
    (b"G1 X1 F60\nG4 P500.\n", [12.0], b"G1 X1 F60\nG4 P12.\n"),
    (b"G1 X1 F60\np 0 . 5 g 4 ; P9\n", [0.25], b"G1 X1 F60\np 0.25 g 4 ; P9\n"),
]


@pytest.mark.parametrize(("body", "times", "expected"), [case for case in STYLES if case[2] is not None])
def test_style(body: bytes, times: list[float], expected: bytes) -> None:
    assert rewritten(body, times) == expected


def test_an_f_between_the_points_holds() -> None:
    """An F of a rapid governs what follows also after an earlier block was given another one."""
    body = b"F60\nG1 X1\nG0 Z1 F120\nG1 X2\nX3\n"
    assert rewritten(body, [2.0, 0.5, 0.5]) == b"F60\nG1 X1 F30\nG0 Z1 F120\nG1 X2\nX3\n"


@pytest.mark.parametrize("times", [[1.0], [1.0, 2.0, 3.0], [[1.0, 2.0]], [1.0, np.nan], [1.0, np.inf], [1.0, 0.0]])
def test_times_that_cannot_be_written(times: list[float]) -> None:
    found = read(HEAD + b"G1 X1 F60\nX2\nM2", "t.rnc")
    with pytest.raises(ProgramError, match=r"t\.rnc"):
        rewrite(found, np.array(times))


def test_a_dwell_below_zero_cannot_be_written() -> None:
    found = read(HEAD + b"G1 X1 F60\nG4 P1\nM2", "t.rnc")
    with pytest.raises(ProgramError, match=r"line 4: a time of -0\.1 s"):
        rewrite(found, np.array([-0.1]))


def test_path_program_reads_back() -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform(-40, 40, (50, 3)) * [1, 1, 0.01]
    axis = rng.normal(size=(50, 3)) * 0.05 + [0, 0, 1]
    axis[10:13] = [0, 0, 1]
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    feed = rng.uniform(300, 3000, 49)
    found = read(path_program(points, axis, feed, "part (1) é\n"), "made")
    assert (found.encoding, found.n, found.warnings) == ("feed", 49, ())
    np.testing.assert_allclose(found.end_mm, points[1:], atol=5.1e-5)
    np.testing.assert_allclose(found.start_mm, points[:-1], atol=5.1e-5)
    np.testing.assert_allclose(found.axis, axis[1:], atol=1e-6)
    np.testing.assert_allclose(found.length_mm / found.time_s * 60, feed, rtol=1e-5)
    assert b"G0 Z20.0000" in found.text or b"G0 Z20" in found.text


@pytest.mark.parametrize(
    ("points", "axis", "feed"),
    [
        (np.zeros((1, 3)), np.zeros((1, 3)), 60.0),
        (np.zeros((3, 2)), np.zeros((3, 2)), 60.0),
        (np.full((3, 3), np.nan), np.ones((3, 3)), 60.0),
        (np.zeros((3, 3)), np.ones((3, 3)), 0.0),
    ],
)
def test_path_program_refuses(points: Times, axis: Times, feed: float) -> None:
    with pytest.raises(ProgramError):
        path_program(points, axis, feed, "bad")


NUMBER = st.sampled_from(["{:.3f}", "{:.1f}", "{:.0f}", "{:.0f}.", "+{:.2f}"])
AFTER = st.sampled_from(["", " ", " (G4 P9 F7)", " ; P.5 F100", "\r", " (\u00e9) ;\r", "\t"])
TIME = st.floats(0.01, 1000.0)


@st.composite
def programs(draw: st.DrawFn, encoding: str) -> bytes:
    """A program of that encoding in all sorts of spelling."""
    lines = [draw(st.sampled_from(["G21 G90", "g21\ng90 (x)", "N1 G21 G90"])), "G0 X0 Y0 Z0", "F77"]
    lines[0] += "\nG93" if encoding == "inverse" else ""
    for index in range(1, draw(st.integers(1, 12)) + 1):
        move = f"G1 X{index}"
        own = encoding == "inverse" or draw(st.booleans())
        if encoding != "dwell" and own:
            # a feed that is written as 0 would be another trap
            move += " F" + draw(NUMBER).format(draw(st.floats(2, 5000)))
        move = move.lower() if draw(st.booleans()) else move
        lines.append(move + draw(AFTER))
        if encoding == "dwell":
            lines.append("G4 P" + draw(NUMBER).format(draw(st.floats(0, 99))) + draw(AFTER))
    end = draw(st.sampled_from(["M2", "M30\r\n", "M2\n%\n\ngarbage # [\n"]))
    return ("\n".join(lines) + "\n" + end).encode()


def skeleton(text: bytes, encoding: str) -> list[bytes]:
    """The text with the numbers that may carry time taken out, and F words that may have been added."""
    letter = b"[Pp]" if encoding == "dwell" else b"[Ff]"
    found = []
    for line in text.split(b"\n"):
        code, mark, comment = re.match(rb"([^(;]*)(.?)(.*)$", line, re.DOTALL).groups()  # type: ignore[union-attr]
        code = re.sub(rb" ?" + letter + rb"[-+0-9.]+", b"", code) if re.search(rb"(?i)g1 |g4 ", code) else code
        found.append(code + mark + comment)
    return found


def quanta(new: Program) -> Times:
    """Time of one unit in the last written digit of each point's number."""
    found = []
    for line, time_s in zip(new.line, new.time_s, strict=True):
        code = re.split(rb"[(;]", new.blocks[line - 1])[0]
        number = re.search(rb"[PpFf] *([-+0-9.]+)", code)
        if number is None:
            found.append(found[-1] if found else 0.0)
            continue
        step = 10.0 ** -len(number[1].partition(b".")[2])
        found.append(step if new.encoding == "dwell" else time_s * step / float(number[1]))
    return np.array(found)


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize("encoding", ["feed", "dwell", "inverse"])
@given(data=st.data())
def test_only_time_changes_and_the_total_is_kept(encoding: str, data: st.DataObject) -> None:
    text = data.draw(programs(encoding))
    old = read(text, "t.rnc")
    assert old.encoding == encoding
    assert rewrite(old, old.time_s) == text
    times = np.array(data.draw(st.lists(TIME, min_size=old.n, max_size=old.n)))
    keep = np.array(data.draw(st.lists(st.booleans(), min_size=old.n, max_size=old.n)))
    times = np.where(keep, old.time_s, times)

    new_text = rewrite(old, times)
    new = read(new_text, "t.rnc")

    assert skeleton(new_text, encoding) == skeleton(text, encoding)
    np.testing.assert_array_equal(new.end_mm, old.end_mm)
    np.testing.assert_array_equal(new.line, old.line)
    np.testing.assert_allclose(new.time_s, times, rtol=1e-4, atol=1e-9)
    # what was carried is the rounding of one point at most; trailing zeros hide the digits of some
    largest = max(quanta(new).max(), 1e-4 * times.max())
    assert abs(new.time_s.sum() - times.sum()) <= largest


@pytest.mark.full
def test_the_total_of_many_dwells_is_exact_to_one_quantum() -> None:
    n = 5000
    body = b"".join(b"G1 X%d\nG4 P0.5\n" % (i % 90) for i in range(n))
    old = read(HEAD + b"F600\n" + body + b"M2\n", "t.rnc")
    times = np.random.default_rng(0).gamma(2.0, 0.3, n) + 0.02
    new = read(rewrite(old, times), "t.rnc")
    assert np.abs(new.time_s - times).max() <= 1e-6 * (1 + 1e-9)
    assert abs(new.time_s.sum() - times.sum()) <= 1e-6


@pytest.mark.full
def test_the_total_of_many_feeds_is_exact_to_one_quantum() -> None:
    n = 5000
    points = np.stack([np.arange(n) % 70, np.arange(n) // 70, np.zeros(n)], axis=1).astype(float)
    old = read(path_program(points, np.tile([0.0, 0.0, 1.0], (n, 1)), 600.0, "x"), "t.rnc")
    times = np.random.default_rng(0).gamma(2.0, 0.3, n - 1) + 0.02
    new = read(rewrite(old, times), "t.rnc")
    np.testing.assert_allclose(new.time_s, times, rtol=1e-4)
    assert abs(new.time_s.sum() - times.sum()) <= quanta(new).max()
