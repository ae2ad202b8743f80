"""Time that moves into another encoding: the same motion, the times that were asked for, or a refusal by line."""

from __future__ import annotations

import re
import shutil
from dataclasses import dataclass
from functools import cache
from itertools import permutations
from typing import cast

import numpy as np
import pytest

from polishd.api import Program, ProgramError
from polishd.model.program import Encoding
from polishd.plugins.rnc_robot import formats
from polishd.plugins.rnc_robot.dialect import GcodeDialect, dialect
from polishd.plugins.rnc_robot.languages import LanguageProfile
from polishd.plugins.rnc_robot.verify import verify
from tests.corpus.changes import quanta_s

NO_RS274 = shutil.which("rs274") is None
CHANGES: list[tuple[Encoding, Encoding]] = list(permutations(("feed", "dwell", "inverse"), 2))


@dataclass(frozen=True)
class Style:
    """How a dialect writes a program."""

    units: str
    dwell: str
    inverse: bool = True
    inch: str = "G20"
    end: str = "M30"


STYLES = {
    "rs274": Style("G21", "G4 P{:.3f}", end="M2"),
    "fanuc": Style("G21", "G04 X{:.3f}"),
    "haas": Style("G21", "G04 P{:.3f}"),
    "siemens": Style("G71", "G4 F{:.3f}", inch="G700"),
    "siemens-iso": Style("G21", "G04 U{:.3f}"),
    "twincat-nci": Style("G71", "G4 X{:.3f}", inverse=False, inch="G700"),
    "twincat-cnc": Style("G71", "#TIME {:.3f}", inch=""),
    "grbl": Style("G21", "G4 P{:.3f}", end="M2"),
    "weihong": Style("G21", "G04 P{:.0f}", inverse=False),
    "codesys": Style("", "G4 TIME={:.3f}", inverse=False, inch=""),
}


@cache
def profile(name: str) -> GcodeDialect:
    return cast(GcodeDialect, dialect(name))


@dataclass(frozen=True)
class Form:
    """How a program is written, beside its dialect."""

    newline: str = "\n"
    lower: bool = False
    final: bool = True
    tape: bool = False
    """Begins and ends with %."""
    inch: bool = False
    incremental: bool = False
    modal: bool = False
    """F holds over three moves."""
    leads: bool = False
    """A feed move in and one out that have no dwell of their own."""
    said: bool = False
    """G94 stands at the head, where the encoding is not inverse."""
    comments: bool = False
    numbers: bool = False


FORMS = {
    "plain": Form(),
    "crlf": Form(newline="\r\n", said=True),
    "lower case": Form(lower=True, modal=True),
    "no final newline": Form(final=False, said=True, modal=True),
    "no final newline, crlf, tape": Form(newline="\r\n", final=False, tape=True),
    "inch": Form(inch=True, modal=True),
    "incremental": Form(incremental=True, modal=True, said=True),
    "leads": Form(leads=True, modal=True),
    "leads, said": Form(leads=True, said=True),
    "comments": Form(comments=True, modal=True, leads=True),
    "numbered": Form(numbers=True, tape=True, modal=True),
}


def written(name: str, encoding: Encoding, form: Form, n: int = 9) -> bytes:
    """A program of n points."""
    style, rng = STYLES[name], np.random.default_rng(n)
    head = ["%"] if form.tape else []
    head += [style.inch if form.inch and style.inch else style.units, "G90"]
    head += ["G94"] if form.said and encoding != "inverse" and style.inverse else []
    head += ["G0 X0. Y0. Z0.", "G91" if form.incremental else "G90"]
    head += ["G93"] if encoding == "inverse" else []
    body = ["G1 Z-1. F50."] if form.leads else []
    for index in range(n):
        x, y = (1.5, -0.5 * (index % 3)) if form.incremental else (1.5 * index + 1, 0.25 * index**1.5)
        own = encoding == "inverse" or index % 3 == 0 or not form.modal
        body.append(f"G1 X{x:.4f} Y{y:.4f}" + (f" F{rng.uniform(5, 900):.2f}" if own else ""))
        if form.comments:
            body[-1] += " (G4 P9 F7)" if "()" in profile(name).text.comments else " ; G4 F9 X7"
        if encoding == "dwell":
            body.append(style.dwell.format(rng.uniform(0.2, 3) * (1000 if name == "weihong" else 1)))
    body += ["G1 Z5. F90."] if form.leads else []
    lines = [*head, *body, "G0 Z50.", style.end, *(["%"] if form.tape else [])]
    lines = [line for line in lines if line]
    if form.numbers:
        lines = [line if "%" in line or "#" in line else f"N{10 * k} {line}" for k, line in enumerate(lines)]
    text = form.newline.join(lines) + (form.newline if form.final else "")
    return (text.lower() if form.lower else text).encode()


def recoded(name: str, old: Program, asked: np.ndarray, encoding: Encoding, leads: int = 0) -> Program:
    """The program in another encoding, read back; every promise is kept. ``leads``: moves that become points."""
    text = formats.rewrite(profile(name), old, asked, encoding)
    new = formats.read(profile(name), text, "new.nc")
    assert new.encoding == encoding
    mine = slice(leads, new.n - leads)
    assert new.n == old.n + 2 * leads
    np.testing.assert_array_equal(new.end_mm[mine], old.end_mm)
    np.testing.assert_array_equal(new.axis[mine], old.axis)
    quanta = quanta_s(new, text, new.time_s)[mine]
    assert (np.abs(new.time_s[mine] - asked) <= quanta * 1.001 + 1e-12).all(), text
    # what rounding leaves goes into the next point, the last one's may be the lead-out's
    assert abs(new.time_s[mine].sum() - asked.sum()) <= quanta.max() * 1.001 + 1e-12
    proof = verify(old.text, text, profile(name))
    assert proof.identical_motion, (proof.difference, text)
    assert {change.kind for change in proof.other_changes} <= {"timing", "comment"}
    assert text.endswith(b"\n") == old.text.endswith(b"\n")
    crlf = old.text.count(b"\r\n") == old.text.count(b"\n")
    assert text.count(b"\r") == (text.count(b"\n") if crlf else 0)
    return new


POSSIBLE = [
    (name, old, new)
    for name, style in STYLES.items()
    for old, new in CHANGES
    if style.inverse or "inverse" not in {old, new}
]


# Every form in some dialects, some forms in every dialect.
ALL = [
    (*each, form)
    for each in POSSIBLE
    for form in FORMS
    if each[0] in {"rs274", "haas", "twincat-cnc"} or form in {"crlf", "inch", "leads", "numbered"}
]


@pytest.mark.one_of_each
@pytest.mark.parametrize(("name", "before", "after", "form"), ALL, ids=map("-".join, ALL))
def test_there_and_back(name: str, before: Encoding, after: Encoding, form: str) -> None:
    old = formats.read(profile(name), written(name, before, FORMS[form]), "old.nc")
    assert (old.encoding, old.n) == (before, 9 + (before != "dwell" and FORMS[form].leads) * 2)
    asked = np.random.default_rng(2).uniform(0.06, 7, old.n)
    new = recoded(name, old, asked, after, leads=int(before == "dwell" and FORMS[form].leads))
    recoded(name, new, np.random.default_rng(3).uniform(0.06, 7, new.n), before)


def test_leads_keep_their_times() -> None:
    """Moves that were no points take as long as before; then they are points."""
    old = formats.read(profile("rs274"), b"G21 G90\nG0 X0 Y0 Z0\nG1 Z-3 F60\nX2\nG4 P1\nX4\nG4 P1\nZ3 F120\nM2\n", "o")
    encodings: list[Encoding] = ["feed", "inverse"]
    for encoding in encodings:
        text = formats.rewrite(profile("rs274"), old, np.array([0.5, 0.25]), encoding)
        new = formats.read(profile("rs274"), text, "n")
        np.testing.assert_allclose(new.time_s, [3.0, 0.5, 0.25, 3.0], rtol=1e-4)
        assert verify(old.text, text, profile("rs274")).identical_motion


# What comes out, byte for byte.

HEAD = "G21 G90\nG0 X0 Y0 Z0\n"
EXACT = [
    ("dwell", "feed", "G1 X1 F60\nG4 P1\nX3\nG4 P1\n", [2, 4], "G1 X1 F30\nX3 F30\n"),
    ("dwell", "inverse", "G1 X1 F60\nG4 P1\nX3\nG4 P1\n", [2, 4], "G93\nG1 X1 F30\nX3 F15\n"),
    ("feed", "dwell", "G1 X1 F60\nX3\n", [0.5, 2], "G1 X1 F60\nG4 P0.5\nX3\nG4 P2.\n"),
    ("feed", "inverse", "G1 X1 F60\nX3\n", [0.5, 2], "G93\nG1 X1 F120\nX3 F30\n"),
    ("feed", "inverse", "G94\nG1 X1 F60\nX3\n", [0.5, 2], "G93\nG1 X1 F120\nX3 F30\n"),
    ("feed", "inverse", "G1 G94 X1 F60.0\nX3\n", [0.5, 2], "G1 G93 X1 F120.0\nX3 F30.0\n"),
    ("inverse", "feed", "G93\nG1 X1 F60\nX3 F60\n", [0.5, 2], "G94\nG1 X1 F120\nX3 F60\n"),
    ("inverse", "dwell", "G93\nG1 X1 F60\nX3 F60\n", [0.5, 2], "G93\nG1 X1 F60\nG4 P0.5\nX3 F60\nG4 P2.\n"),
    ("feed", "dwell", "G1 X1 F60 (a) ; b\nX3 ;\n", [0.5, 2], "G1 X1 F60 (a) ; b\nG4 P0.5\nX3 ;\nG4 P2.\n"),
    ("feed", "inverse", "g1 x1 f60 (a)\nx3 ; b\n", [0.5, 2], "G93\ng1 x1 f120 (a)\nx3 f30 ; b\n"),
    ("feed", "dwell", "G1 X1 F60\n\n(x)\nX3\n", [0, 2], "G1 X1 F60\nG4 P0.\n\n(x)\nX3\nG4 P2.\n"),
    ("inverse", "dwell", "G93\nG1 A5 F60\n", [2], "G93\nG1 A5 F60\nG4 P2.\n"),
    ("dwell", "inverse", "G93\nG1 X1 F60\nG4 P1\nX3 F60\nG4 P2\n", [2, 1], "G93\nG1 X1 F30\nX3 F60\n"),
    ("dwell", "feed", "G93\nG1 X1 F60\nG4 P1\nX3 F60\nG4 P2\n", [2, 1], "G94\nG1 X1 F30\nX3 F120\n"),
    ("dwell", "feed", "G1 X1 F60\n(p) N7 P1 G4 ; c\nX3\ng 4 p 0 . 5\n", [2, 4], "G1 X1 F30\nX3 F30\n"),
    ("dwell", "feed", "G4 P9\nG1 X1 F60\nG4 P1\nG0 Z5\nG4 P7\n", [2], "G4 P9\nG1 X1 F30\nG0 Z5\nG4 P7\n"),
]


@pytest.mark.parametrize(("before", "after", "body", "asked", "expected"), EXACT)
def test_written(before: str, after: Encoding, body: str, asked: list[float], expected: str) -> None:
    head = HEAD.replace("X0", "X0 A0") if "A5" in body else HEAD
    old = formats.read(profile("rs274"), (head + body + "M2\n").encode(), "old.nc")
    assert old.encoding == before
    new = formats.rewrite(profile("rs274"), old, np.array(asked, dtype=float), after).decode()
    assert new == head + expected + "M2\n"


@pytest.mark.parametrize(
    ("name", "head", "block"),
    [
        ("rs274", "G21 G90\n", "G4 P1.5\n"),
        ("fanuc", "G21 G90\n", "G4 X1.5\n"),
        ("haas", "G21 G90\n", "G4 P1.5\n"),
        ("siemens", "G71 G90\n", "G4 F1.5\n"),
        ("siemens-iso", "G21 G90\n", "G4 X1.5\n"),
        ("twincat-nci", "G71 G90\n", "G4 X1.5\n"),
        ("twincat-cnc", "G71 G90\n", "G04 X1.5\n"),
        ("grbl", "G21 G90\n", "G4 P1.5\n"),
        ("weihong", "G21 G90\n", "G4 P1500\n"),
        ("codesys", "G90\n", "G4 T1.5\n"),
    ],
)
def test_the_dwell_block_of_each_dialect(name: str, head: str, block: str) -> None:
    """Never a factor of 1000."""
    text = f"{head}G0 X0. Y0. Z0.\nG1 X5. F60.\nM30\n"
    old = formats.read(profile(name), text.encode(), "old.nc")
    assert formats.rewrite(profile(name), old, np.array([1.5]), "dwell").decode() == text.replace("M30", block + "M30")


def test_inverse_time_in_seconds() -> None:
    """TwinCAT CNC's G93 F20 is twenty seconds."""
    old = formats.read(profile("twincat-cnc"), b"G71 G90\nG0 X0 Y0 Z0\nG1 X5 F60\nX7\nM30\n", "old.nc")
    new = formats.rewrite(profile("twincat-cnc"), old, np.array([20.0, 0.125]), "inverse")
    assert new == b"G71 G90\nG0 X0 Y0 Z0\nG93\nG1 X5 F20\nX7 F0.125\nM30\n"


# What cannot be said otherwise.

REFUSED = [
    ("rs274", "inverse", "G93\nG1 A5 F60\n", "feed", 4, "turns on the spot"),
    ("rs274", "turned dwell", "G1 A5 F60\nG4 P1\nX1\nG4 P2\n", "feed", 3, "turns on the spot"),
    ("rs274", "arc", "G1 X1 F60\nG4 P1\nG2 X2 I0.5\nG4 P1\n", "feed", 5, "an arc"),
    ("rs274", "arc", "G1 X1 F60\nG4 P1\nG2 X2 I0.5\nG4 P1\n", "inverse", 5, "an arc"),
    ("rs274", "arc to", "G93 G1 X1 F60\nG4 P1\nG2 X2 I0.5 F9\nG4 P1\n", "feed", 5, "an arc"),
    ("rs274", "M2 in the block", "G1 X1 F60\nX2 M2\n", "dwell", 4, "ends in a point's block"),
    ("rs274", "M2 in the dwell", "G1 X1 F60\nG4 P1 M2\n", "feed", 4, "contains other words"),
    ("rs274", "coolant", "G1 X1 F60\nG4 P1 M8\n", "feed", 4, "contains other words"),
    ("rs274", "coolant", "G1 X1 F60\nG4 P1\nG1 X2\nG4 P1 M 8\n", "inverse", 6, "contains other words"),
    ("rs274", "incremental", "G1 X1 F60\nG4 G91 P1\nX1\nG4 P1\n", "feed", 4, "contains other words"),
    ("rs274", "plane", "G1 X1 F60\nG18 G4 P1\n", "feed", 4, "contains other words"),
    ("rs274", "inch", "G1 X1 F60\nG20 G4 P1\nX1 F3\nG4 P2\n", "inverse", 4, "contains other words"),
    ("rs274", "rapid", "G1 X1 F60\nG0 G4 P1\nX1\n", "feed", 4, "contains other words"),
    ("rs274", "still", "G1 X0 F60\nX1\nG4 P1\nX2\nG4 P1\n", "inverse", 3, "goes nowhere"),
    ("rs274", "still point", "G1 X1 F60\nG4 P1\nX1\nG4 P2\n", "inverse", 5, "goes nowhere"),
    ("rs274", "still point", "G1 X1 F60\nG4 P1\nX1\nG4 P2\n", "feed", 5, "goes nowhere|on the spot"),
    ("rs274", "still feed", "G1 X1 F60\nX1\nX2\n", "inverse", 4, "goes nowhere"),
    ("rs274", "no start", "G53 G0 Z0\nG1 X1 Z1 F60\nG4 P1\n", "feed", 4, "unknown|not stated"),
    ("rs274", "no start", "G53 G0 Z0\nG1 X1 Z1 F60\nG4 P1\n", "inverse", 4, "unknown|not stated"),
    ("weihong", "no G93", "G1 X1. F60.\nG4 P1\n", "inverse", 0, "no inverse time"),
    ("twincat-nci", "no G93", "G1 X1. F60.\nG4 X1\n", "inverse", 0, "no inverse time"),
    ("codesys", "no G93", "G1 X1. F1.\nG4 T1\n", "inverse", 0, "no inverse time"),
    ("fanuc", "no points", "G1 X1 F60.\nG4 X1.\n", "feed", 3, "positions without a decimal point"),
    ("haas", "no points in F", "G1 X1. F60\nG4 P1.\n", "feed", 3, "the unit of F"),
    ("grbl", "long", f"G1 X1.0000 Y1.0000 ({'x' * 56})\nG4 P1.0\n", "feed", 4, "longer"),
]


@pytest.mark.parametrize(("name", "what", "body", "after", "line", "why"), REFUSED)
def test_refused(name: str, what: str, body: str, after: Encoding, line: int, why: str) -> None:
    assert what
    units = STYLES[name].units
    head = f"{units} G90\nG0 X0. Y0. Z0.{' A0.' if 'A5' in body else ''}{chr(10) + 'F50.' if what == 'long' else ''}\n"
    old = formats.read(profile(name), (head + body + f"{STYLES[name].end}\n").encode(), "old.nc")
    with pytest.raises(ProgramError) as caught:
        formats.rewrite(profile(name), old, np.full(old.n, 0.75), after)
    message = str(caught.value)
    assert re.match(r"old\.nc, line \d+: " if line else r"old\.nc: ", message), message
    assert re.search(why, message), message
    assert "To do: " in message
    if line:
        assert f"line {line}:" in message, message


@pytest.mark.parametrize(
    ("after", "times", "why"),
    [
        ("feed", [1.0, 0.0], "line 6: a time of 0"),
        ("inverse", [-1.0, 1.0], "line 4: a time of -1"),
        ("feed", [1.0, np.nan], "line 6: a time of nan"),
        ("inverse", [np.inf, 1.0], "line 4: a time of inf"),
        ("feed", [1.0], "2 points need as many times"),
        ("feed", [1.0, 2.0, 3.0], "2 points need as many times"),
    ],
)
def test_times_that_cannot_be_written(after: Encoding, times: list[float], why: str) -> None:
    old = formats.read(profile("rs274"), (HEAD + "G1 X1 F60\nG4 P1\nX3\nG4 P1\nM2\n").encode(), "old.nc")
    with pytest.raises(ProgramError, match=why):
        formats.rewrite(profile("rs274"), old, np.array(times), after)


@pytest.mark.parametrize(("after", "time_s"), [("feed", 1e9), ("inverse", 1e9)])
def test_a_time_that_the_digits_cannot_hold(after: Encoding, time_s: float) -> None:
    """The smallest feed that can be written would be another time by far: refused, not written."""
    old = formats.read(profile("rs274"), (HEAD + "G1 X1 F60\nG4 P1\nM2\n").encode(), "old.nc")
    with pytest.raises(ProgramError, match=r"line [34]"):
        formats.rewrite(profile("rs274"), old, np.array([time_s]), after)


def test_a_language_without_times_of_moves_keeps_its_waits() -> None:
    waits = cast(LanguageProfile, dialect("urscript")).model_copy(update={"move_time": None})
    old = formats.read(waits, b"def m():\n  movel(p[0,0,0,0,3,0])\n  sleep(1)\nend\n", "old.script")
    with pytest.raises(ProgramError, match="in urscript time sits in dwells"):
        formats.rewrite(waits, old, np.array([1.0]), "feed")


# LinuxCNC says the same of them.


def random_program(encoding: Encoding, seed: int, n: int) -> bytes:
    """Five axes, steps of all lengths, modal F; every number in another style."""
    rng = np.random.default_rng(seed)
    places = np.cumsum((rng.uniform(0.2, 2, (n, 3)) * rng.choice([1, -1], (n, 3))) * rng.choice([5, 1], (n, 1)), axis=0)
    lines = ["G21 G90" if seed % 2 else "G20 G90", "G0 X0 Y0 Z0 A0 C0", "G93" if encoding == "inverse" else "F200"]
    lines += ["G1 Z-1 F30", "G1 Z1 F30"] if encoding == "dwell" else []
    for index, (x, y, z) in enumerate(places):
        place = f"X{x:.3f} Y{y:.4f} Z{z:.5f} A{index % 30} C{index % 360}.25"
        own = encoding == "inverse" or index % 4 == 0
        lines.append(f"G1 {place}" + (f" F{rng.uniform(1, 900):.{index % 4}f}" if own else ""))
        lines[-1] = (lines[-1] + " (G4 P9)", lines[-1].lower(), lines[-1] + " ; F9")[index % 3]
        if encoding == "dwell":
            lines.append(("G4 P{:.3f}", "P{:.2f} g4", "g 4 p {:.1f} (x)")[index % 3].format(rng.uniform(0, 5)))
    return "\n".join([*lines, "G0 Z90", "M2", ""]).encode()


@pytest.mark.one_of_each
@pytest.mark.skipif(NO_RS274, reason="no rs274 (LinuxCNC) on this machine")
@pytest.mark.parametrize("seed", [0, 1], ids=["inch", "mm"])
@pytest.mark.parametrize(("before", "after"), CHANGES)
def test_linuxcnc_agrees(before: Encoding, after: Encoding, seed: int) -> None:
    old = formats.read(profile("rs274"), random_program(before, seed, 400), "old.nc")
    asked = np.random.default_rng(seed).uniform(0.02, 2, old.n)
    text = formats.rewrite(profile("rs274"), old, asked, after)
    new = formats.read(profile("rs274"), text, "new.nc")
    points = slice(2, None) if before == "dwell" else slice(None)  # two moves lead in
    quanta = quanta_s(new, text, new.time_s)[points]
    assert (np.abs(new.time_s[points] - asked) <= quanta * 1.001).all()
    proof = verify(old.text, text, profile("rs274"), with_rs274=True)
    assert proof.identical_motion, proof.difference
    assert any(said.startswith("LinuxCNC: ") for said in proof.proved_by)


@pytest.mark.skipif(NO_RS274, reason="no rs274 (LinuxCNC) on this machine")
def test_linuxcnc_has_a_slowest_inverse_time() -> None:
    """It moves 0.1 units/min at least, whatever G93 says: the proof finds it."""
    old = formats.read(profile("rs274"), b"G20 G90 G94\nG0 X0 Y0 Z0\nG1 X1 F10\nX1.004\nM2\n", "old.nc")
    text = formats.rewrite(profile("rs274"), old, np.array([6.0, 6.0]), "inverse")
    assert verify(old.text, text, profile("rs274")).identical_motion
    proof = verify(old.text, text, profile("rs274"), with_rs274=True)
    assert "new, line 4: polishd reads 6 s, LinuxCNC 2.4 s" in (proof.difference or "")


def test_a_time_of_each_block_is_inverse_time_in_nc_text() -> None:
    old = formats.read(profile("rs274"), b"G21 G90 G94\nG0 X0 Y0 Z0\nG1 X1 F60\nG1 X2\nM2\n", "p.rnc")
    new = formats.rewrite(dialect("rs274"), old, np.array([2.0, 0.5]), "time")
    found = formats.read(profile("rs274"), new, "n.rnc")
    assert (found.encoding, found.time_s.tolist()) == ("inverse", [2.0, 0.5])
