"""A known part in a known instrument come back, each with its uncertainty; wrong poses are reported.

Share of an instrument's shorter waves that poses leave undetermined: predicted, then confirmed.
"""

from __future__ import annotations

import numpy as np
import pytest

from polishd.model.errors import MapError
from polishd.model.surface import FloatArray
from polishd.process.metrology.absolute_poses import PartPose
from polishd.process.metrology.absolute_test import AbsoluteSolution, PlaceError, hidden_share, separate_instrument
from tests.unit.process.metrology.turned_maps import (
    PITCH_MM,
    PLANE,
    RADIUS_MM,
    instrument_nm,
    maps,
    part_nm,
    rms_nm,
    true_nm,
    turns,
)

NOISE_NM = 0.3
ASTIGMATISM = (2, 2)


def astigmatism_nm(x: FloatArray, y: FloatArray) -> FloatArray:
    """3 nm at the edge and nothing else: sqrt(6) times less in RMS norm."""
    return np.asarray(3.0 * (x * x - y * y))


def true_astigmatism_nm(found: AbsoluteSolution) -> float:
    """In RMS norm over the circle of the terms, which is wider than the part where that is shifted."""
    return float(3.0 / np.sqrt(6) * (found.design.radius_mm / RADIUS_MM) ** 2)


@pytest.mark.full
def test_two_turns_find_the_astigmatism_of_an_instrument() -> None:
    poses = [PartPose(0), PartPose(90)]
    found = separate_instrument(maps(poses, NOISE_NM, instrument=astigmatism_nm), poses, PITCH_MM)
    at = found.design.terms.index(ASTIGMATISM)
    off = found.solution.instrument_nm[at] - true_astigmatism_nm(found)
    assert abs(off) < 4 * found.sigma_nm[at]
    # of two maps of n samples, RMS norm: noise / sqrt(n) each, and half of their difference
    samples = np.count_nonzero(np.abs(PLANE) <= RADIUS_MM)
    assert found.sigma_nm[at] == pytest.approx(NOISE_NM / np.sqrt(2 * samples), rel=0.35)
    assert rms_nm(found.part_nm - true_nm(part_nm)) < 1.2 * NOISE_NM


def test_four_turns_give_back_instrument_and_part() -> None:
    found = separate_instrument(maps(turns(4), NOISE_NM), turns(4), PITCH_MM)
    off = rms_nm(found.instrument_nm - true_nm(instrument_nm))
    assert off < 0.2 * rms_nm(true_nm(instrument_nm))
    assert off == pytest.approx(found.uncertainty_nm, rel=0.5)
    assert rms_nm(found.part_nm - true_nm(part_nm)) < 0.8 * NOISE_NM
    assert found.noise_nm == pytest.approx(NOISE_NM, rel=0.15)
    assert found.rest_noise_nm == pytest.approx(NOISE_NM, rel=0.1)
    assert found.sense
    assert found.misfit == pytest.approx(1)
    assert max(found.decentre_mm) < 0.1 * PITCH_MM


def test_what_is_unknown_is_the_parts() -> None:
    """An instrument of tetrafoil and power alone: four turns see neither, and the instrument's map has neither."""

    def hidden_nm(x: FloatArray, y: FloatArray) -> FloatArray:
        return 4 * np.asarray((x + 1j * y) ** 4).real + 5 * (x * x + y * y)

    found = separate_instrument(maps(turns(4), 0.1, instrument=hidden_nm), turns(4), PITCH_MM)
    assert rms_nm(found.instrument_nm) < 0.2
    assert rms_nm(found.part_nm - true_nm(part_nm) - true_nm(hidden_nm)) < 0.2


@pytest.mark.full
def test_errors_are_what_sigma_says() -> None:
    """Over draws of noise each term is off by its sigma."""
    poses = [*turns(3), PartPose(45)]
    off = []
    for seed in range(20):
        found = separate_instrument(
            maps(poses, NOISE_NM, instrument=astigmatism_nm, seed=seed), poses, PITCH_MM, noise_nm=NOISE_NM
        )
        true = np.zeros(len(found.design.terms))
        true[found.design.terms.index(ASTIGMATISM)] = true_astigmatism_nm(found)
        known = found.sigma_nm > 1e-6
        off.append(((found.solution.instrument_nm - true) / found.sigma_nm)[known])
    assert np.sqrt(np.mean(np.square(off))) == pytest.approx(1, abs=0.25)


@pytest.mark.full
def test_a_shift_tells_what_is_round_but_power() -> None:
    def round_nm(x: FloatArray, y: FloatArray) -> FloatArray:
        square = x * x + y * y
        return np.asarray(3 * (6 * square**2 - 6 * square + 1))

    poses = [*turns(4), *turns(3)[1:], PartPose(0, 2.0), PartPose(0, 0, 2.0)]
    given = maps(poses, 0.1, instrument=round_nm, part=lambda x, y: 5 * (x * x - y * y) + 3 * x**3)
    found = separate_instrument(given, poses, PITCH_MM)
    at = found.design.terms.index((4, 0))
    assert [one.name for one in found.design.unknown] == ["power"]
    # the unit circle is wider than the part, by the shift: compare maps, not coefficients
    power = [lambda x, y: x * x + y * y]
    assert rms_nm(found.instrument_nm - true_nm(round_nm), without=power) < 0.3
    assert found.sigma_nm[at] > 3 * found.sigma_nm[found.design.terms.index((4, 4))]


def test_the_wrong_sense_is_refused() -> None:
    with pytest.raises(MapError, match=r"times better with the angles' signs turned.*counter-clockwise as the maps"):
        separate_instrument(maps(turns(4), sense=-1), turns(4), PITCH_MM)


def test_half_turns_have_no_sense() -> None:
    assert not separate_instrument(maps(turns(2)), turns(2), PITCH_MM).sense


@pytest.mark.full
def test_poses_that_are_not_well_known_make_the_instrument_less_sure() -> None:
    """By far less than one map alone: an error of its pose shows in all of its terms, and is found there."""
    given = maps(turns(4), 0.05)
    sure = separate_instrument(given, turns(4), PITCH_MM, noise_nm=0.05)
    unsure = separate_instrument(
        given, turns(4), PITCH_MM, noise_nm=0.05, place=PlaceError(angle_deg=0.2, shift_mm=0.2)
    )
    known = sure.sigma_nm > 1e-6
    assert (unsure.sigma_nm[known] > sure.sigma_nm[known]).all()
    # 0.2 deg turn 2.4 nm of one astigmatism into 0.017 nm of the other, 0.2 mm trefoil and coma into more
    at = sure.design.terms.index((2, -2))
    assert 1.3 * sure.sigma_nm[at] < unsure.sigma_nm[at] < 0.01


@pytest.mark.full
def test_turns_that_were_not_as_said_are_within_their_uncertainty() -> None:
    off, sigma = [], []
    for seed in range(12):
        rng = np.random.default_rng(100 + seed)
        true = [PartPose(p.angle_deg + rng.normal(0, 0.3), *rng.normal(0, 0.15, 2)) for p in turns(4)]
        given = maps(true, 0.05, instrument=astigmatism_nm, part=lambda x, y: 8 * x * y + 6 * (x**3 - 3 * x * y * y))
        found = separate_instrument(given, turns(4), PITCH_MM, noise_nm=0.05, place=PlaceError(0.3, 0.15))
        at = found.design.terms.index(ASTIGMATISM)
        off.append(found.solution.instrument_nm[at] - true_astigmatism_nm(found))
        sigma.append(found.sigma_nm[at])
    assert 0.4 < np.sqrt(np.mean(np.square(off))) / np.mean(sigma) < 1.8


@pytest.mark.full
def test_a_shift_of_the_wrong_sign_shows() -> None:
    """In the middle of the data, and in terms that differ by more than samples do."""
    poses = [*turns(4), PartPose(45), PartPose(0, 4.0)]
    given = maps(poses)
    found = separate_instrument(given, [*poses[:-1], PartPose(0, -4.0)], PITCH_MM)
    assert found.decentre_mm[-1] > 5
    assert found.rest_noise_nm is not None
    assert found.noise_nm > 5 * found.rest_noise_nm


def test_maps_that_cannot_be_distinguished_are_refused() -> None:
    given = maps(turns(2))
    with pytest.raises(MapError, match="one map does not tell"):
        separate_instrument(given[:1], [PartPose(0)], PITCH_MM)
    with pytest.raises(MapError, match="2 maps and 1 poses"):
        separate_instrument(given, [PartPose(0)], PITCH_MM)
    with pytest.raises(MapError, match="not of one camera's frame"):
        separate_instrument([given[0], given[1][:-1]], turns(2), PITCH_MM)
    with pytest.raises(MapError, match="lies alike"):
        separate_instrument(given, [PartPose(0), PartPose(0)], PITCH_MM)


def test_little_in_common_needs_the_noise() -> None:
    """At 0 and 37 deg up to order 4 both maps share only power and spherical: two equations leave the noise open."""
    poses = [PartPose(0), PartPose(37)]
    with pytest.raises(MapError, match="nothing in common to tell their noise"):
        separate_instrument(maps(poses), poses, PITCH_MM, degree=4)
    assert separate_instrument(maps(poses), poses, PITCH_MM, degree=4, noise_nm=0.3).noise_nm == 0.3


@pytest.mark.parametrize("count", [2, 4, pytest.param(3, marks=pytest.mark.full)])
def test_equal_turns_leave_one_part_in_their_number(count: int) -> None:
    """Of directions alike: m = kN are one in N of all."""
    assert hidden_share(turns(count), 10, RADIUS_MM) == pytest.approx(1 / count, abs=0.06)


@pytest.mark.full
def test_turns_that_share_no_fold_leave_little() -> None:
    both = [*turns(4), *turns(3)[1:]]
    assert hidden_share(both, 10, RADIUS_MM) < 0.5 * hidden_share(turns(4), 10, RADIUS_MM)
    assert hidden_share([*both, PartPose(0, 2.0), PartPose(0, 0, 2.0)], 10, RADIUS_MM) < hidden_share(
        both, 10, RADIUS_MM
    )


@pytest.mark.full
@pytest.mark.parametrize("count", [4, pytest.param(2, marks=pytest.mark.full)])
def test_what_is_left_of_prints_is_as_large_as_said(count: int) -> None:
    """Of eight waves each, of 31 radians a radius: one print can leave half or twice as much, twelve together not."""
    poses = turns(count)
    off, said = [], []
    for seed in range(12):
        ways = np.random.default_rng(seed).uniform(0, 2 * np.pi, (8, 2))

        def print_nm(x: FloatArray, y: FloatArray, ways: FloatArray = ways) -> FloatArray:
            return np.asarray(sum(np.sin(31 * (np.cos(a) * x + np.sin(a) * y) + b) for a, b in ways) / 2)

        found = separate_instrument(maps(poses, 0.01, instrument=print_nm), poses, PITCH_MM, noise_nm=0.01)
        off.append(rms_nm(found.instrument_nm - true_nm(print_nm)))
        said.append(found.hidden_rest_nm)
    # of prints of 1 nm RMS
    assert np.hypot.reduce(off) / 12**0.5 == pytest.approx(1 / count**0.5, rel=0.2)
    assert np.hypot.reduce(said) == pytest.approx(np.hypot.reduce(off), rel=0.25)


@pytest.mark.full
def test_noise_is_no_print() -> None:
    poses = turns(4)
    found = separate_instrument(maps(poses, 0.3, instrument=lambda x, y: 3 * (x * x - y * y)), poses, PITCH_MM)
    assert found.hidden_rest_nm < 0.03
