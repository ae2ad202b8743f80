"""Ripple of a path, against a direct sum on a grid of a twentieth of the spot radius that shares no code with it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.stats import chi2

from polishd.model.errors import ComputeError
from polishd.model.process import ToolProcess
from polishd.model.surface import BoolArray, FloatArray, Grid
from polishd.process.removal import contact, path_lines
from polishd.process.removal.path_lines import patch_frames
from polishd.process.removal.quiet_pitch import ContactAt, quiet_pitch, ripple_shares
from polishd.process.removal.ripple import (
    RADIUS_ERROR,
    SEAT_MM,
    ActingSpots,
    PathErrors,
    Ripple,
    RippleLine,
    sum_ripples,
)
from polishd.process.removal.ripple_forecast import ripple_of
from polishd.process.removal.tif import HertzSpot, WiderSpot
from polishd.process.removal.tif_family import PathBlocks

PROCESS = ToolProcess()
DEPTH_MM = contact.hertz_depth_mm(PROCESS)
RADIUS_MM = float(contact.contact_radius_mm(PROCESS, DEPTH_MM))
GRID = Grid(61, 61, 0.5)
CLEAR_MM = 14.0


def clear() -> BoolArray:
    x, y = np.meshgrid(GRID.x_mm, GRID.y_mm)
    return np.asarray(np.hypot(x, y) < CLEAR_MM)


@dataclass(frozen=True)
class Lines:
    """A raster of 40 mm, each point or block with its dwell."""

    pitch_mm: float
    step_mm: float = 1.0
    rests: bool = False
    azimuth_deg: float = 90.0
    gamma: tuple[float, float] = (0.95, 0.95)
    """At both ends of the part, linear between them across the lines."""
    slope: tuple[float, float] = (0.0, 0.0)
    """Relative change of the removal from the centre to 20 mm, along and across the lines."""
    angle_deg: float = 0.0
    mean_nm: float = 20.0

    def blocks(self) -> tuple[PathBlocks, FloatArray]:
        """The path and its dwell."""
        half, starts, ends = 20.0, [], []
        for number, y in enumerate(np.arange(-half, half + self.pitch_mm / 2, self.pitch_mm)):
            x = np.arange(-half, half + self.step_mm / 2, self.step_mm)[:: -1 if number % 2 else 1]
            points = np.column_stack([x, np.full(x.size, y)])
            starts.append(points if self.rests else points[:-1])
            ends.append(points if self.rests else points[1:])
        start, end = np.concatenate(starts), np.concatenate(ends)
        middle = (start + end) / 2
        low, high = self.gamma
        gamma = low + (high - low) * (middle[:, 1] + half) / (2 * half)
        wanted = self.mean_nm * (1 + middle @ np.array(self.slope) / half)
        rate = contact.volume_rate_nm_mm2_s(PROCESS, DEPTH_MM * gamma)
        turn = np.radians(self.angle_deg)
        axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        azimuth = np.full(len(start), np.radians(self.azimuth_deg))
        blocks = PathBlocks(start @ axes, end @ axes, azimuth, gamma, np.ones(len(start)))
        return blocks, wanted * self.pitch_mm * self.step_mm / rate


def direct_nm(
    blocks: PathBlocks, time_s: FloatArray, scale: float, half_mm: float, pieces: int = 24
) -> tuple[FloatArray, FloatArray]:
    """Return places (m,) and removal (m, m), rows with y: the sum of the rate at each place over the positions."""
    side = 2 * int(np.ceil(half_mm / (RADIUS_MM / 20))) + 1
    at = np.linspace(-half_mm, half_mm, side)
    height = np.zeros((side, side))
    near = np.abs((blocks.start_mm + blocks.end_mm) / 2).max(axis=1) < half_mm + 3 * RADIUS_MM
    for k in np.flatnonzero(near):
        moves = np.linalg.norm(blocks.end_mm[k] - blocks.start_mm[k]) > 0
        depth = np.array(DEPTH_MM * blocks.depth_ratio[k])
        radius = RADIUS_MM * blocks.depth_ratio[k] ** 0.5
        sine, cosine = np.sin(blocks.azimuth_rad[k]), np.cos(blocks.azimuth_rad[k])
        count = pieces if moves else 1
        for share in (np.arange(count) + 0.5) / count:
            centre = blocks.start_mm[k] + share * (blocks.end_mm[k] - blocks.start_mm[k])
            column, row = (slice(*np.searchsorted(at, [c - radius * scale, c + radius * scale])) for c in centre)
            u, v = np.meshgrid((at[column] - centre[0]) / scale, (at[row] - centre[1]) / scale)
            touched = u**2 + v**2 < radius**2
            tool = u[touched] * sine - v[touched] * cosine, u[touched] * cosine + v[touched] * sine
            rate = contact.removal_rate_nm_s(PROCESS, depth, *tool)
            height[row, column][touched] += rate * time_s[k] / count / scale**2
    return at, height


def amplitudes(at: FloatArray, height: FloatArray, angle_deg: float, period_mm: float) -> FloatArray:
    """(3,) amplitude of the harmonics along a direction, beside a smooth surface, by least squares."""
    x, y = np.meshgrid(at, at)
    along = x * np.cos(np.radians(angle_deg)) + y * np.sin(np.radians(angle_deg))
    terms = [x**i * y**j for i in range(4) for j in range(4 - i)]
    for n in (1, 2, 3):
        terms += [np.cos(2 * np.pi * n * along / period_mm), np.sin(2 * np.pi * n * along / period_mm)]
    basis = np.column_stack([term.ravel() for term in terms])
    found = np.linalg.lstsq(basis, height.ravel(), rcond=None)[0][-6:].reshape(3, 2)
    return np.asarray(np.hypot(*found.T))


def forecast(lines: Lines, radius_error: float = RADIUS_ERROR) -> Ripple:
    blocks, time_s = lines.blocks()
    return ripple_of(ActingSpots(HertzSpot(PROCESS), blocks), time_s, GRID, clear(), errors=PathErrors(radius_error))


def of(ripple: Ripple, direction: str) -> list[RippleLine]:
    return [one for one in ripple.lines if one.direction == direction]


CASES = [
    Lines(0.972),
    Lines(1.2, azimuth_deg=0.0),
    Lines(1.5, angle_deg=30.0),
    Lines(2.0, slope=(0.3, 0.5), gamma=(0.9, 1.0)),
    Lines(1.2, step_mm=0.5, gamma=(0.85, 0.98), azimuth_deg=40.0, slope=(0.0, 0.6)),
]


@pytest.mark.full
@pytest.mark.parametrize("lines", CASES, ids=lambda one: f"{one.pitch_mm}-{one.angle_deg}-{one.azimuth_deg}")
def test_the_lines_of_a_raster_are_those_of_a_direct_sum(lines: Lines) -> None:
    blocks, time_s = lines.blocks()
    across = of(forecast(lines), "across")
    assert [one.period_mm for one in across] == pytest.approx([lines.pitch_mm / n for n in (1, 2, 3)], rel=1e-3)
    for scale, figure in ((1.0, "rms_nm"), (0.97, "rms_high_nm"), (1.03, "rms_high_nm")):
        exact = amplitudes(*direct_nm(blocks, time_s, scale, 2 * lines.pitch_mm), lines.angle_deg + 90, lines.pitch_mm)
        found = np.array([getattr(one, figure) for one in across]) * 2**0.5
        total, known = float(np.linalg.norm(exact)), float(np.linalg.norm(found))
        if figure == "rms_nm":
            assert known == pytest.approx(total, rel=0.1)
        else:
            assert known >= 0.9 * total


@pytest.mark.parametrize(
    "lines",
    [
        pytest.param(Lines(4.0), id="moving"),
        pytest.param(Lines(4.5, rests=True, step_mm=1.5), id="resting", marks=pytest.mark.full),
    ],
)
def test_lines_farther_apart_than_a_spot_is_wide_have_coarser_cells_and_the_same_ripple(
    lines: Lines, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocks, time_s = lines.blocks()
    coarse, frames = forecast(lines), patch_frames(ActingSpots(HertzSpot(PROCESS), blocks), time_s, GRID, clear(), 4)
    assert [frame.cells for frame in frames] == [path_lines.MOST_CELLS] * 4
    monkeypatch.setattr(path_lines, "MOST_CELLS", 1000)
    fine = forecast(lines)
    assert coarse.rms_nm == pytest.approx(fine.rms_nm, rel=0.01)
    assert coarse.rms_high_nm == pytest.approx(fine.rms_high_nm, rel=0.01)


@pytest.mark.full
def test_points_at_rest_leave_a_pattern_along_the_lines_too() -> None:
    lines = Lines(1.0, rests=True)
    blocks, time_s = lines.blocks()
    at, height = direct_nm(blocks, time_s, 1.0, 2.0)
    found = forecast(lines)
    for direction, angle in (("across", 90.0), ("along", 0.0)):
        own = np.array([one.amplitude_nm for one in of(found, direction)])
        assert np.linalg.norm(own) == pytest.approx(np.linalg.norm(amplitudes(at, height, angle, 1.0)), rel=0.1)


def test_a_moving_tool_leaves_no_pattern_along_its_lines() -> None:
    assert of(forecast(Lines(1.0)), "along") == []


@pytest.mark.full
def test_an_uncertain_radius_counts_the_more_the_nearer_the_distance_is_to_a_null_of_the_spot() -> None:
    null, beside = forecast(Lines(0.967)), forecast(Lines(1.2))
    assert null.rms_high_nm > 1.25 * null.rms_nm
    assert beside.rms_high_nm < 1.15 * beside.rms_nm
    assert forecast(Lines(0.967), 0.0).rms_high_nm == pytest.approx(null.rms_nm)


@pytest.mark.full
def test_lines_that_a_cell_averages_away_are_not_on_the_grid() -> None:
    ripple = forecast(Lines(0.5))
    assert ripple.lines[0].on_grid < 1e-6
    assert ripple.finer_nm == pytest.approx(ripple.rms_nm)
    coarse = forecast(Lines(2.0))
    assert coarse.lines[0].on_grid == pytest.approx(np.sinc(0.25) ** 2)
    assert coarse.finer_nm < 0.6 * coarse.rms_nm


def test_a_map_shows_what_its_samples_resolve() -> None:
    ripple = forecast(Lines(0.972))
    assert ripple.shown_nm(0.02) == pytest.approx(ripple.finer_nm, rel=0.02)
    assert ripple.shown_nm(None, high=True) > ripple.shown_nm(0.1, high=True) > ripple.shown_nm(0.5, high=True)


@pytest.mark.full
def test_a_spiral_has_the_ripple_of_a_raster_of_its_pitch() -> None:
    pitch, turns = 1.5, 13
    angle = np.sqrt(np.arange(1, 20_000) / 19_999.0) * 2 * np.pi * turns
    radius = pitch * angle / (2 * np.pi)
    points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])[::10]
    start, end = points[:-1], points[1:]
    rate = float(contact.volume_rate_nm_mm2_s(PROCESS, np.array([0.95 * DEPTH_MM]))[0])
    time_s = 20.0 * pitch * np.linalg.norm(end - start, axis=1) / rate
    n = len(start)
    blocks = PathBlocks(start, end, np.full(n, np.pi / 2), np.full(n, 0.95), np.ones(n))
    found = ripple_of(ActingSpots(HertzSpot(PROCESS), blocks), time_s, GRID, clear())
    # its lines run in all directions, across which the spot of a leaning spindle is not the same
    sides = [forecast(Lines(pitch, azimuth_deg=azimuth)).rms_nm for azimuth in (0.0, 90.0)]
    assert 0.9 * min(sides) < found.rms_nm < 1.1 * max(sides)
    assert found.lines[0].period_mm == pytest.approx(pitch, rel=0.02)


@pytest.mark.full
def test_a_path_without_lines_has_one_figure_for_all_directions() -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform(-20, 20, (1600, 2))
    n = len(points)
    blocks = PathBlocks(points, points, np.full(n, np.pi / 2), np.full(n, 0.95), np.ones(n))
    time_s = np.full(n, 1.0)
    found = ripple_of(ActingSpots(HertzSpot(PROCESS), blocks), time_s, GRID, clear())
    assert [one.direction for one in found.lines] == ["every"]
    _, height = direct_nm(blocks, time_s, 1.0, 4.0)
    assert 0.0 < found.rms_nm < float(height.std())


@pytest.mark.full
def test_a_wider_spot_of_the_same_volume_is_the_spot_of_the_high_value() -> None:
    lines = Lines(1.5)
    blocks, time_s = lines.blocks()
    spots = [WiderSpot(HertzSpot(PROCESS, 128), factor) for factor in (1.0, 0.97, 1.03)]
    each = [
        ripple_of(ActingSpots(spot, blocks), time_s, GRID, clear(), errors=PathErrors(0.0)).lines[0] for spot in spots
    ]
    assert forecast(lines).lines[0].rms_high_nm == pytest.approx(max(one.rms_nm for one in each), rel=1e-3)


@pytest.mark.full
def test_a_curved_contact_is_laid_down_as_it_is_widened() -> None:
    blocks, time_s = Lines(1.5).blocks()
    wide = replace(blocks, bent=np.tile([1.1, 1.1, 0.0], (blocks.n, 1)))
    plain = ripple_of(
        ActingSpots(WiderSpot(HertzSpot(PROCESS), 1.1), blocks), time_s, GRID, clear(), errors=PathErrors(0.0)
    )
    curved = ripple_of(ActingSpots(HertzSpot(PROCESS), wide), time_s, GRID, clear(), errors=PathErrors(0.0))
    assert curved.lines[0].rms_nm == pytest.approx(plain.lines[0].rms_nm, rel=0.02)


def test_no_block_in_the_aperture_leaves_no_ripple() -> None:
    blocks, time_s = Lines(1.0).blocks()
    acting = ActingSpots(HertzSpot(PROCESS), blocks)
    assert ripple_of(acting, np.zeros_like(time_s), GRID, clear()).lines == ()
    assert ripple_of(acting, time_s, GRID, np.zeros(GRID.shape, dtype=np.bool_)).lines == ()


@pytest.mark.parametrize(
    ("wrong", "what"),
    [
        (PathErrors(-0.1), "the error of the spot's radius"),
        (PathErrors(0.7), "the error of the spot's radius"),
        (PathErrors(np.nan), "the error of the spot's radius"),
        (PathErrors(line_mm=-1.0), "the error of a line's place"),
        (PathErrors(lag_mm=np.inf), "the lag"),
    ],
)
def test_an_error_that_cannot_be_is_refused(wrong: PathErrors, what: str) -> None:
    with pytest.raises(ComputeError, match=what):
        with_errors(Lines(1.0), wrong)


# Lines out of place, and a tool that trails its path.


def with_errors(lines: Lines, errors: PathErrors) -> Ripple:
    blocks, time_s = lines.blocks()
    return ripple_of(ActingSpots(HertzSpot(PROCESS), blocks), time_s, GRID, clear(), errors=errors)


def by_cause(ripple: Ripple, cause: str) -> list[RippleLine]:
    return [one for one in ripple.lines if one.cause == cause]


def profile(y: FloatArray, azimuth_deg: float) -> FloatArray:
    """(m,) removal of a straight line across it, of mean 1 over 1 mm: the rate summed along the line."""
    x = np.arange(-1.2 * RADIUS_MM, 1.2 * RADIUS_MM, RADIUS_MM / 200)[:, None]
    sine, cosine = np.sin(np.radians(azimuth_deg)), np.cos(np.radians(azimuth_deg))
    tool = x * sine - y * cosine, x * cosine + y * sine
    depth = np.full(tool[0].shape, 0.95 * DEPTH_MM)
    found = contact.removal_rate_nm_s(PROCESS, depth, *tool).sum(axis=0)
    return np.asarray(found / (found.sum() * (y[1] - y[0])))


@pytest.mark.one_of_each
@pytest.mark.parametrize("pitch_mm", [0.7, 1.5])
def test_lines_out_of_place_leave_what_lines_moved_at_random_leave(pitch_mm: float) -> None:
    error_mm, count = 0.06, 4000
    found = by_cause(with_errors(Lines(pitch_mm), PathErrors(0.0, error_mm)), "line_error")
    step = RADIUS_MM / 60
    y = np.asarray(np.arange(-120, 121) * step * 1.2, dtype=np.float64)
    slope = np.gradient(profile(y, 90.0), y)
    at = np.arange(0, count * pitch_mm, step)
    moved = np.random.default_rng(3).standard_normal(count) * error_mm / 1.96
    change = np.zeros_like(at)
    for number, shift in enumerate(moved):
        near = slice(*np.searchsorted(at, [number * pitch_mm + y[0], number * pitch_mm + y[-1]]))
        change[near] -= 20.0 * pitch_mm * shift * np.interp(at[near] - number * pitch_mm, y, slope)
    lines = 2 * CLEAR_MM / pitch_mm
    sure = np.sqrt(chi2.ppf(0.95, lines) / lines)
    assert [(one.direction, one.rms_nm, one.amplitude_nm) for one in found] == [("across", 0.0, 0.0)]
    assert found[0].rms_high_nm == pytest.approx(change.std() * sure, rel=0.06)
    power, frequency = np.abs(np.fft.rfft(change)) ** 2, np.fft.rfftfreq(at.size, step)
    half = np.searchsorted(np.cumsum(power), power.sum() / 2)
    assert found[0].period_mm == pytest.approx(1 / frequency[half], rel=0.05)


@pytest.mark.full
def test_a_tool_that_trails_lines_to_and_fro_leaves_twice_their_period() -> None:
    lines, lag_mm = Lines(1.5, slope=(1.0, 0.0)), 0.4
    found = by_cause(with_errors(lines, PathErrors(0.0, lag_mm=lag_mm)), "lag")
    blocks, time_s = lines.blocks()
    back = np.array([lag_mm, 0.0]) * np.sign(blocks.end_mm - blocks.start_mm)[:, :1]
    trailing = replace(blocks, start_mm=blocks.start_mm - back, end_mm=blocks.end_mm - back)
    at, late = direct_nm(trailing, time_s, 1.0, 3.0)
    _, prompt = direct_nm(blocks, time_s, 1.0, 3.0)
    exact = float(np.linalg.norm(amplitudes(at, late - prompt, 90.0, 3.0)))
    assert exact > 0.01
    assert [(one.direction, one.rms_nm) for one in found] == [("across", 0.0)]
    assert found[0].period_mm == pytest.approx(3.0)
    assert found[0].rms_high_nm * 2**0.5 == pytest.approx(exact, rel=0.1)


@pytest.mark.full
def test_a_lag_along_an_even_removal_or_lines_of_one_direction_leaves_nothing() -> None:
    assert by_cause(with_errors(Lines(1.5), PathErrors(lag_mm=0.4)), "lag")[0].rms_high_nm < 1e-3
    blocks, time_s = Lines(1.5, slope=(1.0, 0.0)).blocks()
    back = (blocks.end_mm < blocks.start_mm)[:, :1]
    one_way = replace(
        blocks,
        start_mm=np.where(back, blocks.end_mm, blocks.start_mm),
        end_mm=np.where(back, blocks.start_mm, blocks.end_mm),
    )
    acting = ActingSpots(HertzSpot(PROCESS), one_way)
    found = ripple_of(acting, time_s, GRID, clear(), errors=PathErrors(lag_mm=0.4))
    assert by_cause(found, "lag")[0].rms_high_nm < 1e-3


@pytest.mark.full
def test_a_path_without_lines_has_its_errors_too() -> None:
    points = np.random.default_rng(1).uniform(-20, 20, (1600, 2))
    n = len(points)
    blocks = PathBlocks(points, points, np.full(n, np.pi / 2), np.full(n, 0.95), np.ones(n))
    acting, errors = ActingSpots(HertzSpot(PROCESS), blocks), PathErrors(0.03, 0.02, 0.1)
    found = ripple_of(acting, np.ones(n), GRID, clear(), errors=errors)
    assert [one.cause for one in found.lines] == ["path", "lag", "line_error"]
    assert all(one.rms_high_nm > 0 for one in found.lines)


# The line distance with the least ripple.


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize("azimuth_deg", [0.0, 40.0, 90.0])
def test_the_share_of_straight_lines_is_that_of_their_sum(azimuth_deg: float) -> None:
    pitch = np.array([0.972, 1.2, 2.0])
    contact_at = ContactAt(0.95, np.radians(azimuth_deg))
    share, high = ripple_shares(HertzSpot(PROCESS), contact_at, pitch)
    found = [forecast(Lines(one, azimuth_deg=azimuth_deg)) for one in pitch]
    assert 20.0 * share == pytest.approx([one.rms_nm for one in found], rel=0.05)
    assert (high >= share).all()
    assert 20.0 * high == pytest.approx([one.rms_high_nm for one in found], rel=0.15)


def test_the_quiet_pitch_is_better_than_its_neighbours_and_within_its_path() -> None:
    contact_at = ContactAt(0.95, np.pi / 2)
    found = quiet_pitch(HertzSpot(PROCESS), [contact_at], 1.0)
    others = np.linspace(1.0 / 1.15, 1.0, 50)
    assert found.share_high <= ripple_shares(HertzSpot(PROCESS), contact_at, others)[1].min() * 1.001
    assert 1.0 / 1.15 <= found.pitch_mm <= 1.0
    shorter = quiet_pitch(HertzSpot(PROCESS), [contact_at], 1.0, more_path=3.0)
    assert shorter.share_high < found.share_high


# Several passes: lines add with their phase where it is known.


def shifted(lines: Lines, shift: float) -> tuple[PathBlocks, FloatArray]:
    """The path and its dwell, with all lines that part of their distance to their left."""
    blocks, time_s = lines.blocks()
    turn = np.radians(lines.angle_deg)
    move = shift * lines.pitch_mm * np.array([-np.sin(turn), np.cos(turn)])
    return replace(blocks, start_mm=blocks.start_mm + move, end_mm=blocks.end_mm + move), time_s


def of_pass(lines: Lines, shift: float) -> Ripple:
    blocks, time_s = shifted(lines, shift)
    return ripple_of(ActingSpots(HertzSpot(PROCESS), blocks), time_s, GRID, clear())


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize("shifts", [(0.0, 0.5), (0.1, 0.35), (0.2, 0.2 + 1 / 3, 0.2 + 2 / 3)], ids=str)
@pytest.mark.parametrize("lines", [Lines(1.5), Lines(1.2, angle_deg=30.0)], ids=["along x", "at 30 degrees"])
def test_lines_of_passes_add_with_their_phase_as_a_direct_sum_does(lines: Lines, shifts: tuple[float, ...]) -> None:
    parts = [direct_nm(*shifted(lines, shift), 1.0, 2 * lines.pitch_mm) for shift in shifts]
    exact = amplitudes(
        parts[0][0], np.sum([height for _, height in parts], axis=0), lines.angle_deg + 90, lines.pitch_mm
    )
    passes = [of_pass(lines, shift) for shift in shifts]
    found = np.array([one.amplitude_nm for one in of(sum_ripples(passes), "across")])
    largest = max(one.amplitude_nm for one in of(passes[0], "across"))
    assert np.abs(found - exact).max() < 0.1 * max(largest, exact.max())


@pytest.mark.full
def test_the_high_value_of_lines_between_lines_contains_a_part_that_lies_elsewhere() -> None:
    lines = Lines(1.5)
    first, between = of_pass(lines, 0.0), of_pass(lines, 0.5)
    one, total = first.lines[0], sum_ripples([first, between]).lines[0]
    assert total.rms_nm < 0.01 * one.rms_nm
    off = of_pass(lines, 0.5 + SEAT_MM / lines.pitch_mm)
    assert sum_ripples([first, off]).lines[0].rms_nm < total.rms_high_nm < 2 * one.rms_high_nm


@pytest.mark.full
def test_lines_of_one_path_made_twice_add_up() -> None:
    one = of_pass(Lines(1.5), 0.25)
    for single, total in zip(one.lines, sum_ripples([one, one]).lines, strict=True):
        for figure in ("amplitude_nm", "rms_nm", "rms_high_nm"):
            assert getattr(total, figure) == pytest.approx(2 * getattr(single, figure))


@pytest.mark.full
@pytest.mark.parametrize(
    "other", [Lines(1.51), Lines(1.5, angle_deg=0.2)], ids=["another distance", "another direction"]
)
def test_lines_without_a_common_phase_add_up(other: Lines) -> None:
    first, second = of_pass(Lines(1.5), 0.0), of_pass(other, 0.5)
    total = sum_ripples([first, second]).lines[0]
    assert total.rms_nm == pytest.approx(first.lines[0].rms_nm + second.lines[0].rms_nm)
    assert sum_ripples([first, of_pass(Lines(1.5), 0.5).without_phase()]).lines[0].rms_nm > first.lines[0].rms_nm


@pytest.mark.full
def test_bent_lines_have_no_phase() -> None:
    blocks, time_s = Lines(1.5).blocks()
    start, end = (place + 0.2 * np.sin(place[:, ::-1] / 3) for place in (blocks.start_mm, blocks.end_mm))
    bent = replace(blocks, start_mm=start, end_mm=end)
    found = ripple_of(ActingSpots(HertzSpot(PROCESS), bent), time_s, GRID, clear())
    assert found.lines
    assert {one.phase for one in found.lines} == {None}


# Paths whose lines cross, repeat in pairs or bend: all short periods of the direct sum, at places all over the part.

Path = tuple[PathBlocks, FloatArray]


def joined(*parts: Path) -> Path:
    """One path after the other, as one program makes them."""
    fields = ("start_mm", "end_mm", "azimuth_rad", "depth_ratio", "factor")
    blocks = PathBlocks(*(np.concatenate([getattr(blocks, name) for blocks, _ in parts]) for name in fields))
    return blocks, np.concatenate([time_s for _, time_s in parts])


def turned(lines: Lines, *angles_deg: float) -> Path:
    """Rasters at angles."""
    return joined(*(replace(lines, angle_deg=lines.angle_deg + angle).blocks() for angle in angles_deg))


def beside(lines: Lines, *shifts: float) -> Path:
    """Rasters shifted by shares of their distance."""
    return joined(*(shifted(lines, shift) for shift in shifts))


def turns(pitch_mm: float, azimuth_deg: float, phase: float = 0.0, *, way: int = 1, rings: bool = False) -> Path:
    """A spiral or rings, up to a radius of 20 mm."""
    start, end = list[FloatArray](), list[FloatArray]()
    for number in range(int(20.0 / pitch_mm)):
        count = max(int(2 * np.pi * (number + 0.5) * pitch_mm), 8)
        share = np.arange(count + 1) / count
        radius = (number + phase + (0.5 if rings else share)) * pitch_mm * np.ones(count + 1)
        angle = way * 2 * np.pi * share
        points = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
        start.append(points[:-1])
        end.append(points[1:])
    starts, ends = np.concatenate(start), np.concatenate(end)
    n = len(starts)
    rate = float(contact.volume_rate_nm_mm2_s(PROCESS, np.array([0.95 * DEPTH_MM]))[0])
    blocks = PathBlocks(starts, ends, np.full(n, np.radians(azimuth_deg)), np.full(n, 0.95), np.ones(n))
    return blocks, 15.0 * pitch_mm * np.linalg.norm(ends - starts, axis=1) / rate


def short_rms_nm(path: Path, scale: float, longest_mm: float, half_mm: float) -> float:
    """RMS of the periods up to one, in tapered squares at three places of the part, none the pole of a spiral."""
    power = list[float]()
    for centre in ((7.0, -3.0), (-6.0, 4.0), (1.0, -8.0)):
        at, height = direct_nm(path[0].seen_from(np.array(centre)), path[1], scale, half_mm, 8)
        taper = np.hanning(at.size + 2)[1:-1]
        weight = taper[:, None] * taper
        x, y = np.meshgrid(at / half_mm, at / half_mm)
        terms = np.column_stack([(x**i * y**j).ravel() for i in range(5) for j in range(5 - i)])
        root = weight.ravel() ** 0.5
        fit = np.linalg.lstsq(terms * root[:, None], height.ravel() * root, rcond=None)[0]
        left = (height.ravel() - terms @ fit).reshape(height.shape)
        frequency = np.fft.fftfreq(at.size, at[1] - at[0])
        short = np.hypot(frequency[:, None], frequency) > 1 / longest_mm
        spectrum = np.abs(np.fft.fft2(left * weight)) ** 2
        power.append(float(spectrum[short].sum()) / at.size**2 / float((weight**2).sum()))
    return float(np.sqrt(np.mean(power)))


def at_random(seed: int) -> Lines:
    """A raster of half the removal, whose spot, line distance, gamma and dwell gradient are drawn."""
    rng = np.random.default_rng(seed)
    pitch, azimuth, angle = (float(v) for v in rng.uniform([1.0, 0.0, 0.0], [2.0, 180.0, 180.0]))
    low, high, along, across = (float(v) for v in rng.uniform([0.85, 0.85, -0.4, -0.4], [1.0, 1.0, 0.4, 0.4]))
    return Lines(
        pitch, azimuth_deg=azimuth, gamma=(low, high), slope=(along, across), angle_deg=angle, mean_nm=10.0
    )  # fmt: skip


FAMILIES: dict[str, tuple[Callable[[], Path], float]] = {
    "crossed at 90 degrees, drawn": (lambda: turned(at_random(1), 0.0, 90.0), at_random(1).pitch_mm),
    "crossed at 60 degrees, drawn": (lambda: turned(at_random(2), 0.0, 60.0), at_random(2).pitch_mm),
    "crossed at 35 degrees, drawn": (lambda: turned(at_random(3), 0.0, 35.0), at_random(3).pitch_mm),
    "crossed, of two distances": (lambda: joined(Lines(1.2).blocks(), Lines(1.7, angle_deg=90.0).blocks()), 1.7),
    "crossed, points at rest": (lambda: turned(Lines(1.0, rests=True, mean_nm=10.0), 0.0, 90.0), 1.0),
    "three at 60 degrees": (lambda: turned(Lines(1.6, mean_nm=7.0), 0.0, 60.0, 120.0), 1.6),
    "shifted by 0.3": (lambda: beside(at_random(4), 0.0, 0.3), at_random(4).pitch_mm),
    "shifted by 0.1 and 0.5": (lambda: beside(Lines(1.5, mean_nm=7.0), 0.0, 0.1, 0.5), 1.5),
    "spiral": (lambda: turns(1.5, 90.0), 1.5),
    "spiral shifted by 0.3": (lambda: joined(turns(1.5, 90.0), turns(1.5, 90.0, 0.3)), 1.5),
    "spirals to and fro": (lambda: joined(turns(1.3, 20.0), turns(1.3, 20.0, 0.5, way=-1)), 1.3),
    "rings": (lambda: turns(1.2, 0.0, rings=True), 1.2),
}


@pytest.mark.full
@pytest.mark.parametrize("family", FAMILIES)
def test_paths_of_many_lines_have_the_short_periods_of_a_direct_sum(family: str) -> None:
    make, pitch_mm = FAMILIES[family]
    path = make()
    found = ripple_of(ActingSpots(HertzSpot(PROCESS), path[0]), path[1], GRID, clear())
    exact = {scale: short_rms_nm(path, scale, 1.5 * pitch_mm, 4 * pitch_mm) for scale in (1.0, 0.97, 1.03)}
    assert found.rms_nm == pytest.approx(exact[1.0], rel=0.1)
    assert 0.9 * max(exact.values()) < found.rms_high_nm


@pytest.mark.full
def test_crossed_lines_are_stated_by_direction_and_add_in_quadrature() -> None:
    lines = Lines(1.5, mean_nm=10.0)
    blocks, time_s = turned(lines, 0.0, 90.0)
    together = ripple_of(ActingSpots(HertzSpot(PROCESS), blocks), time_s, GRID, clear())
    apart = [forecast(replace(lines, angle_deg=angle)) for angle in (0.0, 90.0)]
    found = {(one.azimuth_deg, round(one.period_mm, 2)): one.rms_nm for one in together.lines}
    for ripple, angle in zip(apart, (0.0, 90.0), strict=True):
        assert found[angle, 1.5] == pytest.approx(ripple.lines[0].rms_nm, rel=0.05)
    assert sum_ripples(apart).rms_nm == pytest.approx(together.rms_nm, rel=0.05)
    assert len(sum_ripples(apart).lines) == len(together.lines)


@pytest.mark.full
def test_lines_out_of_place_leave_less_where_as_many_cross() -> None:
    half = turned(Lines(1.5, mean_nm=10.0), 0.0, 90.0)
    errors = PathErrors(0.0, 0.06)
    crossed = ripple_of(ActingSpots(HertzSpot(PROCESS), half[0]), half[1], GRID, clear(), errors=errors)
    one_way = by_cause(with_errors(Lines(1.5), errors), "line_error")[0].rms_high_nm
    lines = 2 * CLEAR_MM / 1.5 * np.array([1.0, 2.0])  # more lines: the mean square scatters less
    sure = np.sqrt(chi2.ppf(0.95, lines) / lines)
    expected = one_way / 2**0.5 * sure[1] / sure[0]
    assert by_cause(crossed, "line_error")[0].rms_high_nm == pytest.approx(expected, rel=0.03)
