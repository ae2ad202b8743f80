"""The unit of systemd: what it says, that systemd can read it, and that odd names stay what they are."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from polishd.cli.service import quoted
from polishd.model.errors import ConfigError, DeviceError
from tests.unit.cli_result import Polishd
from tests.unit.conftest import EXAMPLE

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
    assert values(unit, "ExecStart") == [f"{sys.executable} -m polishd run {EXAMPLE} --start-held"]
    queue = polishd("service", "show", EXAMPLE, "--user", "--queue").out
    assert values(queue, "ExecStart") == [f"{sys.executable} -m polishd run {EXAMPLE} --queue --start-held"]
    assert "LimitNICE" not in unit, "its own user's systemd may not give it"
    assert float(values(unit, "TimeoutStopSec")[0]) > float(values(unit, "WatchdogSec")[0])


def test_the_systems_unit_has_the_rights_of_the_host_page(polishd: Polishd) -> None:
    unit = polishd("service", "show", EXAMPLE, EXAMPLE.parent / "two_robots.toml", "--system").out
    page = (EXAMPLE.parents[1] / "docs" / "how-to" / "host.md").read_text()
    for line in ("LimitNICE=-10", "LimitMEMLOCK=infinity", "CPUWeight=1000"):
        assert line in unit
        assert line in page
    assert len(values(unit, "ExecStart")[0].split()) == 7


def test_install_writes_it_and_says_how_to_start_it(polishd: Polishd, home: Path, odd: Path) -> None:
    first, said = (polishd("service", "install", odd, "--user") for _ in range(2))
    assert (first.code, said.code) == (0, 0), first.err + said.err
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


BESIDE = {"web": "web", "opcua": "opcua", "shop-connect": "shop connect", "shop-serve": "shop serve"}


@pytest.fixture
def served(tmp_path: Path) -> dict[str, Path]:
    """Return the configuration file of each process: a cell that has all sections, and a shop."""
    cell = tmp_path / "a cell" / "cell.toml"
    shutil.copytree(EXAMPLE.parent, cell.parent)
    more = """
[opcua]
manufacturer = "Lathe & Sons"
serial_number = "7"
product_instance_uri = "urn:lathe:7"

[shop]
url = "http://127.0.0.1:8760/"
token = "file:shop.token"
"""
    cell.write_text(cell.read_text() + more)
    (cell.parent / "shop.token").write_text("t" * 43)
    (tmp_path / "shop.toml").write_text('[shop]\nname = "hall"\nstate_dir = "shop"\n')
    return {**dict.fromkeys(("web", "opcua", "shop-connect"), cell), "shop-serve": tmp_path / "shop.toml"}


@pytest.mark.one_of_each
@pytest.mark.parametrize("of", BESIDE)
def test_what_runs_beside_a_daemon_has_a_unit_of_its_own(
    polishd: Polishd, served: dict[str, Path], home: Path, of: str
) -> None:
    said = polishd("service", "install", served[of], "--user", "--of", of)
    assert said.code == 0, said.err
    (unit,) = home.iterdir()
    assert unit.name.startswith(f"polishd-{of}-")
    text = unit.read_text()
    path = quoted(str(served[of]))
    assert values(text, "ExecStart") == [f"{sys.executable} -m polishd {BESIDE[of]} {path}"]
    assert values(text, "Restart") == ["always"]
    assert values(text, "RestartPreventExitStatus") == [f"2 {ConfigError.exit_code}"], "or it would end so for ever"
    assert int(values(text, "CPUWeight")[0]) < 100, "the daemon goes first"
    if ANALYZE is not None:
        require_readable(unit, "--user", home)


@pytest.mark.parametrize("of", ["opcua", "shop-connect"])
def test_a_cell_without_the_section_has_no_such_unit(polishd: Polishd, of: str) -> None:
    said = polishd("service", "show", EXAMPLE, "--user", "--of", of)
    assert said.code == ConfigError.exit_code
    assert "is missing" in said.err


def test_each_of_what_runs_beside_is_a_process_of_its_own(polishd: Polishd) -> None:
    for more in ([EXAMPLE], ["--queue"]):
        said = polishd("service", "show", EXAMPLE, *more, "--user", "--of", "web")
        assert (said.code, "one file" in said.err) == (2, True)


@pytest.mark.skipif(ANALYZE is None, reason="needs systemd-analyze (Debian: systemd)")
@pytest.mark.parametrize("scope", ["--user", "--system"])
def test_systemd_reads_it_without_a_word(polishd: Polishd, odd: Path, tmp_path: Path, scope: str) -> None:
    unit = tmp_path / "polishd-test.service"
    unit.write_text(polishd("service", "show", odd, scope).out)
    require_readable(unit, scope, tmp_path)


def require_readable(unit: Path, scope: str, runtime: Path) -> None:
    command = [str(ANALYZE), "verify", "--recursive-errors=no", "--man=no", scope, str(unit)]
    environment = {**os.environ, "XDG_RUNTIME_DIR": str(runtime)}
    found = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    own = [line for line in found.stderr.splitlines() if unit.stem in line]
    assert (found.returncode, own) == (0, []), found.stderr
