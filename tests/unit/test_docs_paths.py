"""Pages that source, tests, examples and the root's pages name are there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.arch.repository_rules import tracked_files

ROOT = Path(__file__).parents[2]
NAMED = re.compile(r"(?<![\w/.-])docs/[\w./-]+\.(?:md|jsonl|json|png|py|pml|lock|in)\b")
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


def test_the_readme_is_one_screen_and_keeps_its_two_commands() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.split()) < 400
    assert all(words in text for words in ("make demo", "make test", "pip install polishd", "pipx ", "uv tool "))
