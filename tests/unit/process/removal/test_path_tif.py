"""The modelled spot at a free rim keeps its force, is the plain spot inside and nothing outside, and has no steps."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.model.errors import ComputeError
from polishd.model.outline import Circle, Lengths, rectangle
from polishd.model.process import ToolProcess
from polishd.model.surface import FloatArray, Grid
from polishd.process.removal import contact
from polishd.process.removal.dynamic_tif import effect_matrix
from polishd.process.removal.path_tif import MOST_SUNK, contact_centres_mm, load_share, rim_contact, rim_sink_mm
from polishd.process.removal.tif import HertzSpot
from tests.unit.process.moves import program

PAPER = ToolProcess()
DEPTH = contact.hertz_depth_mm(PAPER)
A = float(contact.contact_radius_mm(PAPER, DEPTH))
SPOT = HertzSpot(PAPER)
RIM = Circle(50.0)


class Straight(Circle):
    """A part that ends at x = 0."""

    def inside_mm(self, x_mm: Lengths, y_mm: Lengths) -> FloatArray:
        return -np.asarray(x_mm, dtype=np.float64)


def force_on_half_plane_n(depth_mm: float, inside_mm: float) -> float:
    """Integral of the model's pressure over what lies less than ``inside_mm`` to the right of the centre."""
    process = ToolProcess(viscosity_mpa_s=0.0, second_viscosity_mpa_s=0.0)  # the shift is not the matter here
    a = float(contact.contact_radius_mm(process, depth_mm))
    node, weight = np.polynomial.legendre.leggauss(200)
    cut = np.clip(inside_mm, -a, a)
    x, wx = -a + (node + 1) * (cut + a) / 2, weight * (cut + a) / 2
    half = np.sqrt(np.maximum(a**2 - x**2, 0.0))
    # y = half sin(t): the pressure's root at the rim is smooth in t
    t, wt = node * np.pi / 2, weight * np.pi / 2
    y = half[:, None] * np.sin(t)
    pressure = contact.pressure_mpa(process, depth_mm, x[:, None], y)
    return float((pressure * wx[:, None] * (wt * half[:, None] * np.cos(t))).sum())


def on_line(distance_mm: FloatArray) -> FloatArray:
    """Centres this far inside the rim of RIM."""
    return np.column_stack([50.0 - distance_mm, np.zeros_like(distance_mm)])


@pytest.mark.parametrize("inside", [1.2, 1.0, 0.9, 0.5, 0.1, 0.0, -0.1, -0.5, -1.0, -2.0])
def test_the_force_is_kept(inside: float) -> None:
    sunk = float(rim_sink_mm(np.array([inside]))[0])
    assert force_on_half_plane_n(sunk * DEPTH, inside * A) == pytest.approx(PAPER.force_n, rel=1e-5)
    assert load_share(np.array([inside]), np.array([sunk]))[0] == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("inside", [0.9, 0.3, -0.4, -1.0, -1.3])
def test_where_it_may_sink_no_further_it_carries_what_is_stated(inside: float) -> None:
    held = force_on_half_plane_n(1.2 * DEPTH, inside * A) / PAPER.force_n
    assert load_share(np.array([inside]), np.array([1.2]))[0] == pytest.approx(held, rel=1e-5, abs=1e-9)


def test_known_depths() -> None:
    np.testing.assert_allclose(rim_sink_mm(np.array([1.0, 5.0])), 1.0)
    assert rim_sink_mm(np.array([0.0]))[0] == pytest.approx(2 ** (2 / 3))  # half a contact: d^1.5 doubles


@given(st.floats(-20, 20))
def test_the_root_is_the_root(inside: float) -> None:
    c = min(inside, 1.0)
    s = float(np.sqrt(rim_sink_mm(np.array([inside]))[0]))
    assert s >= max(1.0, -c)
    assert 2 * s**3 + 3 * c * s**2 - c**3 == pytest.approx(4.0, abs=1e-9 * (1 + abs(c) ** 3))


def test_it_sinks_more_the_further_out_and_without_steps() -> None:
    inside = np.linspace(1.5, -2.0, 3501)
    sunk = rim_sink_mm(inside)
    assert (np.diff(sunk) >= -1e-12).all()
    assert np.diff(sunk).max() < 6e-3
    force = load_share(inside, np.minimum(sunk, MOST_SUNK))
    assert (np.diff(force) <= 1e-12).all()
    assert np.abs(np.diff(force)).max() < 2e-3
    assert (force[inside <= -np.sqrt(MOST_SUNK)] <= 1e-12).all()


def test_well_inside_nothing_changes_at_all() -> None:
    gamma = np.array([0.83, 0.87, 0.91])
    found = rim_contact(PAPER, RIM, on_line(np.array([A + 0.01, 10.0, 50.0])), gamma)
    np.testing.assert_array_equal(found.depth_ratio, gamma)
    np.testing.assert_array_equal(found.force, 1.0)
    assert (found.inside > 1).all()


def test_gamma_sets_the_radius_that_overhangs() -> None:
    gamma = np.array([1.0, 0.64])
    found = rim_contact(PAPER, RIM, on_line(np.full(2, 0.5 * A)), gamma)
    np.testing.assert_allclose(found.inside, [0.5, 0.5 / 0.8], rtol=1e-9)
    np.testing.assert_allclose(found.depth_ratio, gamma * rim_sink_mm(found.inside))


def columns(x_mm: FloatArray, most_sunk: float = MOST_SUNK) -> tuple[FloatArray, Grid]:
    """(points, ny, nx) nm/s on a part that ends at x = 0, of dwells at these x; on fine cells."""
    grid = Grid(80, 160, 0.1)
    part = np.broadcast_to(grid.x_mm < 0, grid.shape)
    at = np.column_stack([x_mm, np.zeros_like(x_mm)])
    path = program(at, at, np.pi / 2)
    gamma = np.full(len(x_mm), 0.87)
    shallow = HertzSpot(ToolProcess(viscosity_mpa_s=0.0, second_viscosity_mpa_s=0.0))
    found = rim_contact(PAPER, Straight(1.0), contact_centres_mm(shallow, path, gamma), gamma, most_sunk)
    matrix = effect_matrix(grid, shallow, path, found.depth_ratio, np.ones(len(x_mm)))
    return matrix.toarray().T.reshape(-1, *grid.shape) * part, grid


def test_the_effect_is_the_plain_spots_inside_and_nothing_outside() -> None:
    a = A * np.sqrt(0.87)
    cut, grid = columns(np.array([-a - 0.2, a * np.sqrt(MOST_SUNK) + 0.1]))
    at = np.array([[-a - 0.2, 0.0]])
    still = HertzSpot(ToolProcess(viscosity_mpa_s=0.0, second_viscosity_mpa_s=0.0))
    plain = effect_matrix(grid, still, program(at, at, np.pi / 2), np.array([0.87]), np.ones(1))
    np.testing.assert_allclose(cut[0].ravel(), plain.toarray()[:, 0], rtol=1e-12)
    assert cut[1].max() == 0


def test_over_the_rim_the_volume_stays_and_moves_inwards() -> None:
    """The lean lies along the rim: pressure and volume go together, as the speed is even in x."""
    a = A * np.sqrt(0.87)
    inside = np.array([1.2, 0.6, 0.2, 0.0])
    cut, grid = columns(-inside * a)
    volume = cut.sum(axis=(1, 2))
    np.testing.assert_allclose(volume / volume[0], 1.0, atol=0.02)
    centroid = (cut.sum(axis=1) @ grid.x_mm) / volume
    assert centroid[0] == pytest.approx(-1.2 * a, abs=0.02)
    assert (centroid < -0.3 * a).all()  # the tool's centre comes to the rim, its removal does not
    peak = cut.max(axis=(1, 2))
    assert peak[-1] / peak[0] == pytest.approx(2 ** (1 / 3), rel=0.02)  # pressure goes as the root of the depth


def test_the_removal_has_no_step_as_the_spot_goes_over_the_rim() -> None:
    x = np.arange(-3.0, 3.01, 0.05)
    cut, _ = columns(x)
    volume = cut.sum(axis=(1, 2))
    assert np.abs(np.diff(volume)).max() < 0.06 * volume[0]
    step = np.abs(np.diff(cut, axis=0)).max(axis=(1, 2))
    assert step.max() < 0.2 * cut.max()
    assert volume[-1] == 0


def test_a_stiff_actuator_loses_the_force_instead() -> None:
    a = A * np.sqrt(0.87)
    cut, _ = columns(np.array([-2 * a, 0.0]), most_sunk=1.0)
    volume = cut.sum(axis=(1, 2))
    assert volume[1] / volume[0] == pytest.approx(0.5, abs=0.01)


def test_the_contact_and_not_the_programmed_point_meets_the_rim() -> None:
    spot = HertzSpot(ToolProcess(spot_offset_mm=(0.0, 1.0)))
    path = program([(0.0, 0.0)], [(2.0, 0.0)], 0.0)
    shift = float(contact.dissipative_shift_mm(PAPER, DEPTH))
    centre = contact_centres_mm(spot, path, np.ones(1))
    # half way along the block, 1 mm where the spindle leans (x), the shift to its right
    np.testing.assert_allclose(centre, [[2.0, -shift]], atol=1e-9)


def test_what_cannot_be_is_refused() -> None:
    at = on_line(np.zeros(2))
    for most in (0.5, np.nan, np.inf):
        with pytest.raises(ComputeError, match="the depth that the bonnet may sink to"):
            rim_contact(PAPER, RIM, at, np.ones(2), most)
    for gamma in (0.0, -1.0, np.nan):
        with pytest.raises(ComputeError, match="point 1: gamma is"):
            rim_contact(PAPER, RIM, at, np.array([1.0, gamma]))
    with pytest.raises(ComputeError, match="point 0: the distance from the rim"):
        rim_contact(PAPER, RIM, np.array([[np.nan, 0.0], [0.0, 0.0]]), np.ones(2))


def test_a_straight_side_of_a_polygon_is_a_straight_rim() -> None:
    """Away from its corners; over the rim of a hole the bonnet sinks as over the outer one."""
    inside = np.linspace(-1.5, 1.5, 31) * A
    along = np.stack([np.linspace(-20, 20, 31), 15.0 - inside], axis=1)
    found = rim_contact(PAPER, rectangle(100, 30), along, np.ones(31))
    np.testing.assert_allclose(found.depth_ratio, np.minimum(rim_sink_mm(inside / A), MOST_SUNK), rtol=1e-12)
    hole = rim_contact(PAPER, Circle(50.0, 20.0), np.stack([20.0 + inside, 0 * inside], axis=1), np.ones(31))
    np.testing.assert_allclose(hole.depth_ratio, found.depth_ratio, rtol=1e-12)
