"""What a spot cannot make: its transfer function against closed forms, its cut-off, the split of a surface there."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

from polishd.model.errors import ComputeError, MapError
from polishd.model.process import MeasuredTif, ToolProcess
from polishd.model.surface import FloatArray, Grid
from polishd.process.removal import contact
from polishd.process.removal import transfer_function as module
from polishd.process.removal.dynamic_tif import effect_matrix
from polishd.process.removal.tif import HertzSpot, MeasuredSpot, measured_spot
from polishd.process.removal.transfer_function import (
    SHARE,
    SpotTransferFunction,
    correctable_surface,
    spot_transfer_function,
)
from tests.unit.process.moves import program

# At a dip of 89 deg the speed hardly varies over the contact, and the rate goes as the pressure.
EVEN = ToolProcess(dip_deg=89.0, viscosity_mpa_s=0.0, second_viscosity_mpa_s=0.0)
A = float(contact.contact_radius_mm(EVEN, contact.hertz_depth_mm(EVEN)))
GRID = Grid(160, 160, 0.5)
DISC = GRID.radius_mm() <= 35


def hertz(u: FloatArray) -> FloatArray:
    """Transform of the hemisphere of pressure, relative to that at 0; u = 2 pi a f."""
    return np.asarray(3 * (np.sin(u) - u * np.cos(u)) / u**3, dtype=np.float64)


def gaussian(sigma_mm: float, pitch_mm: float = 0.1) -> MeasuredSpot:
    n = int(5 * sigma_mm / pitch_mm)
    line = np.arange(-n, n + 1) * pitch_mm
    rate = 50 * np.exp(-(line[None, :] ** 2 + line[:, None] ** 2) / 2 / sigma_mm**2)
    return measured_spot(MeasuredTif(rate, pitch_mm), ToolProcess())


def wave(period_mm: float, amplitude_nm: float = 10.0) -> FloatArray:
    return np.broadcast_to(amplitude_nm * np.sin(2 * np.pi * GRID.x_mm / period_mm), GRID.shape).copy()


def test_a_hertz_spot_has_the_transform_of_its_pressure() -> None:
    found = spot_transfer_function(HertzSpot(EVEN))
    u = 2 * np.pi * A * found.frequency_per_mm[1:]
    assert found.modulus[0] == pytest.approx(1.0)
    low = u < 8
    np.testing.assert_allclose(found.modulus[1:][low], np.abs(hertz(u[low])), atol=3e-3)


def test_a_hertz_spot_has_its_null_where_the_raster_is_quiet() -> None:
    found = spot_transfer_function(HertzSpot(EVEN))
    assert found.null_period_mm == pytest.approx(2 * np.pi * A / brentq(lambda u: np.tan(u) - u, 4.4, 4.5), rel=2e-3)


def test_the_papers_spot_too() -> None:
    found = spot_transfer_function(HertzSpot(ToolProcess()))
    assert found.null_period_mm == pytest.approx(2 * np.pi * 1.7225 / 4.4934, rel=5e-3)
    assert 1.4 * 1.7225 < found.cutoff_period_mm < 1.6 * 1.7225


def test_the_cutoff_of_a_hertz_spot_is_where_it_is_down_to_the_share() -> None:
    for share in (0.5, 0.2, SHARE, 0.01):
        u = brentq(lambda u, share=share: float(hertz(np.array(u))) - share, 0.1, 4.493)
        assert spot_transfer_function(HertzSpot(EVEN), share=share).cutoff_period_mm == pytest.approx(
            2 * np.pi * A / u, rel=4e-3
        )


def test_below_the_share_of_its_null_the_null_is_the_cutoff() -> None:
    found = spot_transfer_function(HertzSpot(EVEN), share=1e-6)
    assert found.cutoff_period_mm == found.null_period_mm


@pytest.mark.one_of_each
@pytest.mark.parametrize("sigma", [0.5, 0.8, 3.0])
@pytest.mark.parametrize("share", [0.3, SHARE, 0.01])
def test_a_gaussian_has_no_null_and_a_cutoff_in_closed_form(sigma: float, share: float) -> None:
    found = spot_transfer_function(gaussian(sigma, sigma / 8), share=share)
    assert found.cutoff_period_mm == pytest.approx(np.pi * sigma * np.sqrt(2 / np.log(1 / share)), rel=3e-3)
    assert found.null_period_mm is None
    expected = np.exp(-2 * (np.pi * sigma * found.frequency_per_mm) ** 2)
    np.testing.assert_allclose(found.modulus, expected, atol=2e-3)


def test_a_deeper_contact_reaches_less_far() -> None:
    one, deep = (spot_transfer_function(HertzSpot(EVEN), ratio).cutoff_period_mm for ratio in (1.0, 1.44))
    assert deep / one == pytest.approx(1.2, rel=1e-3)


def test_the_azimuth_does_not_matter_to_the_mean_over_directions() -> None:
    one, other = (spot_transfer_function(HertzSpot(ToolProcess()), azimuth_rad=turn) for turn in (0.0, 1.1))
    assert one.cutoff_period_mm == pytest.approx(other.cutoff_period_mm, rel=2e-3)


@pytest.mark.full
def test_the_directions_and_frequencies_are_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    rough = spot_transfer_function(HertzSpot(ToolProcess()))
    monkeypatch.setattr(module, "DIRECTIONS", 180)
    monkeypatch.setattr(module, "FREQUENCIES", 2000)
    fine = spot_transfer_function(HertzSpot(ToolProcess()))
    assert rough.cutoff_period_mm == pytest.approx(fine.cutoff_period_mm, rel=1e-3)
    assert rough.null_period_mm == pytest.approx(fine.null_period_mm or 0.0, rel=2e-3)


def at(cutoff_mm: float) -> SpotTransferFunction:
    return SpotTransferFunction(np.zeros(1), np.ones(1), SHARE, cutoff_mm, None)


def test_a_surface_is_split_at_the_cutoff() -> None:
    long, short = wave(20.0), wave(4.0, 3.0)
    found = correctable_surface(long + short, DISC, GRID.pitch_mm, at(8.0))
    assert found.within_reach_rms_nm == pytest.approx(long[DISC].std(), rel=0.03)
    assert found.beyond_reach_rms_nm == pytest.approx(short[DISC].std(), rel=0.05)
    assert found.rms_nm == pytest.approx((long + short)[DISC].std())
    assert found.resolved


def test_a_longer_cutoff_leaves_more() -> None:
    surface = wave(20.0) + wave(7.0) + wave(3.0)
    left = [
        correctable_surface(surface, DISC, GRID.pitch_mm, at(cut)).beyond_reach_rms_nm for cut in (2.0, 5.0, 12.0, 30.0)
    ]
    assert (np.diff(left) > 1.0).all()


def test_what_the_map_does_not_show_is_not_known() -> None:
    found = correctable_surface(wave(20.0), DISC, GRID.pitch_mm, at(0.9))
    assert not found.resolved
    assert found.beyond_reach_rms_nm < 1e-9


@pytest.mark.full
def test_a_dwell_reaches_what_the_transfer_function_says() -> None:
    """Waves of two periods under a dwell held down such that, at the cut-off, half of a wave would stay."""
    found = spot_transfer_function(HertzSpot(EVEN))
    grid = Grid(40, 40, 0.5)
    x, y = (part.ravel() for part in np.meshgrid(grid.x_mm, grid.y_mm))
    at = np.column_stack([x, y])
    one = np.ones(len(at))
    matrix = effect_matrix(grid, HertzSpot(EVEN), program(at, at), one, one).toarray()
    mean = matrix[:, grid.nx * grid.ny // 2 + grid.nx // 2].sum()
    inner = np.maximum(np.abs(x), np.abs(y)) < 5
    for period in (2 * found.cutoff_period_mm, 0.97 * found.cutoff_period_mm):
        target = np.sin(2 * np.pi * x / period)
        normal = matrix.T @ matrix + (SHARE * mean) ** 2 * np.eye(len(at))
        left = target - matrix @ np.linalg.solve(normal, matrix.T @ target)
        modulus = np.interp(1 / period, found.frequency_per_mm, found.modulus)
        expected = 1 / (1 + (modulus / SHARE) ** 2)
        assert left[inner].std() / target[inner].std() == pytest.approx(expected, rel=0.15, abs=0.02)


def test_what_cannot_be_is_refused() -> None:
    spot = HertzSpot(EVEN)
    for share in (0.0, 1.0, -1.0, np.nan):
        with pytest.raises(ComputeError, match="the share at the cut-off"):
            spot_transfer_function(spot, share=share)
    for ratio in (0.0, np.nan):
        with pytest.raises(ComputeError, match="the depth ratio gamma"):
            spot_transfer_function(spot, ratio)
    needle = np.zeros((9, 9))
    needle[4, 4] = 1.0
    with pytest.raises(ComputeError, match="its patch is too coarse"):
        spot_transfer_function(measured_spot(MeasuredTif(needle, 0.1), ToolProcess()))
    with pytest.raises(MapError, match="have no data"):
        correctable_surface(np.full(GRID.shape, np.nan), DISC, GRID.pitch_mm, at(8.0))
    with pytest.raises(MapError, match="no sample"):
        correctable_surface(wave(9.0), np.zeros(GRID.shape, dtype=bool), GRID.pitch_mm, at(8.0))
