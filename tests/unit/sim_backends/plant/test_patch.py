"""The fine patch of the simulated part shows the lines that the forecast of ripple states."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from polishd.commissioning.rehearsal.simulated_cell import with_values
from polishd.config.simulator import SimConfig, load_simulator
from polishd.config.simulator_physics import Effects, Plant, Truth
from polishd.maps.map_files import MapSource
from polishd.model.program import Program
from polishd.model.surface import FloatArray, Grid
from polishd.pipeline import steps
from polishd.pipeline.build_recipe import make_recipe
from polishd.pipeline.recipe import Recipe
from polishd.plugin_loader import load_cell
from polishd.process.removal.ripple import PathErrors, Ripple
from polishd.process.removal.ripple_forecast import ripple_of
from polishd.programs.make import make_program
from polishd.programs.options import MakeOptions
from polishd.sim_backends.batch import BatchPlant

DATA = Path(steps.__file__).parents[1] / "commissioning/rehearsal/demo_data"
PERFECT = Truth(rate=(0.0, 0.0), stiffness=0.0, drift=0.0, force_noise=0.0, map_noise_nm=0.0)
EXACT = Effects(eq_44=(1.0, 1.0), friction=(0.0, 0.0))
APERTURE_MM = 24.0
PATCH = (1.0, -0.5, 5.0)


@dataclass(frozen=True)
class Bench:
    """The demo's cell over a small part, and its simulator without errors."""

    recipe: Recipe
    program: Program
    config: SimConfig

    def polished(self, seconds: FloatArray, **plant: object) -> BatchPlant:
        own = self.config.plant.model_copy(update=plant)
        made = BatchPlant(self.config.model_copy(update={"plant": own}), 1)
        part, n, process = steps.executed_surface(self.recipe, self.program), self.program.n, self.recipe.process
        made.polish(
            {
                "begin_mm": part.start_mm,
                "end_mm": part.end_mm,
                "axis": part.axis,
                "seconds": seconds,
                "force_n": np.full(n, process.force_n),
                "rpm": np.full(n, process.rpm),
            }
        )
        return made

    def forecast(self, seconds: FloatArray) -> Ripple:
        grid = Grid(49, 49, 0.5)
        answer = steps.effect_of(self.recipe, self.program, grid)
        assert answer.acting is not None
        clear = grid.radius_mm() < APERTURE_MM / 2 - 3.0
        return ripple_of(answer.acting, seconds, grid, clear, errors=PathErrors(0.0))


def bench(folder: Path, pitch_mm: float) -> Bench:
    cell = folder / "cell.toml"
    cell.write_text(with_values((DATA / "cell.toml").read_text(), {"part": {"aperture_mm": APERTURE_MM}}))
    (folder / "sim.toml").write_text((DATA / "sim.toml").read_text())
    config, hooks = load_cell(cell)
    without_map = config.model_copy(update={"instrument": type(config.instrument)()})
    recipe = make_recipe(without_map, hooks)
    text = make_program(MakeOptions("raster", folder / "program.rnc", pitch_mm=pitch_mm), config, hooks).text
    (folder / "program.rnc").write_bytes(text)
    sim = load_simulator(folder / "sim.toml")
    plain = sim.plant.model_copy(update={"rms_nm": 0.0, "patch_mm": PATCH, "patch_pitch_mm": 0.08})
    sim = sim.model_copy(update={"plant": plain, "hidden_truth": PERFECT, "effects": EXACT})
    return Bench(recipe, steps.read_program(recipe, folder / "program.rnc"), sim)


def amplitudes(patch_nm: FloatArray, sample_mm: float, period_mm: float) -> FloatArray:
    """(2,) of the first two harmonics across x, of samples that average over their width, by least squares."""
    at = (np.arange(len(patch_nm)) - (len(patch_nm) - 1) / 2) * sample_mm
    x, y = np.meshgrid(at, -at)
    terms = [x**i * y**j for i in range(4) for j in range(4 - i)]
    for n in (1, 2):
        terms += [np.cos(2 * np.pi * n * y / period_mm), np.sin(2 * np.pi * n * y / period_mm)]
    found = np.linalg.lstsq(np.column_stack([t.ravel() for t in terms]), patch_nm.ravel(), rcond=None)[0]
    own = np.hypot(*found[-4:].reshape(2, 2).T) / np.sinc(sample_mm * np.array([1, 2]) / period_mm)
    return np.asarray(own, dtype=np.float64)


@pytest.mark.full
@pytest.mark.parametrize("pitch_mm", [1.5, 1.2, 2.0])
def test_the_plants_lines_are_those_of_the_forecast(tmp_path: Path, pitch_mm: float) -> None:
    made = bench(tmp_path, pitch_mm)
    seconds = 0.15 * np.linalg.norm(made.program.end_mm - made.program.start_mm, axis=1)
    patch = made.polished(seconds).world.part.patch
    assert patch is not None
    removed = patch.start_nm - patch.height_nm
    assert removed.min() > 1.0
    forecast = [one.amplitude_nm for one in made.forecast(seconds).lines[:2]]
    assert np.linalg.norm(amplitudes(removed, 0.08, pitch_mm)) == pytest.approx(np.linalg.norm(forecast), rel=0.05)


def test_the_patch_wears_as_the_part_does_and_its_map_is_read(tmp_path: Path) -> None:
    made = bench(tmp_path, 1.0)
    seconds = 0.15 * np.linalg.norm(made.program.end_mm - made.program.start_mm, axis=1)
    part = made.polished(seconds, rms_nm=10.0, pv_nm=60.0, pitch_mm=0.4, patch_mm=(0.0, 0.0, 3.6)).world.part
    assert part.patch is not None
    own = part.patch.height_nm.reshape(9, 5, 9, 5).mean(axis=(1, 3))
    middle = part.height_nm.shape[0] // 2
    seen = part.height_nm[middle - 4 : middle + 5, middle - 4 : middle + 5]
    assert own == pytest.approx(seen, abs=0.15)
    assert np.ptp(seen) > 1.0
    part.patch.write_map(tmp_path / "patch.dat", "DEMO-100")
    surface = MapSource.of(None).read(tmp_path / "patch.dat")
    assert surface.pitch_mm == pytest.approx(0.08)
    np.testing.assert_allclose(surface.height_nm, part.patch.height_nm, atol=0.01)
    part.write(tmp_path / "truth.npz")
    with np.load(tmp_path / "truth.npz") as kept:
        np.testing.assert_array_equal(kept["patch_height_nm"], part.patch.height_nm)
        assert kept["patch_pitch_mm"] == 0.08


def test_a_patch_beside_the_part_is_refused() -> None:
    with pytest.raises(ValidationError, match="patch_mm: 5 mm about 60, 0 mm is not all on the part and its ring"):
        Plant(aperture_mm=100.0, patch_mm=(60.0, 0.0, 5.0), ring_mm=10.0)
