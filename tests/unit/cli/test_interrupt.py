"""Ctrl-C at any moment ends ``polishd`` with exit code 130 and no traceback: in imports, at work, and in between."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
SCRIPT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]["polishd"]
START = """
import importlib.metadata, sys
sys.argv[0] = "polishd"
importlib.metadata.EntryPoint("polishd", sys.argv.pop(1), "console_scripts").load()()
"""
HOOK = """
import os, signal, sys

seen = [-1]

def interrupt(event, arguments):
    words = os.environ["INTERRUPT_AT"].split()
    if event == words[0] == "import":
        seen[0] += seen[0] >= 0 or arguments[0] == "typer"
        if seen[0] == int(words[1]):
            seen[0] = -1 << 30
            signal.raise_signal(signal.SIGINT)
    elif event == words[0] and str(arguments[0]).endswith(words[1]) and seen[0] > -2:
        seen[0] = -1 << 30
        Destroyed() if "destructor" in words else signal.raise_signal(signal.SIGINT)

class Destroyed:
    def __del__(self):
        signal.raise_signal(signal.SIGINT)

sys.addaudithook(interrupt)
"""


def interrupted(tmp_path: Path, at: str, *words: str) -> subprocess.CompletedProcess[str]:
    """``polishd`` as its script starts it, which is sent SIGINT at an event: ``import 40``, ``open map.npy``."""
    (tmp_path / "sitecustomize.py").write_text(HOOK)
    return subprocess.run(
        [sys.executable, "-c", START, SCRIPT, *words],
        env=os.environ | {"PYTHONPATH": f"{tmp_path}:{ROOT}", "INTERRUPT_AT": at},
        cwd=tmp_path, capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip


# Imports from typer's on, of about a thousand: the program's own, numpy's parts in C, and scipy's.
@pytest.mark.one_of_each
@pytest.mark.parametrize("number", [0, 20, 100, 250, 450, 700])
def test_in_the_imports(tmp_path: Path, number: int) -> None:
    ended = interrupted(tmp_path, f"import {number}", "check", str(ROOT / "examples" / "cell.toml"))
    assert ended.stderr == ""
    assert (ended.returncode, ended.stdout) == (130, "")


@pytest.mark.full
@pytest.mark.parametrize("place", ["", "destructor"])
def test_at_work(tmp_path: Path, place: str) -> None:
    """Python ignores, with a traceback, what is raised in a destructor."""
    (tmp_path / "map.csv").write_text("".join(f"{x} {y} 1\n" for x in range(300) for y in range(300)))
    ended = interrupted(tmp_path, f"open map.csv {place}", "map", "map.csv")
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, "", "")


@pytest.mark.full
def test_behind_nohup_it_is_ignored(tmp_path: Path) -> None:
    """Who started it with SIGINT ignored meant that."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        ended = interrupted(tmp_path, "import 20", "--version")
    finally:
        signal.signal(signal.SIGINT, before)
    assert (ended.returncode, ended.stderr) == (0, "")


@pytest.mark.full
def test_the_module_is_the_program(tmp_path: Path) -> None:
    ended = subprocess.run([sys.executable, "-m", "polishd", "--version"], capture_output=True, check=True, timeout=60)
    assert ended.stdout == subprocess.run(
        [sys.executable, "-c", START, SCRIPT, "--version"], capture_output=True, check=True, timeout=60
    ).stdout  # fmt: skip
    assert callable(EntryPoint("polishd", SCRIPT, "console_scripts").load())
