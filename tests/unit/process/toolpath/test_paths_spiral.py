"""The geometry of spirals: pitch and steps along the surface, the centre, hole and rim, ways out."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import KDTree

from polishd.model.errors import ComputeError
from polishd.model.process import FLAT, Optic
from polishd.model.surface import FloatArray, Grid
from polishd.process.optic_surface import sag_mm
from polishd.process.toolpath.apertures import Aperture, annulus, circle, ellipse, over_mask, rectangle
from polishd.process.toolpath.paths import spiral as whole_spiral
from tests.unit.process.toolpath.test_paths_raster import lengths, outside, samples

MASK = over_mask(Grid(60, 60, 1.0), Grid(60, 60, 1.0).radius_mm() < 25)
APERTURES = {
    "circle": circle(60),
    "ellipse": ellipse(70, 30),
    "rectangle": rectangle(50, 24),
    "ring": annulus(60, 20),
    "mask": MASK,
}


def spiral(aperture: Aperture, pitch_mm: float, step_mm: float, **more: Any) -> FloatArray:
    """The turns, and the way out."""
    return whole_spiral(aperture, pitch_mm, step_mm, way_in=False, **more)


def run(points: FloatArray) -> FloatArray:
    """(n,) angle run through since the first point off the centre."""
    return np.asarray(np.unwrap(np.arctan2(points[:, 1], points[:, 0])))


def on_curve(points: FloatArray, aperture: Aperture, overrun: float = 1.0) -> FloatArray:
    """The points before the way out."""
    return points[: int(np.argmax(outside(aperture.larger(overrun), points) > 1e-3)) or len(points)]


@settings(max_examples=25)
@given(st.floats(5, 60), st.floats(0.3, 4), st.floats(0.2, 3), st.floats(0, 3), st.floats(0, 8))
def test_any_spiral_on_a_flat(radius: float, pitch: float, step: float, overrun: float, landing: float) -> None:
    """Archimedes: the radius grows by the pitch a turn; the way along it has equal steps, by the arc's closed form."""
    aperture = circle(2 * radius)
    points = spiral(aperture, pitch, step, overrun_mm=overrun, landing_mm=landing)
    r = np.hypot(points[:, 0], points[:, 1])
    curve = points[: int(np.argmax(r >= radius + overrun - 1e-9)) or len(points)]
    r = r[: len(curve)]
    grown, seen = 2 * np.pi * r / pitch, np.arctan2(curve[:, 1], curve[:, 0])
    theta = seen + 2 * np.pi * np.round((grown - seen) / (2 * np.pi))
    theta[0] = 0.0
    np.testing.assert_allclose(grown, theta, atol=1e-9, rtol=1e-6)  # the rim is a polygon of 4096 sides
    way = pitch / (4 * np.pi) * (theta * np.sqrt(1 + theta**2) + np.arcsinh(theta))
    steps = np.diff(way)[:-1]
    np.testing.assert_allclose(steps, steps.mean(), rtol=1e-3)
    assert steps.mean() == pytest.approx(step, rel=0.5 / len(steps) + 1e-3)
    assert np.hypot(*points[-1, :2]) >= radius + landing - 1e-6


def test_the_centre_is_one_point() -> None:
    points = spiral(circle(50), 1.0, 1.0)
    assert np.abs(points[0]).max() < 1e-12
    assert np.linalg.norm(points[1:, :2], axis=1).min() > 0.3
    assert lengths(points).min() > 0.4


@pytest.mark.parametrize("optic", [FLAT, Optic(80.0)])
def test_inwards_is_the_same_run_back(optic: Optic) -> None:
    out = spiral(circle(50), 1.0, 1.0, optic=optic)
    back = spiral(circle(50), 1.0, 1.0, optic=optic, inwards=True)
    np.testing.assert_array_equal(back, out[::-1])
    assert back.flags.c_contiguous


def test_it_runs_counterclockwise_from_the_centre() -> None:
    angle = run(spiral(circle(50), 1.0, 1.0)[1:])
    assert (np.diff(angle) > 0).all()
    assert angle[-1] - angle[0] == pytest.approx(2 * np.pi * 26, rel=0.05)


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize("name", APERTURES)
@pytest.mark.parametrize("optic", [FLAT, Optic(120.0, -0.5, (1e-8,), (30.0, 10.0))])
def test_any_aperture_is_covered(name: str, optic: Optic) -> None:
    aperture = APERTURES[name]
    points = spiral(aperture, 1.0, 1.0, optic=optic, overrun_mm=1.5, landing_mm=6.0)
    covered = samples(aperture)
    covered = covered[np.hypot(*covered.T) >= aperture.hole_mm]
    assert KDTree(points[:, :2]).query(covered)[0].max() < 0.9, "half a pitch, and half a step along"
    np.testing.assert_allclose(points[:, 2], sag_mm(optic, points[:, :2]), atol=1e-12)
    assert outside(aperture, points[-1:])[0] > 6.0 - 1e-3
    curve = on_curve(points, aperture, 1.5)
    assert outside(aperture, curve).max() <= 1.5 + 1e-3
    assert outside(aperture, curve[-1:])[0] > 1.0, "it ends on the rim of what is covered"


def test_a_ring_keeps_out_of_its_hole() -> None:
    points = spiral(annulus(60, 20), 1.0, 1.0, overrun_mm=1.5)
    r = np.hypot(points[:, 0], points[:, 1])
    assert r.min() == pytest.approx(8.5, abs=1e-3)
    assert np.argmin(r) == 0
    through = spiral(annulus(60, 20), 1.0, 1.0, overrun_mm=11)
    assert np.abs(through[0]).max() < 1e-12, "an overrun over all of the hole ends at the centre"


@pytest.mark.parametrize("optic", [Optic(60.0), Optic(-60.0), Optic(80.0, -1.0, (1e-6,))])
def test_on_an_optic_the_pitch_is_measured_along_it(optic: Optic) -> None:
    points = spiral(circle(80), 1.0, 0.2, optic=optic, overrun_mm=0.0, landing_mm=0.0)
    angle = np.concatenate([[0.0], run(points[1:]) - run(points[1:2]) + np.arctan2(*points[1, 1::-1]) % (2 * np.pi)])
    crossings = np.interp(2 * np.pi * np.arange(1, int(angle[-1] / 2 / np.pi)), angle, np.hypot(*points.T[:2]))
    fine = np.linspace(crossings[:-1], crossings[1:], 41)
    height = sag_mm(optic, np.column_stack([fine.ravel(), 0 * fine.ravel()])).reshape(fine.shape)
    apart = np.hypot(np.diff(fine, axis=0), np.diff(height, axis=0)).sum(axis=0)
    np.testing.assert_allclose(apart, 1.0, rtol=3e-3)
    assert np.diff(crossings)[-1] < 0.9, "which is less seen from above"


@pytest.mark.parametrize("optic", [Optic(60.0), Optic(150.0, -0.6, (1e-7,), (40.0, -25.0))])
def test_steps_are_equal_along_the_surface(optic: Optic) -> None:
    """Of short steps the chords are as good as the ways."""
    size = lengths(spiral(circle(60), 1.0, 0.1, optic=optic))
    np.testing.assert_allclose(size[200:-300], 0.1, rtol=1e-3)
    assert size.max() < 0.11


@pytest.mark.full
def test_over_an_ellipse_the_turns_keep_its_shape() -> None:
    points = spiral(ellipse(80, 40), 1.0, 0.3, overrun_mm=0.0)
    curve = on_curve(points, ellipse(80, 40), 0.0)[1:]
    size = np.hypot(curve[:, 0], 2 * curve[:, 1])
    angle = np.unwrap(np.arctan2(2 * curve[:, 1], curve[:, 0]))
    # the angle run through is that seen from the centre, the ellipse's own differs by a periodic part
    turns = np.interp(2 * np.pi * np.arange(2, 39), angle, size)
    np.testing.assert_allclose(np.diff(turns), 1.0, rtol=5e-3)


def test_the_way_out_is_straight_on() -> None:
    points = spiral(circle(60), 1.0, 0.5, landing_mm=8.0)
    move = np.diff(points, axis=0) / lengths(points)[:, None]
    bend = np.degrees(np.arccos(np.clip(np.einsum("ni,ni->n", move[1:], move[:-1]), -1, 1)))
    assert bend[100:].max() < 10.0, "no corner anywhere off the centre"
    np.testing.assert_allclose(bend[-10:], 0.0, atol=1e-5)
    assert len(spiral(circle(60), 1.0, 0.5, landing_mm=0.0)) < len(points)


@pytest.mark.one_of_each
@pytest.mark.parametrize("inwards", [False, True])
@pytest.mark.parametrize("optic", [FLAT, Optic(120.0, -0.5, (1e-8,), (30.0, 10.0))])
@pytest.mark.parametrize("name", APERTURES)
def test_it_lands_and_lifts_beside_the_part(name: str, optic: Optic, inwards: bool) -> None:
    """A tool that stands on the part while the force comes digs a pit: the way in crosses it in contact, moving."""
    aperture = APERTURES[name]
    points = whole_spiral(aperture, 1.0, 1.0, optic=optic, landing_mm=6.0, inwards=inwards)
    assert (outside(aperture, points[[0, -1]]) > 6.0 - 1e-3).all()
    turns = spiral(aperture, 1.0, 1.0, optic=optic, landing_mm=6.0)
    way = points[: -len(turns)] if not inwards else points[len(turns) :]
    run_back = points[::-1] if inwards else points
    np.testing.assert_array_equal(run_back[-len(turns) :], turns, "with the way in, the turns are the same")
    assert lengths(points).max() < 1.6, "and nothing is jumped over"
    across = np.diff(way[:, :2], axis=0)
    across /= np.linalg.norm(across, axis=1)[:, None]
    np.testing.assert_allclose(across, across[:1].repeat(len(across), axis=0), atol=1e-9)


def test_an_optic_that_ends_before_the_path_does() -> None:
    with pytest.raises(
        ComputeError, match=r"the distance from the part's axis is \d+\.?\d* mm, .* 50 mm from its axis"
    ):
        spiral(circle(98), 1.0, 1.0, optic=Optic(50.0), overrun_mm=2.0)


@pytest.mark.parametrize(
    ("pitch", "step", "what"),
    [(0.0, 1.0, "the pitch is 0"), (1.0, -1.0, "the step is -1"), (1, 1e-7, "number of points")],
)
def test_lengths_that_are_none(pitch: float, step: float, what: str) -> None:
    with pytest.raises(ComputeError, match=what):
        spiral(circle(50), pitch, step)
    with pytest.raises(ComputeError, match="overrun is nan"):
        spiral(circle(50), 1.0, 1.0, overrun_mm=float("nan"))


@pytest.mark.full
def test_a_million_points() -> None:
    points = spiral(circle(1100), 1.0, 1.0, optic=Optic(4000.0, -1.0))
    assert 0.95e6 < len(points) < 1.05e6
    assert np.isfinite(points).all()


def test_a_phase_shifts_the_turns() -> None:
    """On each ray from the center the turns of the second spiral lie between those of the first."""
    crossed = []
    for phase in (0.0, 0.5):
        points = spiral(circle(60), 2.0, 0.2, phase=phase, landing_mm=0.0)[1:]
        angle = run(points)
        crossed.append(np.interp(2 * np.pi * np.arange(2, 14), angle, np.hypot(*points.T[:2])))
    np.testing.assert_allclose(np.diff(crossed, axis=1), 2.0, atol=0.02)
    np.testing.assert_allclose(np.abs(crossed[1] - crossed[0]) % 2.0, 1.0, atol=0.02)


@pytest.mark.parametrize("phase", [0.0, 0.25, 0.5])
def test_concentric_rings(phase: float) -> None:
    points = spiral(circle(60), 2.0, 0.5, rings=True, phase=phase)
    r = np.hypot(*points.T[:2])
    rings = (0.5 + phase) % 1.0 * 2.0 + 2.0 * np.arange(1, 15)
    on_ring = np.abs(r[:, None] - rings[rings < 30]).min(axis=1) < 1e-2  # chords of 0.5 mm
    within = (r > 4) & (r < 29)
    assert 0.8 < on_ring[within].mean() < 0.95, "an eighth of each turn leads to the next"
    assert lengths(points)[5:-25].max() < 0.51


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize("phase", [0.0, 0.5])
@pytest.mark.parametrize("name", APERTURES)
def test_rings_cover_any_aperture(name: str, phase: float) -> None:
    aperture = APERTURES[name]
    points = whole_spiral(aperture, 1.0, 1.0, rings=True, phase=phase, landing_mm=6.0)
    covered = samples(aperture)
    covered = covered[np.hypot(*covered.T) >= aperture.hole_mm]
    assert KDTree(points[:, :2]).query(covered)[0].max() < 1.2
    assert (outside(aperture, points[[0, -1]]) > 6.0 - 1e-3).all()
    if aperture.hole_mm:
        turns = spiral(aperture, 1.0, 1.0, rings=True, phase=phase)
        assert np.hypot(*turns.T[:2]).min() > aperture.hole_mm - 2.0
