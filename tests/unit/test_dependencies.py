"""docs/reference/dependencies.md: its tables have the dependencies of pyproject.toml, with the locked versions."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

from polishd.util.extras import EXTRAS

ROOT = Path(__file__).parents[2]
PAGE = "\n" + (ROOT / "docs" / "reference" / "dependencies.md").read_text()
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
LOCKED = dict(re.findall(r"^([a-z0-9.-]+)==([^ ;\\]+)", (ROOT / "requirements.lock").read_text(), re.MULTILINE))


def rows(heading: str) -> list[list[str]]:
    """Cells of the first table below a heading, without its head."""
    below = PAGE.partition(f"\n{heading}\n")[2]
    table = re.search(r"((?:^\|.*\n)+)", below, re.MULTILINE)
    assert table is not None, heading
    return [[cell.strip() for cell in line.strip("|\n").split(" | ")] for line in table[1].splitlines()[2:]]


def name_of(requirement: str) -> str:
    found = re.match(r"[A-Za-z0-9._-]+", requirement)
    assert found is not None
    return found.group()


def test_the_core_is_listed() -> None:
    assert {row[0] for row in rows("## The core")} == {name_of(each) for each in PROJECT["dependencies"]}


def test_the_extras_are_listed() -> None:
    listed = {(row[0], row[1]) for row in rows("## Extras")}
    assert listed == {(library, extra) for extra, of in EXTRAS.items() for library in of.libraries}
    named = {name for row in rows("# Dependencies and size") for name in re.findall(r"`(\w+)`", row[0])}
    assert named == set(PROJECT["optional-dependencies"])


def test_the_versions_are_those_of_the_lock() -> None:
    for row in (*rows("## The core"), *rows("## Extras")):
        version, date = re.fullmatch(r"(\S+), (20\d\d-\d\d)", row[3]).groups()  # type: ignore[union-attr]
        assert LOCKED.get(row[0].lower(), version) == version, row[0]
        assert "2020-01" < date <= "2026-12"
        assert all(row), row
