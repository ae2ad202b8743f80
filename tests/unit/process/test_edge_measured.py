"""Measured edge TIFs: between the plain spot and nothing, turned with the rim, cut at it, as good as their table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from polishd.model.errors import ComputeError
from polishd.model.process import MeasuredTif, ToolProcess
from polishd.model.program import Program
from polishd.model.surface import FloatArray, Grid
from polishd.process import contact
from polishd.process.dynamic_tif import effect_matrix
from polishd.process.edge.edge_tif import EdgeTif, carried, measured_edge_effect, sinking
from polishd.process.edge.rim import Rim, mask_rim, round_rim
from polishd.process.measured_spot import measured_spot
from polishd.process.spot import Spot
from tests.unit.process.moves import program

PAPER = ToolProcess()
PITCH = 0.05
A = 1.5
GRID = Grid(61, 61, 0.2)
PART = GRID.x_mm[None, :] + 0 * GRID.y_mm[:, None] < 0
STRAIGHT = mask_rim(GRID, PART)


def paraboloid(overhang: float = -9.0, sunk: float = 1.0) -> MeasuredTif:
    """A spot whose rate is Hertz's pressure, sunk, and cut off ``-overhang`` to the right of the map's centre."""
    line = np.arange(-60, 61) * PITCH
    rate = 50 * np.sqrt(np.clip(sunk - (line[None, :] ** 2 + line[:, None] ** 2) / A**2, 0, None))
    on_part = np.clip((-overhang - line) / PITCH + 0.5, 0.0, 1.0)  # share of each sample
    return MeasuredTif(rate * on_part, PITCH)


def table(overhangs: Sequence[float]) -> list[EdgeTif]:
    """What the model of the contact that sinks would have been measured as."""
    sunk = np.minimum(sinking(-np.asarray(overhangs) / A), 2.0)
    return [EdgeTif(paraboloid(s, float(d)), s) for s, d in zip(overhangs, sunk, strict=True)]


PLAIN = measured_spot(paraboloid(), PAPER)
HALF = float(PLAIN.half_width_mm(np.ones(1))[0])


def edge_effect(
    path: Program,
    edge: Sequence[EdgeTif],
    rim: Rim = STRAIGHT,
    spot: Spot = PLAIN,
    gamma: float = 1.0,
    process: ToolProcess = PAPER,
) -> FloatArray:
    """(n, ny, nx) nm/s."""
    matrix = measured_edge_effect(
        GRID, spot, path, np.full(path.n, gamma), np.ones(path.n), process=process, rim=rim, edge=edge
    )
    return np.asarray(matrix.toarray().T.reshape(-1, *GRID.shape))


def plain_effect(path: Program, spot: Spot = PLAIN) -> FloatArray:
    matrix = effect_matrix(GRID, spot, path, np.ones(path.n), np.ones(path.n))
    return np.asarray(matrix.toarray().T.reshape(-1, *GRID.shape))


def at_rest(x: Sequence[float] | FloatArray, azimuth: float = 0.7) -> Program:
    at = np.column_stack([x, np.zeros(len(x))])
    return program(at, at, azimuth)


RIM_X = float(GRID.x_mm[np.flatnonzero(PART[0])[-1]] + GRID.pitch_mm / 2)


def test_inside_it_is_the_plain_spot_and_outside_nothing() -> None:
    path = at_rest([RIM_X - HALF - 1.0, RIM_X - HALF, RIM_X + HALF, RIM_X + HALF + 2])
    found = edge_effect(path, table([-0.5, 0.5]))
    np.testing.assert_allclose(found[:2], plain_effect(path)[:2], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found[2:], 0.0, atol=1e-12)


def test_at_a_measured_overhang_it_is_the_measured_tif() -> None:
    for overhang in (-0.8, 0.0, 0.6):
        path = at_rest([RIM_X + overhang])
        edge = table([-0.8, 0.0, 0.6])
        one = next(e for e in edge if e.overhang_mm == overhang)
        same = measured_spot(replace(one.tif, rotates=False), PAPER)
        np.testing.assert_allclose(edge_effect(path, edge), plain_effect(path, same), atol=1e-6)


def test_nothing_is_removed_beyond_the_rim_between_measured_overhangs() -> None:
    path = at_rest(RIM_X + np.linspace(-1.2, 1.2, 9))
    found = edge_effect(path, table([-1.0, -0.5, 0.0, 0.5, 1.0]))
    beyond = found[:, :, GRID.x_mm > RIM_X + 0.11].sum(axis=(1, 2))
    assert (beyond < 0.01 * found.sum(axis=(1, 2))).all()


def test_a_dense_table_gives_the_model_back() -> None:
    overhangs = np.linspace(-1.4, 1.2, 14)
    path = at_rest(RIM_X + np.array([-1.1, -0.65, -0.13, 0.07, 0.33]))
    found = edge_effect(path, table(overhangs.tolist()))
    for k, x in enumerate(path.end_mm[:, 0] - RIM_X):
        true = measured_spot(replace(table([float(x)])[0].tif, rotates=False), PAPER)
        exact = plain_effect(at_rest([RIM_X + x]), true)[0]
        assert np.abs(found[k] - exact).max() < 0.06 * exact.max()
        assert found[k].sum() == pytest.approx(exact.sum(), rel=0.01)


def test_the_removal_has_no_step_over_the_rim() -> None:
    path = at_rest(RIM_X + np.arange(-3.2, 3.2, 0.02))
    found = edge_effect(path, table([-1.0, -0.5, 0.0, 0.5, 1.0]))
    volume = found.sum(axis=(1, 2))
    assert np.abs(np.diff(volume)).max() < 0.03 * volume[0]
    assert np.abs(np.diff(found, axis=0)).max() < 0.12 * found.max()
    assert (found >= 0).all()


def test_between_the_knots_the_volume_is_theirs_linearly() -> None:
    edge = table([-0.4, 0.4])
    low, middle, high = (found.sum() for found in edge_effect(at_rest(RIM_X + np.array([-0.4, 0.0, 0.4])), edge))
    assert middle == pytest.approx((low + high) / 2, rel=1e-6)


def test_it_turns_with_the_rim_and_not_with_the_spindle() -> None:
    rim = round_rim(3.0)
    edge = table([-0.5, 0.2])
    for angle in (0.0, np.pi / 2, np.pi, -np.pi / 2):
        at = np.array([[3.1 * np.cos(angle), 3.1 * np.sin(angle)]])
        images = [edge_effect(program(at, at, lean), edge, rim)[0] for lean in (0.0, 1.0)]
        np.testing.assert_allclose(images[0], images[1], atol=1e-9)
        turned = np.rot90(images[0], -round(angle / (np.pi / 2)))
        first = edge_effect(program([(3.1, 0.0)], [(3.1, 0.0)]), edge, rim)[0]
        np.testing.assert_allclose(turned, first, atol=0.02 * first.max())


def test_the_map_may_lie_any_way_round() -> None:
    path = at_rest([RIM_X + 0.3])
    edge = table([-0.5, 0.3])
    turned = [
        EdgeTif(replace(e.tif, rate_nm_s=np.rot90(e.tif.rate_nm_s).copy()), e.overhang_mm, outward_deg=90.0)
        for e in edge
    ]
    found, expected = edge_effect(path, turned), edge_effect(path, edge)
    np.testing.assert_allclose(found, expected, atol=0.02 * expected.max())


def test_moving_blocks_are_laid_along_their_way() -> None:
    places = [(RIM_X + 0.2, y) for y in np.linspace(-1, 1, 41)]
    still = program(places, places)
    moving = program([(RIM_X + 0.2, -1.0)], [(RIM_X + 0.2, 1.0)])
    edge = table([-0.5, 0.5])
    # the ends of the way count half
    weight = np.r_[0.5, np.ones(39), 0.5] / 40
    mean = np.tensordot(weight, edge_effect(still, edge), 1)
    np.testing.assert_allclose(edge_effect(moving, edge)[0], mean, atol=0.05 * mean.max())


def test_the_offset_of_the_spot_counts_once() -> None:
    process = ToolProcess(spot_offset_mm=(0.0, 0.5))
    spot = measured_spot(paraboloid(), process)
    edge = table([-0.5, 0.5])
    leaning = program([(RIM_X - 0.4, 0.0)], [(RIM_X - 0.4, 0.0)], 0.0)  # the offset carries it 0.5 mm outwards
    np.testing.assert_allclose(
        edge_effect(leaning, edge, spot=spot, process=process)[0],
        edge_effect(at_rest([RIM_X + 0.1]), edge)[0],
        atol=1e-6,
    )


def test_sizes_follow_the_depth() -> None:
    shallow = edge_effect(at_rest([RIM_X - 3.0, RIM_X]), table([-0.5, 0.0, 0.5]), gamma=0.81)
    deep = edge_effect(at_rest([RIM_X - 3.0, RIM_X]), table([-0.5, 0.0, 0.5]))
    ratio = shallow.sum(axis=(1, 2)) / deep.sum(axis=(1, 2))
    np.testing.assert_allclose(ratio, 0.81**1.5, rtol=5e-3)


def test_the_table_is_as_the_model_says() -> None:
    """What `table` makes is the modelled contact, so that the tests above mean something."""
    for one in table([-0.7, 0.0, 0.5]):
        volume = one.tif.rate_nm_s.sum() * PITCH**2
        inside = np.array([-one.overhang_mm / A])
        whole = 50 * 2 / 3 * np.pi * A**2
        assert volume == pytest.approx(whole * float(carried(inside, np.minimum(sinking(inside), 2.0))[0]), rel=0.03)
    assert contact.hertz_depth_mm(PAPER) > 0


def test_what_cannot_be_a_table_is_refused() -> None:
    path = at_rest([0.0])
    with pytest.raises(ComputeError, match="no measured edge TIFs"):
        edge_effect(path, [])
    with pytest.raises(ComputeError, match=r"point 1: the overhang .* is -0\.5 mm, overhangs must rise"):
        edge_effect(path, [*table([0.5]), *table([-0.5])])
    with pytest.raises(ComputeError, match="overhangs must rise"):
        edge_effect(path, table([0.5, 0.5]))
    with pytest.raises(ComputeError, match=r"point 0: the overhang .* the spot does not lie across the rim"):
        edge_effect(path, [EdgeTif(paraboloid(), 5.0)])
    with pytest.raises(ComputeError, match="the depth ratio of a measured edge TIF is 0"):
        edge_effect(path, [EdgeTif(replace(paraboloid(), depth_ratio=0.0), 0.5)])
    with pytest.raises(ComputeError, match="the factor on the removal"):
        measured_edge_effect(
            GRID, PLAIN, path, np.ones(1), np.array([-1.0]), process=PAPER, rim=STRAIGHT, edge=table([0.0])
        )
