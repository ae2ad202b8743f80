"""A program that polishd adds (touch-off, first touch) names the tool and the frame of the cell's own program."""

from __future__ import annotations

import numpy as np
import pytest

from polishd.api import ProgramError
from polishd.plugins.rnc_robot.dialect import DIALECTS
from polishd.plugins.rnc_robot.formats import made_like_shipped, make_shipped, shipped
from polishd.plugins.rnc_robot.languages import tool_and_frame
from polishd.plugins.rnc_robot.languages.profile import LanguageProfile

POINTS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
UP = np.tile([0.0, 0.0, 1.0], (3, 1))
LANGUAGES = [name for name in DIALECTS if isinstance(shipped(name), LanguageProfile) and shipped(name).make]  # type: ignore[union-attr]
OTHERS = {
    "rapid": ((b"tPolish", b"pad"), (b"wPart", b"glass")),
    "krl": ((b"TOOL_DATA[1]", b"TOOL_DATA[4]"), (b"BASE_DATA[1]", b"BASE_DATA[7]")),
    "fanuc-tp": (
        (b"UTOOL_NUM=1", b"UTOOL_NUM=4"),
        (b"UFRAME_NUM=1", b"UFRAME_NUM=7"),
        (b"UF : 1, UT : 1", b"UF : 7, UT : 4"),
    ),
    "val3": ((b"tPolish", b"tPad"),),
}
"""What another tool and another frame are in a made program."""


def program(language: str) -> bytes:
    text = make_shipped(language, POINTS, UP, 600.0, "own")
    for old, new in OTHERS[language]:
        assert old in text
        text = text.replace(old, new)
    return text


@pytest.mark.parametrize("language", OTHERS)
def test_tool_and_frame_are_those_of_the_cells_program(language: str) -> None:
    own = program(language)
    made = made_like_shipped(language, own, "own.mod").make
    assert made is not None
    text = made(POINTS[:2], UP[:2], 600.0, "touch-off")
    profile = shipped(language)
    assert isinstance(profile, LanguageProfile)
    assert tool_and_frame(profile, text, "made") == tool_and_frame(profile, own, "own")
    assert tool_and_frame(profile, text, "made") != tool_and_frame(
        profile, make_shipped(language, POINTS, UP, 600.0, "usual"), "usual"
    )


@pytest.mark.parametrize("language", LANGUAGES)
def test_a_made_program_is_like_itself(language: str) -> None:
    text = make_shipped(language, POINTS, UP, 600.0, "touch-off")
    made = made_like_shipped(language, text, "own").make
    assert made is not None
    assert made(POINTS, UP, 600.0, "touch-off").lower() == text.lower()  # a name is written as the language compares it


def test_a_rapid_move_without_a_work_object_is_in_the_base_frame() -> None:
    own = program("rapid").replace(b"\\WObj:=glass", b"")
    made = made_like_shipped("rapid", own, "own.mod").make
    assert made is not None
    assert b"pad\\WObj:=wobj0;" in made(POINTS, UP, 600.0, "touch-off")


def test_a_program_that_names_no_base_is_refused() -> None:
    own = b"".join(line for line in program("krl").splitlines(keepends=True) if b"BASE" not in line)
    with pytest.raises(ProgramError, match=r"name tool .*4.* and frame none"):
        made_like_shipped("krl", own, "own.src")


def test_nc_text_names_neither() -> None:
    text = make_shipped("rs274", POINTS, UP, 600.0, "own")
    made = made_like_shipped("rs274", text, "own").make
    assert made is not None
    assert made(POINTS, UP, 600.0, "own") == text
