"""The verifier: claims identical motion where it is, in every dialect and encoding, and never where it is not."""

from __future__ import annotations

import dataclasses
import functools
import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polishd.api import ProgramError
from polishd.drivers.linuxcnc.interpreter import exact_python
from polishd.plugins.rnc_robot import verify as verifier
from polishd.plugins.rnc_robot.dialect import GcodeDialect
from polishd.plugins.rnc_robot.dialect import dialect as load
from polishd.plugins.rnc_robot.formats import read, rewrite
from polishd.plugins.rnc_robot.verify import Verification, verify
from tests.unit.plugins.rnc_robot.languages.robot_programs import PROGRAMS

dialect = functools.cache(load)
RS274 = dialect("rs274")
assert isinstance(RS274, GcodeDialect)
HEAD = "G21 G90 G94\nG0 X0 Y0 Z5\nG0 Z0\n"
DWELL = HEAD + "G1 X1 F60\nG4 P1\nG1 X3\nG4 P.5\nG1 X4 Y1 F60\nG4 P2\nG0 Z5\nM2\n"
FEED = HEAD + "G1 X1 F60\nG1 X3 F240\nG1 X4 Y1 F42.4264\nG0 Z5\nM2\n"
INVERSE = HEAD + "G93\nG1 X1 F60\nG1 X3 F120\nG1 X4 Y1 F30\nG94\nG0 Z5\nM2\n"

needs_linuxcnc = pytest.mark.skipif(shutil.which("rs274") is None, reason="LinuxCNC is not installed")
WITH = [False, pytest.param(True, marks=needs_linuxcnc)]


def compared(old: str, new: str, name: str = "rs274", *, with_rs274: bool = False) -> Verification:
    return verify(old.encode(), new.encode(), dialect(name), with_rs274=with_rs274)


@pytest.mark.parametrize("with_rs274", WITH)
@pytest.mark.parametrize("text", [DWELL, FEED, INVERSE], ids=["dwell", "feed", "inverse"])
def test_a_program_moves_as_itself(text: str, with_rs274: bool) -> None:
    found = compared(text, text, with_rs274=with_rs274)
    assert found.identical_motion
    assert (found.difference, found.other_changes, found.changed_points) == (None, (), 0)
    assert found.time_before_s == found.time_after_s == pytest.approx(3.5, rel=1e-6)
    assert found.proved_by[0] == f"text: {len(text.splitlines())} lines, every byte but the 3 numbers that carry time"
    assert found.proved_by[1] == "motion: 6 moves, kind, place and order, bit for bit"
    assert len(found.proved_by) == 2 + with_rs274


@pytest.mark.parametrize("with_rs274", WITH)
@pytest.mark.parametrize("text", [DWELL, FEED, INVERSE], ids=["dwell", "feed", "inverse"])
def test_what_the_rewriter_writes_is_proved(text: str, with_rs274: bool) -> None:
    program = read(RS274, text.encode(), "t")
    new = rewrite(RS274, program, np.array([0.25, 0.5, 4.0]))
    found = verify(text.encode(), new, RS274, with_rs274=with_rs274)
    assert found.identical_motion
    assert found.changed_points == 2
    assert found.largest_change_s == pytest.approx(2.0, rel=1e-4)
    assert found.time_after_s == pytest.approx(4.75, rel=1e-4)
    assert found.range_after_s == pytest.approx((0.25, 4.0), rel=1e-4)
    assert found.range_before_s == pytest.approx((0.5, 2.0), rel=1e-4)


@pytest.mark.one_of_each
@pytest.mark.parametrize("with_rs274", WITH)
@pytest.mark.parametrize(
    ("old", "new"),
    [(DWELL, FEED), (DWELL, INVERSE), (FEED, INVERSE)],
    ids=["dwell-feed", "dwell-inverse", "feed-inverse"],
)
def test_a_change_of_encoding_is_proved_and_listed(old: str, new: str, with_rs274: bool) -> None:
    for one, other in ((old, new), (new, old)):
        found = compared(one, other, with_rs274=with_rs274)
        assert found.identical_motion, found.difference
        assert found.largest_change_s == pytest.approx(0.0, abs=1e-5)
        assert {change.kind for change in found.other_changes} == {"timing"}


SPOILT = {
    "a place": ("G1 X3", "G1 X3.0001"),
    "the same place, written otherwise": ("G1 X3", "G1 X3.0"),
    "a rapid": ("G0 Z5\nM2", "G0 Z6\nM2"),
    "a rapid for a feed move": ("G1 X3", "G0 X3"),
    "an axis more": ("G0 X0", "G0 A1 X0"),
    "a move more": ("G1 X3", "G1 X2\nG1 X3"),
    "a move less": ("G0 Z5\nM2", "M2"),
    "units": ("G21", "G20"),
    "incremental": ("G1 X3", "G91 G1 X2"),
    "the spindle": ("G1 X3", "S100 G1 X3"),
    "coolant": ("M2", "M9\nM2"),
    "a dwell that is no point": ("G0 X0", "G4 P9\nG0 X0"),
    "the feed beside dwells": ("F60\nG4 P1", "F61\nG4 P1"),
    "another end": ("M2", "M30"),
    "path mode": ("G21 G90", "G64 G21 G90"),
}


@pytest.mark.one_of_each
@pytest.mark.parametrize("with_rs274", WITH)
@pytest.mark.parametrize("spoil", SPOILT.values(), ids=SPOILT)
def test_anything_else_that_changed_is_not_proved(spoil: tuple[str, str], with_rs274: bool) -> None:
    old, new = spoil
    for one, other in ((DWELL, DWELL.replace(old, new)), (DWELL.replace(old, new), DWELL)):
        assert one != other
        found = compared(one, other, with_rs274=with_rs274)
        assert not found.identical_motion
        assert found.difference
        assert found.proved_by == ()
        assert any(change.kind == "other" and str(change) == found.difference for change in found.other_changes)


def test_an_f_that_holds_carries_no_time_of_later_moves() -> None:
    old = HEAD + "G1 X1 F60\nG1 X3\nG1 X4\nM2\n"
    new = rewrite(RS274, read(RS274, old.encode(), "t"), np.array([1.0, 0.5, 1.0])).decode()
    assert new == old.replace("X3", "X3 F240").replace("X4", "X4 F60")
    found = compared(old, new)
    assert found.identical_motion
    assert "every byte but the 3 numbers" in found.proved_by[0]
    assert [(change.kind, change.new) for change in found.other_changes] == [
        ("timing", "G1 X3 F240"),
        ("timing", "G1 X4 F60"),
    ]
    assert not compared(old, new.replace("X4", "X5")).identical_motion
    assert not compared(old, new.replace("M2", "M9\nM2")).identical_motion


def test_a_program_read_in_pieces_is_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("polishd.plugins.rnc_robot.gcode.rewrite.PIECE_BYTES", 32)
    found = compared(DWELL, DWELL.replace("P.5", "P.75").replace("P2", "P12"))
    assert (found.identical_motion, found.changed_points, found.largest_change_s) == (True, 2, 10.0)
    assert not compared(DWELL, DWELL.replace("G0 Z5\nM2", "G0 Z6\nM2")).identical_motion


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b"0.15", b"0.16"),
        (b"False", b"True"),
        (b"a=1.4", b"a=1.5"),
        (b"0.4, 0", b"0.5, 0"),
        (b"end\npolish", b"end\n\tpolish"),
    ],
)
def test_in_a_robot_language_brackets_are_no_comments(old: bytes, new: bytes) -> None:
    text = PROGRAMS["urscript"].text
    assert old in text
    found = verify(text, text.replace(old, new), dialect("urscript"))
    assert not found.identical_motion
    assert verify(text, text.replace(b"# sleep(9)", b"# sleep(8)"), dialect("urscript")).identical_motion


def test_the_first_difference_is_named_and_all_are_listed() -> None:
    found = compared(DWELL, DWELL.replace("X3", "X7").replace("M2", "M30").replace("P.5", "P.6"))
    assert found.difference == 'line 6 "G1 X3" became line 6 "G1 X7"'
    assert [(change.kind, change.old_line) for change in found.other_changes] == [("other", 6), ("other", 11)]


def test_what_is_listed_is_bounded_but_not_what_is_judged(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(verifier, "LISTED", 2)
    commented = DWELL.replace("\n", " (c)\n")
    found = compared(DWELL, commented)
    assert found.identical_motion
    assert len(found.other_changes) == 2
    spoilt = compared(DWELL, commented.replace("M2", "M30"))
    assert spoilt.difference == 'line 11 "M2" became line 11 "M30 (c)"'
    assert len(spoilt.other_changes) == 2


def test_moves_are_compared_apart_from_the_text(monkeypatch: pytest.MonkeyPatch) -> None:
    """Should text and rules ever agree on too much, the moves still do not."""
    monkeypatch.setattr(verifier, "changes", lambda *_: iter(()))
    for spoil, says in (
        (("G1 X3", "G1 X3.0001"), "move 4: line 6 to x3.0 y0.0 z0.0 became line 6 to x3.0001 y0.0 z0.0"),
        (("G0 Z5\nM2", "G0 Z6\nM2"), "move 6: line 10 to x4.0 y1.0 z5.0 became line 10 to x4.0 y1.0 z6.0"),
        (("G0 Z5\nM2", "G1 Z5\nM2"), "move 6: line 10"),
        (("G0 Z5\nM2", "M2"), "old has 6 moves, new 5"),
    ):
        found = compared(DWELL, DWELL.replace(*spoil))
        assert not found.identical_motion
        assert (found.difference or "").startswith(says)


OTHERS = {
    "fanuc": "G21 G90 G94\nG0 X0. Y0. Z0.\nG1 X1. F60.\nG4 P1000\nG1 X2.\nG4 X1.5\nM30\n",
    "haas": "G21 G90 G94\nG0 X0. Y0. Z0.\nG1 X1. F60.\nG4 P500\nG1 X2.\nG4 P0.5\nM30\n",
    "siemens": "G71 G90 G94\nG0 X0 Y0 Z0\nG1 X1 F60\nG4 F1.5 ; here\nG1 X2\nG4 F2\nM30\n",
    "twincat-cnc": "G71 G90 G94\nG0 X0 Y0 Z0\nG1 X1 F60\nG04 X1.5\nG1 X2\n#TIME 2.5\nM30\n",
}


@pytest.mark.parametrize("name", OTHERS)
def test_other_dialects_are_proved_too(name: str) -> None:
    text, profile = OTHERS[name].encode(), dialect(name)
    program = read(profile, text, "t")
    new = rewrite(profile, program, np.array([2.0, 3.0]))
    found = verify(text, new, profile)
    assert found.identical_motion, found.difference
    assert (found.changed_points, found.time_after_s) == (2, 5.0)
    assert not verify(text, new.replace(b"X2", b"X3"), profile).identical_motion


@needs_linuxcnc
def test_linuxcnc_judges_motion_but_not_times_that_mean_something_else_to_it() -> None:
    text = OTHERS["haas"]
    found = compared(text, text.replace("P500", "P700"), "haas", with_rs274=True)
    assert found.identical_motion, found.difference
    assert "canonical calls and 0 times" in found.proved_by[-1]


@needs_linuxcnc
def test_linuxcnc_refuses_in_its_own_words() -> None:
    with pytest.raises(ProgramError, match=r"LinuxCNC's interpreter refuses it: .*Dwell time missing"):
        compared(OTHERS["fanuc"], OTHERS["fanuc"], "fanuc", with_rs274=True)


def test_robot_languages_are_not_for_linuxcnc() -> None:
    with pytest.raises(ProgramError, match="reads NC text, and rapid is none"):
        compared("", "", "rapid", with_rs274=True)


@pytest.mark.skipif(exact_python() is None, reason="LinuxCNC's module gcode is not installed")
@pytest.mark.parametrize(
    ("lie", "says"),
    [
        ({"time_s": np.array([1.0, 0.5000001, 2.0])}, "line 7: polishd reads 0.5000001 s, LinuxCNC 0.5 s"),
        ({"line": np.array([5, 8, 9])}, "polishd reads 3 timed points, LinuxCNC 2"),
    ],
)
def test_linuxcnc_sees_times_that_we_read_wrong(lie: dict[str, object], says: str) -> None:
    program = read(RS274, DWELL.encode(), "t")
    said = verifier.interpreted(program, dataclasses.replace(program, **lie), RS274)  # type: ignore[arg-type]
    assert says in (said.difference or "")


@pytest.mark.full
@needs_linuxcnc
@pytest.mark.parametrize("text", [DWELL, FEED, INVERSE], ids=["dwell", "feed", "inverse"])
def test_without_the_module_rs274_itself_is_asked(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("polishd.drivers.linuxcnc.interpreter.exact_python", lambda: None)
    monkeypatch.setattr(verifier, "exact_python", lambda: None)
    strays = text.replace("G0 X0", "G4 P.5\nG0 X0")
    program = read(RS274, strays.encode(), "t")
    said = verifier.interpreted(program, program, RS274)
    assert said.difference is None
    assert said.times == (6 if text == DWELL else 0), "four decimals say nothing about the time of a short move"
    wrong = dataclasses.replace(program, time_s=program.time_s + 2e-4)
    assert (verifier.interpreted(program, wrong, RS274).difference is None) == (text != DWELL)
    moved = read(RS274, strays.replace("Z0\n", "Z1\n").encode(), "t")
    assert "STRAIGHT_TRAVERSE(0.0000, 0.0000, 0.0000" in (verifier.interpreted(program, moved, RS274).difference or "")


@pytest.mark.skipif(exact_python() is None, reason="LinuxCNC's module gcode is not installed")
def test_linuxcnc_agrees_on_five_axes_and_inverse_time() -> None:
    body = "".join(f"G1 X{i} Y{i % 3} Z{i % 5} A{i / 2} C{-3 * i} F{20 + i}\n" for i in range(1, 40))
    still = "G1 A9 F30\nG1 C5 F30\n"
    for text in (HEAD + "G93\n" + body + still + "M2\n", HEAD + body + "M2\n", (HEAD + "G20\n" + body + "M2\n")):
        found = compared(text, text, with_rs274=True)
        assert found.identical_motion, found.difference
        turns = 2 * text.count(still)
        assert f"and {2 * (found.points - turns)} times" in found.proved_by[-1]


def test_files_are_read_and_named(tmp_path: Path) -> None:
    (tmp_path / "a.rnc").write_text(DWELL)
    (tmp_path / "b.rnc").write_text(DWELL.replace("X3", "#3"))
    assert verify(tmp_path / "a.rnc", DWELL.encode(), RS274).identical_motion
    with pytest.raises(ProgramError, match=r"^b\.rnc, line 6: "):
        verify(tmp_path / "a.rnc", tmp_path / "b.rnc", RS274)
    with pytest.raises(ProgramError, match="cannot be read: No such file"):
        verify(tmp_path / "c.rnc", tmp_path / "b.rnc", RS274)


@pytest.mark.full
@settings(max_examples=150, deadline=None)
@given(
    at=st.integers(0, len(DWELL) - 1),
    byte=st.sampled_from(list(b" 0189.-+XYZFGPMS()/\n")),
    text=st.sampled_from([DWELL, FEED]),
)
def test_one_changed_byte_is_never_taken_for_the_same_motion(at: int, byte: int, text: str) -> None:
    """Either refused, or not proved, or the two really read as the same moves with other times."""
    old = text.encode()
    new = old[:at] + bytes([byte]) + old[at + 1 :]
    try:
        found = verify(old, new, RS274)
    except ProgramError:
        return
    if found.identical_motion:
        one, other = read(RS274, old, "old"), read(RS274, new, "new")
        assert np.array_equal(one.end_mm, other.end_mm)
        words = [b"".join(line.split()) for line in (old, new)]
        rest = [bytes(c for c in word if c not in b"0123456789.+-FP()") for word in words]
        assert rest[0] == rest[1], "only numbers of times changed, or a comment came"
