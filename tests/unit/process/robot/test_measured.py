"""A measured compliance table: affine fields to the last digit, hulls by hand, and tables that are no table."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from polishd.model.errors import ComputeError
from polishd.model.process import MeasuredCompliance
from polishd.model.surface import FloatArray
from polishd.process.robot.compliance import measured_compliance, measured_reachable


def affine(tip: FloatArray) -> FloatArray:
    """um/N, a field that linear interpolation must hit exactly."""
    return np.asarray(1.4 + tip @ [3e-4, -2e-4, 5e-4], dtype=np.float64)


def box(nx: int = 5, ny: int = 4, nz: int = 3) -> FloatArray:
    """A regular grid as a loading test has it: many places on one sphere, which Delaunay has to break up."""
    axes = np.linspace(-400, 400, nx), np.linspace(-300, 300, ny), np.linspace(1800, 2200, nz)
    return np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")], axis=1)


def table(tip: FloatArray, value: FloatArray | None = None) -> MeasuredCompliance:
    tip = np.asarray(tip, dtype=np.float64)
    return MeasuredCompliance(tip, affine(tip) if value is None else np.asarray(value), "loads.csv")


def test_an_affine_field_comes_back_exactly_in_space() -> None:
    rng = np.random.default_rng(1)
    tip = rng.uniform([-400, -300, 1800], [400, 300, 2200], (5000, 3))
    np.testing.assert_allclose(measured_compliance(table(box()), tip), affine(tip) * 1e-3, rtol=1e-12)


def test_places_scattered_at_random_do_too() -> None:
    rng = np.random.default_rng(2)
    places = rng.uniform([-500, -500, 1500], [500, 500, 2500], (60, 3))
    corners = rng.dirichlet(np.ones(60), 500) @ places
    np.testing.assert_allclose(measured_compliance(table(places), corners), affine(corners) * 1e-3, rtol=1e-12)


def test_the_places_themselves_are_inside_and_keep_their_value() -> None:
    places = box()
    value = np.random.default_rng(3).uniform(1.0, 2.0, len(places))
    measured = table(places, value)
    assert measured_reachable(measured, places).all()
    np.testing.assert_allclose(measured_compliance(measured, places), value * 1e-3, rtol=1e-9)


def test_between_the_extremes_and_never_beyond() -> None:
    rng = np.random.default_rng(4)
    measured = table(box(), rng.uniform(1.0, 2.0, len(box())))
    got = measured_compliance(measured, rng.uniform([-400, -300, 1800], [400, 300, 2200], (3000, 3)))
    assert (
        measured.compliance_um_per_n.min() * 1e-3 <= got.min() < got.max() <= measured.compliance_um_per_n.max() * 1e-3
    )


def test_one_simplex_by_hand() -> None:
    places = np.array([[0.0, 0, 0], [100, 0, 0], [0, 100, 0], [0, 0, 100]])
    measured = table(places, [1.0, 2.0, 3.0, 4.0])
    got = measured_compliance(measured, np.array([[25.0, 25, 25], [50, 50, 0], [10, 0, 0]]))
    np.testing.assert_allclose(got * 1e3, [2.5, 2.5, 1.1], rtol=1e-12)
    outside = np.array([[34.0, 34, 34], [-0.1, 10, 10], [33.3, 33.3, 33.3]])
    assert measured_reachable(measured, outside).tolist() == [False, False, True]


tilt = st.floats(-0.5, 0.5)


@given(tilt, tilt)
def test_one_height_or_any_other_plane_is_enough(slope_x: float, slope_y: float) -> None:
    flat = box(nz=1)
    flat[:, 2] = 2000 + slope_x * flat[:, 0] + slope_y * flat[:, 1]
    rng = np.random.default_rng(5)
    tip = rng.dirichlet(np.ones(len(flat)), 50) @ flat
    normal = np.array([-slope_x, -slope_y, 1.0]) / np.linalg.norm([slope_x, slope_y, 1.0])
    np.testing.assert_allclose(measured_compliance(table(flat), tip), affine(tip) * 1e-3, rtol=1e-12)
    assert measured_reachable(table(flat), tip + 0.9 * normal).all()
    assert not measured_reachable(table(flat), tip - 1.1 * normal).any()
    with pytest.raises(ComputeError, match=r"point 0: .*distance from the plane of the table loads.csv is 1.1 mm"):
        measured_compliance(table(flat), tip + 1.1 * normal)


def on_line(place: list[float], aside: float = 0.0) -> FloatArray:
    return np.stack([np.multiply(place, 0.6) + 10, np.full(len(place), 20 + aside), np.multiply(place, 0.8) + 2000], 1)


def test_a_line_of_places_in_any_order() -> None:
    measured = table(on_line([300.0, -100.0, 200.0, 0.0]), [4.0, 1.0, 2.0, 3.0])
    at = [-50.0, 100.0, 250.0, 300.0, -100.0]
    for aside in (0.0, 0.5):
        got = measured_compliance(measured, on_line(at, aside))
        np.testing.assert_allclose(got * 1e3, [2.0, 2.5, 3.0, 4.0, 1.0], rtol=1e-12)
    with pytest.raises(ComputeError, match=r"point 0: .* from the line of the table loads.csv is 1.5 mm, at most 1 mm"):
        measured_compliance(measured, on_line(at, 1.5))
    assert measured_reachable(measured, on_line([-101.0, 0.0, 301.0])).tolist() == [False, True, False]


def test_a_table_not_quite_flat_is_flat() -> None:
    flat = box(nz=1)
    wavy = flat + np.random.default_rng(6).uniform(-0.3, 0.3, flat.shape) * [0, 0, 1]
    got = measured_compliance(table(wavy, affine(flat)), np.array([[33.0, -45.0, 1800.0]]))
    assert got[0] * 1e3 == pytest.approx(affine(np.array([[33.0, -45.0, 1800.0]]))[0], abs=1e-5)


def test_outside_of_the_hull_is_refused_by_name() -> None:
    tip = np.array([[0.0, 0, 2000], [0, 0, 2150], [460.0, 300, 2200]])
    says = r"point 2: .*distance from the nearest place measured is 60 mm, .* hull of the table loads.csv: not extrapol"
    with pytest.raises(ComputeError, match=says):
        measured_compliance(table(box()), tip)
    assert measured_reachable(table(box()), tip).tolist() == [True, True, False]


@pytest.mark.parametrize("places", [box(), box(nz=1), box(nx=1, nz=1)])
def test_a_place_measured_twice_alike_counts_once(places: FloatArray) -> None:
    twice = np.vstack([places, places[: len(places) // 2]])
    tip = places[:1] / 3 + 2 * places[-1:] / 3
    np.testing.assert_allclose(measured_compliance(table(twice), tip), affine(tip) * 1e-3, rtol=1e-12)


def test_a_place_measured_twice_otherwise_is_refused() -> None:
    value = np.append(affine(box()), 1.77)
    with pytest.raises(ComputeError, match=r"point 60: .* place that was measured before is 1.77 um/N"):
        measured_compliance(table(np.vstack([box(), box()[:1]]), value), box())


def test_no_points_are_no_points() -> None:
    nothing = np.empty((0, 3))
    for places in (box(), box(nz=1), box(nx=1, nz=1)):
        assert measured_compliance(table(places), nothing).shape == (0,)
        assert measured_reachable(table(places), nothing).shape == (0,)


@pytest.mark.parametrize(
    ("tip", "value", "says"),
    [
        (box()[:1], [1.0], "has 1 places: at least 2 are needed"),
        (np.empty((0, 3)), [], "has 0 places: at least 2 are needed"),
        ([[0.0, 0, 0], [0.5, 0, 0]], [1.0, 1.1], "extends over 0.5 mm, it must be above 1 mm"),
        (box()[:3], [1.0, -1.2, 1.0], "point 1: the compliance measured is -1.2 um/N, it must be finite and above 0"),
        (box()[:3], [1.0, 1.0, np.nan], "point 2: the compliance measured is nan um/N"),
        (box()[:3], [1.0, 0.0, 1.0], "point 1: the compliance measured is 0 um/N"),
        ([[0.0, 0, 0], [0, np.inf, 0]], [1.0, 1.0], "point 1: place measured is inf mm"),
        (box()[:3], [1.0, 1.0], r"3 places and compliances of the shape \(2,\)"),
        (box()[:, :2], [1.0] * 60, r"place measured has the shape \(60, 2\)"),
    ],
)
def test_a_table_that_is_none_is_refused(tip: FloatArray, value: list[float], says: str) -> None:
    measured = MeasuredCompliance(np.asarray(tip), np.asarray(value))
    for ask in (measured_compliance, measured_reachable):
        with pytest.raises(ComputeError, match=says):
            ask(measured, np.array([[0.0, 0, 0]]))


def test_a_point_that_is_no_number_is_refused() -> None:
    with pytest.raises(ComputeError, match="point 1: tool tip is nan mm"):
        measured_compliance(table(box()), np.array([[0.0, 0, 2000], [0, np.nan, 2000]]))
