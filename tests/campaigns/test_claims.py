"""Figures of README and docs against docs/data/claims.jsonl."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from tests.campaigns import result_files
from tests.campaigns.claims import Claim, machine, read, record, section_hash, uncovered, write

PAGE = "README.md"
SPEED = Claim(
    "speed",
    PAGE,
    ("polishd/fast",),
    "make bench",
    text="It takes {s} CPU s, the peer {peer} s.",
    figure={"s": "2.0", "peer": "5"},
)
TABLE = Claim("table", PAGE, ("polishd/fast",), "make table", section="make table")


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A project with one source and one page."""
    (tmp_path / "polishd/fast").mkdir(parents=True)
    (tmp_path / "polishd/fast/loop.py").write_text("FAST = True\n")
    (tmp_path / "docs/explanation").mkdir(parents=True)
    (tmp_path / PAGE).write_text(
        "It takes 2.0 CPU s, the peer 5 s.\n\n<!-- written by make table -->\n| 1 |\n<!-- end of it -->\n"
    )
    return tmp_path


def test_the_pages_have_the_figures_of_the_data() -> None:
    claims = read()
    assert len(claims) > 30
    assert [difference for one in claims for difference in one.differences()] == []
    assert uncovered(claims) == []


def test_a_figure_that_the_page_does_not_have_is_a_difference(root: Path) -> None:
    assert SPEED.differences(root) == []
    [said] = replace(SPEED, figure={"s": "2.1", "peer": "5"}).differences(root)
    assert said.startswith(f"{PAGE}: it does not contain 'It takes 2.1 CPU s, the peer 5 s.'")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"page": "nowhere.md"}, "there is no nowhere.md"),
        ({"scope": ("polishd/fast/loop.py",)}, "scope polishd/fast/loop.py is no folder"),
        ({"figure": {"s": "2.0"}}, "'peer' of its text is no figure"),
        ({"text": ""}, "give either text or section"),
        ({"section": "make table"}, "give either text or section"),
    ],
)
def test_a_wrong_record_is_a_difference(root: Path, change: dict[str, object], said: str) -> None:
    assert said in replace(SPEED, **change).differences(root)[0]  # type: ignore[arg-type]


def test_a_recorded_measurement_changes_the_page_and_is_fresh_until_a_source_changes(root: Path) -> None:
    [new, _] = record([SPEED, TABLE], "speed", {"s": "1.5"}, root)
    assert "It takes 1.5 CPU s, the peer 5 s." in (root / PAGE).read_text()
    assert new.is_fresh(root)
    assert not SPEED.is_fresh(root)
    assert (new.date, new.machine) == (result_files.today(), machine())
    (root / "polishd/fast/loop.py").write_text("FAST = False\n")
    assert not new.is_fresh(root)


def test_a_table_that_was_changed_by_hand_is_a_difference(root: Path) -> None:
    [new] = record([TABLE], "table", {}, root)
    assert new.differences(root) == []
    page = (root / PAGE).read_text()
    (root / PAGE).write_text(page.replace("| 1 |", "| 2 |"))
    assert "the part written by make table differs from the data" in new.differences(root)[0]
    assert section_hash(page, "make nothing") is None


@pytest.mark.parametrize(
    ("name", "figures", "said"),
    [("none", {}, "there is no claim none"), ("speed", {"x": "1"}, "speed has no figure x")],
)
def test_an_unknown_claim_or_figure_is_refused(root: Path, name: str, figures: dict[str, str], said: str) -> None:
    before = (root / PAGE).read_text()
    with pytest.raises(ValueError, match=said):
        record([SPEED], name, figures, root)
    assert (root / PAGE).read_text() == before


def test_a_measured_figure_without_a_claim_is_named_with_its_line(root: Path) -> None:
    (root / PAGE).write_text("It takes 2.0 CPU s, the peer 5 s.\n\n24 times as fast as the peer\n")
    assert uncovered([SPEED], root) == [
        "README.md:3: a measured figure without a claim. Add it to docs/data/claims.jsonl."
    ]


def test_records_are_kept_as_they_are_read(tmp_path: Path) -> None:
    path = tmp_path / "claims.jsonl"
    write([SPEED, TABLE], path)
    assert read(path) == [SPEED, TABLE]
    path.write_text(path.read_text() * 2)
    with pytest.raises(ValueError, match=r"claims.jsonl:3: speed is there twice"):
        read(path)
    path.write_text(json.dumps({"claim": "x"}) + "\n")
    with pytest.raises(ValueError, match=r"claims.jsonl:1: 'scope'"):
        read(path)


SOURCE = '''"""Read a speed."""

LIMIT = "# 5"
"""In mm/s."""


def speed(text: str) -> float:
    """Return the speed.

    In mm/s.
    """
    first = text.split("#")[0]  # what follows is a note

    # Blanks are allowed.
    return float(first)
'''


@pytest.mark.parametrize(
    ("old", "new", "same"),
    [
        ("Read a speed.", 'Read a speed of # 3, or of "none".', True),
        ('"""In mm/s."""\n', "", True),
        ("\n\n    In mm/s.\n    ", "", True),
        ("  # what follows is a note", "", True),
        ("    # Blanks are allowed.\n", "    # Blanks are allowed, and tabs.\n    # That's all.\n", True),
        ('"# 5"', '"# 6"', False),
        ('"#")[0]', '"#")[1]', False),
        ("    return float", "    return -float", False),
        ("float(first)", "2.0", False),
    ],
)
def test_another_code_makes_a_measurement_old_and_a_better_explanation_does_not(
    root: Path, old: str, new: str, same: bool
) -> None:
    loop = root / "polishd/fast/loop.py"
    loop.write_text(SOURCE)
    measured = result_files.sources(["polishd"], root)
    assert old in SOURCE
    loop.write_text(SOURCE.replace(old, new))
    assert (result_files.sources(["polishd"], root) == measured) is same
