"""What a path covers of a round part, against areas that are known."""

from __future__ import annotations

import numpy as np
import pytest

from polishd.model.outline import Circle, rectangle
from polishd.model.surface import FloatArray
from polishd.process.toolpath import apertures
from polishd.process.toolpath.apertures import coverage


def lines(diameter_mm: float, apart_mm: float = 1.0) -> tuple[FloatArray, FloatArray]:
    """Starts and ends of the lines of one block each that fill a disc."""
    y = np.arange(-diameter_mm / 2, diameter_mm / 2 + apart_mm / 2, apart_mm)
    x = np.sqrt(np.maximum((diameter_mm / 2) ** 2 - y**2, 0.0))
    return np.stack([-x, y, 0 * y], axis=1), np.stack([x, y, 0 * y], axis=1)


@pytest.mark.parametrize(
    ("diameter_mm", "unreachable"), [(94.0, 0.0), (60.0, 1 - (32 / 47) ** 2), (40.0, 1 - (22 / 47) ** 2)]
)
def test_a_smaller_path_leaves_the_rest(diameter_mm: float, unreachable: float) -> None:
    found = coverage(*lines(diameter_mm), spot_mm=2.0, outline=Circle(50.0), edge_mm=3.0, landing_mm=0.0)
    assert found.unreachable == pytest.approx(unreachable, abs=0.01)
    assert found.outside == 0.0
    assert found.reach_mm == pytest.approx(diameter_mm / 2, abs=1.0)


def test_a_larger_path_lies_beyond_the_rim() -> None:
    found = coverage(*lines(100.0), spot_mm=2.0, outline=Circle(30.0), edge_mm=3.0, landing_mm=0.0)
    assert found.outside == pytest.approx(1 - 0.6**2, abs=0.02)
    assert found.unreachable == 0.0


def test_blocks_reach_along_their_length_however_few_they_are() -> None:
    """2 mm apart: spots of more than 1 mm leave nothing between, those of half of that leave half."""
    assert (
        coverage(*lines(100.0, 2.0), spot_mm=1.1, outline=Circle(50.0), edge_mm=3.0, landing_mm=0.0).unreachable == 0.0
    )
    narrow = coverage(*lines(100.0, 2.0), spot_mm=0.5, outline=Circle(50.0), edge_mm=3.0, landing_mm=0.0)
    assert narrow.unreachable == pytest.approx(0.5, abs=0.05)


def test_points_without_length_count_where_they_are() -> None:
    dwells = np.array([[0.0, 0.0, 0.0], [0.0, 40.0, 0.0], [0.0, 70.0, 0.0]])
    found = coverage(dwells, dwells, spot_mm=3.0, outline=Circle(50.0), edge_mm=3.0, landing_mm=0.0)
    assert found.reach_mm == 70.0
    assert found.outside == pytest.approx(1 / 3)
    assert found.unreachable == pytest.approx(1 - 2 * (3 / 47) ** 2, abs=0.002)


def test_of_a_part_that_is_not_round_its_own_outline_counts() -> None:
    """A path over 100 x 100 mm; one over a disc leaves the corners of the rectangle that it lies in."""
    part = rectangle(80.0, 40.0)
    found = coverage(*lines(100.0), spot_mm=2.0, outline=part, edge_mm=3.0, landing_mm=5.0)
    assert found.unreachable == 0.0
    assert found.outside == pytest.approx(1 - disc_share(90.0, 50.0, 100.0), abs=0.02)
    found = coverage(*lines(60.0), spot_mm=2.0, outline=part, edge_mm=3.0, landing_mm=5.0)
    assert found.unreachable == pytest.approx(1 - disc_share(74.0, 34.0, 64.0) * 32**2 * np.pi / (74 * 34), abs=0.02)


def disc_share(wide_mm: float, high_mm: float, diameter_mm: float) -> float:
    """Share of a disc that lies in a rectangle about its centre."""
    x, y = np.meshgrid(*(np.linspace(-diameter_mm / 2, diameter_mm / 2, 1001),) * 2)
    disc = np.hypot(x, y) <= diameter_mm / 2
    return float(np.mean((np.abs(x) <= wide_mm / 2)[disc] & (np.abs(y) <= high_mm / 2)[disc]))


def test_what_is_reached_is_what_lies_within_a_spot_of_the_path() -> None:
    """Against all distances, for paths within, across and beyond the samples, and none."""
    rng = np.random.default_rng(2)
    x, y = np.linspace(-7.0, 7.0, 60), np.linspace(-4.0, 4.0, 50)
    for spot_mm, count in ((0.3, 200), (2.0, 10), (9.0, 1), (30.0, 1), (1.0, 0)):
        path = rng.uniform(-9.0, 9.0, (count, 2))
        away = np.hypot(x[:, None] - path[:, 0], (y[:, None] - path[:, 1])[:, None]).min(axis=2, initial=np.inf)
        np.testing.assert_array_equal(apertures._reached(path, spot_mm, x, y), away < spot_mm)
