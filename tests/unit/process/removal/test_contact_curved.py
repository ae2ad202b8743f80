"""Contacts on curved parts: against an elastic half space under the true gap, and against the simulated plant."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from polishd.config.simulator_physics import Plant
from polishd.model.errors import ComputeError
from polishd.model.process import FLAT, Optic, ToolProcess
from polishd.model.surface import FloatArray, Grid
from polishd.process import optic_surface
from polishd.process.removal import contact
from polishd.process.removal.contact import CurvedContact, contact_on_curved_part
from polishd.process.removal.dynamic_tif import PointLocation, effects_columns
from polishd.process.removal.tif import HertzSpot
from polishd.sim_backends.plant.part import Shape
from polishd.sim_backends.plant.tool import contact_radius_mm, hertz_depth_mm, wear
from tests.unit.process.removal.half_space import pressure_mpa

TOOL = ToolProcess()
DEPTH_MM = contact.hertz_depth_mm(TOOL)
RADIUS_MM = float(contact.contact_radius_mm(TOOL, DEPTH_MM))
CENTRE = np.zeros((1, 2))
SADDLE = Optic(400.0, 0.0, (-1 / (8 * 400.0 * 90.0**2),), (90.0, 0.0))
"""1 / R along y less than half of it, along x as much the other way."""
GRID = Grid(45, 45, 0.25)
PEAK = 0.005
"""Permitted difference relative to the spot's peak, in cells of a sixth of its radius."""
SQUARES, CELL = 135, 9
"""Across, and of these to a cell: mean over cells, as a map has them, is what is compared."""


def beside_a_flat(optic: Optic, place: FloatArray = CENTRE) -> CurvedContact:
    """Return the contact on an optic that is not flat (None means flat)."""
    found = contact_on_curved_part(TOOL, optic, place)
    assert found is not None
    return found


def cells(values: FloatArray, side: int) -> FloatArray:
    """Return the means over squares of this number of pixels each way."""
    n = len(values) // side
    return np.asarray(values.reshape(n, side, n, side).mean(axis=(1, 3)))


def hertz_mpa(wider: FloatArray, pitch_mm: float) -> FloatArray:
    """(SQUARES, SQUARES) mean pressure of the ellipse in each square."""
    fine = (np.arange(8 * SQUARES) - 4 * SQUARES + 0.5) * pitch_mm / 8
    x, y = np.meshgrid(fine / (RADIUS_MM * wider[0]), fine / (RADIUS_MM * wider[1]))
    shape = cells(np.sqrt(np.clip(1 - x**2 - y**2, 0.0, None)), 8)
    return np.asarray(shape * contact.normal_force_n(TOOL) / (shape.sum() * pitch_mm**2))


@pytest.mark.one_of_each
@pytest.mark.parametrize("optic", [Optic(200.0), Optic(800.0), Optic(2000.0), Optic(-200.0), SADDLE])
def test_the_pressure_is_that_of_the_true_gap(optic: Optic) -> None:
    pitch_mm = 2.6 * RADIUS_MM / SQUARES
    at = (np.arange(SQUARES) - SQUARES // 2) * pitch_mm
    x, y = np.meshgrid(at, at)
    bonnet = TOOL.tool_radius_mm - np.sqrt(TOOL.tool_radius_mm**2 - x**2 - y**2)
    gap = bonnet - optic_surface.sag_mm(optic, np.column_stack([x.ravel(), y.ravel()])).reshape(x.shape)
    true = pressure_mpa(gap, pitch_mm, contact.normal_force_n(TOOL), contact.reduced_modulus_mpa(TOOL))
    own, flat = (hertz_mpa(wider, pitch_mm) for wider in (beside_a_flat(optic).wider[0], np.ones(2)))
    off, as_flat = (np.abs(cells(one - true, CELL)).max() / true.max() for one in (own, flat))
    assert off < PEAK
    assert as_flat > 1.5 * off


def test_a_saddle_is_pressed_as_an_ellipse() -> None:
    found = beside_a_flat(SADDLE)
    assert found.wider[0, 0] < 0.99 < 1.01 < found.wider[0, 1]
    assert abs(found.askew) < 1e-9
    turned = beside_a_flat(replace(SADDLE, offset_mm=(90.0 / np.sqrt(2), 90.0 / np.sqrt(2))))
    assert turned.wider[0, 0] == pytest.approx(turned.wider[0, 1])
    assert abs(turned.askew) > 0.01


@pytest.mark.parametrize("radius_mm", [800.0, -300.0])
def test_a_sphere_gives_the_contact_of_the_relative_curvature(radius_mm: float) -> None:
    """Hertz: radius as R^(1/3), depth as R^(-1/3), the force the same."""
    relative = 1 / (1 - TOOL.tool_radius_mm / radius_mm)
    found = beside_a_flat(Optic(radius_mm), np.array([[0.0, 0.0], [60.0, -30.0]]))
    np.testing.assert_allclose(found.deeper, relative ** (-1 / 3), rtol=1e-6)
    np.testing.assert_allclose(found.wider[0], relative ** (1 / 3), rtol=1e-6)
    np.testing.assert_allclose(found.seen[1], np.sqrt(1 - (60.0**2 + 30.0**2) / radius_mm**2))


@pytest.mark.parametrize(
    ("optic", "place"),
    [
        (Optic(800.0), (150.0, 0.0)),
        (Optic(800.0), (-100.0, 110.0)),
        (Optic(-300.0, 0.4), (0.0, 70.0)),
        (Optic(500.0, -0.6, (2e-9,), (80.0, -40.0)), (20.0, 30.0)),
    ],
)
def test_the_spot_is_the_plant_s(optic: Optic, place: tuple[float, float]) -> None:
    """Which has its own heights, normals and turn along the slope, and the mean of two curvatures for both."""
    point = np.array([place])
    plant = Plant(
        curvature_radius_mm=optic.radius_mm, conic=optic.conic, even=optic.even, off_axis_mm=optic.offset_mm,
        aperture_mm=400.0 if optic.radius_mm == 800.0 else 200.0,
    )  # fmt: skip
    local = Shape(plant).under(point)
    worn = worn_nm(contact_radius_mm(TOOL, local.curvature_per_mm), local.stretch)
    found = beside_a_flat(optic, point)
    own, as_flat = spot_nm(found), spot_nm(None)
    rim = np.abs(as_flat - worn_nm(np.full(1, TOOL.tool_radius_mm), np.eye(2)[None])).max() / as_flat.max()
    off, flat_off = (np.abs(one - worn).max() / worn.max() for one in (own, as_flat))
    assert off < rim + PEAK, "beyond what the squares of either make of a flat's rim"
    assert flat_off > 3 * off
    assert own.sum() == pytest.approx(worn.sum(), rel=1e-3)


def worn_nm(radius_mm: FloatArray, stretch: FloatArray) -> FloatArray:
    """What the plant takes off in a second at rest, the spindle leaning to the right where the surface lies level."""
    dip, worn = np.radians(TOOL.dip_deg), np.zeros(GRID.shape)
    wear(
        worn, GRID, TOOL, centre_mm=np.zeros((1, 2)), axis=np.array([[np.sin(dip), 0.0, np.cos(dip)]]),
        radius_mm=radius_mm, stretch=stretch, depth_mm=hertz_depth_mm(TOOL, np.array([TOOL.force_n]), radius_mm),
        rpm=np.array([TOOL.rpm]), seconds=np.ones(1),
    )  # fmt: skip
    return -worn


def spot_nm(curved: CurvedContact | None) -> FloatArray:
    """Return the controller's spot in fine squares."""
    at = np.zeros((1, 2)), np.zeros((1, 2))
    lie, factor, turned = PointLocation(at), np.ones(1), None
    if curved is not None:
        lie, factor, turned = PointLocation(at, curved.wider), curved.seen, curved.askew
    found = effects_columns(
        GRID, HertzSpot(TOOL, 128), [lie], np.zeros(1), depth_ratio=np.ones(1), factor=factor, correlation=turned
    )
    return np.asarray(found[0].toarray().reshape(GRID.shape))


def test_a_flat_changes_nothing_and_no_point_is_none() -> None:
    assert contact_on_curved_part(TOOL, FLAT, np.zeros((3, 2))) is None
    assert contact_on_curved_part(TOOL, Optic(800.0), np.zeros((0, 3))) is None


def test_without_a_contact_only_the_slope_counts() -> None:
    found = contact_on_curved_part(TOOL, Optic(800.0), np.array([[0.0, 0.0], [150.0, 0.0]]), contact=False)
    assert found is not None
    cosine = np.sqrt(1 - (150.0 / 800.0) ** 2)
    np.testing.assert_allclose(found.wider, [[1.0, 1.0], [cosine, 1.0]], rtol=1e-9)
    np.testing.assert_allclose(found.deeper, 1.0)


def test_a_part_that_the_bonnet_does_not_fit_into_is_refused() -> None:
    with pytest.raises(ComputeError, match=r"radius of curvature is 21 mm.*does not lie in it with a spot"):
        contact_on_curved_part(TOOL, Optic(21.0), CENTRE)
