"""The effect without a matrix against the matrix, and against itself transposed."""

from __future__ import annotations

import dataclasses
import pickle
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from scipy import special

from polishd.model.errors import ComputeError
from polishd.model.outline import Circle
from polishd.model.process import Optic, ToolProcess
from polishd.model.program import Program
from polishd.model.surface import FloatArray, Grid
from polishd.process.dwell import newton_cg
from polishd.process.dwell.problem import DwellProblem
from polishd.process.dwell.quadratic import quadratic, regularisation_from_rho
from polishd.process.removal.contact import CurvedContact, contact_on_curved_part
from polishd.process.removal.dynamic_tif import CorrectedSpot, effect_matrix, tif_at_point
from polishd.process.removal.effect import Effect, SparseEffect
from polishd.process.removal.path_tif import SpotPath, rim_depth_mm
from polishd.process.removal.spread_effect import SpreadEffect, damping, spline, spread_effect
from polishd.process.removal.spread_effect_compiled import compiled_spread
from polishd.process.removal.tif import HertzSpot, Spot, hertz_spot
from polishd.process.removal.tif_family import blocks_of, effect_row
from tests.unit.process.moves import inward_program, program

GRID = Grid(40, 48, 1.0)
LARGE = dataclasses.replace(ToolProcess(), tool_radius_mm=200.0, force_n=120.0)
"""A contact of 8 mm radius: many cells, and many blocks over each other."""
SPOT = hertz_spot(LARGE, GRID.pitch_mm)


def moves(n: int = 2000, move_mm: float = 1.0, seed: int = 0) -> Program:
    """Blocks in any direction anywhere on the grid and beyond it, the spindle leaning towards the base's z axis."""
    rng = np.random.default_rng(seed)
    start, way = rng.uniform(-26, 26, (n, 2)), rng.uniform(0, 2 * np.pi, n)
    return inward_program(start, start + move_mm * np.column_stack([np.cos(way), np.sin(way)]))


def gamma_of(path: Program, ratios: tuple[float, float] = (0.8, 1.0)) -> FloatArray:
    """A depth ratio that changes over the part."""
    return np.asarray(np.interp(np.sin(path.end_mm[:, 0] / 9 + path.end_mm[:, 1] / 15), [-1, 1], ratios))


def both(
    path: Program, spot: Spot = SPOT, gamma: FloatArray | None = None, tolerance: float = 1e-3, grid: Grid = GRID
) -> tuple[SpreadEffect, SparseEffect]:
    """Return the effect without a matrix and as a matrix."""
    ratio = gamma_of(path) if gamma is None else gamma
    factor = np.random.default_rng(3).uniform(0.9, 1.1, path.n)
    quick = spread_effect(grid, spot, path, ratio, factor, tolerance=tolerance)
    return quick, SparseEffect(grid, effect_matrix(grid, spot, path, ratio, factor))


def off(quick: SpreadEffect, exact: SparseEffect) -> float:
    """Largest difference of the removal anywhere, over its peak: of a flat dwell, and of nine random ones."""
    rng, worst = np.random.default_rng(1), 0.0
    for time in (np.ones(quick.n), *rng.exponential(1.0, (9, quick.n))):
        want = exact.removal_nm(time)
        worst = max(worst, float(np.abs(quick.removal_nm(time) - want).max() / want.max()))
    return worst


@dataclass(frozen=True)
class Gaussian:
    """A spot without a rim, longer along x, in squares so small that they do not show."""

    sigma_mm: float = 2.5

    def half_width_mm(self, depth_ratio: FloatArray) -> FloatArray:
        return 5 * self.sigma_mm * np.sqrt(depth_ratio)

    def step_mm(self, depth_ratio: FloatArray) -> FloatArray:
        return self.half_width_mm(depth_ratio) / 10

    def offset_mm(self, depth_ratio: FloatArray, azimuth_rad: FloatArray) -> FloatArray:
        return np.column_stack([0.4 * depth_ratio, np.zeros(depth_ratio.size)])

    def patch(self, depth_ratio: FloatArray, azimuth_rad: FloatArray) -> FloatArray:
        edge = np.linspace(-5, 5, 257)
        down, across = np.diff(special.ndtr(edge)), np.diff(special.ndtr(edge / 1.1))
        return np.asarray(depth_ratio[:, None, None] ** 1.5 * (1e3 * down[:, None] * across))


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize("move_mm", [1.0, 0.0, 7.0])
def test_the_removal_is_the_matrix_one_within_the_stated_error(move_mm: float) -> None:
    quick, exact = both(moves(move_mm=move_mm))
    assert quick.error <= 1e-3
    assert quick.error / 10 < off(quick, exact) < 1.5 * quick.error  # sampled at a few places, met at all


@pytest.mark.full
def test_a_finer_grid_brings_what_the_tolerance_asks_for() -> None:
    path = moves(500)
    coarse, fine = (both(path, tolerance=tolerance)[0] for tolerance in (2e-2, 2e-3))
    assert coarse.finer < fine.finer
    assert coarse.rank <= fine.rank


@pytest.mark.full
def test_a_spot_without_a_rim_is_met_in_every_column() -> None:
    path = moves(500)
    quick, exact = both(path, Gaussian(), tolerance=3e-4)
    assert quick.finer == 2
    assert off(quick, exact) < 3e-4
    largest = exact.matrix.max()
    for one in np.eye(quick.n)[::25]:
        assert np.abs(quick.removal_nm(one) - exact.removal_nm(one)).max() < 5e-4 * largest


@pytest.mark.full
@pytest.mark.parametrize("azimuth", [0.0, 2.0])
def test_any_way_of_leaning(azimuth: float) -> None:
    """Thick slurry: the spot lies beside the point, and turns about it."""
    thick = dataclasses.replace(LARGE, spot_offset_mm=(1.5, -0.7))
    start = moves().start_mm[:, :2]
    lean = azimuth + np.linspace(-0.5, 0.5, len(start))
    quick, exact = both(program(start, start + np.array([0.6, -0.5]), lean), hertz_spot(thick, GRID.pitch_mm))
    assert off(quick, exact) < 1.5e-3


@pytest.mark.full
def test_a_spindle_that_leans_every_way() -> None:
    start = moves(1200).start_mm[:, :2]
    quick, exact = both(program(start, start, np.random.default_rng(5).uniform(-np.pi, np.pi, len(start))))
    assert off(quick, exact) < 1.5e-3


@pytest.mark.full
@pytest.mark.parametrize("ratios", [(0.9, 0.9), pytest.param((0.95, 1.0), marks=pytest.mark.full), (0.5, 1.2)])
def test_the_rank_follows_the_range_of_depths(ratios: tuple[float, float]) -> None:
    path = moves(800)
    level = program(path.start_mm[:, :2], path.end_mm[:, :2])
    quick, exact = both(level, gamma=gamma_of(level, ratios), tolerance=2e-3)
    rank = {0.0: 1, 0.05: 3, 0.7: 20}[round(ratios[1] - ratios[0], 2)]
    assert quick.rank == 1 if rank == 1 else 1 < quick.rank <= rank
    assert off(quick, exact) < 3e-3


@pytest.mark.full
def test_blocks_over_a_free_rim_are_sunk_there_too() -> None:
    rim, path = Circle(22.0), moves()
    inside = rim.inside_mm(*path.end_mm[:, :2].T) > -3.0
    path = inward_program(path.start_mm[inside, :2], path.end_mm[inside, :2])
    sunk, _ = rim_depth_mm(CorrectedSpot(gamma_of(path), np.ones(path.n)), rim, LARGE, SPOT, path)
    assert (sunk.depth_ratio > 1.05 * gamma_of(path)).mean() > 0.2
    quick, exact = both(path, gamma=sunk.depth_ratio)
    assert quick.error <= 1e-3
    assert off(quick, exact) < 1.5e-3


BONNET = dataclasses.replace(ToolProcess(), tool_radius_mm=80.0, force_n=60.0)
"""A contact of 4.5 mm radius."""
CURVED = {
    "concave": Optic(radius_mm=200.0),
    "convex": Optic(radius_mm=-200.0),
    "off axis": Optic(radius_mm=400.0, conic=-1.0, offset_mm=(150.0, 60.0)),
    "aspheric": Optic(radius_mm=400.0, even=(-6e-7,)),
}


def on_part(optic: Optic, path: Program, bonnet: ToolProcess = BONNET) -> tuple[SpotPath, CurvedContact]:
    """The bonnet along a path over it."""
    curved = contact_on_curved_part(bonnet, optic, path.end_mm)
    assert curved is not None
    return SpotPath(path, hertz_spot(bonnet, GRID.pitch_mm), bonnet, None, curved), curved


def require_transpose(effect: SpreadEffect) -> None:
    """The adjoint is the transpose of the removal, to rounding."""
    rng = np.random.default_rng(2)
    time, weight = rng.standard_normal(effect.n), rng.standard_normal(GRID.shape)
    image, back = effect.removal_nm(time), effect.adjoint(weight)
    scale = np.linalg.norm(image) * np.linalg.norm(weight) + np.linalg.norm(time) * np.linalg.norm(back)
    assert abs(np.vdot(image, weight) - time @ back) < 1e-12 * scale


@pytest.mark.full
@pytest.mark.parametrize(
    "kind", ["concave", *(pytest.param(kind, marks=pytest.mark.full) for kind in ("convex", "off axis", "aspheric"))]
)
def test_on_a_curved_part_each_block_has_its_own_contact(kind: str) -> None:
    """Up to 1 % wider and askew by 3 %, on the asphere by a fifth: near to the matrix as asked, its transpose exact."""
    path = moves(2000)
    along, curved = on_part(CURVED[kind], path)
    spots, _ = along.on_part(tif_at_point("exact", gamma_of(path, (0.8, 0.95))))
    quick, exact = along.without_matrix(GRID, spots, 2e-3), along.matrix(GRID, spots)
    assert quick.error <= 2e-3
    assert off(quick, exact) < 3e-3
    require_transpose(quick)
    assert np.ptp(curved.wider, axis=0).max() > 5e-3
    alike = spread_effect(GRID, along.even, path, spots.depth_ratio, spots.factor, tolerance=2e-3)  # one width for all
    assert off(alike, exact) > 1.3 * off(quick, exact)


SMALLER = dataclasses.replace(ToolProcess(), tool_radius_mm=40.0, force_n=350.0)
"""A contact of 6.7 mm radius on a flat, of a bonnet that lies in steep parts."""
STEEP = {
    "as 500 mm of R 800 mm": Optic(radius_mm=83.0),
    "off axis": Optic(radius_mm=120.0, conic=-1.0, offset_mm=(50.0, 25.0)),
}


@pytest.mark.full
@pytest.mark.parametrize("kind", STEEP)
def test_on_a_steep_part_the_removal_is_met_to_a_thousandth(kind: str) -> None:
    """Slopes up to 18 degrees and more: contacts change by 5 % and are askew by 5 %, both at once."""
    path = moves(3000)
    inside = np.linalg.norm(path.end_mm[:, :2], axis=1) < 26
    path = inward_program(path.start_mm[inside, :2], path.end_mm[inside, :2])
    along, curved = on_part(STEEP[kind], path, SMALLER)
    assert np.ptp(curved.wider, axis=0).min() > 0.03
    assert np.ptp(curved.askew) > 0.04
    spots, _ = along.on_part(tif_at_point("exact", gamma_of(path, (0.84, 0.91))))
    quick, exact = along.without_matrix(GRID, spots), along.matrix(GRID, spots)
    assert quick.error <= 1e-3
    assert off(quick, exact) < 1e-3
    require_transpose(quick)
    want = exact.adjoint(GRID.radius_mm())
    assert np.abs(quick.adjoint(GRID.radius_mm()) - want).max() < 1e-3 * want.max()


@pytest.mark.full
def test_a_curved_part_is_left_to_the_matrix_where_its_error_is_larger_than_asked() -> None:
    path = moves(2000)
    along, _ = on_part(CURVED["aspheric"], path)
    spots, _ = along.on_part(tif_at_point("exact", gamma_of(path, (0.8, 0.95))))
    with pytest.raises(ComputeError, match=r"off by \S+ of its peak on a grid 4 times as fine, 1.0e-05 is wanted"):
        along.without_matrix(GRID, spots, 1e-5)


def test_exact_rows_are_those_of_the_matrix_on_a_curved_part_too() -> None:
    path = moves(300, move_mm=5.0)
    along, curved = on_part(CURVED["off axis"], path)
    spots, _ = along.on_part(tif_at_point("exact", gamma_of(path)))
    matrix = along.matrix(GRID, spots).matrix.toarray()
    bent = np.column_stack([curved.wider, curved.askew])
    blocks = blocks_of(path, spots.depth_ratio, spots.factor, bent)
    for row, column in ((0, 0), (20, 24), (39, 11)):
        here = np.array([GRID.x_mm[column], GRID.y_mm[row]])
        want = matrix[row * GRID.nx + column]
        np.testing.assert_allclose(effect_row(along.spot, blocks, here, 1.0), want, rtol=0, atol=1e-12 * matrix.max())


@pytest.mark.full
def test_the_adjoint_is_the_transpose() -> None:
    quick, exact = both(moves())
    rng = np.random.default_rng(2)
    for _ in range(5):
        time, weight = rng.standard_normal(quick.n), rng.standard_normal(GRID.shape)
        image, back = quick.removal_nm(time), quick.adjoint(weight)
        scale = np.linalg.norm(image) * np.linalg.norm(weight) + np.linalg.norm(time) * np.linalg.norm(back)
        assert abs(np.vdot(image, weight) - time @ back) < 1e-12 * scale
    want = exact.adjoint(GRID.radius_mm())
    assert np.abs(quick.adjoint(GRID.radius_mm()) - want).max() < 2e-3 * want.max()


@pytest.mark.full
@pytest.mark.parametrize(
    "made",
    [
        pytest.param(SpreadEffect.single, id="interpreted"),
        pytest.param(compiled_spread, id="compiled", marks=pytest.mark.full),
    ],
)
def test_in_float32_it_is_the_same_to_a_millionth(made: Callable[[SpreadEffect], Effect]) -> None:
    """Also where nodes are finer than samples."""
    quick, _ = both(moves(600), tolerance=5e-3)
    assert quick.finer > 1
    rough, rng = made(quick), np.random.default_rng(2)
    time, weight = rng.uniform(0, 1, quick.n), rng.uniform(0, 1, GRID.shape)
    for got, want in (
        (rough.removal_nm(time), quick.removal_nm(time)),
        (rough.adjoint(weight), quick.adjoint(weight)),
    ):
        assert 0 < np.abs(got - want).max() < 2e-6 * want.max()
        assert got.dtype == np.float64


@pytest.mark.full
def test_no_volume_is_lost() -> None:
    """Weights on the nodes add up to one; what is left is the family's."""
    path = moves(400)
    inner = np.linalg.norm(path.end_mm, axis=1) < 9
    quick, exact = both(path)
    volume = exact.adjoint(np.ones(GRID.shape))
    np.testing.assert_allclose(quick.adjoint(np.ones(GRID.shape))[inner], volume[inner], rtol=2e-3)
    np.testing.assert_allclose(quick.weights.sum(axis=1), 1.0, rtol=0, atol=1e-12)


def test_exact_rows_are_the_rows_of_the_matrix() -> None:
    path = moves(300, move_mm=5.0)
    gamma, factor = gamma_of(path), np.linspace(0.5, 1.5, path.n)
    matrix = effect_matrix(GRID, SPOT, path, gamma, factor).toarray()
    blocks = blocks_of(path, gamma, factor)
    for row, column in ((0, 0), (20, 24), (39, 11)):
        here = np.array([GRID.x_mm[column], GRID.y_mm[row]])
        want = matrix[row * GRID.nx + column]
        np.testing.assert_allclose(effect_row(SPOT, blocks, here, 1.0), want, rtol=0, atol=1e-12 * matrix.max())


def test_weights_keep_what_there_is_and_where_it_is() -> None:
    place = np.random.default_rng(0).uniform(-5, 5, 50)
    first, weight = spline(place)
    node = first[:, None] + np.arange(weight.shape[1])
    for degree in (0, 1):
        np.testing.assert_allclose((weight * node**degree).sum(axis=1), place**degree, rtol=0, atol=1e-12)
    assert weight.min() >= 0


def test_a_wave_is_damped_as_is_said() -> None:
    """On nodes; and a window that is divided by that passes through its own values again."""
    node, wave = np.arange(-1, 2), np.linspace(0, 0.5, 7)
    first, weight = spline(np.zeros(1))
    assert first[0] == -1
    np.testing.assert_allclose(weight[0] @ np.cos(2 * np.pi * wave * node[:, None]), damping(wave), atol=1e-12)
    np.testing.assert_allclose(damping(np.array([0.0, 0.5])), [1.0, 0.5])


@pytest.mark.full
def test_memory_goes_with_points_and_nodes() -> None:
    """120 bytes a block on 9 nodes, and a few transforms; the matrix takes 12 for each of a million entries."""
    path, grid = moves(6_000), Grid(64, 64, 1.0)
    gamma, factor = gamma_of(path), np.ones(path.n)
    quick = spread_effect(grid, SPOT, path, gamma, factor, tolerance=2e-3)
    nodes = float(np.prod(quick.where.size))
    tracemalloc.start()
    try:
        again = spread_effect(grid, SPOT, path, gamma, factor, tolerance=2e-3)
        kept, _ = tracemalloc.get_traced_memory()
        tracemalloc.reset_peak()
        again.adjoint(again.removal_nm(np.ones(path.n)))
        peak = tracemalloc.get_traced_memory()[1] - kept
    finally:
        tracemalloc.stop()
    assert kept < (12 * 28 + 16 * quick.rank) * path.n + 16 * quick.rank * nodes
    assert peak < 64 * (path.n + nodes)


def test_it_is_an_effect_and_can_go_to_the_worker() -> None:
    quick, _ = both(moves(300), tolerance=1e-2)
    effect: Effect = pickle.loads(pickle.dumps(quick))
    np.testing.assert_array_equal(effect.removal_nm(np.ones(300)), quick.removal_nm(np.ones(300)))
    assert effect.grid == GRID


@pytest.mark.full
def test_a_tolerance_out_of_reach_is_refused_with_what_was_reached() -> None:
    path = moves(60)
    with pytest.raises(ComputeError, match=r"off by \S+ of its peak on a grid 4 times as fine, 1.0e-06 is wanted"):
        spread_effect(GRID, HertzSpot(LARGE), path, gamma_of(path), np.ones(60), tolerance=1e-6)


def test_a_path_beside_the_grid_is_refused() -> None:
    far = program([[200.0, 0.0]], [[201.0, 0.0]])
    with pytest.raises(ComputeError, match="no block touches the grid"):
        spread_effect(GRID, SPOT, far, np.ones(1), np.ones(1))


@pytest.mark.parametrize(("gamma", "factor"), [(np.nan, 1.0), (0.0, 1.0), (1.0, -1.0)])
def test_an_impossible_depth_or_factor_is_refused(gamma: float, factor: float) -> None:
    with pytest.raises(ComputeError, match=r"point 0: the (depth ratio gamma|factor on the removal) is"):
        spread_effect(GRID, SPOT, moves(1), np.full(1, gamma), np.full(1, factor))


@pytest.mark.full
def test_projected_newton_runs_on_it_and_finds_the_dwell_of_the_matrix() -> None:
    path = moves(1500)
    quick, exact = both(path)
    disc = GRID.radius_mm() < 19
    x, y = GRID.axes_mm
    target = 300 + 40 * np.sin(x / 11) * np.cos(y / 14)
    p = regularisation_from_rho(exact, disc, 1e-3)
    lower, upper = np.full(path.n, 1e-4), np.full(path.n, np.inf)
    found, want = (
        newton_cg.solve(DwellProblem(effect, target, disc, disc, lower, upper, p), 120.0) for effect in (quick, exact)
    )
    assert found.certificate.kkt_residual <= 1e-5
    assert quick.note in found.certificate.notes
    assert want.certificate.notes == ()
    really = exact.removal_nm(found.time_s)
    assert np.abs(really - found.removal_nm)[disc].max() < 2e-3 * really.max()
    f = quadratic(DwellProblem(exact, target, disc, disc, lower, upper, p))
    assert f.value(found.time_s) < want.certificate.objective + (1e-3 * really.max()) ** 2
