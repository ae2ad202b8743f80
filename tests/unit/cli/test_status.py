"""What people wait for at the terminal imports nothing that it does not need: which modules, not how many seconds."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

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
