"""A key of before release 1.0 is refused with its new name."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest

from polishd.config.cell import load_config
from polishd.config.renamed_keys import RENAMED_KEYS, renamed_key
from polishd.config.simulator import load_simulator
from polishd.model.errors import ConfigError

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"

OF_CELL = {
    "[between]": "between: was renamed: write part_handling",
    "[memory]": "memory: was renamed: write estimates",
    '[process]\nlearns = "rate"': "process.learns: was renamed: write process.estimates",
    '[dwell]\nchoose = "least"': "dwell.choose: was renamed: write dwell.objective",
    "[limits]\npit_nm = 5.0": "limits.pit_nm: was renamed: write limits.max_stall_removal_nm",
    "[limits]\nforce_grace_s = 0.3": "limits.force_grace_s: was renamed: write limits.force_alarm_delay_s",
    '[part]\nrim = "free"': "part.rim: was renamed: write part.free_edge (true or false)",
    '[part_handling.clean]\nperson = "wipe"': "part_handling.clean.person: was renamed: write operator",
}


def with_section(text: str, lines: str) -> str:
    """The file's text with these lines at the start of their section, or at its end where it has no such section."""
    header, _, keys = lines.partition("\n")
    if f"\n{header}\n" not in text and f"\n{header} " not in text:
        return f"{text}\n{lines}\n"
    at = text.index("\n", text.index(f"\n{header}") + 1)
    return f"{text[:at]}\n{keys}{text[at:]}"


@pytest.mark.parametrize("lines", OF_CELL)
def test_a_cell_file_with_an_old_key_is_refused_with_the_new_one(tmp_path: Path, lines: str) -> None:
    path = tmp_path / "cell.toml"
    path.write_text(with_section((EXAMPLES / "cell.toml").read_text(), lines))
    with pytest.raises(ConfigError) as refused:
        load_config(path)
    assert OF_CELL[lines] in str(refused.value)


def test_a_simulator_file_with_an_old_key_is_refused_with_the_new_one(tmp_path: Path) -> None:
    (tmp_path / "cell.toml").write_text((EXAMPLES / "cell.toml").read_text())
    path = tmp_path / "sim.toml"
    path.write_text(with_section((EXAMPLES / "sim.toml").read_text(), "[truth]"))
    with pytest.raises(ConfigError, match="truth: was renamed: write hidden_truth"):
        load_simulator(path)


def test_no_example_has_an_old_key() -> None:
    for path in EXAMPLES.rglob("*.toml"):
        found = tomllib.loads(path.read_text())
        tables = [(name, value) for name, value in found.items() if isinstance(value, dict)]
        dotted = [*found, *(f"{name}.{key}" for name, table in tables for key in table)]
        assert not [key for key in dotted if renamed_key(key)], path


def test_no_new_name_is_an_old_one() -> None:
    assert not {new.split(" ")[0] for new in RENAMED_KEYS.values()} & set(RENAMED_KEYS)
