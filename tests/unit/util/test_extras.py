"""Extras: the table agrees with pyproject.toml, a verb without its extra names it, and the core does without any."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import numpy as np
import pytest

from polishd.commissioning.rehearsal.simulated_cell import write_demo
from polishd.plugins.rnc_robot.gcode import jit as gcode_jit
from polishd.plugins.rnc_robot.gcode import scanner
from polishd.process.dwell import alternating_directions, douglas_rachford
from polishd.process.removal import combined_effect
from polishd.studies import cases
from polishd.util import extras, jit
from tests.unit.cli_result import Polishd
from tests.unit.maps.maps import dat

ROOT = Path(__file__).parents[3]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
Patch = pytest.MonkeyPatch


def name_of(requirement: str) -> str:
    found = re.match(r"[A-Za-z0-9._-]+", requirement)
    assert found is not None
    return found.group()


def test_the_table_has_the_extras_of_pyproject() -> None:
    declared = {extra: {name_of(each) for each in needed} for extra, needed in PROJECT["optional-dependencies"].items()}
    everything = declared.pop("all")
    assert declared == {extra: set(of.libraries) for extra, of in extras.EXTRAS.items()}
    assert everything == {"polishd"}
    (line,) = PROJECT["optional-dependencies"]["all"]
    assert set(line.removeprefix("polishd[").removesuffix("]").split(",")) == declared.keys() - {"tail"}


def test_no_library_is_core_and_of_an_extra() -> None:
    core = {name_of(each) for each in PROJECT["dependencies"]}
    assert not core & {library for of in extras.EXTRAS.values() for library in of.libraries}


@pytest.mark.parametrize("extra", extras.EXTRAS)
def test_a_missing_library_is_named_with_its_extra(extra: str, monkeypatch: Patch) -> None:
    library, module = next(iter(extras.EXTRAS[extra].libraries.items()))
    monkeypatch.setitem(sys.modules, module, None)
    assert library in extras.missing_libraries(extra)
    with pytest.raises(extras.ConfigError) as refused:
        extras.require_extra("this verb", extra)
    assert str(refused.value).startswith(f"this verb needs {library}")
    assert str(refused.value).endswith(f"Run: pip install 'polishd[{extra}]'")


def demo(tmp_path: Path) -> Path:
    return write_demo(tmp_path / "demo", None, 2.0, 4, None).cell


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    ("module", "extra", "words"),
    [
        ("pyarrow", "studies", ("study", "STUDY", "--out", "OUT")),
        ("distributed", "dask", ("study", "STUDY", "--scheduler", "tcp://127.0.0.1:1")),
        ("asyncua", "opcua", ("opcua", "CELL")),
        ("pytest_asyncio", "testing", ("hil", "CELL")),
        ("astropy.io.fits", "fits", ("map", "figures", "MAP.fits")),
        ("gwyfile.objects", "gwy", ("map", "figures", "MAP.gwy")),
        ("tifffile", "tiff", ("map", "figures", "MAP.tif")),
        ("prometheus_client.core", "metrics", ("web", "CELL")),
    ],
)
def test_a_verb_without_its_extra_ends_with_one_error(
    module: str, extra: str, words: tuple[str, ...], tmp_path: Path, polishd: Polishd, monkeypatch: Patch
) -> None:
    cell, out = demo(tmp_path), tmp_path / "out"
    if extra == "opcua":
        identity = '[opcua]\nmanufacturer = "A"\nserial_number = "1"\nproduct_instance_uri = "urn:a:1"\n'
        cell.write_text(cell.read_text() + identity)
    if extra == "metrics":
        cell.write_text(cell.read_text().replace("[web] ", "[web]\nmetrics = true\n# "))
        monkeypatch.delitem(sys.modules, "polishd.web.metrics", raising=False)
    start = {
        "MAP.fits": b"SIMPLE  =                    T" + b" " * 2850,
        "MAP.gwy": b"GWYPGwyContainer\0",
        "MAP.tif": b"II*\0\x08\0\0\0",
    }
    for name, content in start.items():
        (tmp_path / name).write_bytes(content + b" " * 100)
    known = {"STUDY": ROOT / "examples" / "robustness.toml", "OUT": out, "CELL": cell}
    monkeypatch.setitem(sys.modules, module, None)
    said = polishd(*(known.get(word, tmp_path / word if word in start else word) for word in words))
    assert said.code != 0
    assert said.err.count(f"pip install 'polishd[{extra}]'") == 1
    assert "Traceback" not in said.err
    assert not out.exists()


# The core alone.

BLOCKED = """import sys
for name in {modules!r}:
    sys.modules[name] = None
"""


@pytest.mark.full
def test_without_any_extra_a_pass_is_planned_with_the_same_figures(tmp_path: Path) -> None:
    """Run the chain in a separate process, from the map to the rewritten program and the report."""
    cell = demo(tmp_path)
    at = (np.arange(111) - 55) * 1.0
    x, y = np.meshgrid(at, -at)
    surface = dat(
        tmp_path / "part.dat", np.where(np.hypot(x, y) <= 52, 30 * np.cos(x / 9) + y / 5, np.nan), 1.0, "DEMO-100"
    )
    blocked = tmp_path / "blocked"
    blocked.mkdir()
    modules = [module for of in extras.EXTRAS.values() for module in of.libraries.values()]
    (blocked / "sitecustomize.py").write_text(BLOCKED.format(modules=modules))
    answers = []
    for name, path in (("core", str(blocked)), ("all", "")):
        command = [sys.executable, "-m", "polishd", "plan", str(cell), str(surface), "--out", str(tmp_path / name)]
        env = {**os.environ, "PYTHONPATH": path}
        done = subprocess.run([*command, "--json"], cwd=ROOT, env=env, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        assert (tmp_path / name / "report.html").stat().st_size > 10_000
        answers.append(json.loads(done.stdout)["certificate"])
    core, everything = answers
    assert core["predicted_rms_nm"] == pytest.approx(everything["predicted_rms_nm"], rel=1e-6)
    assert core["dwell_total_s"] == pytest.approx(everything["dwell_total_s"], rel=1e-6)


def test_without_numba_numpy_and_the_interpreter_are_taken(monkeypatch: Patch) -> None:
    """The figures are compared where each has both ways: test_transforms, test_spread_effect, test_jit."""
    monkeypatch.setitem(sys.modules, "numba", None)
    assert not jit.has_compiler()
    assert gcode_jit.kernel(scanner.scan, 1 << 30) is scanner.scan
    iteration = douglas_rachford._iteration((1000, 1000), np.float32)
    assert isinstance(iteration, douglas_rachford.NumpyIteration)
    assert not combined_effect.is_compiled(Many())  # type: ignore[arg-type]


def test_a_study_counts_a_missing_numba_as_a_version(monkeypatch: Patch) -> None:
    def version(name: str) -> str:
        if name == "numba":
            raise PackageNotFoundError(name)
        return "1"

    monkeypatch.setattr(cases, "version", version)
    assert cases.versions.__wrapped__()["numba"] == ""  # the answer of this process is kept
    assert cases.versions.__wrapped__()["numpy"] == "1"


@pytest.mark.full
def test_the_solvers_load_numba_only_when_a_problem_is_large() -> None:
    """A start without what small parts and most verbs do not need."""
    code = "import sys, polishd.plugins.dwell_solvers, polishd.plugins.rnc_robot; sys.exit('numba' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False).returncode == 0


@pytest.mark.full
def test_the_map_formats_load_no_sparse_matrices() -> None:
    """``scipy.sparse`` loads numpy's test and Fortran tools: a fifth of the start of what only reads maps."""
    code = "import sys, polishd.plugins.interferometer; sys.exit('scipy.sparse' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=False).returncode == 0


class Many:
    n = alternating_directions.MAX_STEPS * 1000
