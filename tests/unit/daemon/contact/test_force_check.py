"""Two readings of one force: a long disagreement ends contact, and the error names which left the set point first."""

from __future__ import annotations

import math

import pytest

from polishd.daemon.contact.force_check import ForceCeiling, ForceCheck, verdict
from polishd.model.errors import ForcesApart, SafetyStop

STEP_S = 0.05


class Forces:
    """A check that gets both readings every 50 ms."""

    def __init__(self, set_n: float = 12.0, max_difference_n: float = 1.0, *, set_band: float = 0.25) -> None:
        self.check = ForceCheck(set_n, max_difference_n, 0.5, set_band=set_band, set_alarm_delay_s=0.3)
        self.at_s = 100.0

    def read(self, actuator_n: float, sensor_n: float, seconds: float = STEP_S, *, landed: bool = True) -> None:
        for _ in range(round(seconds / STEP_S)):
            self.at_s += STEP_S
            self.check.actuator(self.at_s, actuator_n)
            self.check.sensor(self.at_s + 0.01, sensor_n, landed=landed)


@pytest.fixture
def forces() -> Forces:
    return Forces()


def test_words_within_the_band_agree(forces: Forces) -> None:
    for sensor_n in (11.0, 12.0, 13.0):
        forces.read(12.0, sensor_n, 5.0)


def test_a_short_disagreement_is_none(forces: Forces) -> None:
    forces.read(12.0, 12.0, 1.0)
    for _ in range(10):
        forces.read(12.0, 14.0, 0.4)
        forces.read(12.0, 12.0, 0.1)


def test_a_sensor_that_leaves_is_named_with_both_values_and_the_set_point(forces: Forces) -> None:
    forces.read(12.0, 12.0, 1.0)
    with pytest.raises(ForcesApart) as stop:
        forces.read(12.02, 10.5, 1.0)
    assert str(stop.value) == (
        "the forces disagree: the actuator reads 12.02 N, the force sensor 10.50 N, the set point is 12 N; 1.52 N "
        "apart, at most 1 N (force_sensor.max_difference_n), for more than 0.5 s; "
        "the force sensor left the set point first"
    )
    assert forces.at_s == pytest.approx(101.0 + 0.5, abs=2 * STEP_S), "no sooner than after the grace, and no later"


def test_an_actuator_that_leaves_first_is_named(forces: Forces) -> None:
    forces.read(12.0, 12.0, 1.0)
    forces.read(11.4, 12.0, 0.3)
    forces.read(11.4, 12.55, 0.3)
    with pytest.raises(ForcesApart, match="the actuator left the set point first"):
        forces.read(11.4, 12.6, 1.0)


def test_one_that_comes_back_has_not_left(forces: Forces) -> None:
    forces.read(12.0, 12.0, 1.0)
    forces.read(11.3, 12.0, 0.3)
    forces.read(12.0, 12.0)
    with pytest.raises(ForcesApart, match=r"the force sensor left the set point first"):
        forces.read(12.0, 13.5, 1.0)


def test_a_drift_ends_contact_where_the_band_ends(forces: Forces) -> None:
    forces.read(12.0, 12.0, 1.0)
    drifts_n = iter([0.02 * step for step in range(200)])

    def drift() -> None:
        for drift_n in drifts_n:
            forces.read(12.0, 12.0 - drift_n)

    with pytest.raises(ForcesApart):
        drift()
    assert next(drifts_n) == pytest.approx(1.0 + 0.02 * 0.5 / STEP_S, abs=0.06)


def test_nan_is_no_agreement(forces: Forces) -> None:
    forces.read(12.0, 12.0, 1.0)
    with pytest.raises(SafetyStop):
        forces.read(12.0, math.nan, 1.0)


def test_an_actuator_that_feels_nothing_and_presses_on_is_stopped_while_it_lands(forces: Forces) -> None:
    forces.read(0.0, 0.0, 2.0, landed=False)
    with pytest.raises(ForcesApart, match="neither stayed at the set point"):
        forces.read(0.7, 3.0, 1.0, landed=False)


@pytest.mark.parametrize(
    ("actuator_n", "sensor_n", "said"),
    [
        (0.0, 3.0, r"the force sensor reads 3.00 N and the actuator none \(0.00 N\) for more than 0.2 s"),
        (3.0, 0.4, r"the actuator reads 3.00 N and the force sensor none \(0.40 N\)"),
        (-0.3, -3.0, r"the force sensor reads -3.00 N and the actuator none \(-0.30 N\)"),
        (3.0, 0.5, r"the actuator reads 3.00 N and the force sensor none \(0.50 N\)"),
    ],
)
@pytest.mark.parametrize("landed", [False, True])
def test_a_force_that_only_one_of_them_feels_ends_landing_and_contact(
    actuator_n: float, sensor_n: float, said: str, landed: bool
) -> None:
    forces = Forces()
    forces.read(0.0, 0.0, 2.0, landed=False)
    began_s = forces.at_s + STEP_S
    with pytest.raises(ForcesApart, match=said):
        forces.read(actuator_n, sensor_n, 5.0, landed=landed)
    assert forces.at_s - began_s == pytest.approx(0.225, abs=0.026)


def test_of_a_small_set_point_a_quarter_counts_as_none() -> None:
    forces = Forces(set_n=1.0)
    forces.read(0.0, 0.0, 1.0, landed=False)
    with pytest.raises(ForcesApart, match=r"the actuator reads 1.50 N and the force sensor none \(0.25 N\)"):
        forces.read(1.5, 0.25, 1.0, landed=False)


def test_a_force_up_to_the_largest_difference_is_not_felt_by_one_alone(forces: Forces) -> None:
    forces.read(1.0, 0.0, 5.0, landed=False)


def patient(**delays: float) -> ForceCheck:
    """A check with exact times: only the given delay ends within the test."""
    times = {"alarm_delay_s": 60.0, "set_alarm_delay_s": 60.0} | delays
    return ForceCheck(12.0, 1.0, times.pop("alarm_delay_s"), set_band=0.25, **times)


def test_one_alone_may_feel_it_for_its_time_and_no_longer() -> None:
    check = patient(delay_s=0.4)
    check.actuator(1.0, 0.0)
    check.sensor(1.0, 3.0, landed=False)
    check.sensor(1.25, 3.0, landed=False)
    check.actuator(1.5, 0.0)
    with pytest.raises(ForcesApart, match=r"for more than 0.5 s"):
        check.actuator(1.625, 0.0)


def test_a_sensor_that_sent_nothing_since_is_not_the_one_that_feels_it() -> None:
    check = patient(delay_s=0.4)
    check.actuator(1.0, 0.0)
    check.sensor(1.0, 3.0, landed=False)
    check.actuator(1.75, 0.0)
    check.actuator(2.75, 0.0)


def test_both_may_disagree_for_the_delay_and_no_longer() -> None:
    check = patient(alarm_delay_s=0.5)
    check.actuator(1.0, 12.0)
    check.sensor(1.0, 12.0, landed=True)
    check.actuator(1.5, 14.0)
    with pytest.raises(ForcesApart, match="the forces disagree"):
        check.actuator(1.625, 14.0)


def test_forces_that_never_agreed_disagree(forces: Forces) -> None:
    with pytest.raises(ForcesApart, match="the forces disagree"):
        forces.read(12.0, 14.0, 1.0)


def test_a_reading_half_the_largest_difference_away_is_at_the_set_point(forces: Forces) -> None:
    forces.read(12.0, 12.5, 1.0)
    with pytest.raises(ForcesApart, match="the force sensor left the set point first"):
        forces.read(12.0, 14.0, 1.0)


def test_a_sensor_may_be_off_the_set_point_for_the_delay_and_no_longer() -> None:
    check = patient(set_alarm_delay_s=0.5)
    check.sensor(1.0, 12.0, landed=True)
    check.sensor(1.5, 6.0, landed=True)
    with pytest.raises(ForcesApart, match=r"by the force sensor 6.00 N is outside 12 N \+- 25% for more than 0.5 s"):
        check.sensor(1.625, 6.0, landed=True)


def test_a_force_that_one_of_them_feels_first_is_none(forces: Forces) -> None:
    for _ in range(5):
        forces.read(12.0, 0.0, 0.2)
        forces.read(12.0, 12.0, 0.1)


def test_a_slow_sensor_has_its_delay_to_tell() -> None:
    check = ForceCheck(12.0, 1.0, 5.0, set_band=0.25, set_alarm_delay_s=5.0, delay_s=0.5)
    assert check.one_sided_s == pytest.approx(0.6)
    assert ForceCheck(12.0, 1.0, 5.0, set_band=0.25, set_alarm_delay_s=5.0, delay_s=0.1).one_sided_s == 0.2


def test_a_force_without_a_new_reading_is_not_compared_with_the_other(forces: Forces) -> None:
    """A link that asks again: its last word is of before the tool landed."""
    forces.read(0.0, 0.0, 1.0, landed=False)
    for _ in range(6):
        forces.at_s += STEP_S
        forces.check.actuator(forces.at_s, 12.0)
    forces.read(12.0, 12.0, 1.0)


# the largest force


def make_ceiling() -> ForceCeiling:
    return ForceCeiling("actuator", 12.0, band=0.25, most_n=18.0, key="process.force_max_n")


def readings(forces_n: list[float], step_s: float = STEP_S) -> str:
    """Why the first of them that ends contact does, and empty where none does."""
    ceiling = make_ceiling()
    for number, force_n in enumerate(forces_n):
        try:
            ceiling.check(100.0 + number * step_s, force_n)
        except SafetyStop as stop:
            assert number == len(forces_n) - 1, f"{forces_n[number:]} come after it"
            return str(stop)
    return ""


@pytest.mark.parametrize("force_n", [18.1, 48.0, -48.0, math.inf])
def test_one_reading_above_the_largest_force_is_enough(force_n: float) -> None:
    said = readings([12.0, 12.0, force_n])
    assert f"the actuator reads {force_n:.2f} N; at most 18 N may act (process.force_max_n)" in said


def test_a_landing_may_be_steep_and_overshoot_within_the_band() -> None:
    assert readings([0.0, 0.0, 12.0, 14.9, 12.0, 11.8]) == ""
    assert readings([0.0, 6.0, 12.0, 12.1]) == ""
    assert readings([0.0, 16.4, 12.5, 12.0]) == "", "an overshoot, which regulation brings back"
    assert "rises by 332 N/s" in readings([0.0, 16.6])


def test_a_rise_that_would_pass_it_before_the_next_reading_counts() -> None:
    said = readings([12.0, 12.0, 15.6])
    assert "reads 15.60 N and rises by 72 N/s: its next reading would pass 18 N" in said
    assert readings([12.0, 14.0, 15.6, 16.5, 17.2, 17.5]) == "", "slower: the band's grace ends it"
    assert readings([18.0, 18.0]) == "", "up to it, and no farther"


def ceiling_at(*readings: tuple[float, float]) -> str:
    """Why the last of these readings (time, force) ends contact, and empty where it does not."""
    ceiling = make_ceiling()
    for at_s, force_n in readings[:-1]:
        ceiling.check(at_s, force_n)
    try:
        ceiling.check(*readings[-1])
    except SafetyStop as stop:
        return str(stop)
    return ""


STEADY = [(float(at_s), 12.0) for at_s in range(6)]
"""A reading a second: another 0.25 s later would be followed four times as far."""


def test_only_a_rise_above_the_band_counts() -> None:
    assert ceiling_at(*STEADY, (5.25, 15.0)) == "", "up to the band's end"
    assert "rises by" in ceiling_at(*STEADY, (5.25, 15.125))


def test_a_small_rise_counts_near_the_limit() -> None:
    assert "rises by" in ceiling_at(*((at_s, 16.75) for at_s, _ in STEADY), (5.25, 17.5))


def test_a_rise_up_to_the_limit_does_not_pass_it() -> None:
    assert readings([12.0, 14.0, 16.0], 1.0) == ""


def test_a_landing_begins_below_half_of_the_set_point() -> None:
    assert readings([5.0, 16.0], 1.0) == "", "the tool has landed between the two"
    assert "rises by 10 N/s" in readings([6.0, 16.0], 1.0)


def test_a_rise_is_followed_twice_its_interval_at_most() -> None:
    assert ceiling_at(*((at_s, 15.125) for at_s, _ in STEADY), (5.25, 16.0)) == ""


def test_the_last_five_intervals_count() -> None:
    """Of more than five, or of six, the median would be that of the slow readings before."""
    quick = [(5.25, 12.0), (5.5, 14.0), (5.75, 16.0)]
    assert ceiling_at((-1.0, 12.0), *STEADY, *quick) == ""


def test_readings_that_come_together_do_not_make_a_steep_rise_of_noise() -> None:
    ceiling = make_ceiling()
    for number in range(5):
        ceiling.check(100.0 + number * STEP_S, 16.0)
    ceiling.check(100.201, 16.1)
    ceiling.check(100.3, 16.0)
    ceiling.check(100.3, 17.9)  # of the same time: nothing follows from it


def test_a_long_interval_is_not_followed_for_as_long_again() -> None:
    ceiling = make_ceiling()
    for number in range(5):
        ceiling.check(100.0 + number * STEP_S, 12.0)
    ceiling.check(101.2, 16.5)


def test_who_else_reads_what_is_said() -> None:
    check = ForceCheck(12.0, 1.0, 0.5, set_band=0.25, set_alarm_delay_s=0.3, most_n=18.0)
    check.actuator(1.0, 12.0)
    with pytest.raises(SafetyStop, match=r"the force sensor reads 49.00 N; .*; the actuator reads 12.00 N"):
        check.sensor(1.01, 49.0, landed=True)
    check.sensor(1.01, 12.5, landed=True)
    with pytest.raises(SafetyStop) as stop:
        check.monitor("load_cell", 1.02, 20.0)
    assert str(stop.value) == (
        "the signal load_cell reads 20.00 N; at most 18 N may act (process.force_max_n), the set point is 12 N; the "
        "actuator reads 12.00 N; the force sensor reads 12.50 N. Check the actuator, and the part for an obstacle"
    )
    with pytest.raises(SafetyStop, match=r"the set point is 12 N; the force sensor reads 12.50 N\. Check"):
        check.actuator(1.03, 20.0)


def test_without_another_device_no_other_reading_is_said() -> None:
    assert "the set point is 12 N. Check the actuator" in readings([20.0])


def test_a_landing_is_steep_and_no_disagreement(forces: Forces) -> None:
    forces.read(0.0, 0.0, 2.0, landed=False)
    forces.read(12.0, 0.0, 0.2)
    forces.read(12.0, 12.0, 3.0)


# both agree, and the force is still not at the set point


def test_a_sensor_off_the_set_point_by_itself_ends_contact() -> None:
    forces = Forces(set_n=0.8, set_band=0.25)
    forces.read(0.8, 0.8, 1.0)
    with pytest.raises(ForcesApart, match=r"1.30 N is outside 0.8 N \+- 25% .* the actuator reads 0.80 N"):
        forces.read(0.8, 1.3, 1.0)
    assert not forces.check.sensor_fits


def test_it_may_be_too_low_until_the_tool_has_landed_and_never_too_high() -> None:
    forces = Forces(set_n=0.8)
    forces.read(0.0, 0.1, 5.0, landed=False)
    with pytest.raises(ForcesApart, match=r"by the force sensor 1.05 N is outside 0.8 N"):
        forces.read(0.5, 1.05, 1.0, landed=False)


def test_after_landing_too_low_counts() -> None:
    forces = Forces(set_n=0.8)
    with pytest.raises(ForcesApart, match=r"by the force sensor 0.10 N"):
        forces.read(0.8, 0.1, 5.0)


# with the tool up


@pytest.mark.parametrize(
    ("actuator_n", "sensor_n", "says"),
    [
        (2.9, 0.1, "the actuator is probably wrong"),
        (0.1, -2.9, "the force sensor is probably wrong"),
        (0.1, 0.1, "does not show which of them is wrong. Check both with a weight"),
        (2.0, 2.0, "does not show which of them is wrong"),
        (0.5, 0.0, "does not show which of them is wrong"),
        (0.0, -0.5, "does not show which of them is wrong"),
    ],
)
def test_who_does_not_read_zero_where_the_force_is_zero_is_suspected(
    actuator_n: float, sensor_n: float, says: str
) -> None:
    said = verdict(actuator_n, sensor_n, 1.0)
    assert said.startswith(f"with the tool up the actuator reads {actuator_n:.2f} N, the sensor {sensor_n:.2f} N: ")
    assert says in said
