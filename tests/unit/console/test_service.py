"""The unit of systemd: what it says, that systemd can read it, and that odd names stay what they are."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from polishd.console.service import quoted
from polishd.model.errors import ConfigError, DeviceError
from tests.unit.conftest import EXAMPLE
from tests.unit.said import Polishd

ANALYZE = shutil.which("systemd-analyze")


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    return tmp_path / "config" / "systemd" / "user"


@pytest.fixture
def odd(tmp_path: Path) -> Path:
    """The example in a folder that systemd would read otherwise, if it were let."""
    folder = tmp_path / 'a cell, 50% $HOME "q" \\n'
    shutil.copytree(EXAMPLE.parent, folder)
    return folder / "cell.toml"


def values(unit: str, key: str) -> list[str]:
    return [line.partition("=")[2] for line in unit.splitlines() if line.startswith(f"{key}=")]


def test_a_unit_is_supervised_and_restarts_only_what_comes_up_held(polishd: Polishd) -> None:
    unit = polishd("service", "show", EXAMPLE, "--user").out
    assert values(unit, "Type") == ["notify"]
    assert values(unit, "Restart") == ["on-abnormal"]
    assert values(unit, "RestartForceExitStatus") == [str(DeviceError.exit_code)]
    assert values(unit, "ExecStart") == [f"{sys.executable} -m polishd run {EXAMPLE}"]
    queue = polishd("service", "show", EXAMPLE, "--user", "--queue").out
    assert values(queue, "ExecStart") == [f"{sys.executable} -m polishd run {EXAMPLE} --queue"]
    assert "LimitNICE" not in unit, "its own user's systemd may not give it"
    assert float(values(unit, "TimeoutStopSec")[0]) > float(values(unit, "WatchdogSec")[0])


def test_the_systems_unit_has_the_rights_of_the_host_page(polishd: Polishd) -> None:
    unit = polishd("service", "show", EXAMPLE, EXAMPLE.parent / "two_robots.toml", "--system").out
    page = (EXAMPLE.parents[1] / "docs" / "host.md").read_text()
    for line in ("LimitNICE=-10", "LimitMEMLOCK=infinity", "CPUWeight=1000"):
        assert line in unit
        assert line in page
    assert len(values(unit, "ExecStart")[0].split()) == 6


def test_install_writes_it_and_says_how_to_start_it(polishd: Polishd, home: Path, odd: Path) -> None:
    for _ in range(2):
        said = polishd("service", "install", odd, "--user")
        assert said.code == 0, said.err
    (unit,) = home.iterdir()
    assert f"systemctl --user enable --now {unit.name}" in said.out
    assert unit.read_text() == polishd("service", "show", odd, "--user").out


def test_it_says_for_whom_and_where_it_cannot_be_written(polishd: Polishd, home: Path) -> None:
    assert polishd("service", "install", EXAMPLE).code == 2
    home.parent.parent.write_text("a file")
    said = polishd("service", "install", EXAMPLE, "--user")
    assert (said.code, "cannot be written" in said.err) == (3, True)


def test_words_are_quoted_as_systemd_reads_them() -> None:
    assert quoted("/cells/lens.toml") == "/cells/lens.toml"
    assert quoted('a "b" 5% $x \\') == '"a \\"b\\" 5%% $$x \\\\"'
    assert quoted("/opt/$x/python", executable=True) == '"/opt/$x/python"'
    with pytest.raises(ConfigError, match="rename the file"):
        quoted("a\nb")


@pytest.mark.skipif(ANALYZE is None, reason="needs systemd-analyze (Debian: systemd)")
@pytest.mark.parametrize("scope", ["--user", "--system"])
def test_systemd_reads_it_without_a_word(polishd: Polishd, odd: Path, tmp_path: Path, scope: str) -> None:
    unit = tmp_path / "polishd-test.service"
    unit.write_text(polishd("service", "show", odd, scope).out)
    command = [str(ANALYZE), "verify", "--recursive-errors=no", "--man=no", scope, str(unit)]
    environment = {**os.environ, "XDG_RUNTIME_DIR": str(tmp_path)}
    found = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    own = [line for line in found.stderr.splitlines() if "polishd-test" in line]
    assert (found.returncode, own) == (0, []), found.stderr
