"""The rigid fit of marks: accuracy at known noise, and what must be refused."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress

import numpy as np
import pytest

from polishd.model.errors import ConfigError, MapError
from polishd.model.surface import Grid
from polishd.process.metrology import registration
from polishd.process.metrology.resampling import Registration
from tests.unit.process.metrology.placed_parts import MARKS_MM, seen_px

Points = tuple[tuple[float, float], ...]
MAP = Grid(1024, 1024, 0.1)
SEVEN_MM = (*MARKS_MM, (46.0, 2.0), (5.0, -46.0), (-46.0, 9.0))


def fit(found: np.ndarray, nominal: Points = MARKS_MM, grid: Grid = MAP) -> Registration:
    return registration.fit_marks([tuple(p) for p in found], nominal, grid.shape, grid.pitch_mm)


@pytest.mark.parametrize("seed", range(8))
def test_exact_marks_in_any_order_are_placed_exactly(seed: int) -> None:
    rng = np.random.default_rng(seed)
    turn, shift = rng.uniform(-180, 180), rng.uniform(-4, 4, 2)
    placed = fit(rng.permutation(seen_px(MARKS_MM, MAP, turn, shift)))
    assert placed.shift_mm == pytest.approx(shift, abs=1e-9)
    assert placed.rotation_deg == pytest.approx(turn, abs=1e-9)
    assert placed.residual_mm == pytest.approx(0, abs=1e-9)
    assert placed.scale == pytest.approx(1)
    assert (placed.used, placed.by) == (4, "fiducials")


@pytest.mark.one_of_each
@pytest.mark.parametrize(("grid", "nominal"), [(MAP, MARKS_MM), (MAP, SEVEN_MM[:6]), (Grid(880, 864, 0.118), SEVEN_MM)])
def test_accuracy_at_a_twentieth_of_a_pixel(grid: Grid, nominal: Points) -> None:
    """RMS over 300 seeds within 0.05 px and 0.005 deg; no placement can do better than least squares on this noise."""
    rng = np.random.default_rng(5)
    off_px, off_deg = [], []
    for _ in range(300):
        turn, shift = rng.uniform(-2, 2), rng.uniform(-2, 2, 2)
        noisy = seen_px(nominal, grid, turn, shift) + rng.normal(0, 0.05, (len(nominal), 2))
        placed = fit(rng.permutation(noisy), nominal, grid)
        off_px.append(np.hypot(*(np.array(placed.shift_mm) - shift)) / grid.pitch_mm)
        off_deg.append(placed.rotation_deg - turn)
    rms_px, rms_deg = np.sqrt(np.mean(np.square(off_px))), np.sqrt(np.mean(np.square(off_deg)))
    p = np.array(nominal) - np.mean(nominal, axis=0)
    least_deg = np.degrees(0.05 / np.sqrt((p**2).sum()) * grid.pitch_mm)
    print(f"{len(nominal)} marks: rms {rms_px:.4f} px {rms_deg:.5f} deg; "
          f"worst {max(off_px):.3f} px {max(np.abs(off_deg)):.4f} deg")  # fmt: skip
    assert rms_px < 0.05
    assert rms_deg < 0.005
    assert rms_deg == pytest.approx(least_deg, rel=0.15)  # the bound of Cramer and Rao


def test_missing_and_spurious_marks_are_left_out() -> None:
    true = seen_px(SEVEN_MM, MAP, 1.2, (0.4, -0.7))
    found = np.vstack([[[500.0, 520.0], [10.0, 1000.0]], true[[6, 2, 4, 0, 3]], [[700.0, 300.0]]])
    placed = fit(found, SEVEN_MM)
    assert placed.used == 5
    assert placed.shift_mm == pytest.approx((0.4, -0.7), abs=1e-9)
    assert placed.rotation_deg == pytest.approx(1.2, abs=1e-9)


def test_a_mark_out_of_tolerance_is_dropped() -> None:
    found = seen_px(SEVEN_MM, MAP, -0.5, (1, 1))
    found[3] += (9, 0)  # 0.9 mm
    placed = fit(found, SEVEN_MM)
    assert placed.used == 6
    assert placed.shift_mm == pytest.approx((1, 1), abs=1e-9)


@pytest.mark.parametrize("nominal", [MARKS_MM, SEVEN_MM])
def test_a_mark_that_is_off_within_the_tolerance_does_not_draw_the_others(nominal: Points) -> None:
    """Dirt half over a mark: 4 px, 0.4 mm; the part's place would be 1 px off."""
    rng = np.random.default_rng(3)
    for k in range(len(nominal)):
        found = seen_px(nominal, MAP, 0.7, (1, -1)) + rng.normal(0, 0.05, (len(nominal), 2))
        found[k] += (2.4, -3.2)
        placed = fit(found, nominal)
        assert placed.used == len(nominal) - 1
        assert np.hypot(placed.shift_mm[0] - 1, placed.shift_mm[1] + 1) < 0.15 * MAP.pitch_mm
    noisy = [fit(seen_px(nominal, MAP) + rng.normal(0, 0.5, (len(nominal), 2)), nominal).used for _ in range(30)]
    assert np.mean(noisy) > len(nominal) - 0.1  # noise alone drops none


def test_too_few_and_too_many_are_refused() -> None:
    true = seen_px(SEVEN_MM, MAP)
    with pytest.raises(MapError, match="at least 5 are needed"):
        fit(true[:4], SEVEN_MM)
    with pytest.raises(MapError, match="0 marks found"):
        fit(true[:0])
    with pytest.raises(MapError, match="dirt rather than marks"):
        fit(np.random.default_rng(0).uniform(0, 1000, (41, 2)))


def test_a_mirror_image_is_refused_by_name() -> None:
    true = seen_px(MARKS_MM, MAP, 1.0, (0.2, 0.1))
    with pytest.raises(MapError, match="mirror image"):
        fit(np.column_stack([true[:, 0], MAP.nx - 1 - true[:, 1]]))
    with pytest.raises(MapError, match="mirror image"):
        fit(true[:, ::-1])


@pytest.mark.parametrize("scale", [0.5, 1.02, 2.0])
def test_another_scale_is_refused_by_name(scale: float) -> None:
    with pytest.raises(MapError, match=f"{scale:.4f} times .* pitch"):
        fit(seen_px(np.array(MARKS_MM) * scale, MAP, 0.3))


def test_a_small_scale_error_passes_the_tolerance_but_not_the_check() -> None:
    with pytest.raises(MapError, match=r"1\.0080 times as far apart"):
        fit(seen_px(np.array(MARKS_MM) * 1.008, MAP))
    assert fit(seen_px(np.array(MARKS_MM) * 1.002, MAP)).scale == pytest.approx(1.002)


def test_two_ways_to_lie_are_refused() -> None:
    square_and_one = ((30.0, 30.0), (-30.0, 30.0), (-30.0, -30.0), (30.0, -30.0), (12.0, 5.0))
    true = seen_px(square_and_one, MAP, 0.5)
    assert fit(true, square_and_one).used == 5
    with pytest.raises(MapError, match=r"fit in \d ways"):
        fit(true[:4], square_and_one)


def test_three_coarse_matches_could_be_chance() -> None:
    rng = np.random.default_rng(4)
    near = seen_px(MARKS_MM[:3], MAP) + np.array([(2, 3), (-3, 1), (1, -4)])
    crowd = np.vstack([near, rng.uniform(0, 1023, (25, 2))])
    with pytest.raises(MapError, match="chance"):
        fit(crowd, MARKS_MM[:3])


@pytest.mark.parametrize(
    ("marks", "match"),
    [
        (((0.0, 0.0), (9.0, 9.0)), "at least 3"),
        (((30.0, 0.0), (-30.0, 0.0), (0.0, 40.0)), "flipped"),
        (((30.0, 0.0), (-30.0, 0.3), (0.2, 40.0)), "flipped"),
        (((30.0, 10.0), (-10.0, 30.0), (-30.0, -10.0), (10.0, -30.0)), "turned by"),
        (((30.0, 0.0), (30.5, 0.0), (0.0, 40.0)), "less than four tolerances"),
        (((-30.0, 0.0), (0.0, 0.0), (30.0, 0.0)), "turned by 180|turned by -180"),
    ],
)
def test_symmetric_marks_are_refused(marks: Points, match: str) -> None:
    with pytest.raises(ConfigError, match=match):
        registration.require_asymmetric(marks)


def test_asymmetric_marks_are_taken() -> None:
    registration.require_asymmetric(MARKS_MM)
    registration.require_asymmetric(MARKS_MM[:3])


def wrong_sets(rng: np.random.Generator) -> Iterator[np.ndarray]:
    """Yield one set of each wrong kind: strewn, another part's, mirrored, scaled, and too many replaced."""
    true = seen_px(SEVEN_MM[:6], MAP, rng.uniform(-2, 2), rng.uniform(-2, 2, 2))
    middle = (MAP.nx - 1) / 2
    yield rng.uniform(0, MAP.nx - 1, (rng.integers(3, 9), 2))
    yield seen_px(rng.uniform(-46, 46, (6, 2)), MAP)
    yield rng.permutation(np.column_stack([true[:, 0], 2 * middle - true[:, 1]]))
    yield rng.permutation(middle + (true - middle) * rng.choice([0.5, 0.9, 0.98, 1.02, 1.1, 2.0]))
    kept = rng.permutation(true)[: rng.integers(1, 4)]
    yield rng.permutation(np.vstack([kept, rng.uniform(0, MAP.nx - 1, (6 - len(kept), 2))]))


@pytest.mark.full
@pytest.mark.parametrize("rounds", [400, pytest.param(2000, marks=pytest.mark.slow)])
def test_no_wrong_set_is_accepted(rounds: int) -> None:
    """10,000 of them in the long campaign."""
    rng = np.random.default_rng(12)
    accepted, tried = [], 0
    for _ in range(rounds):
        for found in wrong_sets(rng):
            tried += 1
            with suppress(MapError):  # as it should be: what is not refused is counted
                accepted.append(fit(found, SEVEN_MM[:6]))
    assert tried == 5 * rounds
    assert accepted == []
