"""The true part: as rough as configured for every seed, and reachable by the spot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from polishd.config.simulator_physics import Plant
from polishd.sim_backends.common import metropro
from polishd.sim_backends.plant import part as parts

CONFIG = Plant()


@pytest.mark.parametrize("seed", range(6))
def test_rms_and_pv_are_those_of_the_config(seed: int) -> None:
    rms, pv = parts.make(CONFIG, seed).stats()
    assert rms == pytest.approx(18.0, rel=1e-6)
    assert pv == pytest.approx(150.0, rel=0.03)


def test_the_seed_decides() -> None:
    one, same, other = (parts.make(CONFIG, seed).height_nm for seed in (1, 1, 2))
    assert np.array_equal(one, same)
    assert not np.allclose(one, other)


def test_short_periods_are_nearly_absent() -> None:
    """What a 3.4 mm spot cannot reach is far below the tolerance of 2 nm."""
    part = parts.make(CONFIG, 3)
    height = part.height_nm - part.height_nm.mean()
    window = np.outer(np.hanning(height.shape[0]), np.hanning(height.shape[1]))
    power = np.abs(np.fft.fft2(height * window)) ** 2
    f = np.fft.fftfreq(height.shape[0], part.grid.pitch_mm)
    short = np.hypot(*np.meshgrid(f, f)) > 1.0 / 8.0
    share = power[short].sum() / power[~short].sum()
    assert np.sqrt(share) * 18.0 < 0.3


def test_the_map_is_the_aperture_and_the_ring_is_hidden() -> None:
    part = parts.make(CONFIG, 1)
    seen = part.map_nm()
    assert seen.shape == (201, 201)
    assert part.grid.nx == 201 + 2 * part.pad
    assert np.isnan(seen[0, 0])
    assert np.isfinite(seen[100, 0])
    assert part.pad * part.grid.pitch_mm >= CONFIG.ring_mm
    assert np.isfinite(part.height_nm).all()


def test_a_perfect_part() -> None:
    assert parts.make(Plant(rms_nm=0.0), 1).stats() == (0.0, 0.0)


def test_holes_are_filled_smoothly() -> None:
    y, x = np.mgrid[0:60, 0:60]
    height = 0.5 * x + 0.2 * y
    holed = height.copy()
    holed[20:26, 30:37] = np.nan
    filled = parts.fill(holed)
    assert np.array_equal(filled[np.isfinite(holed)], height[np.isfinite(holed)])
    assert np.abs(filled - height).max() < 4.0


def test_a_measured_part_keeps_its_holes_and_its_size(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    height = rng.normal(0.0, 10.0, (81, 91))
    height[0, 0] = height[40:44, 50:53] = np.nan
    path = tmp_path / "map.dat"
    path.write_bytes(metropro.pack(metropro.DatMap(height, 0.4, origin_px=(7, 9))))
    part = parts.from_map(path, CONFIG)
    seen = part.map_nm()
    assert seen.shape == height.shape
    assert np.array_equal(np.isnan(seen), np.isnan(height))
    assert np.nanmax(np.abs(seen - height)) < metropro.UNIT_NM
    assert part.origin_px == (7, 9)
    assert part.grid.pitch_mm == pytest.approx(0.4)
    assert np.isfinite(part.height_nm).all()
    assert not part.clear[0].any()
    assert part.clear[41, 45]
    assert not part.clear[41, 51]


@pytest.mark.full
def test_the_shared_map_becomes_a_part(shared_data: Path) -> None:
    part = parts.from_map(shared_data / "zygo_metropro.dat", CONFIG)
    seen = part.map_nm()
    assert seen.shape == (432, 425)
    assert np.isnan(seen).sum() == 47241
    assert np.nanmax(seen) - np.nanmin(seen) == pytest.approx(330.700173)
    assert np.isfinite(part.height_nm).all()
