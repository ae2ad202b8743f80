"""The removal check accepts good passes, stops on mistakes, and lists the mistakes that a pass cannot show.

How often the gate is wrong: good passes that it stops, and mistakes that it neither stops nor calls undecidable.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
from scipy import ndimage

from polishd.model.errors import ComputeError
from polishd.model.surface import BoolArray, FloatArray, Grid
from polishd.process.frames import ORIENTATIONS, ArrayOrientation
from polishd.process.identification.removal_check import RemovalCheckResult, check_removal, explains_better
from tests.unit.process.gaussian import rough

GRID = Grid(110, 110, 1.0)
MASK = GRID.radius_mm() <= 50
X, Y = np.meshgrid(GRID.x_mm, GRID.y_mm)
PREDICTED = 60 + rough(GRID, rms_nm=15)


def noise(seed: int, rms_nm: float = 0.3) -> FloatArray:
    return np.random.default_rng(seed).normal(0, rms_nm, GRID.shape)


def moved(height: FloatArray, x_mm: float, y_mm: float) -> FloatArray:
    return np.asarray(ndimage.shift(height, (-y_mm, x_mm), order=5, mode="nearest"))


@pytest.mark.one_of_each
@pytest.mark.parametrize("seed", range(10))
def test_good_passes_go_on(seed: int) -> None:
    """Noise, 10 % of rate, 0.2 mm of shift, any piston and tilt, and a removal model that is 10 % off in form."""
    rng = np.random.default_rng(seed)
    predicted = 60 + rough(GRID, rms_nm=rng.uniform(4, 30), seed=seed, cut_mm=rng.uniform(5, 20))
    angle, rate = rng.uniform(0, 2 * np.pi), rng.uniform(0.9, 1.1)
    measured = rate * moved(predicted, 0.2 * np.cos(angle), 0.2 * np.sin(angle)) + noise(seed) - 700 + X - 2 * Y
    measured += 0.1 * predicted.std() * rough(GRID, rms_nm=1, seed=seed + 50)
    verdict = check_removal(predicted, measured, MASK, GRID.pitch_mm)
    assert verdict.stop == ""
    assert verdict.rate == pytest.approx(rate, abs=max(5 * verdict.rate_sigma, 0.02))
    assert verdict.best.as_it_is
    assert np.hypot(*verdict.shift_mm) < 0.5


def test_a_small_shift_is_measured_and_noted() -> None:
    verdict = check_removal(PREDICTED, moved(PREDICTED, 0.2, -0.1) + noise(1), MASK, GRID.pitch_mm)
    assert verdict.stop == ""
    assert verdict.shift_mm == pytest.approx((0.2, -0.1), abs=0.03)
    assert "(+0.2" in verdict.notes[0]


@pytest.mark.one_of_each
@pytest.mark.parametrize("angle_deg", [0, 37, 90, 200, 315])
@pytest.mark.parametrize("distance_mm", [1.0, 3.0])
def test_shifts_stop(angle_deg: float, distance_mm: float) -> None:
    x, y = distance_mm * np.cos(np.radians(angle_deg)), distance_mm * np.sin(np.radians(angle_deg))
    verdict = check_removal(PREDICTED, moved(PREDICTED, x, y) + noise(2), MASK, GRID.pitch_mm)
    assert "mm from where it was predicted" in verdict.stop
    assert verdict.shift_mm == pytest.approx((x, y), abs=0.06)
    assert np.nanstd(verdict.best_residual_nm) < 0.5 * np.nanstd(verdict.residual_nm)


@pytest.mark.full
def test_a_pass_that_is_made_to_find_a_shift_may_have_more_of_it() -> None:
    measured = moved(PREDICTED, 1.5, 0.0) + noise(2)
    assert check_removal(PREDICTED, measured, MASK, GRID.pitch_mm).stop
    verdict = check_removal(PREDICTED, measured, MASK, GRID.pitch_mm, most_shift_mm=3.0)
    assert not verdict.stop
    assert verdict.shift_mm == pytest.approx((1.5, 0.0), abs=0.06)


@pytest.mark.full
def test_shifts_on_a_fine_grid_stop_too() -> None:
    fine = Grid(200, 200, 0.5)
    predicted = 60 + rough(fine, rms_nm=10)
    measured = ndimage.shift(predicted, (0, 2), order=5, mode="nearest")
    verdict = check_removal(predicted, measured, fine.radius_mm() <= 45, fine.pitch_mm)
    assert verdict.shift_mm == pytest.approx((1, 0), abs=0.02)
    assert verdict.stop


@pytest.mark.one_of_each
@pytest.mark.parametrize(
    ("factor", "said"), [(0.5, "half"), (2.0, "double"), (0.02, "hardly"), (1.5, "removal is 1."), (3, "times the")]
)
def test_factors_stop(factor: float, said: str) -> None:
    verdict = check_removal(PREDICTED, factor * PREDICTED + noise(3), MASK, GRID.pitch_mm)
    assert said in verdict.stop
    assert verdict.rate == pytest.approx(factor, abs=0.01)


@pytest.mark.one_of_each
@pytest.mark.parametrize("factor", [0.62, 0.8, 1.38])
def test_a_rate_to_be_learned_goes_on(factor: float) -> None:
    assert check_removal(PREDICTED, factor * PREDICTED + noise(4), MASK, GRID.pitch_mm).stop == ""


@pytest.mark.full
def test_learning_may_be_given_less_but_never_so_much_that_half_is_a_rate() -> None:
    for factor, rates, stops in (
        (0.75, (0.8, 1.2), True), (0.85, (0.8, 1.2), False), (1.3, (0.8, 1.2), True), (0.5, (0.1, 1.9), True),
    ):  # fmt: skip
        stop = check_removal(PREDICTED, factor * PREDICTED + noise(4), MASK, GRID.pitch_mm, rates).stop
        assert bool(stop) == stops, factor
        assert ("0.8 to 1.2 are allowed (limits.max_rate_change)" in stop) == (stops and factor > 0.5)


@pytest.mark.full
@pytest.mark.parametrize("factor", [0.55, 1.6])
def test_a_rate_that_may_as_well_be_allowed_goes_on_and_is_said(factor: float) -> None:
    """Only what is beyond the limits by more than its own error stops; "half" at 0.48 +- 0.10 did."""
    weak = PREDICTED / 8
    wide = ndimage.gaussian_filter(noise(21), 4)
    verdict = check_removal(weak, factor * weak + 2.0 * wide / wide.std(), MASK, GRID.pitch_mm)
    assert not 0.6 <= verdict.rate <= 1.4
    assert verdict.rate_sigma > 0.05
    assert verdict.stop == ""
    assert "beyond 0.6 to 1.4" in verdict.notes[0]
    assert "scaled" in verdict.undecidable
    assert check_removal(PREDICTED, factor * PREDICTED + 2.0 * wide / wide.std(), MASK, GRID.pitch_mm).stop


@pytest.mark.one_of_each
@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("way", ORIENTATIONS[1:], ids=lambda way: way.name)
def test_turns_and_flips_stop_even_beside(way: ArrayOrientation, sign: int) -> None:
    measured = sign * moved(np.asarray(way.turn(PREDICTED)), 2, -1) + noise(5, 1.0)
    verdict = check_removal(PREDICTED, measured, MASK, GRID.pitch_mm)
    assert way.name in verdict.stop
    assert ("negated" in verdict.stop) == (sign < 0)
    assert (verdict.best.orientation, verdict.best.negated) == (way, sign < 0)
    assert verdict.shift_mm == pytest.approx((2, -1), abs=0.1)
    assert verdict.rate == pytest.approx(1, abs=0.02)


def test_negation_stops() -> None:
    assert "predicted one negated" in check_removal(PREDICTED, -PREDICTED, MASK, GRID.pitch_mm).stop


def test_the_picture_shows_both_ways() -> None:
    verdict = check_removal(PREDICTED, np.rot90(PREDICTED) + noise(6), MASK, GRID.pitch_mm)
    for array in (verdict.predicted_nm, verdict.measured_nm, verdict.residual_nm):
        assert array.shape == GRID.shape
        assert (np.isfinite(array) == MASK).all()
    shown = np.isfinite(verdict.explained_nm)
    assert shown.sum() > 0.9 * MASK.sum()
    np.testing.assert_allclose(verdict.explained_nm[shown], verdict.measured_nm[shown], atol=2)
    assert np.nanstd(verdict.best_residual_nm) < 0.4
    assert np.nanstd(verdict.residual_nm) > 10


@pytest.mark.full
def test_a_turn_that_noise_brings_about_is_not_claimed() -> None:
    """On a small part some turn always fits noise better; the one claimed here was "transposed and negated"."""
    small = Grid(30, 30, 1.0)
    mask = small.radius_mm() <= 13
    for seed in range(30):
        weak, drift = rough(small, rms_nm=2, seed=seed, cut_mm=9), rough(small, rms_nm=2.5, seed=100 + seed, cut_mm=9)
        verdict = check_removal(weak, weak + drift, mask, small.pitch_mm)
        assert "looks like" not in verdict.stop
        if verdict.correlation < 0.5:
            assert len(verdict.undecidable) > 10


@pytest.mark.full
def test_drift_of_the_set_up_is_no_mistake() -> None:
    """Power and astigmatism that come and go with temperature, as high as what was removed."""
    bowl = PREDICTED / 10 + 4 * (X**2 + Y**2) / 2500
    for drift in (-9 * (X**2 + Y**2) / 2500, 5 * (X**2 - Y**2) / 2500, 8 * (X**2 + Y**2) / 2500):
        assert check_removal(bowl, bowl + drift + noise(22), MASK, GRID.pitch_mm).stop == ""


def test_even_removal_shows_nothing() -> None:
    verdict = check_removal(np.full(GRID.shape, 50.0) + 0.3 * X, PREDICTED, MASK, GRID.pitch_mm)
    assert verdict.stop == ""
    assert {"negated", "turned 90", "flipped up-down and negated", "shifted", "scaled"} <= set(verdict.undecidable)
    assert len(verdict.undecidable) == 17
    assert np.isnan(verdict.rate)


def test_symmetric_removal_shows_no_turn() -> None:
    bowl = 20 * np.exp(-(X**2 + Y**2) / 400)
    verdict = check_removal(bowl, bowl + noise(7), MASK, GRID.pitch_mm)
    assert set(verdict.undecidable) == {way.name for way in ORIENTATIONS[1:]}
    assert "cannot show" in verdict.notes[-1]
    assert "negated" in check_removal(bowl, -bowl + noise(7), MASK, GRID.pitch_mm).stop


@pytest.mark.full
def test_removal_that_is_even_along_a_line_shows_no_shift_there() -> None:
    ridge = 10 * np.cos(X / 9)
    verdict = check_removal(ridge, ridge + noise(8), MASK, GRID.pitch_mm)
    assert "shifted" in verdict.undecidable
    assert {"turned 180", "flipped left-right", "flipped up-down"} <= set(verdict.undecidable)
    assert "turned 90" not in verdict.undecidable
    assert check_removal(ridge, moved(ridge, 1.5, 0) + noise(8), MASK, GRID.pitch_mm).stop


def test_structured_removal_leaves_nothing_undecided() -> None:
    assert check_removal(PREDICTED, PREDICTED + noise(9), MASK, GRID.pitch_mm).undecidable == ()


def test_what_noise_drowns_is_undecided() -> None:
    weak = PREDICTED / 8
    verdict = check_removal(weak, weak + noise(10, 12.0), MASK, GRID.pitch_mm)
    assert verdict.stop == ""
    assert "turned 90" in verdict.undecidable


def test_when_another_explanation_is_the_better_one() -> None:
    assert explains_better(0.99, 0.95)  # leaves a fifth of what the first leaves
    assert explains_better(0.7, 0.55)
    assert not explains_better(0.99, 0.985)
    assert not explains_better(0.7, 0.65)
    assert not explains_better(0.45, -0.3)


def test_arrays_that_do_not_fit_are_refused() -> None:
    with pytest.raises(ComputeError, match="mask"):
        check_removal(PREDICTED[1:], PREDICTED, MASK, 1.0)
    with pytest.raises(ComputeError, match="measured is not finite"):
        check_removal(PREDICTED, np.where(X == 0.5, np.nan, PREDICTED), MASK, 1.0)
    with pytest.raises(ComputeError, match="too few"):
        check_removal(PREDICTED, PREDICTED, GRID.radius_mm() < 4, 1.0)


@pytest.mark.parametrize("seed", [28, 55, 156, 199])
def test_an_undetermined_shift_does_not_bias_the_rate_of_a_small_part(seed: int) -> None:
    """Removal that rises to the rim is also its own slope: fitted with a shift of 1.6 +- 2.5 mm the rate was 0.17."""
    grid = Grid(34, 34, 0.5)
    radius, rng = grid.radius_mm(), np.random.default_rng(seed)
    towards_the_rim = 8 * np.exp((radius - 7) / 3) * (1 + 0.6 * grid.x_mm[None, :] / 7)
    predicted = towards_the_rim + 6 * ndimage.gaussian_filter(rng.normal(size=grid.shape), 3)
    smooth = 12 * np.sqrt(np.pi) * ndimage.gaussian_filter(rng.normal(size=grid.shape), 3)
    verdict = check_removal(predicted, 0.75 * predicted + smooth, radius <= 7, grid.pitch_mm)
    assert verdict.stop == ""
    assert abs(verdict.rate - 0.75) < 3 * verdict.rate_sigma


MASKS = ("circle", "D", "rectangle", "cut ring", "hole beside")
COUNTS = [32, pytest.param(3000, marks=[pytest.mark.slow, pytest.mark.timeout(1800)])]


def part(kind: str, grid: Grid) -> BoolArray:
    x, y = np.meshgrid(grid.x_mm, grid.y_mm)
    size = 0.45 * grid.nx * grid.pitch_mm
    r = np.hypot(x, y)
    return {
        "circle": r <= size,
        "D": (r <= size) & (x < 0.5 * size),
        "rectangle": (abs(x - 0.1 * size) < 0.75 * size) & (abs(y) < 0.5 * size),
        "cut ring": (r <= size) & (r > 0.3 * size) & ~((y > 0) & (abs(x) < 0.15 * size)),
        "hole beside": (r <= size) & (np.hypot(x - 0.4 * size, y) > 0.3 * size),
    }[kind]


@dataclass(frozen=True)
class Pass:
    """A good pass: what was predicted, what was removed, and what two maps add to it."""

    grid: Grid
    mask: BoolArray
    predicted: FloatArray
    removed: FloatArray
    added: FloatArray

    def judged(self, removed: FloatArray) -> RemovalCheckResult:
        return check_removal(self.predicted, removed + self.added, self.mask, self.grid.pitch_mm)


@cache
def a_pass(seed: int) -> Pass:
    """Parts of 20 to 60 mm; 1.6 to 30 nm of figure; noise of 0.2 to 3 nm, white or as wide as half a spot.

    The noise of the map before is planned on, and polished in; rate and form are 15 and 10 % off, the place 0.2 mm;
    power and astigmatism change by up to 3 nm between the maps.
    """
    rng = np.random.default_rng(seed)
    size, pitch = [(45, 0.5), (30, 1.0), (50, 0.75), (50, 1.3)][rng.integers(4)]
    grid = Grid(int(size), int(size), pitch)
    x, y = np.meshgrid(grid.x_mm, grid.y_mm)
    mask, half, cut = part(str(rng.choice(MASKS)), grid), x.max(), min(rng.uniform(4, 20), x.max() / 1.5)
    seeds, wide = rng.integers(10**9, size=2), float(rng.choice([0, 1, 2])) / grid.pitch_mm
    figure, form = (rough(grid, 1.0, int(s), max(cut, 4 * grid.pitch_mm)) for s in seeds)
    figure *= np.exp(rng.uniform(np.log(1.6), np.log(30))) / figure[mask].std()
    level = np.exp(rng.uniform(np.log(0.2), np.log(3)))
    white = (ndimage.gaussian_filter(rng.normal(size=grid.shape), wide, mode="wrap") for _ in range(2))
    before, after = (level * noise / noise.std() for noise in white)
    predicted = ndimage.gaussian_filter(figure + before, rng.uniform(1.5, 4) / grid.pitch_mm)
    angle, off = rng.uniform(0, 2 * np.pi), rng.uniform(0, 0.2) / grid.pitch_mm
    removed = ndimage.shift(predicted, (off * np.sin(angle), off * np.cos(angle)), order=3, mode="nearest")
    removed += rng.uniform(0, 0.1) * predicted[mask].std() * form
    bent = rng.uniform(-3, 3) * (x**2 + y**2) / half**2 + rng.uniform(-1, 1) * (x**2 - y**2 + x * y) / half**2
    return Pass(grid, mask, predicted, rng.uniform(0.85, 1.15) * removed, before - after + bent + 300 - 2 * x)


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize("count", COUNTS)
def test_good_passes_are_not_stopped(count: int) -> None:
    """Of 1000, 61 were before significance was asked for; now 2, where the maps' noise is as large as the removal."""
    stopped = [verdict.stop for verdict in (made.judged(made.removed) for made in map(a_pass, range(count)))
               if verdict.stop]  # fmt: skip
    print(*stopped, sep="\n")
    assert len(stopped) <= 3e-3 * count


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize("count", COUNTS)
def test_mistakes_are_stopped_or_said_to_be_undecidable(count: int) -> None:
    """A turn, flip or negation; and a shift of 2 mm."""
    missed, named, sure = [], 0, 0
    for seed in range(count):
        made, way, sign = a_pass(seed), ORIENTATIONS[seed % 8], 1 if seed % 3 else -1
        if way == ORIENTATIONS[0] and sign > 0:
            wrong, name = ndimage.shift(made.removed, (2 / made.grid.pitch_mm, 0), order=3, mode="nearest"), "shifted"
        else:
            wrong = sign * np.asarray(way.turn(made.removed))
            name = " and ".join([way.name] * (way != ORIENTATIONS[0]) + ["negated"] * (sign < 0))
        verdict = made.judged(wrong)
        named += bool(verdict.stop) and (verdict.best.name == name or name == "shifted")
        sure += bool(verdict.stop)
        if not verdict.stop and name not in verdict.undecidable:
            missed.append((seed, name))
    assert len(missed) <= 2e-3 * count, missed
    assert named > 0.85 * sure > 0.35 * count


@pytest.mark.full
@pytest.mark.parametrize("factor", [0.5, 2.0])
@pytest.mark.parametrize("count", COUNTS)
def test_factors_are_stopped_or_said_to_be_undecidable(count: int, factor: float) -> None:
    """Where the rate is 15 % off, too, half of it is near what may be learned: then that stands in the notes."""
    stopped = missed = 0
    for seed in range(count):
        verdict = (made := a_pass(seed)).judged(factor * made.removed)
        stopped += bool(verdict.stop)
        reported = verdict.stop or "scaled" in verdict.undecidable or "too large to prove" in str(verdict.notes)
        missed += not reported and abs(verdict.rate - 1) > 0.4 + 0.05
    assert missed <= 2e-3 * count
    assert stopped > 0.3 * count
