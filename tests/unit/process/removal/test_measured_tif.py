"""Import of a measured TIF: synthetic spots with tilt, noise and drop-outs, and one that was really measured."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from polishd.model.errors import ComputeError
from polishd.model.process import ToolProcess
from polishd.process.removal import contact
from polishd.process.removal.measured_tif import fwhm_mm, preston_from_tif, tif_from_maps, volume_mm3_min

PAPER = ToolProcess()
DEPTH = contact.hertz_depth_mm(PAPER)
SECONDS = 60.0
VOLUME = float(contact.volume_rate_nm_mm2_s(PAPER, DEPTH)[0]) * 60e-6
Place = tuple[float, float]


def axes(pitch: float, side: float = 8.0) -> tuple[np.ndarray, np.ndarray]:
    count = int(side / pitch / 2)
    line = np.arange(-count, count + 1) * pitch
    return np.meshgrid(line, -line)


def true_rate(pitch: float, at: Place, side: float = 8.0) -> np.ndarray:
    """Cell means of the paper's spot, nm/s, its contact's centre at (x, y) from the map's centre."""
    right, up = axes(pitch, side)
    fine = (np.arange(8) + 0.5) / 8 - 0.5
    offsets = [(a * pitch, b * pitch) for a in fine for b in fine]
    return sum(contact.removal_rate_nm_s(PAPER, DEPTH, right - at[0] + a, up - at[1] + b) for a, b in offsets) / len(
        offsets
    )  # type: ignore[return-value]


def maps(
    pitch: float = 0.1, at: Place = (0.33, -0.22), noise_nm_s: float = 0.0, side: float = 8.0
) -> tuple[np.ndarray, np.ndarray]:
    """Heights before and after the spot, with form, tilt, piston and noise that are not removal."""
    right, up = axes(pitch, side)
    before = 1000 * np.sin(right / 9) + 50 * up
    noise = SECONDS * noise_nm_s * np.random.default_rng(5).standard_normal(right.shape)
    return before, before - SECONDS * true_rate(pitch, at, side) + 300 + 40 * right - 7 * up + noise


@pytest.mark.parametrize("pitch", [0.05, 0.1, 0.2])
def test_a_clean_spot_comes_back(pitch: float) -> None:
    tif, report = tif_from_maps(*maps(pitch), pitch, SECONDS)
    assert report.volume_mm3_min == pytest.approx(VOLUME, rel=5e-4)
    assert volume_mm3_min(tif) == pytest.approx(report.volume_mm3_min, rel=1e-12)
    assert report.peak_nm_s == pytest.approx(true_rate(pitch, (0.0, 0.0)).max(), rel=5e-3)
    assert report.rim_mm == pytest.approx(1.7225 + 0.11, abs=1.6 * pitch)
    assert report.noise_nm_s < 1e-6
    assert abs(report.volume_change) < 5e-3
    assert tif.pitch_mm == pitch


def test_the_shape_comes_back_centred_on_its_centroid() -> None:
    pitch = 0.1
    tif, report = tif_from_maps(*maps(pitch, (0.33, -0.22)), pitch, SECONDS)
    size = len(tif.rate_nm_s)
    assert size % 2 == 1
    place = (np.arange(size) - size // 2) * pitch
    total = tif.rate_nm_s.sum()
    assert tif.rate_nm_s.sum(axis=0) @ place / total == pytest.approx(0, abs=0.02 * pitch)
    assert tif.rate_nm_s.sum(axis=1) @ place / total == pytest.approx(0, abs=0.02 * pitch)
    # the spot's centroid lies towards y, where the spindle leans, from the contact's centre
    lean = report.centroid_mm[1] + 0.22
    assert report.centroid_mm[0] == pytest.approx(0.33, abs=0.004)
    assert 0.05 < lean < 0.2
    want = true_rate(pitch, (0.0, -lean))
    middle, half = len(want) // 2, size // 2
    want = want[middle - half : middle + half + 1, middle - half : middle + half + 1]
    assert np.abs(tif.rate_nm_s - want).max() < 0.03 * want.max()


@pytest.mark.parametrize(("noise", "within"), [(0.5, 0.002), (3.0, 0.01), (10.0, 0.03)])
def test_noise_is_measured_and_moves_the_volume_little(noise: float, within: float) -> None:
    tif, report = tif_from_maps(*maps(0.1, noise_nm_s=noise), 0.1, SECONDS)
    assert report.volume_mm3_min == pytest.approx(VOLUME, rel=within)
    assert report.noise_nm_s == pytest.approx(noise, rel=0.1)
    assert report.centroid_mm[0] == pytest.approx(0.33, abs=0.03)
    half = len(tif.rate_nm_s) // 2
    place = np.arange(-half, half + 1) * 0.1
    assert (tif.rate_nm_s[np.hypot(place[:, None], place) > report.rim_mm] == 0).all()
    assert (tif.rate_nm_s >= 0).all()
    assert 1.4 < report.rim_mm < 2.2


def test_slowly_varying_noise_is_no_rim() -> None:
    """Noise that is correlated over a few samples averages out more slowly: the rim must not run away in it."""
    from scipy import ndimage

    before, after = maps(0.1)
    noise = ndimage.gaussian_filter(np.random.default_rng(7).standard_normal(after.shape), 2.0)
    _, report = tif_from_maps(before, after + SECONDS * 2.0 * noise / noise.std(), 0.1, SECONDS)
    assert report.rim_mm < 2.6
    assert report.volume_mm3_min == pytest.approx(VOLUME, rel=0.03)


def test_a_rim_of_the_users_cuts_there_and_keeps_the_volume_round_it() -> None:
    tif, report = tif_from_maps(*maps(), 0.1, SECONDS, radius_mm=1.5)
    assert report.rim_mm == 1.5
    assert report.volume_change < -0.02
    assert report.volume_mm3_min == pytest.approx(VOLUME, rel=0.01)
    assert len(tif.rate_nm_s) == 31


def test_what_is_known_of_the_measurement_goes_with_it() -> None:
    tif, _ = tif_from_maps(*maps(), 0.1, SECONDS, azimuth_deg=30.0, depth_ratio=0.9, rotates=False)
    assert (tif.azimuth_deg, tif.depth_ratio, tif.rotates) == (30.0, 0.9, False)


def test_turning_the_maps_turns_the_tif() -> None:
    before, after = maps()
    straight, _ = tif_from_maps(before, after, 0.1, SECONDS)
    turned, _ = tif_from_maps(np.rot90(before), np.rot90(after), 0.1, SECONDS)
    np.testing.assert_allclose(turned.rate_nm_s, np.rot90(straight.rate_nm_s), atol=1e-3 * straight.rate_nm_s.max())


def test_missing_samples_round_the_spot_do_no_harm() -> None:
    before, after = maps(noise_nm_s=1.0)
    right, up = axes(0.1)
    after = np.where(np.hypot(right, up) > 3.9, np.nan, after)
    after[3:20, 5:9] = np.nan
    after[40, 70] = np.inf
    _, report = tif_from_maps(before, after, 0.1, SECONDS)
    assert report.volume_mm3_min == pytest.approx(VOLUME, rel=0.01)


def test_the_plane_lies_in_all_of_the_untouched_surface() -> None:
    """Not only in the map's outer ring, of which one side is left here: noise would tilt the plane over the spot."""
    before, after = maps(noise_nm_s=10.0)
    right, up = axes(0.1)
    ring = np.maximum(np.abs(right), np.abs(up)) > 3.15
    after[ring & (right > -3.3)] = np.nan
    _, report = tif_from_maps(before, after, 0.1, SECONDS)
    assert report.volume_mm3_min == pytest.approx(VOLUME, rel=0.02)


def test_a_hole_in_the_spot_is_refused() -> None:
    before, after = maps()
    after[35, 45] = np.nan
    with pytest.raises(ComputeError, match="1 samples of the spot have no data"):
        tif_from_maps(before, after, 0.1, SECONDS)


@pytest.mark.parametrize("noise", [0.0, 1.0, 1000.0])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_no_spot_is_no_tif(noise: float, seed: int) -> None:
    right, up = axes(0.1)
    before = 30 * right + 5
    after = before + 4 * up + noise * np.random.default_rng(seed).standard_normal(right.shape)
    with pytest.raises(ComputeError, match="no spot stands out"):
        tif_from_maps(before, after, 0.1, SECONDS)


def test_maps_in_the_wrong_order_hold_no_spot() -> None:
    before, after = maps(noise_nm_s=0.5)
    with pytest.raises(ComputeError, match=r"no spot stands out|border"):
        tif_from_maps(after, before, 0.1, SECONDS)


@pytest.mark.parametrize("at", [(3.9, 0.0), (0.0, -3.0), (-2.6, 2.6)])
def test_a_spot_at_the_border_is_refused(at: Place) -> None:
    with pytest.raises(ComputeError, match="border"):
        tif_from_maps(*maps(at=at), 0.1, SECONDS)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"seconds": 0.0}, "the time on the spot is 0 s, it must be above 0"),
        ({"seconds": -1.0}, "the time on the spot is -1 s"),
        ({"seconds": np.nan}, "the time on the spot is nan s"),
        ({"pitch_mm": 0.0}, "the maps' pitch is 0 mm"),
        ({"depth_ratio": 0.0}, "depth ratio gamma is 0"),
        ({"radius_mm": 0.0}, "the TIF's radius is 0 mm"),
        ({"radius_mm": 5.0}, "border"),
        ({"after_nm": np.zeros((81, 80))}, r"shape \(81, 81\), the map after \(81, 80\)"),
        ({"before_nm": np.zeros((9, 9)), "after_nm": np.zeros((9, 9))}, "9 x 9 samples are too small"),
        ({"after_nm": np.full((81, 81), np.nan)}, "0 samples of untouched surface have data"),
    ],
)
def test_what_cannot_be_is_refused(changes: dict[str, object], says: str) -> None:
    before, after = maps()
    whole = {"before_nm": before, "after_nm": after, "pitch_mm": 0.1, "seconds": SECONDS}
    with pytest.raises(ComputeError, match=says):
        tif_from_maps(**(whole | changes))  # type: ignore[arg-type]


def test_the_preston_constant_of_a_spot_is_that_it_was_made_with() -> None:
    tif, _ = tif_from_maps(*maps(), 0.1, SECONDS)
    other = dataclasses.replace(PAPER, preston_cm2_per_n=9e-9)
    for process in (PAPER, other):
        assert preston_from_tif(process, 1.0, tif) == pytest.approx(1.49e-9, rel=1e-3)
    soft = preston_from_tif(PAPER, 0.87, tif)
    assert soft == pytest.approx(1.49e-9 / 0.811, rel=2e-3)
    with pytest.raises(ComputeError, match="gamma is -1"):
        preston_from_tif(PAPER, -1.0, tif)


def test_the_width_of_a_gaussian() -> None:
    right, up = axes(0.05)
    assert fwhm_mm(np.exp(-(right**2 + up**2) / 2), 0.05) == pytest.approx(2 * np.sqrt(2 * np.log(2)), rel=5e-3)


def test_a_tif_that_was_really_measured(shared_data: Path) -> None:
    """A fluid-jet spot, ring-shaped, its file cut off at a disc that touches the map's border."""
    data = np.load(shared_data / "measured_tif.npz")
    removal, pitch = data["Z"] * 1e9, data["m_per_pixel"].item() * 1e3
    tif, report = tif_from_maps(removal, np.zeros_like(removal), pitch, 1.0)
    assert report.volume_mm3_min == pytest.approx(0.0056, rel=0.02)
    assert report.fwhm_mm == pytest.approx(4.15, abs=0.02)
    assert report.peak_nm_s == pytest.approx(6.27, rel=0.03)
    assert abs(report.volume_change) < 0.03
    assert report.rim_mm < 5.0
    assert np.isfinite(tif.rate_nm_s).all()
