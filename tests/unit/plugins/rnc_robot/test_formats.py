"""Programs made from points: every dialect reads back what was meant, to the digits that are written."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from polishd.api import OwnLines
from polishd.model.errors import ConfigError, ProgramError
from polishd.model.process import Optic
from polishd.model.program import Encoding, Program
from polishd.model.surface import FloatArray
from polishd.plugins.rnc_robot.dialect import DIALECTS, GcodeDialect, dialect
from polishd.plugins.rnc_robot.formats import CHUNK, find_misread_line, path_program, read
from polishd.plugins.rnc_robot.languages import LanguageProfile
from polishd.process.optic_surface import unit_normals
from polishd.process.toolpath.apertures import circle
from polishd.process.toolpath.paths import spiral

NC = [name for name in DIALECTS if isinstance(dialect(name), GcodeDialect)]
OPTIC = Optic(120.0, -1.0)
POINTS = spiral(circle(24), 1.0, 1.0, optic=OPTIC)
NORMALS = unit_normals(OPTIC, POINTS[:, :2])
UP = np.tile([0.0, 0.0, 1.0], (len(POINTS), 1))
LENGTH = np.linalg.norm(np.diff(POINTS, axis=0), axis=1)
LINE = np.stack([np.arange(5.0), np.zeros(5), np.zeros(5)], axis=1)
NO_INVERSE = {"twincat-nci", "weihong", "codesys"}


def made(name: str, encoding: Encoding, feed: ArrayLike = 900.0, dwell: ArrayLike = 0.0) -> tuple[bytes, Program]:
    axis = NORMALS if profile(name).axes.rotary else UP
    text = path_program(POINTS, axis, np.asarray(feed), "made", encoding=encoding, dwell_s=np.asarray(dwell), to=name)
    return text, read(dialect(name), text, "made")


def profile(name: str) -> GcodeDialect:
    found = dialect(name)
    assert isinstance(found, GcodeDialect)
    return found


def test_a_table_gets_the_same_tool_axes() -> None:
    """A and C the other way round, and read as they were asked for."""
    head = profile("rs274")
    table = head.model_copy(update={"axes": head.axes.model_copy(update={"turns": "table", "rotary": ["AC"]})})
    text = path_program(POINTS, NORMALS, 900.0, "made", to=table)
    np.testing.assert_allclose(read(table, text, "made").axis, NORMALS[1:], atol=2e-7)
    assert read(head, text, "made").axis[-1, :2] == pytest.approx(NORMALS[-1, :2] * (1, -1), abs=2e-7)


def test_what_is_written() -> None:
    """The layout, once in full."""
    a, dwells = np.radians([0, 0, 10, 10]), [0.25, 0.5, 0.5]
    axis = np.stack([np.sin(a), 0 * a, np.cos(a)], axis=1)
    points = np.array([[-1.0, 0, 0], [0, 0, 0], [1.5, -0.00001, 0.5], [1.5, -0.00001, 0.5]])
    to = profile("rs274")
    to = to.model_copy(update={"dwell": to.dwell.model_copy(update={"decimals": 4})})
    text = path_program(points, axis, [600.0, 300.0, 300.0], "p(1)\né", encoding="dwell", dwell_s=dwells, to=to)
    assert text.decode().split("\n") == [
        "(p_1___: 4 points)",
        "G21 G90 G94",
        "G0 Z20.0000 X-1.0000 Y0.0000 A0.00000 C90.00000",
        "G0 Z0.0000",
        "G1 X0.0000 F600.000",
        "G4 P0.2500",
        "G1 X1.5000 Z0.5000 A10.00000 F300.000",
        "G4 P0.5000",
        "G1 X1.5000",
        "G4 P0.5000",
        "G0 Z20.5000",
        "M2",
        "",
    ]


@pytest.mark.one_of_each
@pytest.mark.parametrize("name", NC)
def test_feeds_read_back(name: str) -> None:
    feed = np.linspace(300, 3000, len(LENGTH))
    _, found = made(name, "feed", feed)
    assert (found.encoding, found.n) == ("feed", len(LENGTH))
    np.testing.assert_allclose(found.end_mm, POINTS[1:], atol=5.1e-5)
    np.testing.assert_allclose(found.start_mm, POINTS[:-1], atol=5.1e-5)
    np.testing.assert_allclose(found.axis, NORMALS[1:] if profile(name).axes.rotary else UP[1:], atol=2e-7)
    np.testing.assert_allclose(found.length_mm / found.time_s * 60, feed, rtol=2e-4)
    assert not [warning for warning in found.warnings if "steps of" not in warning]


@pytest.mark.one_of_each
@pytest.mark.parametrize("name", sorted(set(NC) - NO_INVERSE))
def test_inverse_time_reads_back(name: str) -> None:
    """Also where F behind G93 is seconds and not 1/min."""
    feed = np.linspace(300, 3000, len(LENGTH))
    text, found = made(name, "inverse", feed)
    assert (found.encoding, found.n) == ("inverse", len(LENGTH))
    np.testing.assert_allclose(found.time_s, 60 * LENGTH / feed, rtol=1e-4)
    first = float(re.search(rb"G1 .*F([\d.]+)", text)[1])  # type: ignore[index]
    assert first == pytest.approx(LENGTH[0] / 5 if name == "twincat-cnc" else 300 / LENGTH[0], rel=1e-4)


@pytest.mark.parametrize("name", sorted(NO_INVERSE))
def test_no_inverse_time_is_said(name: str) -> None:
    with pytest.raises(ProgramError, match="has no inverse time"):
        made(name, "inverse")


@pytest.mark.one_of_each
@pytest.mark.parametrize("name", NC)
def test_dwells_read_back(name: str) -> None:
    """Each within one quantum of the one meant, and so the total."""
    dwell = np.random.default_rng(3).uniform(0.1, 3.0, len(LENGTH))
    _, found = made(name, "dwell", 900.0, dwell)
    assert (found.encoding, found.n) == ("dwell", len(LENGTH))
    rules = profile(name).dwell
    quantum = max(rules.resolution_s, 1e-3 if name == "weihong" else 10.0**-rules.decimals)
    assert np.abs(found.time_s - dwell).max() <= quantum * (1 + 1e-9)
    assert found.time_s.sum() == pytest.approx(dwell.sum(), abs=quantum)
    np.testing.assert_allclose(found.end_mm, POINTS[1:], atol=5.1e-5)


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    ("name", "word"),
    [
        ("rs274", rb"G4 P0\.250*"), ("fanuc", rb"G4 X0\.250"), ("haas", rb"G4 P0\.250"), ("siemens", rb"G4 F0\.250*"),
        ("twincat-cnc", rb"G04 X0\.250*"), ("codesys", rb"G4 T0\.250*"), ("weihong", rb"G4 P250"),
    ],
)  # fmt: skip
def test_a_quarter_of_a_second(name: str, word: bytes) -> None:
    assert len(re.findall(word + rb"\n", made(name, "dwell", 900.0, 0.25)[0])) == len(LENGTH)


def test_a_modal_feed_is_written_where_it_changes() -> None:
    text = path_program(LINE, UP[:5], [600.0, 600.0, 700.0, 700.0], "x", encoding="dwell", dwell_s=1.0)
    assert [line for line in text.split(b"\n") if b"F" in line] == [b"G1 X1.0000 F600.000", b"G1 X3.0000 F700.000"]
    own = path_program(LINE, UP[:5], 600.0, "x")
    assert own.count(b"F600.000") == 4


@pytest.mark.full
@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), st.integers(2, 60))
def test_anything_finite_reads_back(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-40, 40, (n, 3)) * [1, 1, 0.01]
    axis = rng.normal(size=(n, 3)) * 0.05 + [0, 0, 1]
    axis[n // 2 : n // 2 + 2] = [0, 0, 1]
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    feed = rng.uniform(300, 3000, n - 1)
    found = read(dialect("rs274"), path_program(points, axis, feed, "part"), "made")
    np.testing.assert_allclose(found.end_mm, points[1:], atol=5.1e-5)
    np.testing.assert_allclose(found.axis, axis[1:], atol=1e-6)
    np.testing.assert_allclose(found.length_mm / found.time_s * 60, feed, rtol=1e-5)


def test_long_programs_are_the_same_in_all_their_pieces() -> None:
    n = CHUNK + 100
    points = np.stack([np.arange(n) * 0.01, np.sin(np.arange(n)), np.zeros(n)], axis=1)
    text = path_program(points, np.tile([0.0, 0.0, 1.0], (n, 1)), 600.0, "long")
    lines = text.split(b"\n")[4:-3]
    assert len(lines) == n - 1
    assert all(line.startswith(b"G1 X") and line.endswith(b" F600.000") for line in lines)
    assert lines[-1].startswith(f"G1 X{points[-1, 0]:.4f} Y{points[-1, 1]:.4f} ".encode())


@pytest.mark.parametrize(
    ("points", "axis", "feed", "what"),
    [
        (LINE[:1], UP[:1], 60.0, "at least two points"),
        (LINE[:, :2], UP[:5, :2], 60.0, "at least two points"),
        (LINE, UP[:4], 60.0, "as many axes"),
        (LINE * [np.nan, 1, 1], UP[:5], 60.0, "point 0 is not finite"),
        (LINE, UP[:5] * 2, 60.0, "axis at point 0 is no unit vector"),
        (LINE, UP[:5] * [1, np.nan, 1], 60.0, "axis at point 0 is no unit vector"),
        (LINE, UP[:5], 0.0, "above zero"),
        (LINE, UP[:5], np.inf, "finite"),
        (LINE, UP[:5], 1e-5, "leave a feed of 0"),
        (LINE[[0, 1, 1, 2]], UP[:4], 60.0, "points 1 and 2 are one place"),
    ],
)
def test_what_cannot_be_written(points: FloatArray, axis: FloatArray, feed: float, what: str) -> None:
    with pytest.raises(ProgramError, match=what):
        path_program(points, axis, feed, "bad")


@pytest.mark.parametrize("dwell", [0.0, -1.0, 1e-4, 1e7])
def test_dwells_that_cannot_be_written(dwell: float) -> None:
    with pytest.raises(ProgramError, match=r"dwells of .* s: Fanuc.* takes 0\.001 to 100000 s"):
        path_program(LINE, UP[:5], 60.0, "bad", encoding="dwell", dwell_s=dwell, to="fanuc")
    with pytest.raises(ProgramError, match="dwells finite"):
        path_program(LINE, UP[:5], 60.0, "bad", encoding="dwell", dwell_s=np.nan)


def test_a_dialect_without_a_wrist_needs_an_upright_tool() -> None:
    with pytest.raises(ProgramError, match="does not turn the tool"):
        path_program(POINTS, NORMALS, 900.0, "bad", to="grbl")
    assert b"A" not in path_program(POINTS, UP, 900.0, "fine", to="grbl").split(b"\n", 1)[1]


def test_a_language_without_a_form_is_not_made() -> None:
    profile = dialect("rapid")
    assert isinstance(profile, LanguageProfile)
    with pytest.raises(ProgramError, match="no programs are made in rapid"):
        path_program(LINE, UP[:5], 900.0, "bad", to=profile.model_copy(update={"make": None}))
    with pytest.raises(ConfigError, match="did you mean"):
        path_program(LINE, UP[:5], 900.0, "bad", to="rs275")


@pytest.mark.one_of_each
@pytest.mark.skipif(shutil.which("rs274") is None, reason="LinuxCNC is not installed")
@pytest.mark.parametrize("encoding", ["feed", "inverse", "dwell"])
def test_linuxcnc_reads_it(encoding: Encoding, tmp_path: Path) -> None:
    text, _ = made("rs274", encoding, 900.0, 0.25)
    (tmp_path / "made.ngc").write_bytes(text)
    said = subprocess.run(
        ["rs274", "-g", str(tmp_path / "made.ngc")],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=True,
    )
    moves = re.findall(r"STRAIGHT_FEED\(([^)]*)\)", said.stdout)
    x = np.array([[float(number) for number in move.split(",")[:3]] for move in moves])
    np.testing.assert_allclose(x, POINTS[1:], atol=5.1e-5)
    assert said.stdout.count("DWELL(0.2500)") == (len(LENGTH) if encoding == "dwell" else 0)


def test_a_long_line_of_words_that_ends_otherwise_is_gone_over_once() -> None:
    assert find_misread_line(dialect("krl"), OwnLines("the driver", {}, ("X111" * 200 + "!",))) == ""
