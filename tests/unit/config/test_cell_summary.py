"""A cell's name and state folder are read as by its models, whose errors it raises."""

from __future__ import annotations

from pathlib import Path

import pytest

from polishd.config.cell import load_config
from polishd.config.cell_summary import CellSummary, cell_summary
from polishd.model.errors import ConfigError

CELL = Path(__file__).parents[3] / "examples" / "cell.toml"


def test_it_is_what_the_models_read(tmp_path: Path) -> None:
    config = load_config(CELL)
    assert cell_summary(CELL) == CellSummary(config.cell.name, config.state_dir)
    text = CELL.read_text()
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


def test_what_else_is_wrong_with_a_file_keeps_nobody_from_its_daemon(tmp_path: Path) -> None:
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
