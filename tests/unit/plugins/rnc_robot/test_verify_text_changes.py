"""Which lines differ in more than their time: every one is found, and its kind is right or the strict one."""

from __future__ import annotations

import re

import numpy as np
import pytest

from polishd.plugins.rnc_robot.verify import ChangeRules, LineChange, changes, skeleton

SAME = ChangeRules(("()", ";"), encoding_changed=False)
MOVED = ChangeRules(("()", ";"), encoding_changed=True)
BASE = "G0 X0\nG1 X1 F<60>\nG1 X2 F<70>\nM2\n"


def marked(text: str) -> tuple[bytes, np.ndarray]:
    """Text with ``<...>`` around numbers that carry time, and their spans once the marks are gone."""
    spans, plain, at = [], "", 0
    for match in re.finditer(r"<([^<>]*)>", text):
        plain += text[at : match.start()]
        spans.append([len(plain), len(plain) + len(match[1])])
        plain += match[1]
        at = match.end()
    return (plain + text[at:]).encode(), np.array(spans, dtype=np.int64).reshape(-1, 2)


def found(old: str, new: str, rules: ChangeRules = SAME) -> list[LineChange]:
    (before, here), (after, there) = marked(old), marked(new)
    return list(changes(before, after, here, there, rules))


def kinds(old: str, new: str, rules: ChangeRules = SAME) -> list[tuple[str, int | None, int | None]]:
    return [(change.kind, change.old_line, change.new_line) for change in found(old, new, rules)]


def test_the_skeleton_is_the_text_without_its_times() -> None:
    assert skeleton(*marked("G1 F<60>\nX<1>")) == b"G1 F\0\nX\0"
    assert skeleton(*marked("G1")) == b"G1"


@pytest.mark.parametrize("number", ["60", "0.5", "", "1234567.89"])
def test_times_are_no_change(number: str) -> None:
    assert found(BASE, BASE.replace("60", number)) == []


@pytest.mark.parametrize(
    ("old", "new", "kind"),
    [
        ("X1", "X9", "other"),
        ("X1", "X1.", "other"),
        ("X1", "x1", "other"),
        ("G1 X1", "G0 X1", "other"),
        ("G1 X1", "S9 G1 X1", "other"),
        ("G1 X1", "G1  X1", "other"),
        ("G1 X1", " G1 X1", "other"),
        ("G1 X1 F<60>", "G1 X1", "timing"),
        ("G1 X1 F<60>", "G1 X1 (why) F<60>", "timing"),
        ("G1 X1 F<60>", "G1 X1 F<60> (why)", "comment"),
        ("G1 X1 F<60>", "G1 X1 F<60> ; why", "comment"),
        ("G1 X1 F<60>", "G1 X1 F<60>\r", "comment"),
        ("G1 X1 F<60>", "G1 X1 F60", "other"),
        ("G1 X1 F<60>", "G1 X1 F<60> M5", "other"),
        ("G1 X1 F<60>", "G93 G1 X1 F<60>", "other"),
        ("M2", "M30", "other"),
        ("M2", "M2 )", "other"),
    ],
)
def test_a_changed_line(old: str, new: str, kind: str) -> None:
    line = next(number for number, text in enumerate(BASE.split("\n"), 1) if old in text)
    for one, other in ((BASE, BASE.replace(old, new)), (BASE.replace(old, new), BASE)):
        assert kinds(one, other) == [(kind, line, line)]


def test_a_line_that_became_blank_is_other() -> None:
    assert ("other", 2, None) in kinds(BASE, BASE.replace("G1 X1 F<60>", ""))


def test_a_line_end_that_is_missing_is_listed() -> None:
    assert kinds(BASE, BASE.removesuffix("\n")) == [("comment", 4, 4)]


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    ("line", "same", "moved"),
    [
        ("(polishd was here)", "comment", "comment"),
        ("", "comment", "comment"),
        ("; G1 X9", "comment", "comment"),
        ("F<9>", "timing", "timing"),
        ("F9", "other", "timing"),
        ("G4 P<1>", "other", "timing"),
        ("g04p<1>", "other", "timing"),
        ("N5 G4 P <0.5>", "other", "timing"),
        ("G4 P1", "other", "other"),
        ("P<1> G4", "other", "timing"),
        ("G4 X<1.>;", "other", "timing"),
        ("G4 TIME=<1>", "other", "timing"),
        ("G04 <3.0>", "other", "timing"),
        ("#TIME <2.5>", "other", "timing"),
        ("#TIME 2.5", "other", "other"),
        ("G93", "other", "timing"),
        ("G4 P<1> M5", "other", "other"),
        ("G4 P<1> X1", "other", "other"),
        ("G4.1 P<1>", "other", "other"),
        ("G40 P<1>", "other", "other"),
        ("G92", "other", "other"),
        ("G94.1", "other", "other"),
        ("FFWON", "other", "other"),
        ("SF9", "other", "other"),
        ("F", "other", "other"),
        ("M5", "other", "other"),
        ("X9", "other", "other"),
    ],
)
@pytest.mark.parametrize("at", [0, 1, 2, 4])
def test_a_line_that_comes_or_goes(line: str, same: str, moved: str, at: int) -> None:
    lines = BASE.splitlines()
    longer = "\n".join([*lines[:at], line, *lines[at:], ""])
    for rules, kind in ((SAME, same), (MOVED, moved)):
        assert kinds(BASE, longer, rules) == [(kind, None, at + 1)]
        assert kinds(longer, BASE, rules) == [(kind, at + 1, None)]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("G1 X1\nG4 P<1>\nG1 X2\nG4 P<2>\n", "G1 X1 F<60>\nG1 X2 F<30>\n"),
        ("G1 X1 F9\nG4 P<1>\nX2\nG4 P<2>\n", "G93\nG1 X1 F<60>\nX2 F<30>\nG94\n"),
        ("G1 X1 F<60>\nG1 X2 F<30>\n", "G93 G1 X1 F<60>\nG1 X2 F<30>\n"),
    ],
)
def test_a_change_of_encoding_is_timing_both_ways(old: str, new: str) -> None:
    for one, other in ((old, new), (new, old)):
        listed = kinds(one, other, MOVED)
        assert {kind for kind, *_ in listed} == {"timing"}
        assert any(kind == "other" for kind, *_ in kinds(one, other, SAME))


@pytest.mark.parametrize(
    ("one", "other"),
    [("G94.1 X1", "G93.1 X1"), ("SF9 X1", "SF8 X1"), ("FFWON X1", "FFWOF X1"), ("F9 X1 M3", "F9 X1 M5"), ("F", "FF")],
)
def test_what_only_looks_like_timing_is_other(one: str, other: str) -> None:
    assert {kind for kind, *_ in kinds(one + "\n", other + "\n", MOVED)} == {"other"}


@pytest.mark.parametrize("spoil", [("X2", "X3"), ("G1 X2", "G0 X2"), ("X2", "X2 M3"), ("G1 X1", "G1 Y1")])
def test_a_change_of_encoding_hides_nothing(spoil: tuple[str, str]) -> None:
    old = "G1 X1 F9\nG4 P<1>\nG1 X2\nG4 P<2>\nM2\n"
    new = "G1 X1 F<60>\nG1 X2 F<30>\nM2\n"
    assert "other" not in {kind for kind, *_ in kinds(old, new, MOVED)}
    assert "other" in {kind for kind, *_ in kinds(old, new.replace(*spoil), MOVED)}


def test_the_end_of_a_block_is_none_of_its_words() -> None:
    moved = ChangeRules(("()",), encoding_changed=True)
    assert kinds("G1 X1.;\nG4 X<1.> ;\n", "G1 X1. F<60.>;\n", moved) == [("timing", 1, 1), ("timing", 2, None)]


def test_comments_are_the_dialects_own() -> None:
    assert kinds("MoveL a;\n", "MoveL a; ! G4\n", ChangeRules(("!",), encoding_changed=False)) == [("comment", 1, 1)]
    assert kinds("movel(p1)\n", "movel(p2)\n", ChangeRules(("#",), encoding_changed=False)) == [("other", 1, 1)]
    assert kinds("a\n", "b\n", ChangeRules((), encoding_changed=False)) == [("other", 1, 1)]


def test_lines_meet_again_behind_what_was_put_in() -> None:
    old = "".join(f"G1 X{i}\n" for i in range(200))
    new = old.replace("G1 X50\n", "G1 X50\nM5\nM3\n").replace("G1 X120\n", "")
    assert kinds(old, new) == [("other", None, 52), ("other", None, 53), ("other", 121, None)]


def test_texts_that_have_nothing_in_common_end() -> None:
    old, new = "".join(f"X{i}\n" for i in range(300)), "".join(f"Y{i}\n" for i in range(200))
    listed = kinds(old, new)
    assert {kind for kind, *_ in listed} == {"other"}
    assert {line for _, line, _ in listed if line} == set(range(1, 301))
    assert {line for *_, line in listed if line} == set(range(1, 201))


def test_changes_read_well() -> None:
    assert [str(change) for change in found("G1 X1\nM2\n", "G1 X2\nM5\nM2\n")] == [
        'line 1 "G1 X1" became line 1 "G1 X2"',
        'line 2 was added: "M5"',
    ]
    assert str(found("A\nM5\n", "A\n")[0]) == 'line 2 was removed: "M5"'
    none = np.zeros((0, 2), dtype=np.int64)
    (change,) = changes(b"\tX\xff\r\n", b"X\n", none, none, SAME)
    assert str(change) == 'line 1 "X\\xff\\r" became line 1 "X"'
