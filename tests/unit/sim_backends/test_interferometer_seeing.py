"""What the simulated interferometer adds: each error alone, on a part that is flat or has a known form."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from polishd.config.simulator import InstrumentErrors, SimConfig, SimInterferometerSection, Truth
from polishd.model.surface import FloatArray, Grid
from polishd.process.metrology import zernike
from polishd.sim_backends.interferometer import add_instrument_errors

GRID = Grid(81, 81, 0.5)
DISC = GRID.radius_mm() <= 20.0
X, Y = (np.broadcast_to(a / 20.25, GRID.shape) for a in GRID.axes_mm)


def seen(true_nm: FloatArray | float = 0.0, *, quarters: int = 0, noise_nm: float = 0.0, **errors: Any) -> FloatArray:
    section = SimInterferometerSection(errors=InstrumentErrors(**errors))
    config = SimConfig(hidden_truth=Truth(map_noise_nm=noise_nm), interferometer=section)
    part = np.where(DISC, true_nm, np.nan)
    return add_instrument_errors(part, config, GRID.pitch_mm, np.random.default_rng(1), quarters=quarters)


def rms(values: FloatArray) -> float:
    return float(np.nanstd(values))


def test_a_perfect_one_shows_the_part() -> None:
    true = np.where(DISC, np.random.default_rng(0).normal(size=GRID.shape), np.nan)
    np.testing.assert_array_equal(seen(true), true)
    np.testing.assert_array_equal(seen(true, quarters=1), np.rot90(true))


@pytest.mark.parametrize(
    ("errors", "noll"),
    [
        ({"power_nm": 5.0}, {4: 5.0}),
        ({"power_nm": -5.0}, {4: -5.0}),
        ({"astigmatism_nm": 3.0, "astigmatism_deg": 0.0}, {6: 3.0}),
        ({"astigmatism_nm": 3.0, "astigmatism_deg": 45.0}, {5: 3.0}),
        ({"coma_nm": 2.0}, {8: 2.0}),
        ({"mount_nm": 2.0}, {9: 2.0}),
    ],
)
def test_a_reference_has_the_errors_that_it_is_given(errors: dict[str, float], noll: dict[int, float]) -> None:
    """Against the controller's own Zernike terms, which the simulator does not have."""
    pairs = zernike.order("noll", 11)
    terms = zernike.values(pairs, "rms", X[DISC], Y[DISC]).T
    found = np.linalg.lstsq(terms, seen(**errors)[DISC], rcond=None)[0]
    want = np.zeros(11)
    for term, size in noll.items():
        want[term - 1] = size
    np.testing.assert_allclose(found, want, atol=0.02)


@pytest.mark.parametrize("turns", [True, False])
def test_a_mount_turns_with_the_part_or_does_not(turns: bool) -> None:
    still, turned = (seen(mount_nm=2.0, mount_turns=turns, quarters=q) for q in (0, 1))
    want = np.rot90(still) if turns else still
    np.testing.assert_allclose(turned[DISC], want[DISC], atol=1e-9)
    assert rms(np.rot90(still) - still) > 2.0


@pytest.mark.full
def test_a_mount_that_presses_anew_is_a_trefoil_of_another_size_and_direction_in_each_map() -> None:
    section = SimInterferometerSection(errors=InstrumentErrors(mount_nm=2.0, mount_anew=True))
    config, rng = SimConfig(hidden_truth=Truth(map_noise_nm=0.0), interferometer=section), np.random.default_rng(3)
    terms = zernike.values(zernike.order("noll", 11), "rms", X[DISC], Y[DISC]).T
    part = np.where(DISC, 0.0, np.nan)
    maps = [add_instrument_errors(part, config, 0.5, rng)[DISC] for _ in range(300)]
    found = np.linalg.lstsq(terms, np.column_stack(maps), rcond=None)[0]
    trefoil = found[[8, 9]]
    assert abs(np.delete(found, [8, 9], axis=0)).max() < 0.03, "nothing else"
    assert np.sqrt((trefoil**2).sum(axis=0).mean()) == pytest.approx(2.0, rel=0.1)
    assert abs(np.corrcoef(trefoil)[0, 1]) < 0.15, "any direction"
    assert trefoil.std(axis=1) == pytest.approx(2.0 / np.sqrt(2.0), rel=0.15)


def test_tilt_is_another_with_each_map() -> None:
    section = SimInterferometerSection(errors=InstrumentErrors(tilt_nm=50.0))
    config, rng = SimConfig(hidden_truth=Truth(map_noise_nm=0.0), interferometer=section), np.random.default_rng(3)
    first, second = (add_instrument_errors(np.zeros(GRID.shape), config, 0.5, rng) for _ in range(2))
    for one in (first, second):
        plane = np.linalg.lstsq(np.column_stack([X.ravel(), Y.ravel()]), one.ravel(), rcond=None)[0]
        np.testing.assert_allclose(one.ravel(), plane @ [X.ravel(), Y.ravel()], atol=1e-9)
        assert 0 < abs(plane).max() <= 100.0
    assert rms(first - second) > 1.0


@pytest.mark.parametrize(("errors", "at_rim"), [({"magnification": 0.05}, 1.05), ({"distortion": 0.05}, 1.037)])
def test_what_is_magnified_lies_farther_out(errors: dict[str, float], at_rim: float) -> None:
    x, y = GRID.axes_mm
    bump = 10.0 * np.exp(-((x - 15.0) ** 2 + y**2) / 8.0)
    found = np.nan_to_num(seen(bump, **errors))
    centre = (found * x).sum() / found.sum()
    true = np.where(DISC, bump, 0.0)
    assert centre / ((true * x).sum() / true.sum()) == pytest.approx(at_rim, abs=0.012)


def test_slopes_add_what_they_should() -> None:
    slope = 4.0 * np.broadcast_to(GRID.axes_mm[0], GRID.shape)  # 4 nm/mm: 4 urad
    level = seen(slope, retrace_nm_per_urad=0.5) - np.where(DISC, slope, np.nan)
    inner = GRID.radius_mm() < 18.0
    np.testing.assert_allclose(level[inner], 2.0, atol=1e-9)
    noise = seen(slope, slope_noise_nm_per_urad=0.1) - np.where(DISC, slope, np.nan)
    assert noise[inner].std() == pytest.approx(0.4, rel=0.1)
    assert rms(seen(0.0, slope_noise_nm_per_urad=0.1)) == 0.0, "a flat has none"


def test_dead_pixels_are_the_camera_s() -> None:
    first, turned = (np.isnan(seen(dead_pixels=0.02, quarters=q))[DISC] for q in (0, 1))
    assert first.mean() == pytest.approx(0.02, abs=0.008)
    np.testing.assert_array_equal(first, turned)
