"""Peers of other authors, and how to talk to one that is a process."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
PROGRAMS = Path(__file__).with_name("programs")
BUILT = ROOT / "build" / "interop"
SITE = BUILT / "venv" / "lib" / f"python{sys.version_info[0]}.{sys.version_info[1]}" / "site-packages"
"""What ``make interop`` installed of requirements.txt. It comes last in the path: conftest.py."""
NODE_MODULES = BUILT / "node_modules"
END_S = 10.0
LINKS = (
    "Modbus RTU and TCP",
    "Modbus RTU",
    "Modbus TCP",
    "OPC UA",
    "ADS",
    "FTP",
    "SFTP",
    "CANopen",
    "RTDE",
    "Robot Web Services 1.0",
    "Robot Web Services 2.0",
    "FANUC RMI",
    "KUKAVARPROXY",
    "HSES",
    "linuxcncrsh",
    "HTTP",
    "the page",
)
"""What peers speak with us, in the order of the page."""


@dataclass(frozen=True, slots=True)
class Peer:
    """Program or library of another author. Each test module names its peer as ``PEER``."""

    name: str
    link: str
    """Key of ``LINKS``."""
    part: str
    """Which end of the link it is, and of ours the other."""
    source: str
    """Source of the peer: Debian, PyPI or npm."""
    package: str

    def __post_init__(self) -> None:
        """A link that the page does not know is found when the tests are collected, not when all have run."""
        assert self.link in LINKS, f"{self.link!r}: add it to LINKS"

    @property
    def version(self) -> str:
        """Return the installed version; empty where the peer is not installed."""
        return {"Debian": _debian, "PyPI": _pypi, "npm": _npm}[self.source](self.package)

    @property
    def needed(self) -> pytest.MarkDecorator:
        """Skips where it is not installed."""
        return pytest.mark.skipif(not self.version, reason=f"{self.name} is not installed")


def _debian(package: str) -> str:
    if shutil.which("dpkg-query") is None:
        return ""
    command = ["dpkg-query", "--show", "--showformat=${db:Status-Status} ${Version}", package]
    status, _, version = subprocess.run(command, capture_output=True, text=True, check=False).stdout.partition(" ")
    return version if status == "installed" else ""


def _pypi(package: str) -> str:
    found = [*metadata.distributions(name=package), *metadata.distributions(name=package, path=[str(SITE)])]
    return found[0].version if found else ""


def _npm(package: str) -> str:
    said = NODE_MODULES / package / "package.json"
    if shutil.which("node") is None or not said.exists():
        return ""
    return str(json.loads(said.read_text())["version"])


class Program:
    """A peer's process: a line of JSON for each question, one for each answer."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process
        self.greeting = self._answer()

    def ask(self, **question: Any) -> Any:
        """What it answers under ``ok``; AssertionError where it says ``error``."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(question) + "\n")
        self._process.stdin.flush()
        return self._answer()

    def _answer(self) -> Any:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        assert line, "the peer ended"
        said = json.loads(line)
        assert "error" not in said, said["error"]
        return said["ok"]


@contextmanager
def program(name: str, *arguments: object) -> Iterator[Program]:
    """Run a program of ``programs/`` for the duration of the block; it ends with its standard input."""
    path = PROGRAMS / name
    runner = "node" if path.suffix == ".js" else sys.executable
    environment = {**os.environ, "NODE_PATH": str(NODE_MODULES), "PYTHONPATH": os.pathsep.join([str(ROOT), str(SITE)])}
    with subprocess.Popen(
        [runner, str(path), *map(str, arguments)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment, cwd=PROGRAMS,
    ) as process:  # fmt: skip
        try:
            yield Program(process)
        finally:
            assert process.stdin is not None
            process.stdin.close()
            try:
                process.wait(END_S)
            except subprocess.TimeoutExpired:
                process.kill()
