"""Heights and normals of the nominal surface: closed forms, finite differences, implicit equations, refusals."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polishd.model.errors import ComputeError
from polishd.model.process import FLAT, Optic
from polishd.model.surface import FloatArray
from polishd.process.optic_surface import is_flat, sag_mm, unit_normals

PLANE = np.random.default_rng(7).uniform(-60, 60, (400, 2))
RADII = st.one_of(st.floats(150, 5000), st.floats(-5000, -150))


def printed(optic: Optic, x: FloatArray, y: FloatArray) -> FloatArray:
    """The height over the parent's vertex, as `Optic` prints it."""
    r2 = x**2 + y**2
    radius = np.inf if optic.radius_mm is None else optic.radius_mm
    z = r2 / (radius * (1 + np.sqrt(1 - (1 + optic.conic) * r2 / radius**2))) if np.isfinite(radius) else 0 * r2
    return np.asarray(z + sum(a * r2 ** (2 + k) for k, a in enumerate(optic.even)))


def differences(optic: Optic, plane: FloatArray, h: float = 1e-3) -> FloatArray:
    """(n, 3) unit normals by central differences of the heights."""
    slope = [(sag_mm(optic, plane + step) - sag_mm(optic, plane - step)) / (2 * h) for step in h * np.eye(2)]
    normal = np.column_stack([-slope[0], -slope[1], np.ones(len(plane))])
    return np.asarray(normal / np.linalg.norm(normal, axis=1)[:, None])


def frame_by_hand(optic: Optic) -> tuple[FloatArray, FloatArray]:
    """Origin and axes of the part's frame: the short way from the parent's z to the normal, by Rodrigues' formula."""
    x, y = (np.array([value]) for value in optic.offset_mm)
    h = 1e-4
    slope = np.array(
        [
            (printed(optic, x + h, y) - printed(optic, x - h, y))[0] / (2 * h),
            (printed(optic, x, y + h) - printed(optic, x, y - h))[0] / (2 * h),
        ]
    )
    normal = np.append(-slope, 1.0) / np.sqrt(1 + slope @ slope)
    about = np.cross([0.0, 0.0, 1.0], normal)
    sine, cosine = np.linalg.norm(about), normal[2]
    k = about / max(sine, 1e-300)
    cross = np.array([[0, -k[2], k[1]], [k[2], 0, -k[0]], [-k[1], k[0], 0]])
    return np.array([x[0], y[0], printed(optic, x, y)[0]]), np.eye(3) + sine * cross + (1 - cosine) * cross @ cross


def test_a_flat_is_flat() -> None:
    assert is_flat(FLAT)
    assert is_flat(Optic(None, -1.0, (0.0,), (20.0, 3.0)))
    assert not is_flat(Optic(None, 0.0, (1e-9,)))
    np.testing.assert_array_equal(sag_mm(FLAT, PLANE), 0)
    np.testing.assert_array_equal(unit_normals(FLAT, PLANE), np.tile([0, 0, 1], (len(PLANE), 1)))


@pytest.mark.parametrize("radius", [200.0, -200.0, 90.0])
def test_a_sphere_in_closed_form(radius: float) -> None:
    z = sag_mm(Optic(radius), PLANE)
    centre = np.array([0.0, 0.0, radius])
    points = np.column_stack([PLANE, z])
    np.testing.assert_allclose(np.linalg.norm(points - centre, axis=1), abs(radius), rtol=1e-14)
    assert (np.sign(z) == np.sign(radius)).all(), "concave rises towards the rim, convex falls"
    normals = unit_normals(Optic(radius), PLANE)
    np.testing.assert_allclose(normals, (centre - points) / radius, atol=1e-14)
    assert (normals[:, 2] > 0).all(), "out of the part"


def test_a_paraboloid_in_closed_form() -> None:
    z = sag_mm(Optic(300.0, -1.0), PLANE)
    np.testing.assert_allclose(z, (PLANE**2).sum(axis=1) / 600, rtol=1e-14)
    slope = unit_normals(Optic(300.0, -1.0), PLANE)
    np.testing.assert_allclose(-slope[:, :2] / slope[:, 2:], PLANE / 300, rtol=1e-13, atol=1e-15)


def test_an_asphere_is_its_formula() -> None:
    optic = Optic(-250.0, -0.7, (3e-8, -2e-12, 1e-16))
    np.testing.assert_allclose(sag_mm(optic, PLANE), printed(optic, *PLANE.T), rtol=1e-14)
    corrector = Optic(None, 0.0, (1e-8,))
    np.testing.assert_allclose(sag_mm(corrector, PLANE), 1e-8 * (PLANE**2).sum(axis=1) ** 2, rtol=1e-13)


@settings(max_examples=60)
@given(
    RADII, st.floats(-3, 1.5), st.floats(-1e-8, 1e-8), st.floats(-1e-12, 1e-12), st.floats(0, 60), st.floats(-40, 40)
)
def test_normals_are_those_of_the_heights(
    radius: float, conic: float, a4: float, a6: float, x0: float, y0: float
) -> None:
    optic = Optic(radius, conic, (a4, a6), (x0, y0))
    plane = PLANE[:50] / 2
    normals = unit_normals(optic, plane)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, rtol=1e-14)
    np.testing.assert_allclose(normals, differences(optic, plane), atol=3e-8)


@settings(max_examples=60)
@given(RADII, st.floats(-3, 1.0), st.floats(-1e-8, 1e-8), st.floats(-60, 60), st.floats(-60, 60))
def test_an_off_axis_piece_lies_on_its_parent(radius: float, conic: float, a4: float, x0: float, y0: float) -> None:
    optic = Optic(radius, conic, (a4,), (x0, y0))
    plane = PLANE[:50] / 2
    centre, axes = frame_by_hand(optic)
    at = centre + np.column_stack([plane, sag_mm(optic, plane)]) @ axes.T
    np.testing.assert_allclose(at[:, 2], printed(optic, at[:, 0], at[:, 1]), atol=2e-8)


@pytest.mark.parametrize("offset", [(40.0, 0.0), (0.0, -70.0), (-30.0, 55.0)])
def test_the_part_lies_level_at_its_own_centre(offset: tuple[float, float]) -> None:
    optic = Optic(220.0, -1.3, (2e-9,), offset)
    origin = np.zeros((1, 2))
    assert sag_mm(optic, origin)[0] == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(unit_normals(optic, origin), [[0, 0, 1]], atol=1e-14)


@pytest.mark.parametrize("even", [(), (0.0,)])
def test_a_piece_of_a_sphere_is_that_sphere(even: tuple[float, ...]) -> None:
    """Wherever it is cut: also through Newton's steps, which the coefficient asks for... where it is not 0."""
    whole, piece = Optic(180.0), Optic(180.0, 0.0, even, (70.0, -50.0))
    np.testing.assert_allclose(sag_mm(piece, PLANE), sag_mm(whole, PLANE), atol=1e-11)
    np.testing.assert_allclose(unit_normals(piece, PLANE), unit_normals(whole, PLANE), atol=1e-13)


def test_newton_agrees_with_the_closed_form() -> None:
    """A sphere as a paraboloid with the even terms of its series, off axis, is nearly that sphere; and a tiny term
    changes only the closed form."""
    exact, series = Optic(400.0, 0.0, (), (50.0, 20.0)), Optic(400.0, -1.0, _series(400.0, 9), (50.0, 20.0))
    np.testing.assert_allclose(sag_mm(series, PLANE), sag_mm(exact, PLANE), atol=1e-10)
    np.testing.assert_allclose(unit_normals(series, PLANE), unit_normals(exact, PLANE), atol=1e-11)
    tiny = Optic(400.0, -0.5, (1e-20,), (50.0, 20.0))
    np.testing.assert_allclose(sag_mm(tiny, PLANE), sag_mm(Optic(400.0, -0.5, (), (50.0, 20.0)), PLANE), atol=1e-11)


def _series(radius: float, terms: int) -> tuple[float, ...]:
    """A4, A6, ... of a sphere's height beyond r^2 / 2R."""
    found, binomial = [], 1.0
    for k in range(1, terms + 2):
        binomial *= (0.5 - (k - 1)) / k
        found.append(-binomial * (-1.0) ** k / radius ** (2 * k - 1))
    return tuple(found[1:])


def test_an_off_axis_paraboloid_in_closed_form() -> None:
    """Cut along x: in the part's frame it obeys the quadratic that a turn of x and z by the slope gives."""
    x0, radius = 80.0, 300.0
    optic = Optic(radius, -1.0, (), (x0, 0.0))
    slope = x0 / radius
    c, s = 1 / np.hypot(1, slope), slope / np.hypot(1, slope)
    u, v = PLANE.T
    w = sag_mm(optic, PLANE)
    x, z = x0 + c * u - s * w, x0**2 / (2 * radius) + s * u + c * w
    np.testing.assert_allclose(z, (x**2 + v**2) / (2 * radius), atol=1e-12)


def test_beyond_the_sphere() -> None:
    plane = np.array([[10.0, 0.0], [30.0, -45.0], [60.0, 0.0]])
    what = (
        r"point 1: the distance from the part's axis is 54\.0833 mm, .*before it, 50 mm from its axis; at x 30, y -45"
    )
    with pytest.raises(ComputeError, match=what):
        sag_mm(Optic(50.0), plane)
    with pytest.raises(ComputeError, match=r"2 of 3 points"):
        unit_normals(Optic(-50.0), plane)
    assert np.isfinite(sag_mm(Optic(50.0, -1.0), plane)).all(), "a paraboloid goes on"
    with pytest.raises(ComputeError, match=r"point 2: .* before it, 55\.9"):
        sag_mm(Optic(50.0, -0.2), plane)


def test_beyond_an_off_axis_piece() -> None:
    with pytest.raises(ComputeError, match=r"point 0: the distance from the part's axis is 120 mm"):
        sag_mm(Optic(100.0, 0.0, (), (120.0, 0.0)), np.zeros((1, 2)))
    with pytest.raises(ComputeError, match=r"point 1: the distance from the part's centre is 101 mm"):
        sag_mm(Optic(100.0, 0.0, (), (60.0, 0.0)), np.array([[0.0, 0.0], [101.0, 0.0]]))
    with pytest.raises(ComputeError, match=r"point 0: the distance from the part's centre is 99 mm"):
        sag_mm(Optic(100.0, 0.0, (), (60.0, 0.0)), np.array([[99.0, 0.0]]))  # on the sphere's upper half
    assert np.isfinite(sag_mm(Optic(100.0, 0.0, (), (60.0, 0.0)), np.array([[-99.0, 0.0], [79.0, 0.0]]))).all()


def test_where_a_piece_turns_away_it_is_refused() -> None:
    """A hump so steep that a line along the part's z misses it, or meets it from below."""
    with pytest.raises(ComputeError, match="point 0"):
        sag_mm(Optic(1000.0, 0.0, (1e-4,), (20.0, 0.0)), np.array([[-60.0, 0.0]]))


@pytest.mark.parametrize(
    ("optic", "what"),
    [
        (Optic(0.0), "radius of curvature is 0"),
        (Optic(np.nan), "radius of curvature is nan"),
        (Optic(np.inf), "radius of curvature is inf"),
        (Optic(100.0, np.nan), "conic nan"),
        (Optic(100.0, 0.0, (np.inf,)), "coefficients"),
        (Optic(100.0, 0.0, (), (np.nan, 0.0)), "offset"),
    ],
)
def test_an_optic_that_is_none(optic: Optic, what: str) -> None:
    for function in (sag_mm, unit_normals):
        with pytest.raises(ComputeError, match=what):
            function(optic, PLANE)
