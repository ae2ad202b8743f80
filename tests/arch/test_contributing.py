"""Each example in docs/contributing applies to a copy of the tree, and the test that it brings passes there."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = ROOT / "docs" / "contributing"
NEEDED = ("polishd", "tests", "examples", "pyproject.toml")
"""Parts of the tree that a patch changes or its test needs."""
NOT_COPIED = shutil.ignore_patterns("data", "*.prof")
EXAMPLES = ("device", "map_format", "dwell_solver", "config_key", "report_figure")
MOST_PLACES = {"device": 0, "map_format": 1, "dwell_solver": 1, "config_key": 4, "report_figure": 1}
"""Files that a change of that kind edits, besides those that it adds."""


def patch_of(example: str) -> str:
    return (PAGES / "patches" / f"{example}.patch").read_text()


def files_of(patch: str) -> tuple[list[str], list[str]]:
    """(files that it adds, files that it edits)."""
    heads = re.findall(r"^diff --git a/(\S+) b/\S+\n(new file)?", patch, re.MULTILINE)
    return [name for name, new in heads if new], [name for name, new in heads if not new]


def test_each_example_has_a_page_and_a_patch() -> None:
    assert {path.stem for path in PAGES.glob("*.md")} - {"index"} == set(EXAMPLES)
    assert {path.stem for path in (PAGES / "patches").iterdir()} == set(EXAMPLES)


@pytest.mark.parametrize("example", EXAMPLES)
def test_a_change_touches_few_files_and_its_page_names_each(example: str) -> None:
    added, edited = files_of(patch_of(example))
    assert len(edited) <= MOST_PLACES[example], edited
    page = (PAGES / f"{example}.md").read_text()
    assert [name for name in (*added, *edited) if f"`{name}`" not in page] == []
    assert any(Path(name).name.startswith("test_") for name in added)


@pytest.mark.parametrize(
    "example", [name if name == "config_key" else pytest.param(name, marks=pytest.mark.full) for name in EXAMPLES]
)
def test_the_patch_applies_and_its_test_passes(example: str, tmp_path: Path) -> None:
    copy = tmp_path / "tree"
    copy.mkdir()
    for name in NEEDED:
        source = ROOT / name
        if source.is_dir():
            ignored = NOT_COPIED if name == "tests" else None
            shutil.copytree(source, copy / name, symlinks=True, ignore=ignored)
        else:
            shutil.copy2(source, copy / name)
    patch = patch_of(example)
    applied = subprocess.run(
        ["git", "apply", "--unidiff-zero", "-"], input=patch, cwd=copy, text=True, capture_output=True, check=False
    )
    assert applied.returncode == 0, applied.stderr
    tests = [name for name in files_of(patch)[0] if Path(name).name.startswith("test_")]
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", "not full", *tests]
    environment = {**os.environ, "PYTHONPATH": str(copy)}
    environment.pop("PYTEST_ADDOPTS", None)
    done = subprocess.run(command, cwd=copy, env=environment, text=True, capture_output=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.search(r"[1-9]\d* passed", done.stdout), done.stdout
