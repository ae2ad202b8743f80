"""docs/how-to/drivers.md: its driver passes the suite, a broken one fails; ports.md is the code's."""

from __future__ import annotations

import re
import subprocess
import sys
import sysconfig
import venv
from functools import partial
from pathlib import Path

import pytest

from docs.reference import ports
from polishd.config.cell import PORTS
from polishd.interfaces import Device

ROOT = Path(__file__).parents[3]
TEXT = (ROOT / "docs" / "how-to" / "drivers.md").read_text()
FILES = {
    name: content
    for content, name in re.findall(r"^```(?:python|ini)\n(# ([\w.]+)\n.*?)^```", TEXT, re.DOTALL | re.MULTILINE)
}
DRIVER = "line_tool.py"
SAFE, LANDS = "    async def make_safe(self):\n", "        while force_n > 0.0 and not"
WRONG = [
    ("not 0.0 <= force_n <= 50.0", "force_n < 0.0 or force_n > 50.0", "test_impossible_forces_are_refused", "NaN"),
    ("<= 50.0", "<= 60.0", "test_impossible_forces_are_refused", "more than the device may"),
    (LANDS, "        while False and not", "test_it_lands_and_regulates", "returns in contact"),
    (
        "self.sample, urgent=True)).retracted",
        "self.sample, urgent=True))",
        "test_retract_returns",
        "when the tool is off",
    ),
    (SAFE, f"{SAFE}        return\n", "test_make_safe_in_contact", "takes the force off, retracts"),
    ("one.retracted, ", "True, ", "test_make_safe_in_contact", "In contact the status is not safe"),
    ('f"fault {one.fault}"', '""', "test_without_samples", "says why"),
    ("self.lifts + 1", "self.lifts", "test_retracting_wins", "overtakes it"),
    (".line.open, ", ".make_safe, ", "test_opening_changes_nothing", "is ready, safe and has a state"),
]
"""Text of the driver, its replacement, the test that then fails, and a part of its message."""


def written(folder: Path, driver: str) -> Path:
    """The files of the page, with that driver."""
    for name, content in {**FILES, DRIVER: driver}.items():
        (folder / name).write_text(content)
    return folder


def suite(folder: Path, *options: str, python: str | Path = sys.executable) -> subprocess.CompletedProcess[str]:
    """Run the suite as the page describes it."""
    command = [python, "-m", "pytest", "-q", "-p", "no:cacheprovider", *options]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


def installed(folder: Path) -> Path:
    """The Python of an environment into which polishd's wheel was installed, beside the packages that it needs."""
    run = partial(subprocess.run, check=True, capture_output=True, text=True)
    run([sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", folder], cwd=ROOT)
    (wheel,) = folder.glob("polishd-*.whl")
    venv.create(folder / "venv")
    python = folder / "venv" / "bin" / "python"
    site = Path(run([python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"]).stdout.strip())
    for package in Path(sysconfig.get_path("purelib")).iterdir():
        if package.suffix != ".pth" and "polishd" not in package.name:  # not the checkout's
            (site / package.name).symlink_to(package)
    pip = [sys.executable, "-m", "pip", "--python", python, "--disable-pip-version-check", "install"]
    run([*pip, "--no-index", "--no-deps", wheel])
    return python


def test_it_has_a_driver_of_under_60_lines_with_simulator_and_test() -> None:
    assert set(FILES) == {DRIVER, "line_tool_sim.py", "test_line_tool.py", "pytest.ini"}
    assert len([line for line in FILES[DRIVER].splitlines() if line.strip()]) < 60


@pytest.mark.full
def test_its_driver_passes(tmp_path: Path) -> None:
    done = suite(written(tmp_path, FILES[DRIVER]), "-k", "identifies or nothing_works or impossible or lands")
    assert done.returncode == 0, done.stdout
    assert done.stdout.splitlines()[-1].startswith("8 passed")


@pytest.mark.full
def test_its_driver_passes_the_whole_suite(tmp_path: Path) -> None:
    done = suite(written(tmp_path, FILES[DRIVER]))
    assert done.returncode == 0, done.stdout
    assert re.search(r"^\d{2} passed in", done.stdout, re.MULTILINE), done.stdout


@pytest.mark.full
def test_its_driver_passes_where_polishd_is_installed_and_there_is_no_checkout(tmp_path: Path) -> None:
    """Acceptance: written from the docs alone, in a clean environment."""
    python = installed(tmp_path)
    work = tmp_path / "work"
    work.mkdir()
    where = subprocess.run(
        [python, "-c", "import polishd, sys; print(polishd.__file__, *sys.path, sep='\\n')"],
        cwd=work, capture_output=True, text=True, check=True,
    ).stdout.splitlines()  # fmt: skip
    assert where[0].startswith(str(tmp_path))
    assert not any(Path(path).is_relative_to(ROOT) for path in where), where
    done = suite(written(work, FILES[DRIVER]), python=python)
    assert done.returncode == 0, done.stdout
    assert re.search(r"^\d{2} passed in", done.stdout, re.MULTILINE), done.stdout


@pytest.mark.full
@pytest.mark.parametrize(("right", "wrong", "test", "demand"), WRONG, ids=[f"{case[2]}-{case[3]}" for case in WRONG])
def test_a_driver_that_breaks_a_demand_gets_its_name(
    tmp_path: Path, right: str, wrong: str, test: str, demand: str
) -> None:
    assert FILES[DRIVER].count(right) == 1
    done = suite(written(tmp_path, FILES[DRIVER].replace(right, wrong)), "-k", test)
    assert done.returncode == 1, done.stdout
    assert demand in done.stdout.partition("requirement of the port")[2], done.stdout


def test_the_ports_are_what_the_code_says() -> None:
    page = ports.PAGE.read_text()
    assert ports.laid_into(page) == page, "write them anew: make reference"


@pytest.mark.parametrize("port", [Device, *(port.protocol for port in PORTS.values())], ids=lambda port: port.__name__)
def test_every_method_says_what_it_takes(port: type) -> None:
    for name, member in ports.methods(port).items():
        if not isinstance(member, property):
            missing = {"", *ports.ASPECTS} - set(ports.aspects(member))
            assert not missing, f"{port.__name__}.{name}: its docstring lacks {missing}"
