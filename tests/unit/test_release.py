"""What a release needs: one version everywhere, the same hashes twice, files of the forge, a valid Containerfile."""

from __future__ import annotations

import re
import subprocess
import tomllib
from pathlib import Path

import pytest

import polishd
from tests.release import dist, image

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
CHANGELOG = (ROOT / "CHANGELOG.md").read_text()


def test_the_version_is_the_same_everywhere() -> None:
    version = PROJECT["version"]
    assert polishd.__version__ == version
    assert re.search(r"^version: (.*)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)[1] == version  # type: ignore[index]
    assert f'"polishd {version}"' in (ROOT / "docs" / "polishd.1").read_text()
    assert re.findall(r"^## \[?([\d.]+)", CHANGELOG, re.MULTILINE)[0] == version


def test_the_changelog_has_three_releases_newest_first_with_dates() -> None:
    found = re.findall(r"^## ([\d.]+) - (20\d\d-\d\d-\d\d)$", CHANGELOG, re.MULTILINE)
    assert [version for version, _ in found] == ["1.0.0", "0.2.0", "0.1.0"]
    assert sorted((date for _, date in found), reverse=True) == [date for _, date in found]
    assert f"date-released: {found[0][1]}" in (ROOT / "CITATION.cff").read_text()
    assert len(CHANGELOG.splitlines()) <= 400


def test_the_citation_has_what_its_format_requires() -> None:
    keys = set(re.findall(r"^([a-z-]+):", (ROOT / "CITATION.cff").read_text(), re.MULTILINE))
    assert {"cff-version", "message", "title", "authors", "version", "date-released", "license"} <= keys


@pytest.mark.full
def test_two_builds_are_the_same_to_the_byte(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1600000000")
    first, second = dist.build(tmp_path / "a"), dist.build(tmp_path / "b")
    assert len(first) == 2
    assert first == second
    assert dist.problems_of(tmp_path / "a") == []
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1600000100")
    assert dist.build(tmp_path / "c") != first


def test_the_hooks_before_a_commit_are_local_and_their_tools_are_locked() -> None:
    text = (ROOT / ".pre-commit-config.yaml").read_text()
    assert re.findall(r"repo: (\S+)", text) == ["local"]
    locked = (ROOT / "requirements.lock").read_text()
    tools = {"ruff": "ruff", "mypy": "mypy", "lint-imports": "import-linter", "python": "pytest"}
    for tool in re.findall(r"entry: \.venv/bin/(\S+)", text):
        assert f"\n{tools[tool]}==" in locked


def test_the_workflow_runs_the_check_of_this_repository() -> None:
    text = (ROOT / ".github" / "workflows" / "ci.yml").read_text()
    assert "run: .ci/run\n" in text
    for target in re.findall(r"run: make (\S+)", text):
        assert f"\n{target}:" in (ROOT / "Makefile").read_text()


def test_the_containerfile_can_be_built() -> None:
    assert list(image.problems((ROOT / "Containerfile").read_text())) == []


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        ("ENTRYPOINT [", "ENTRYPOINT /bin/sh -c [", "write CMD and ENTRYPOINT as lists"),
        ("USER polishd\n", "", "runs as root"),
        ("FROM ${BASE}\n", "FROM python:latest\n", "has no fixed version"),
        ("COPY polishd ", "COPY polished ", "there is no polished"),
        ("COPY polishd ", "COPY tests ", ".containerignore leaves out tests"),
        ("WORKDIR /cell", "WORKDIRS /cell", "'WORKDIRS' is no instruction"),
        ("--no-index --find-links /wheels hatchling", "--index-url http://a/ hatchling", "names a host"),
        ("ARG EXTRAS=all\n", "", "$EXTRAS is not declared"),
    ],
)
def test_a_mistake_in_it_is_found(old: str, new: str, fault: str) -> None:
    text = (ROOT / "Containerfile").read_text()
    assert old in text
    assert any(fault in each for each in image.problems(text.replace(old, new)))


def test_only_tested_python_versions_are_classified() -> None:
    """Those that the workflow runs, or whose record stands in docs/how-to/upgrade.md."""
    classified = {line.rpartition(" ")[2] for line in PROJECT["classifiers"] if re.search(r"Python :: 3\.\d", line)}
    tested = set(re.findall(r"CPython (3\.\d+)", (ROOT / "docs" / "how-to" / "upgrade.md").read_text()))
    assert classified == tested


def test_git_holds_no_built_file() -> None:
    tracked = subprocess.run(["git", "ls-files"], cwd=ROOT, check=True, capture_output=True, text=True).stdout.split()
    assert not [name for name in tracked if name.startswith(("dist/", "build/")) or name.endswith((".whl", ".tar.gz"))]
