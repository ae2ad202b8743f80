"""The project itself keeps the rules: `make check`. That the rules can fail is shown in test_rules.py."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.arch import code_rules, repository_rules
from tests.arch.source import Rule, forget
from tests.arch.words import plain_words

ROOT = Path(__file__).resolve().parents[2]
# Cells, studies, profiles; the simulator's own config is loaded by tests/system/test_sim_cell.py.
EXAMPLES = sorted(
    path for path in (ROOT / "examples").rglob("*.toml") if path.name not in ("pyproject.toml", "sim.toml")
)


@pytest.fixture(autouse=True, scope="module")
def _parsed_for_these_alone() -> Iterator[None]:
    yield
    forget()


@pytest.mark.full
@pytest.mark.parametrize(
    "rule", [*code_rules.RULES, *repository_rules.RULES, plain_words], ids=lambda rule: rule.__name__
)
def test_the_tree_keeps(rule: Rule) -> None:
    broken = rule(ROOT)
    assert not broken, "\n".join([str(rule.__doc__), *broken])


@pytest.mark.full
def test_the_layers_hold() -> None:
    """The contracts are in pyproject.toml; a breach fails with the linter's own message."""
    linter = [str(Path(sys.executable).with_name("lint-imports")), "--no-logo", "--no-cache"]
    result = subprocess.run(linter, cwd=ROOT, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout + result.stderr


def test_there_are_examples() -> None:
    assert EXAMPLES


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_the_example_loads(path: Path) -> None:
    from polishd.config.cell import load_config  # not at the top: the rules should run while this does not
    from polishd.config.device_profile_checks import load_device_profile
    from polishd.config.instrument_profile import load_profile
    from polishd.config.job_file import JobFile
    from polishd.config.study import load_scenario
    from polishd.config.sweep import load_swept

    keys = tomllib.loads(path.read_text()).keys()
    if path.name == "job.toml":
        JobFile.read(path).laid_over(load_config(path.with_name("cell.toml")))
        return
    if {"modbus", "lines"} & keys:
        load_device_profile(path)
        return
    if "what" in keys:
        load_scenario(path)
        return
    load = load_swept if "kind" in keys else load_profile if "artefact" in keys else load_config
    load(path)
