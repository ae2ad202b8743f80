"""Figures of the dwell beyond the rim: what is of use there, what falls off the part, what is spent in the air."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from polishd.model.errors import ComputeError
from polishd.model.process import ToolProcess
from polishd.model.program import Program
from polishd.model.surface import FloatArray, Grid
from polishd.process import contact
from polishd.process.dynamic_tif import effect_matrix
from polishd.process.edge.edge_tif import contact_centres_mm, rim_contact
from polishd.process.edge.overrun import Overrun, overrun, wanted_overrun_mm
from polishd.process.edge.rim import round_rim
from polishd.process.effect import SparseEffect
from polishd.process.spot import HertzSpot
from tests.unit.process.moves import program

PROCESS = ToolProcess(viscosity_mpa_s=0.0, second_viscosity_mpa_s=0.0)
SPOT = HertzSpot(PROCESS)
A = float(contact.contact_radius_mm(PROCESS, contact.hertz_depth_mm(PROCESS)))
GRID = Grid(120, 120, 0.25)
RADIUS = 12.0
RIM = round_rim(RADIUS)
PART = GRID.radius_mm() <= RADIUS


def figures(path: Program, time_s: FloatArray, gamma: FloatArray | None = None, **changes: Any) -> Overrun:
    gamma = np.ones(path.n) if gamma is None else gamma
    factor = np.ones(path.n)
    effect = SparseEffect(GRID, effect_matrix(GRID, SPOT, path, gamma, factor))
    given: dict[str, Any] = {"effect": effect, "part": PART, "time_s": time_s} | changes
    return overrun(**given, program=path, spot=SPOT, depth_ratio=gamma, factor=factor, rim=RIM)


def at_rest(*x: float) -> Program:
    """Dwells along x, the spindle leaning along y: the rate is even in x."""
    at = np.column_stack([x, np.zeros(len(x))])
    return program(at, at, np.pi / 2)


def test_the_spots_radius_is_wanted() -> None:
    gamma, azimuth = np.array([0.81, 1.0]), np.array([0.3, 2.0])
    assert wanted_overrun_mm(SPOT, gamma, azimuth) == pytest.approx(A)
    assert wanted_overrun_mm(SPOT, gamma[:1], azimuth[:1]) == pytest.approx(0.9 * A)
    shifted = HertzSpot(ToolProcess(viscosity_mpa_s=0.0, second_viscosity_mpa_s=0.0, spot_offset_mm=(0.3, 0.4)))
    assert wanted_overrun_mm(shifted, gamma, azimuth) == pytest.approx(A + 0.5)
    assert wanted_overrun_mm(SPOT, np.zeros(0), np.zeros(0)) == 0.0


def test_on_the_part_nothing_falls_off() -> None:
    found = figures(at_rest(0.0, 5.0, RADIUS - A - 0.5), np.array([1.0, 2.0, 3.0]))
    assert found.off_part == pytest.approx(0.0, abs=1e-9)
    assert (found.idle_s, found.total_s) == (0.0, 6.0)
    assert found.reached_mm == pytest.approx(-A - 0.5)


def test_on_the_rim_half_falls_off() -> None:
    found = figures(at_rest(RADIUS), np.array([1.0]))
    # the part curves away: a hundredth more than half
    assert found.off_part == pytest.approx(0.5, abs=0.04)
    assert found.reached_mm == pytest.approx(0.0)


def test_the_share_is_of_the_removal_and_not_of_points() -> None:
    one = figures(at_rest(0.0, RADIUS), np.array([1.0, 1.0]))
    more = figures(at_rest(0.0, RADIUS), np.array([1.0, 3.0]))
    half = figures(at_rest(RADIUS), np.array([1.0])).off_part
    assert one.off_part == pytest.approx(half / 2)
    assert more.off_part == pytest.approx(half * 3 / 4)
    shallow = figures(at_rest(0.0, RADIUS), np.array([1.0, 1.0]), np.array([1.0, 0.64]))
    assert shallow.off_part < one.off_part


def test_beside_the_part_time_is_idle() -> None:
    found = figures(at_rest(0.0, RADIUS + A + 0.3, RADIUS + A + 1.0), np.array([1.0, 2.0, 0.5]))
    assert found.idle_s == pytest.approx(2.5)
    assert found.off_part == pytest.approx(2.5 / 3.5, rel=1e-6)
    assert found.reached_mm == pytest.approx(A + 1.0)


def test_what_falls_beyond_the_grid_counts_as_off_the_part() -> None:
    found = figures(at_rest(0.0, 40.0), np.array([1.0, 1.0]))
    assert found.off_part == pytest.approx(0.5, rel=1e-6)
    assert found.idle_s == 1.0


def test_both_ends_of_a_block_count_for_the_reach() -> None:
    path = program([(0.0, 0.0)], [(RADIUS + 1.0, 0.0)])
    assert figures(path, np.ones(1)).reached_mm == pytest.approx(1.0)
    back = program([(RADIUS + 1.0, 0.0)], [(0.0, 0.0)])
    assert figures(back, np.ones(1)).reached_mm == pytest.approx(1.0)


def test_a_free_rim_takes_more_of_the_force() -> None:
    path = at_rest(RADIUS)
    found = rim_contact(PROCESS, RIM, contact_centres_mm(SPOT, path, np.ones(1)), np.ones(1))
    plain, sunk = figures(path, np.ones(1)), figures(path, np.ones(1), found.depth_ratio)
    assert sunk.off_part == pytest.approx(plain.off_part, abs=0.02)
    assert sunk.wanted_mm == pytest.approx(A * 2 ** (1 / 3))


def test_what_cannot_be_is_refused() -> None:
    path = at_rest(0.0, 1.0)
    for time, what in ((-1.0, "point 1: the dwell is -1 s"), (np.nan, "point 1: the dwell is nan s")):
        with pytest.raises(ComputeError, match=what):
            figures(path, np.array([1.0, time]))
    with pytest.raises(ComputeError, match="the dwell removes nothing"):
        figures(path, np.zeros(2))
    with pytest.raises(ComputeError, match=r"the dwell \(3,\)"):
        figures(path, np.ones(3))
    with pytest.raises(ComputeError, match=r"the part's mask is \(2, 2\)"):
        figures(path, np.ones(2), part=np.ones((2, 2), dtype=bool))
