"""A demo's files: two configs that agree, and a program that keeps off the part where the machine stops."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polishd.commissioning.rehearsal.simulated_cell import (
    SURFACE_PERIOD_MM,
    DemoFiles,
    aperture_of,
    demo_program,
    free_port,
    with_values,
    write_demo,
)
from polishd.config.cell import CellConfig, load_config
from polishd.config.simulator import load_simulator
from polishd.model.errors import MapError
from polishd.model.program import Program
from polishd.pipeline import steps
from polishd.pipeline.build_recipe import make_recipe
from polishd.plugin_loader import load_own
from polishd.programs.make import LANDING_MM, OVERRUN_MM, RASTER_MM
from polishd.sim_backends.common.metropro import DatMap, pack
from tests.rs274 import read

TEMPLATE = """# top
[one]
name = "bench"                # who it is
size = 1.5                    # of it
# where = "runs/today"        # optional
# A comment with one = sign in it

[two]  # next
size = 3
"""


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> DemoFiles:
    return write_demo(tmp_path_factory.mktemp("demo") / "out", None, 2.0, 4, None)


@pytest.fixture(scope="module")
def config(demo: DemoFiles) -> CellConfig:
    return load_config(demo.cell)


@pytest.fixture(scope="module")
def program(config: CellConfig) -> Program:
    return read(config.program_path.read_bytes(), "program.rnc")


def tables(path: Path) -> dict[str, Any]:
    return tomllib.loads(path.read_text())


def scan(path: Path, size_mm: float, pitch_mm: float = 0.5) -> Path:
    """A map of a round part of that size."""
    n = int(size_mm / pitch_mm) + 9
    axis = (np.arange(n) - (n - 1) / 2) * pitch_mm
    height = np.where(np.hypot(axis[:, None], axis) <= size_mm / 2, 10 * np.sin(axis), np.nan)
    path.write_bytes(pack(DatMap(height, pitch_mm, "X")))
    return path


# with_values


def test_values_change_and_comments_stay() -> None:
    text = with_values(TEMPLATE, {"one": {"name": "other", "size": 2.5}, "two": {"size": [1, 2]}})
    assert tomllib.loads(text) == {"one": {"name": "other", "size": 2.5}, "two": {"size": [1, 2]}}
    assert 'name = "other"                # who it is' in text
    assert "size = 2.5                    # of it" in text
    assert text.startswith("# top\n[one]\n")


def test_a_key_that_is_commented_out_comes_in() -> None:
    text = with_values(TEMPLATE, {"one": {"where": "run"}})
    assert tomllib.loads(text)["one"]["where"] == "run"
    assert 'where = "run"        # optional' in text


def test_nothing_to_change_changes_nothing() -> None:
    assert with_values(TEMPLATE, {}) == TEMPLATE


@pytest.mark.parametrize("wrong", [{"one": {"nmae": 1}}, {"two": {"name": 1}}, {"three": {"size": 1}}])
def test_a_key_that_is_not_there(wrong: dict[str, dict[str, int]]) -> None:
    with pytest.raises(KeyError, match="not in the template"):
        with_values(TEMPLATE, wrong)


# the configs


def test_everything_is_there(demo: DemoFiles, config: CellConfig) -> None:
    assert config.state_dir == demo.state_dir
    assert config.run_dir == demo.run_dir
    assert config.program_path.parent == demo.out
    assert (config.job.tolerance_nm, config.job.max_cycles, config.job.tolerance_period_mm) == (2.0, 4, 0.0)
    assert config.process.correction == "exact"


def test_the_simulator_has_the_cells_part_address_and_artefact(demo: DemoFiles, config: CellConfig) -> None:
    sim = load_simulator(demo.sim)
    sim.require_simulated()
    assert (sim.plant.part_id, sim.plant.outline) == (config.part.id, config.outline())
    assert (sim.plant.origin_mm, sim.plant.program_offset_mm) == (config.part.origin_mm, config.program.offset_mm)
    assert tables(demo.cell)["robot"]["address"] == f"tcp://127.0.0.1:{sim.robot.port}"
    assert len(sim.interferometer.artefact.bumps) == 3
    assert sim.plant.ring_mm > LANDING_MM, "the tool lands on the ring that the part sits in"


def test_a_demo_on_a_measured_map_has_its_size(tmp_path: Path) -> None:
    files = write_demo(tmp_path / "out", scan(tmp_path / "m.dat", 30.0), 5.0, 2, "none")
    cell = tables(files.cell)
    assert cell["part"]["aperture_mm"] == load_simulator(files.sim).plant.aperture_mm == 30.0
    assert cell["job"]["tolerance_period_mm"] == SURFACE_PERIOD_MM
    assert (cell["job"]["tolerance_nm"], cell["job"]["max_cycles"]) == (5.0, 2)
    assert cell["process"]["correction"] == "none"
    found = read((files.out / "program.rnc").read_bytes(), "p")
    assert np.abs(found.end_mm[:, :2]).max() < 15 + LANDING_MM + RASTER_MM


def test_a_map_without_a_scale_cannot_start_a_demo(tmp_path: Path) -> None:
    path = tmp_path / "m.dat"
    path.write_bytes(pack(DatMap(np.arange(81.0).reshape(9, 9) + 1, 0.0)))
    with pytest.raises(MapError, match="no lateral scale"):
        write_demo(tmp_path / "out", path, 5.0, 2, None)
    assert not (tmp_path / "out").exists()


def test_the_aperture_of_a_map(tmp_path: Path) -> None:
    assert aperture_of(scan(tmp_path / "m.dat", 24.4)) == 24.0


def test_a_port_that_is_free() -> None:
    assert 1024 <= free_port() <= 65535


# the program


@pytest.mark.full
def test_the_program_reads_back(program: Program, config: CellConfig) -> None:
    assert program.encoding == "feed"
    assert program.warnings == ()
    assert np.array_equal(program.start_mm[1:], program.end_mm[:-1]), "one path, no rapids within"
    assert program.length_mm.max() <= 1.5 * RASTER_MM
    assert demo_program(config) == program.text, "the same every time"


@pytest.mark.full
def test_turns_and_landings_lie_off_the_part(program: Program, config: CellConfig) -> None:
    reach = config.outline().radius_mm
    move = program.end_mm - program.start_mm
    turns = np.abs(move[:, 1]) > 1e-6
    assert turns.sum() > 50
    for ends in (program.start_mm[turns], program.end_mm[turns]):
        assert np.hypot(ends[:, 0], ends[:, 1]).min() >= reach + OVERRUN_MM - 1e-3
    for point in (program.start_mm[0], program.end_mm[-1]):
        assert np.hypot(point[0], point[1]) >= reach + LANDING_MM - 1e-3


def test_the_lines_cover_the_part_at_a_quiet_step(program: Program, config: CellConfig) -> None:
    y = np.unique(np.round(program.end_mm[:, 1], 3))
    lines = y[np.abs(y) < config.outline().radius_mm]
    at = np.unique(program.end_mm[np.abs(program.end_mm[:, 0]) < 1.0, 1])
    step = np.diff(at)
    assert step == pytest.approx(step[0], abs=1e-3)
    assert 0.5 < step[0] <= RASTER_MM
    assert lines[0] < -config.outline().radius_mm + 1.5


def test_the_tool_dips_inward_by_the_processs_angle(program: Program, config: CellConfig) -> None:
    recipe = make_recipe(config, load_own())
    part = steps.in_part_frame(recipe, program)
    assert part.axis[:, 2] == pytest.approx(np.cos(np.radians(config.process.dip_deg)), abs=1e-6)
    stripped = steps.executed_surface(recipe, replace(program, axis=np.tile([0.0, 0.0, 1.0], (program.n, 1))))
    assert part.axis == pytest.approx(stripped.axis, abs=1e-5), "what an unstated axis is taken for"


def test_the_program_stays_in_the_machines_envelope(program: Program, config: CellConfig) -> None:
    envelope = config.envelope()
    for points, (low, high) in zip(program.end_mm.T, (envelope.x_mm, envelope.y_mm, envelope.z_mm), strict=True):
        assert low <= points.min() <= points.max() <= high
