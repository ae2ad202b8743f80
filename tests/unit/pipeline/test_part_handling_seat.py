"""The seat of a part from three heights: rigid bodies that are really moved, flat and curved."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from polishd.model.errors import ComputeError
from polishd.model.outline import Circle, Outline, hexagon, polygon, rectangle
from polishd.model.part_handling import PartSeat, TouchOff
from polishd.model.process import FLAT, Optic
from polishd.model.surface import FloatArray
from polishd.pipeline.part_handling import rim_points_mm, seat_of, separate_seat_terms
from polishd.process import optic_surface

RIM_MM, EDGE_MM = 50.0, 3.0
OPTICS = {
    "flat": FLAT,
    "concave": Optic(200.0),
    "convex": Optic(-150.0, -1.0),
    "off axis": Optic(400.0, -1.0, (), (60.0, 20.0)),
}


def asked(optic: Optic, places: FloatArray | None = None, dip_deg: float = 15.0) -> TouchOff:
    """A touch-off whose tool leans by the dip, towards +x."""
    flat = rim_points_mm(Circle(RIM_MM), EDGE_MM) if places is None else places
    points, normal = np.column_stack([flat, optic_surface.sag_mm(optic, flat)]), optic_surface.unit_normals(optic, flat)
    axis = Rotation.from_euler("y", dip_deg, degrees=True).apply(normal)
    return TouchOff(0.8, 5.0, 0.3, each_pass=False, points_mm=points, normal=normal, axis=axis, rim_mm=RIM_MM)


def early_mm(off: TouchOff, optic: Optic, height_mm: float, about_x: float, about_y: float) -> FloatArray:
    """(3,) how much earlier the tool's way along its axis ends on a part that is really moved so."""
    turn = Rotation.from_rotvec(np.radians([about_x, about_y, 0.0]))

    def above(place: int, way_mm: float) -> float:
        """Of the point so far back on the tool's way, over the moved surface, in the part's own frame."""
        point = off.points_mm[place] + way_mm * off.axis[place]
        own = turn.inv().apply(point - [0.0, 0.0, height_mm])
        return float(own[2] - optic_surface.sag_mm(optic, own[None, :2])[0])

    return np.array([brentq(lambda way_mm, k=k: above(k, way_mm), -5.0, 5.0) for k in range(3)])


@pytest.mark.parametrize("name", OPTICS)
@pytest.mark.parametrize("moved", [(0.5, 0.0, 0.0), (-0.2, 0.1, -0.3), (0.0, 0.4, 0.0)])
def test_a_part_that_is_really_moved_is_found_so(name: str, moved: tuple[float, float, float]) -> None:
    off = asked(OPTICS[name])
    seat = seat_of(off, early_mm(off, OPTICS[name], *moved))
    assert seat.height_mm == pytest.approx(moved[0], abs=0.006)
    assert seat.tilt_deg == pytest.approx(moved[1:], abs=0.01)


def test_a_flat_in_numbers() -> None:
    """Half a millimetre early along a tool that leans by 15 deg is less along the normal."""
    off = asked(FLAT)
    seat = seat_of(off, np.full(3, 0.5))
    high_mm = 0.5 * np.cos(np.radians(15))
    assert seat.off_mm == pytest.approx([high_mm] * 3)
    assert seat.worst_mm == pytest.approx(high_mm)
    assert seat.tilt_deg == pytest.approx((0.0, 0.0), abs=1e-12)
    assert str(seat) == "0.483 mm too high, tilted by +0.000 deg about x and +0.000 deg about y"
    assert off.reach_mm == pytest.approx(0.3 / np.cos(np.radians(15)))


def test_the_worst_place_of_a_tilted_part_is_its_rim() -> None:
    """Between the places it may rise farther than at any of them."""
    off = asked(FLAT)
    seat = seat_of(off, early_mm(off, FLAT, 0.0, 0.2, 0.0))
    assert seat.worst_mm == pytest.approx(RIM_MM * np.tan(np.radians(0.2)), rel=1e-3)


def test_the_places_lie_on_the_rim_a_third_of_a_turn_apart() -> None:
    places = rim_points_mm(Circle(RIM_MM), EDGE_MM)
    assert np.hypot(*places.T) == pytest.approx([48.5] * 3)
    sides = np.linalg.norm(places - np.roll(places, 1, axis=0), axis=1)
    assert sides == pytest.approx([48.5 * np.sqrt(3)] * 3)


@pytest.mark.parametrize(
    "outline", [rectangle(40, 24), hexagon(30), Circle(30.0, 12.0), polygon([(20, 15), (-18, 15), (-18, -9), (20, -9)])]
)
def test_of_a_part_that_is_not_round_they_lie_in_the_middle_of_its_rim_too(outline: Outline) -> None:
    places = rim_points_mm(outline, EDGE_MM)
    np.testing.assert_allclose(outline.inside_mm(*places.T), [EDGE_MM / 2] * 3, atol=1e-9)
    np.testing.assert_allclose(np.degrees(np.arctan2(places[:, 1], places[:, 0])) % 360, [90, 210, 330], atol=1e-9)


@pytest.mark.parametrize(
    "places", [[[48, 0], [-48, 0], [49, 0]], [[48, 0], [48, 0], [0, 48]], [[48, 0.0], [48.5, 0.5], [49, 1.0]]]
)
def test_three_places_on_a_line_say_no_tilt(places: list[list[float]]) -> None:
    off = asked(FLAT, np.array(places, dtype=np.float64))
    assert not separate_seat_terms(off)
    with pytest.raises(ComputeError, match="lie on a line"):
        seat_of(off, np.zeros(3))


def test_a_seat_that_is_off_by_less_than_is_printed_is_no_note() -> None:
    assert PartSeat(0.0004, (0.0003, -0.0002), (0.0, 0.0, 0.0), 0.0004).is_level
    assert not PartSeat(-0.0006, (0.0, 0.0), (0.0, 0.0, 0.0), 0.0006).is_level
    assert not PartSeat(0.0, (0.0, 0.0006), (0.0, 0.0, 0.0), 0.0006).is_level
