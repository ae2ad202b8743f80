"""Extreme numbers, deep nesting and long texts in each kind of file: accepted, or an error that names the file."""

from __future__ import annotations

import random
import re
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from polishd.config.cell import load_config
from polishd.config.controller_profile import CONTROLLER_PROFILE_DIR as CONTROLLERS
from polishd.config.controller_profile import load_controller_profile
from polishd.config.device_profile_checks import DEVICE_PROFILE_DIR as DEVICES
from polishd.config.device_profile_checks import load_device_profile
from polishd.config.instrument_profile import load_profile
from polishd.config.job_file import JobFile
from polishd.config.simulator import load_simulator
from polishd.config.study import load_scenario
from polishd.config.sweep import load_swept
from polishd.config.toml_loader import MOST_LEVELS
from polishd.model.errors import ConfigError
from tests.unit.cli_result import Polishd

EXAMPLES = Path(__file__).resolve().parents[3] / "examples"
Load = Callable[[Path], object]


def load_job(path: Path) -> object:
    return JobFile.read(path).laid_over(load_config(EXAMPLES / "cell.toml"))


def load_controller(path: Path) -> object:
    return load_controller_profile(str(path), path.parent)


KINDS: dict[str, tuple[Path, Load]] = {
    "cell": (EXAMPLES / "cell.toml", load_config),
    "cell with monitors": (EXAMPLES / "monitored_cell.toml", load_config),
    "job": (EXAMPLES / "job.toml", load_job),
    "study": (EXAMPLES / "corrections.toml", load_swept),
    "study of a table": (EXAMPLES / "table_iii.toml", load_swept),
    "sweep": (EXAMPLES / "guard_band.toml", load_swept),
    "scenario": (EXAMPLES / "scenarios" / "force_lag.toml", load_scenario),
    "simulator": (EXAMPLES / "sim.toml", load_simulator),
    "instrument": (EXAMPLES / "instrument.toml", load_profile),
    "device profile": (DEVICES / "voice_coil_modbus.toml", load_device_profile),
    "controller profile": (
        CONTROLLERS / "plc-opcua.toml",
        lambda path: load_controller_profile(str(path), path.parent),
    ),
}
VALUES = ("1e-300", "-1e-300", "1e300", "-1e300", "1e-9", "1e9", "nan", "-inf", "1" + "0" * 30, "9" * 5000, "0", "-0.0",
          '"' + "x" * 100_000 + '"', "[" * 500 + "]" * 500, "{ a = " * 60 + "1" + " }" * 60)  # fmt: skip
KEYED = re.compile(r"""^\s*[\w."'-]+\s*=\s*""")


def outcome(text: str, path: Path, load: Load) -> str:
    """The error, or nothing where the file is accepted. Anything else that is raised is a fault."""
    path.write_text(text)
    try:
        load(path)
    except ConfigError as error:
        return str(error)
    return ""


@pytest.fixture(params=sorted(KINDS))
def kind(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Path, Load]:
    """A file of each kind beside those that it names, and what reads it."""
    source, load = KINDS[request.param]
    target = tmp_path / source.parent.name
    shutil.copytree(source.parent, target)
    return target / source.name, load


def tried(kind: tuple[Path, Load], cases: list[tuple[int, str]]) -> int:
    """How many of them are refused."""
    path, load = kind
    text = path.read_text()
    assert outcome(text, path, load) == "", "as it is shipped, it is accepted"
    lines, refused = text.split("\n"), 0
    for number, value in cases:
        key = KEYED.match(lines[number])
        assert key is not None
        said = outcome("\n".join([*lines[:number], key[0] + value, *lines[number + 1 :]]), path, load)
        assert not said or path.name in said, (key[0], value[:20], said[:300])
        assert all(len(line) < 100_500 for line in said.splitlines()), key[0]
        refused += bool(said)
    return refused


def cases_of(kind: tuple[Path, Load]) -> list[tuple[int, str]]:
    lines = kind[0].read_text().split("\n")
    keyed = [
        number for number, line in enumerate(lines) if KEYED.match(line) and not line.rstrip().endswith(("[", ","))
    ]
    found = [(number, value) for number in keyed for value in VALUES]
    random.Random(1).shuffle(found)
    return found


def test_no_extreme_value_ends_in_a_traceback(kind: tuple[Path, Load]) -> None:
    cases = cases_of(kind)[:25]
    assert tried(kind, cases) > len(cases) / 4


@pytest.mark.full
@pytest.mark.slow
@pytest.mark.timeout(600)
def test_no_extreme_value_of_any_key_ends_in_a_traceback(kind: tuple[Path, Load]) -> None:
    cases = cases_of(kind)[:1500]
    assert tried(kind, cases) > len(cases) / 4


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("grid_mm", "1e-9", "process.grid_mm: 1e-09 is out of range; must be at least 0.01"),
        ("grid_mm", "0.01", "process.grid_mm: 0.01 mm makes a grid of 1e+08 cells over 100 mm x 100 mm; at most"),
        ("force_n", "1e-9", "process.force_n: 1e-09 is out of range; must be at least 0.01"),
        ("tool_radius_mm", "1e-300", "process.tool_radius_mm: 1e-300 is too small; give at least 1e-12"),
        ("aperture_mm", "1e9", "part.aperture_mm: 1000000000.0 is out of range; must be at most 5000.0"),
        ("edge_mm", "1" + "0" * 40, "part.edge_mm: 1e+40 is too large; give at most 1e+15"),
        ("grid_mm", "[" * 500 + "]" * 500, f"nested more than {MOST_LEVELS} levels deep"),
        ("grid_mm", "9" * 5000, "a value cannot be read: Exceeds the limit"),
    ],
)
def test_check_says_in_a_sentence_what_cannot_be(
    polishd: Polishd, tmp_path: Path, example: str, key: str, value: str, said: str
) -> None:
    path = tmp_path / "cell.toml"
    changed, count = re.subn(rf"(?m)^{key} *= *\S+", f"{key} = {value}", example)
    if not count:
        changed = example.replace("[process]", f"[process]\n{key} = {value}", 1)
    path.write_text(changed)
    found = polishd("check", path)
    assert found.code == 3
    assert said.lower() in found.err.lower()
    assert "Traceback" not in found.err


def test_tables_within_one_another_may_not_be_deep_either(tmp_path: Path) -> None:
    dotted = ".".join(["a"] * 400)
    said = outcome(f"{dotted} = 1\n", tmp_path / "cell.toml", load_config)
    assert f"a is nested more than {MOST_LEVELS} levels deep" in said


def test_a_computer_without_the_memory_says_so(
    polishd: Polishd, tmp_path: Path, example: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def too_much(*_: object) -> None:
        raise MemoryError("Unable to allocate 820. GiB for an array")

    monkeypatch.setattr("polishd.cli.cell.load_cell", too_much)
    (tmp_path / "cell.toml").write_text(example)
    found = polishd("check", tmp_path / "cell.toml")
    assert found.code == 10
    assert "not enough memory: Unable to allocate 820. GiB for an array. Check sizes" in found.err
