"""The example plugin installs as a separate distribution, is found, and reads its declared formats."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from importlib.metadata import distributions
from pathlib import Path
from types import ModuleType

import numpy as np
import pluggy
import pytest

from polishd import hookspecs
from polishd.api import API_VERSION, MapError, SurfaceMap

FOLDER = Path(__file__).resolve().parents[3] / "examples" / "plugin"

# a grid of 0.5 mm, row 0 on top, one sample missing, in no order
SAMPLES = """\
# x_mm y_mm height_nm
1.0 -0.5 23
0.0  0.0 11
0.5  0.0 12
0.0 -0.5 21
1.0  0.0 13
"""


@pytest.fixture(scope="module")
def plugin() -> ModuleType:
    """The plugin's module, from its source."""
    spec = importlib.util.spec_from_file_location("example_reader", FOLDER / "polishd_example_reader.py")
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def read(plugin: ModuleType, folder: Path, text: str) -> SurfaceMap:
    """What the plugin's reader makes of this text."""
    path = folder / "map.xyz"
    path.write_text(text)
    (reader,) = plugin.polishd_surface_readers()
    surface = reader.read(path)
    assert isinstance(surface, SurfaceMap)
    return surface


@pytest.mark.full
def test_it_installs_as_a_distribution_of_its_own(tmp_path: Path) -> None:
    pip = [sys.executable, "-m", "pip", "-qq", "--disable-pip-version-check", "install", "--no-index", "--no-deps"]
    subprocess.run([*pip, "--no-build-isolation", "--target", str(tmp_path), str(FOLDER)], check=True)
    (found,) = distributions(path=[str(tmp_path)])
    (entry,) = found.entry_points.select(group="polishd")
    assert (found.name, entry.name, entry.value) == (
        "polishd-example-reader",
        "example_reader",
        "polishd_example_reader",
    )
    code = "import polishd_example_reader as p; print(p.__file__, p.polishd_surface_readers()[0].name)"
    child = subprocess.run(
        [sys.executable, "-c", code], env={"PYTHONPATH": str(tmp_path)}, capture_output=True, text=True, check=True
    )
    assert child.stdout.split() == [str(tmp_path / "polishd_example_reader.py"), "xyz"]


def test_it_answers_the_hook(plugin: ModuleType) -> None:
    manager = pluggy.PluginManager(hookspecs.PROJECT)
    manager.add_hookspecs(hookspecs)
    manager.register(plugin)
    manager.check_pending()
    ((reader,),) = manager.hook.polishd_surface_readers()
    assert reader.name == "xyz"
    assert plugin.POLISHD_API == API_VERSION


@pytest.mark.parametrize(("name", "known"), [("a.xyz", True), ("A.XYZ", True), ("a.dat", False), ("xyz", False)])
def test_it_knows_its_files(plugin: ModuleType, name: str, known: bool) -> None:
    assert plugin.sniff(SAMPLES.encode(), Path(name)) == known


def test_it_reads_a_map(plugin: ModuleType, tmp_path: Path) -> None:
    surface = read(plugin, tmp_path, SAMPLES)
    np.testing.assert_array_equal(surface.height_nm, [[11, 12, 13], [21, np.nan, 23]])
    assert surface.pitch_mm == 0.5
    assert surface.format == "xyz"
    assert len(surface.sha256) == 64


@pytest.mark.parametrize(
    "text",
    [
        "",
        "no numbers\n",
        "0 0\n1 0\n",
        "0 0 1\n",
        "0 0 1\n0 1 2\n",
        "0 0 1\n1 0 2\n2.4 0 3\n",
        "0 0 1\n1 0 2\n1 0 3\n",
        "nan 0 1\n1 0 2\n",
        "0 nan 1\n1 0 2\n",
        "0 0 nan\n1 0 2\n",
        "0 0 1\n1 0 2\n1e9 0 3\n",
        "0 0 1\n1 0 2\n1 1e300 3\n",
        "0 0 1\n1e-9 0 2\n1 0 3\n",
    ],
)
def test_it_refuses_what_is_no_map(plugin: ModuleType, tmp_path: Path, text: str) -> None:
    with pytest.raises(MapError, match=r"map\.xyz"):
        read(plugin, tmp_path, text)


def test_it_refuses_a_missing_file(plugin: ModuleType, tmp_path: Path) -> None:
    with pytest.raises(MapError, match=r"absent\.xyz"):
        plugin.read(tmp_path / "absent.xyz")
