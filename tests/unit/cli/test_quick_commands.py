"""Quick commands import nothing that they do not need, and read a cell's name and state folder as its models do."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from polishd.cli.status import CellSummary, cell_summary
from polishd.config.cell import load_config
from polishd.model.errors import ConfigError

EXAMPLE = Path(__file__).parents[3] / "examples" / "cell.toml"


def test_it_is_what_the_models_read(tmp_path: Path) -> None:
    config = load_config(EXAMPLE)
    assert cell_summary(EXAMPLE) == CellSummary(config.cell.name, config.state_dir)
    text = EXAMPLE.read_text()
    named = tmp_path / "cell.toml"
    named.write_text('include = ["names.toml", "where.toml"]\n' + text)
    (tmp_path / "names.toml").write_text('[cell]\nname = "other"\nstate_dir = "first"\n')
    (tmp_path / "where.toml").write_text('[cell]\nstate_dir = "~/second"\n')
    config = load_config(named)
    assert (
        cell_summary(named)
        == CellSummary(config.cell.name, config.state_dir)
        == CellSummary("other", Path.home() / "second")
    )


def test_other_mistakes_in_a_file_do_not_hide_its_daemon(tmp_path: Path) -> None:
    (tmp_path / "cell.toml").write_text('[cell]\nname = "bench"\nstate_dir = "state"\n[job]\nnonsense = 1\n')
    assert cell_summary(tmp_path / "cell.toml") == CellSummary("bench", tmp_path / "state")


@pytest.mark.parametrize(
    "text",
    ["[cell\n", "", "cell = 1\n", '[cell]\nname = "bench"\n', '[cell]\nname = 1\nstate_dir = "state"\n',
     "include = 1\n", 'include = ["none.toml"]\n[cell]\nname = "bench"\nstate_dir = "state"\n'],
)  # fmt: skip
def test_what_cannot_be_said_is_the_error_of_the_models(tmp_path: Path, text: str) -> None:
    (tmp_path / "cell.toml").write_text(text)
    with pytest.raises(ConfigError) as ours:
        cell_summary(tmp_path / "cell.toml")
    with pytest.raises(ConfigError) as theirs:
        load_config(tmp_path / "cell.toml")
    assert str(ours.value) == str(theirs.value)


def test_no_file(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        cell_summary(tmp_path / "none.toml")


HEAVY = ("numpy", "scipy", "numba", "matplotlib", "pymodbus", "can", "asyncio", "sqlite3", "starlette", "jinja2")
CELL = '[cell]\nname = "bench"\nstate_dir = "state"\n'
ASK = """
import json, sys
from polishd.cli.app import main
try:
    main()
except SystemExit:
    print(json.dumps(sorted(sys.modules)))
"""


def imported(*words: str | Path) -> set[str]:
    command = [sys.executable, "-c", ASK, *map(str, words)]
    said = subprocess.run(command, capture_output=True, text=True, check=True)
    return set(json.loads(said.stdout.splitlines()[-1]))


@pytest.mark.parametrize("verb", ["status", "hold", "stop", "resume"])
@pytest.mark.one_of_each
def test_asking_and_ordering_load_no_mathematics_and_no_models(tmp_path: Path, verb: str) -> None:
    (tmp_path / "cell.toml").write_text(CELL)
    found = imported(verb, tmp_path / "cell.toml")
    assert "polishd.cli.status" in found
    assert not found & set(HEAVY)
    assert not {
        name for name in found if name.startswith(("polishd.plugins", "polishd.drivers", "polishd.plugin_loader"))
    }
    assert not found & {"polishd.config.cell", "polishd.daemon.journal.journal", "polishd.model.events"}
