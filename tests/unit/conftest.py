"""Shared fixtures of the unit tests: the shipped example, the command line, and fake distributions with plugins."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from textwrap import dedent
from typing import Any

import pytest

from polishd.cli import app
from polishd.hookspecs import API_VERSION
from tests.unit.cli_result import CliResult, Polishd

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "cell.toml"

Install = Callable[..., str]


@pytest.fixture
def example() -> str:
    """Return the text of the shipped example."""
    return EXAMPLE.read_text()


@pytest.fixture
def polishd(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Polishd:
    """Return a function that runs a command in this process as from the shell: ``polishd("check", path)``."""

    def call(*words: object) -> CliResult:
        monkeypatch.setattr(sys, "argv", ["polishd", *map(str, words)])
        with pytest.raises(SystemExit) as ended:
            app.main()
        captured = capsys.readouterr()
        return CliResult(int(ended.value.code or 0), captured.out, captured.err)

    return call


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Install]:
    """Return a function that puts a distribution with one plugin on sys.path: ``install("name", source)``."""
    site = tmp_path / "site"
    site.mkdir()
    monkeypatch.syspath_prepend(str(site))
    modules: list[str] = []

    def add(name: str, source: str, *, distribution: str = "", module: str = "", api: Any = API_VERSION) -> str:
        distribution = distribution or f"polishd-{name}"
        module = module or f"fake_{distribution}_{name}".replace("-", "_")
        head = "from polishd.api import *\nfrom polishd.api import hookimpl\n"
        version = "" if api is None else f"POLISHD_API = {api!r}\n"
        (site / f"{module}.py").write_text(head + version + dedent(source))
        info = site / f"{distribution.replace('-', '_')}-1.2.dist-info"
        info.mkdir(exist_ok=True)
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {distribution}\nVersion: 1.2\n")
        with (info / "entry_points.txt").open("a") as points:
            if not points.tell():
                points.write("[polishd]\n")
            points.write(f"{name} = {module}\n")
        modules.append(module)
        importlib.invalidate_caches()
        return name

    yield add
    for module in modules:
        sys.modules.pop(module, None)
