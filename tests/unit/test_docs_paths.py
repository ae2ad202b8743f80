"""Pages that source, tests, examples and the root's pages name are there."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from polishd.config.renamed_keys import renamed_key
from tests.arch.repository_rules import tracked_files

ROOT = Path(__file__).parents[2]
NAMED = re.compile(r"(?<![\w/.-])docs/[\w./-]+\.(?:md|jsonl|json|png|py|pml|lock|in)\b")
TOML = re.compile(r"^```toml\n(.*?)^```", re.DOTALL | re.MULTILINE)
DOTTED = re.compile(r"`([a-z_]+(?:\.\w+)+)`")
LINK = re.compile(r"\]\(([^)#\s:]+)(?:#[^)]*)?\)")
SUFFIXES = {".py", ".toml", ".html", ".js", ".md", ".jinja", ".yml"}
OTHER_TREES = {"tests/arch/test_rules.py", "CHANGELOG.md"}
"""Files that name pages of an invented tree, or of earlier versions."""


def test_every_page_of_docs_that_a_file_names_is_there() -> None:
    missing = []
    for path in tracked_files(ROOT):
        name = path.relative_to(ROOT).as_posix()
        if (path.suffix in SUFFIXES or path.name in {"Makefile", "run"}) and name not in OTHER_TREES:
            text = path.read_text(encoding="utf-8", errors="replace")
            missing += [f"{name}: {one}" for one in NAMED.findall(text) if not (ROOT / one).exists()]
    assert not missing, "\n".join(missing)


@pytest.mark.parametrize("page", ["README.md", *(str(one.relative_to(ROOT)) for one in ROOT.glob("examples/**/*.md"))])
def test_links_outside_of_the_site_lead_to_files(page: str) -> None:
    """Links between pages of docs are checked by ``make docs``."""
    found = LINK.findall((ROOT / page).read_text(encoding="utf-8"))
    assert [one for one in found if not ((ROOT / page).parent / one).exists()] == []


def _leaves(table: dict[str, Any], before: str = "") -> Iterator[str]:
    for key, value in table.items():
        yield before + key
        for one in value if isinstance(value, list) else [value]:
            if isinstance(one, dict):
                yield from _leaves(one, f"{before}{key}.")


def test_no_page_shows_a_key_by_the_name_of_an_earlier_version() -> None:
    """In TOML blocks, and as `section.key` in the text; the page on upgrades and the decisions have the history."""
    old = []
    for path in ROOT.glob("docs/**/*.md"):
        if path.name == "upgrade.md" or path.parent.name == "decisions":
            continue
        text = path.read_text(encoding="utf-8")
        keys = [key for block in TOML.findall(text) for key in _leaves(tomllib.loads(block))]
        old += [f"{path.name}: {key}" for key in {*keys, *DOTTED.findall(text)} if renamed_key(key)]
    assert old == []


def test_the_readme_is_one_screen_and_keeps_its_two_commands() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.split()) < 400
    assert all(words in text for words in ("make demo", "make test", "pip install polishd", "pipx ", "uv tool "))
