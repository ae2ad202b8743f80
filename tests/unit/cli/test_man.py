"""The man page and docs/reference/cli.md are the command line's own: every verb and option, and no other."""

from __future__ import annotations

import shutil
import subprocess
import tomllib
from typing import Any

import pytest
import typer

from docs.reference import cli, man
from polishd.cli.app import app


def verbs(group: Any, path: str = "polishd") -> dict[str, Any]:
    found = {}
    for name, command in group.commands.items():
        inner = hasattr(command, "commands")
        found |= verbs(command, f"{path} {name}") if inner else {f"{path} {name}": command}
    return found


def test_it_is_written_anew_with_the_command_line() -> None:
    assert man.PAGE.read_text(encoding="utf-8") == man.page(), "make reference"


@pytest.mark.full
def test_the_page_of_the_site_is_written_anew_with_the_command_line() -> None:
    assert cli.PAGE.read_text(encoding="utf-8") == cli.page(), "make reference"
    assert all(f"\n## {name}\n" in cli.page() for name in verbs(typer.main.get_command(app)))


def test_it_has_every_verb_and_option() -> None:
    text = man.page().replace("\\-", "-")
    for name, command in verbs(typer.main.get_command(app)).items():
        assert f'.SS "{name}' in text, name
        _, _, after = text.partition(f'.SS "{name}')
        mine = after.partition(".SS")[0]
        for option in (option for param in command.params for option in param.opts if option.startswith("--")):
            assert option in mine or option == "--help", f"{name} {option}"


def test_its_examples_are_verbs_and_its_exit_codes_those_of_the_reference() -> None:
    known = {name.split()[1] for name in verbs(typer.main.get_command(app))}
    for line, _ in man.EXAMPLES:
        assert {part.split()[1] for part in line.split(" && ")} <= known
    codes = dict(man.exit_codes())
    assert (codes["0"], codes["2"], codes["130"]) == ("done", "usage", "Ctrl-C")


def test_the_wheel_installs_it() -> None:
    build = tomllib.loads((man.ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["build"]["targets"]
    assert build["wheel"]["shared-data"] == {"docs/polishd.1": "share/man/man1/polishd.1"}


@pytest.mark.skipif(shutil.which("groff") is None, reason="groff is not installed")
def test_groff_reads_it_without_a_word() -> None:
    said = subprocess.run(
        ["groff", "-man", "-Tutf8", "-Kutf8", "-ww", str(man.PAGE)], capture_output=True, text=True, check=False
    )
    assert (said.returncode, said.stderr) == (0, "")
    assert "the HTTP API of a cell" in " ".join(said.stdout.split())
