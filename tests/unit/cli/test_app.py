"""The workbench's command line, alone and with the commands of a cell."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from typer.main import get_command
from typer.testing import CliRunner

from polishd.cli import app
from polishd.cli.app import offline_app as workbench

EXAMPLE = Path(__file__).parents[3] / "examples" / "cell.toml"
VERBS = {"calibrate", "compliance", "device", "init", "map", "program", "study", "tif"}


def test_every_verb_of_the_workbench_is_a_verb_of_polishd() -> None:
    assert app._verbs(workbench) == VERBS
    assert app._verbs(app.app) == set(get_command(app.app).commands) > VERBS  # type: ignore[attr-defined]


def test_a_given_command_is_built_alone_and_is_the_same_as_among_all() -> None:
    """A group, a command of plugins and a misspelt one need all others, for lists and suggestions."""
    everything = app._commands(None)
    for command in app.app.registered_commands:
        name = app._name(command)
        alone, among = app._commands(name), everything.commands[name]
        assert list(alone.commands) == [name]
        assert [param.opts for param in alone.params] == [param.opts for param in everything.params]
        assert [param.opts for param in alone.commands[name].params] == [param.opts for param in among.params]
    for name in ("map", "tif", "chekc"):
        assert set(app._commands(name).commands) == set(everything.commands)


def test_it_helps_by_itself() -> None:
    said = CliRunner().invoke(workbench, ["--help"])
    assert said.exit_code == 0
    for verb in VERBS:
        assert verb in said.output


@pytest.mark.full
@pytest.mark.parametrize("words", [("map", "formats", "--json"), ("program", "dialects"), ("tif", str(EXAMPLE))])
def test_it_needs_no_daemon(words: tuple[str, ...]) -> None:
    """Nor the verbs of a cell: it can become a separate distribution."""
    code = (
        f"import atexit, sys\nsys.argv = ['polishd', *{words!r}]\n"
        "others = ('polishd.daemon', 'polishd.web', 'polishd.shop')\n"
        "atexit.register(lambda: print(*(name for name in others if name in sys.modules), file=sys.stderr))\n"
        "from polishd.cli.app import offline_app\noffline_app()"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, timeout=60)
    assert ended.stderr.decode().strip() == ""
    assert ended.stdout


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("status", "my cell.toml"), "polishd run 'my cell.toml'"),
        (("run", "--queue", "a.toml", "b.toml"), "polishd run a.toml"),
        (("map", "--cell", "a.toml", "map.dat"), "polishd run CELL.toml"),
        (("map", "commission", "profile.toml"), "polishd run CELL.toml"),
        (("study", "study.toml"), "polishd run CELL.toml"),
        (("certificate", "make", "cell.toml"), "polishd run cell.toml"),
        (("certificate", "make", "/"), "polishd run CELL.toml"),
    ],
)
def test_commands_of_messages_name_the_given_cell(
    monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], said: str
) -> None:
    monkeypatch.setattr(sys, "argv", ["polishd", *words])
    assert app._with_cell("polishd run CELL.toml") == said
