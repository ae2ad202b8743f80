"""What edge TIF and extension are for: the dwell near a rim, judged by what it leaves there."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest

from polishd.model.outline import Circle
from polishd.model.process import ToolProcess
from polishd.model.surface import BoolArray, FloatArray, Grid
from polishd.process.dwell import newton_cg
from polishd.process.dwell.problem import DwellProblem
from polishd.process.dwell.quadratic import regularisation_from_rho
from polishd.process.metrology.edge_extension import Extension, extend_surface
from polishd.process.removal.dynamic_tif import effect_matrix
from polishd.process.removal.effect import SparseEffect
from polishd.process.removal.path_tif import contact_centres_mm, rim_contact
from polishd.process.removal.tif import HertzSpot
from polishd.process.toolpath.apertures import circle
from polishd.process.toolpath.paths import raster
from tests.unit.process.gaussian import rough
from tests.unit.process.moves import program

RADIUS = 14.0
GRID = Grid(42, 42, 1.0)
PART = GRID.radius_mm() <= RADIUS
BLANK = 3.0
"""Width of the rim that a map may lack."""
SPOT = HertzSpot(ToolProcess())
POINTS = raster(circle(2 * RADIUS), 1.0, 1.0, overrun_mm=2.0)[:, :2]
PATH = program(POINTS[:-1], POINTS[1:], 0.3)
GAMMA, ONE = np.full(PATH.n, 0.87), np.ones(PATH.n)
RIM = Circle(RADIUS)
METHODS: tuple[Extension, ...] = ("nearest", "c1", "gerchberg_papoulis")
LEAST = PATH.length_mm / 50


@cache
def sunk() -> FloatArray:
    """Depth ratios of a tool that hangs over the rim."""
    return rim_contact(ToolProcess(), RIM, contact_centres_mm(SPOT, PATH, GAMMA), GAMMA).depth_ratio


@cache
def plain_effect() -> SparseEffect:
    """The spot wherever it is the same."""
    return SparseEffect(GRID, effect_matrix(GRID, SPOT, PATH, GAMMA, ONE))


@cache
def free_effect() -> SparseEffect:
    """The spot as it becomes over a free rim."""
    return SparseEffect(GRID, effect_matrix(GRID, SPOT, PATH, sunk(), ONE))


def surface(seed: int, cut_mm: float = 6.0) -> FloatArray:
    """A target that can be reached by removing."""
    height = rough(GRID, seed=seed, cut_mm=cut_mm)
    return np.asarray(height - height[PART].min() + 10.0, dtype=np.float64)


def dwell(effect: SparseEffect, target: FloatArray, mask: BoolArray, weight: FloatArray | None = None) -> FloatArray:
    regularisation = regularisation_from_rho(effect, PART, 1e-6)
    most = np.full(PATH.n, 1e3)
    problem = DwellProblem(effect, np.where(mask, target, 0.0), mask, mask, LEAST, most, regularisation, weight)
    return newton_cg.solve(problem, 30.0, 1e-4).time_s


@dataclass(frozen=True)
class Left:
    """RMS that a dwell leaves, nm, from the mean inside the rim's 3 mm."""

    inner: float
    rim: float


def left(target: FloatArray, plant: SparseEffect, time_s: FloatArray, inner: BoolArray) -> Left:
    residual = target - plant.removal_nm(time_s)
    residual = residual - residual[inner].mean()
    rim = PART & ~inner
    return Left(float(residual[inner].std()), float(np.sqrt(np.mean(residual[rim] ** 2))))


@pytest.mark.full
def test_a_free_rim_must_be_known() -> None:
    target = surface(3)
    inner = GRID.radius_mm() <= RADIUS - BLANK
    unaware = left(target, free_effect(), dwell(plain_effect(), target, PART), inner)
    aware = left(target, free_effect(), dwell(free_effect(), target, PART), inner)
    assert unaware.rim > 5
    assert aware.rim < 0.1 * unaware.rim
    assert aware.inner < 1.1 * unaware.inner


def test_the_sunk_spot_takes_less_time_at_the_rim() -> None:
    target = surface(3)
    plain, free = (dwell(effect, target, PART).sum() for effect in (plain_effect(), free_effect()))
    assert free < plain


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize("seed", [3, 4])
def test_where_the_map_ends_before_the_part_the_extension_saves_the_rim(seed: int) -> None:
    """The data end 3 mm before the rim: what the dwell does there is judged against the truth."""
    target = surface(seed, cut_mm=12.0)
    data = GRID.radius_mm() <= RADIUS - BLANK
    bare = left(target, plain_effect(), dwell(plain_effect(), target, data), data)
    rims: dict[str, float] = {"none": bare.rim}
    for method in METHODS:
        wider = extend_surface(np.where(data, target, np.nan), data, 1.0, BLANK, method, cutoff_period_mm=12.0)
        time = dwell(plain_effect(), wider.height_nm, wider.mask, np.where(data, 1.0, 0.01))
        found = left(target, plain_effect(), time, data)
        rims[method] = found.rim
        assert found.inner < 1.2 * bare.inner + 0.05
    assert rims["nearest"] < 0.5 * rims["none"]
    assert rims["c1"] < rims["nearest"]
    assert rims["gerchberg_papoulis"] < 0.7 * rims["c1"]
