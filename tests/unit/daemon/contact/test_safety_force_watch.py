"""An independent force sensor in contact: tared before, watched meanwhile, asked again with the tool up."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import pytest

from polishd.daemon.contact.contact_record import ContactRecord
from polishd.daemon.contact.force_check import ForceCheck
from polishd.daemon.contact.safety import (
    _latest_readings,
    contact,
    diagnose_force_disagreement,
    watch_force_signals,
)
from polishd.model.devices import ActuatorTimes, ForceSample, SensedForce, SensorTimes
from polishd.model.errors import DeviceFault, ForcesApart, LinkError, SafetyStop
from tests.fakes.devices import FakeCell, FakeForceSensor
from tests.unit.daemon.contact.test_safety import LIFTED, SAFE, polish_for, unused_record
from tests.unit.daemon.contact.test_safety import LIMITS as WITHOUT

LIMITS = replace(WITHOUT, apart_n=1.0, apart_s=0.5)
INTO = ["force_sensor.tare", "spindle.set_speed 1000", "actuator.set_force 12"]


@pytest.fixture
def fake() -> FakeCell:
    return FakeCell()


@pytest.fixture
def sensor(fake: FakeCell) -> FakeForceSensor:
    return fake.with_force_sensor()


async def test_a_sensor_that_agrees_changes_nothing_but_the_tare(fake: FakeCell, sensor: FakeForceSensor) -> None:
    await polish_for(fake, 2.0, LIMITS)
    assert fake.events == [*INTO, "pressing", *LIFTED, "spindle.set_speed 0"]


async def test_an_actuator_that_drifts_is_found_and_named(fake: FakeCell, sensor: FakeForceSensor) -> None:
    """It regulates what it reads: less acts than it says, and with the tool up it still reads what it is off by."""

    def drifted(sample: ForceSample) -> ForceSample:
        return replace(sample, force_n=sample.force_n + 3.0) if sample.retracted and "lifted" in fake.events else sample

    fake.actuator.reads = drifted
    sensor.reads = lambda reading: (
        replace(reading, force_n=9.0) if "pressing" in fake.events and "lifted" not in fake.events else reading
    )
    with pytest.raises(ForcesApart) as stop:
        await polish_for(fake, 5.0, LIMITS)
    assert fake.events == [*INTO, "pressing", *SAFE]
    assert "the actuator reads 12.00 N, the force sensor 9.00 N, the set point is 12 N" in str(stop.value)
    assert str(stop.value).endswith("the actuator reads 3.00 N, the sensor 0.00 N: the actuator is probably wrong")


async def test_a_sensor_that_drifts_is_found_and_named(fake: FakeCell, sensor: FakeForceSensor) -> None:
    sensor.reads = lambda r: replace(r, force_n=r.force_n - 2.0) if "pressing" in fake.events else r
    with pytest.raises(ForcesApart, match=r"the sensor -2.00 N: the force sensor is probably wrong"):
        await polish_for(fake, 5.0, LIMITS)
    assert fake.events == [*INTO, "pressing", *SAFE]


async def test_a_sensor_that_is_dead_by_then_does_not_hide_why(fake: FakeCell, sensor: FakeForceSensor) -> None:
    sensor.reads = lambda r: replace(r, force_n=r.force_n - 2.0) if "pressing" in fake.events else r

    def die() -> None:
        sensor.reads = _raises

    fake.robot.acts.before["make_safe"] = die
    with pytest.raises(ForcesApart, match=r"the force sensor left the set point first$"):
        await polish_for(fake, 5.0, LIMITS)


async def test_nor_does_one_whose_readings_ended(
    fake: FakeCell, sensor: FakeForceSensor, caplog: pytest.LogCaptureFixture
) -> None:
    sensor.reads = lambda r: replace(r, force_n=r.force_n - 2.0) if "pressing" in fake.events else r

    async def none() -> AsyncIterator[SensedForce]:
        return
        yield

    fake.robot.acts.before["make_safe"] = lambda: setattr(sensor, "samples", none)
    with pytest.raises(ForcesApart, match=r"the force sensor left the set point first$"):
        await polish_for(fake, 5.0, LIMITS)
    assert "could not be read again: its samples ended" in caplog.text


class OverLimit:
    """A force check that stops at every value of a monitor."""

    def __init__(self) -> None:
        self.values: list[float] = []

    def monitor(self, name: str, _at_s: float, force_n: float) -> None:
        self.values.append(force_n)
        raise SafetyStop(f"{name} reads {force_n:g} N")


async def test_a_force_signal_ends_contact_once_and_only_while_it_lasts(fake: FakeCell) -> None:
    forces, touch = OverLimit(), SimpleNamespace(left="")
    watch = asyncio.ensure_future(watch_force_signals(fake.cell, cast(ForceCheck, forces), cast(ContactRecord, touch)))
    await asyncio.sleep(0)
    touch.left = "left"
    fake.cell.signals.on_force("load cell", 1.0)
    touch.left = ""
    fake.cell.signals.on_force("load cell", 2.0)
    fake.cell.signals.on_force("load cell", 3.0)
    with pytest.raises(SafetyStop, match="load cell reads 2 N"):
        await watch
    fake.cell.signals.on_force("load cell", 4.0)
    assert forces.values == [2.0]


async def test_both_are_read_again_once_the_sensor_shows_the_lift(fake: FakeCell, sensor: FakeForceSensor) -> None:
    sensor.times = SensorTimes(delay_s=0.05)
    loop, read_at_s = asyncio.get_running_loop(), list[float]()
    began_s = loop.time()
    sensor.reads = lambda reading: read_at_s.append(loop.time()) or reading
    found = await diagnose_force_disagreement(fake.cell, ForcesApart("apart"), 1.0)
    assert str(found).startswith("apart; with the tool up the actuator reads ")
    assert read_at_s[0] >= began_s + 0.05


async def test_a_sensor_that_is_silent_by_then_is_not_waited_for(
    fake: FakeCell, sensor: FakeForceSensor, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("polishd.daemon.contact.safety.ANSWERS_S", 0.01)
    sensor.times, sensor.silent = SensorTimes(delay_s=0.0), True
    error = ForcesApart("apart")
    assert await diagnose_force_disagreement(fake.cell, error, 1.0) is error


async def test_without_a_sensor_nothing_is_read_again(fake: FakeCell, caplog: pytest.LogCaptureFixture) -> None:
    error = ForcesApart("apart")
    assert await diagnose_force_disagreement(fake.cell, error, 1.0) is error
    assert caplog.messages == []


async def test_its_readings_are_shown_and_it_counts_as_answering(fake: FakeCell, sensor: FakeForceSensor) -> None:
    answered: list[bool] = []

    def read(reading: SensedForce) -> SensedForce:
        if "pressing" in fake.events:
            answered.append("force_sensor" in fake.cell.answered_s)
            fake.cell.answered_s.pop("force_sensor", None)
        return reading

    sensor.reads = read
    await polish_for(fake, 1.0, LIMITS)
    assert fake.cell.live.sensed is not None
    assert fake.cell.live.speed is not None
    assert answered[0], "it answered the tare"
    assert all(answered[1:])
    assert len(answered) > 2


async def test_a_landing_in_vain_says_what_both_read_last(fake: FakeCell, sensor: FakeForceSensor) -> None:
    fake.actuator.times = ActuatorTimes(landing_s=0.05)
    fake.actuator.reads = lambda s: replace(s, force_n=3.0, in_contact=True)
    sensor.reads = lambda r: replace(r, force_n=2.5)
    with pytest.raises(SafetyStop, match=r"; the actuator reads 3.00 N, on the part; the force sensor 2.50 N\. Check"):
        await polish_for(fake, 1.0, replace(LIMITS, apart_n=5.0))


def test_only_what_was_read_is_said_of_a_landing(fake: FakeCell) -> None:
    fake.cell.live.sensed = SensedForce(0.0, 2.0)
    assert _latest_readings(fake.cell) == "", "of the job before, which had a sensor"
    fake.cell.live.sensed = None
    fake.with_force_sensor()
    assert _latest_readings(fake.cell) == ""


async def test_the_two_have_the_sensors_delay_to_agree(fake: FakeCell, sensor: FakeForceSensor) -> None:
    sensor.times = SensorTimes(delay_s=0.5)
    async with contact(fake.cell, LIMITS, unused_record()) as forces:
        assert forces.one_sided_s == pytest.approx(0.6)


def _raises(_: SensedForce) -> SensedForce:
    raise LinkError("force sensor: gone")


async def test_a_lift_that_is_not_confirmed_proves_nothing(fake: FakeCell, sensor: FakeForceSensor) -> None:
    sensor.reads = lambda r: replace(r, force_n=r.force_n - 2.0) if "pressing" in fake.events else r
    fake.actuator.acts.fails["make_safe"] = DeviceFault("actuator: does not retract")
    with pytest.raises(ForcesApart, match=r"the force sensor left the set point first$"):
        await polish_for(fake, 5.0, LIMITS)


async def test_a_silent_sensor_ends_contact_as_a_silent_actuator_does(fake: FakeCell, sensor: FakeForceSensor) -> None:
    sensor.times = SensorTimes(silence_s=0.05)

    async def fall_silent() -> None:
        async with contact(fake.cell, LIMITS, unused_record()):
            sensor.silent = True
            await asyncio.Event().wait()

    with pytest.raises(LinkError, match=r"force sensor: no sample for 0.05 s while in contact"):
        await fall_silent()
    assert fake.events == [*INTO, *SAFE], "the actuator answers: it lifts, and the robot waits for that"


async def test_a_fault_of_the_sensor_ends_contact(fake: FakeCell, sensor: FakeForceSensor) -> None:
    sensor.reads = lambda r: replace(r, fault=1) if "pressing" in fake.events else r
    with pytest.raises(DeviceFault, match=r"force sensor: fault bits 0x0001"):
        await polish_for(fake, 5.0, LIMITS)
    assert fake.events[-4:] == SAFE


async def test_a_sensor_that_reads_nothing_while_the_tool_lands(fake: FakeCell, sensor: FakeForceSensor) -> None:
    sensor.reads = lambda r: replace(r, force_n=0.0)
    with pytest.raises(SafetyStop, match=r"the actuator reads 12.00 N and the force sensor none"):
        await polish_for(fake, 5.0, LIMITS)
    assert fake.events[-4:] == SAFE


async def test_landing_waits_for_the_sensor_to_read_the_force_too(fake: FakeCell, sensor: FakeForceSensor) -> None:
    """The actuator says 12 N at once; by the sensor 12 N act 0.15 s later: nothing moves before."""
    landed: list[float] = []

    def late(reading: SensedForce) -> SensedForce:
        if reading.force_n and not landed:
            landed.append(reading.at_s)
        full = bool(landed) and reading.at_s - landed[0] >= 0.15
        return reading if full else replace(reading, force_n=min(reading.force_n, 8.0))

    sensor.reads = late
    async with contact(fake.cell, replace(LIMITS, apart_n=5.0), unused_record()):
        began_s = fake.clock.at_s
    assert began_s >= landed[0] + 0.15


async def test_a_spike_that_only_the_sensor_reads_ends_contact_at_once(fake: FakeCell, sensor: FakeForceSensor) -> None:
    sensor.reads = lambda r: replace(r, force_n=48.0) if "pressing" in fake.events else r
    with pytest.raises(SafetyStop, match=r"the force sensor reads 48.00 N; .*; the actuator reads 12.00 N"):
        await polish_for(fake, 5.0, replace(LIMITS, force_max_n=18.0))
    assert fake.events == [*INTO, "pressing", *SAFE]


async def test_a_landing_that_only_the_sensor_feels_ends(fake: FakeCell, sensor: FakeForceSensor) -> None:
    """The actuator presses and reads none: it would press on until its landing is given up."""
    fake.actuator.reads = lambda s: replace(s, force_n=0.0)
    sensor.reads = lambda r: replace(r, force_n=9.0) if fake.actuator.position_mm >= 5.0 else r
    with pytest.raises(ForcesApart, match=r"the force sensor reads 9.00 N and the actuator none \(0.00 N\)"):
        await polish_for(fake, 5.0, replace(LIMITS, apart_s=5.0))
    assert fake.events[:3] == INTO
    assert fake.events[-4:] == SAFE


async def test_its_readings_are_recorded(fake: FakeCell, sensor: FakeForceSensor) -> None:
    readings: list[float] = []
    touch = unused_record()
    touch.sensed = lambda reading: readings.append(reading.force_n)  # type: ignore[method-assign]
    async with contact(fake.cell, LIMITS, touch):
        pass
    assert 12.0 in readings
    assert isinstance(touch, ContactRecord)


# the zero


async def test_a_zero_that_moved_since_the_last_contact_is_refused(fake: FakeCell, sensor: FakeForceSensor) -> None:
    await polish_for(fake, 0.1, LIMITS)
    sensor.reads = lambda r: replace(r, force_n=-1.2)
    fake.events.clear()
    with pytest.raises(DeviceFault, match=r"force_sensor: reads -1.20 N with the tool up, and was 0 there"):
        await polish_for(fake, 0.1, LIMITS)
    assert "actuator.set_force 12" not in fake.events, "nothing was pressed"


async def test_a_zero_that_moved_by_no_more_than_the_largest_difference_is_none(
    fake: FakeCell, sensor: FakeForceSensor
) -> None:
    await polish_for(fake, 0.1, LIMITS)
    fake.events.clear()
    sensor.reads = lambda r: r if "force_sensor.tare" in fake.events else replace(r, force_n=-1.0)
    await polish_for(fake, 0.1, LIMITS)


async def test_a_sensor_that_reports_a_fault_is_not_tared(fake: FakeCell, sensor: FakeForceSensor) -> None:
    sensor.reads = lambda r: replace(r, fault=2)
    with pytest.raises(DeviceFault, match=r"force sensor: fault bits 0x0002"):
        await polish_for(fake, 0.1, LIMITS)
    assert "force_sensor.tare" not in fake.events
    assert "spindle.set_speed 1000" not in fake.events


async def test_a_sensor_that_ends_its_readings_is_silent(fake: FakeCell, sensor: FakeForceSensor) -> None:
    async def none() -> AsyncIterator[SensedForce]:
        return
        yield

    sensor.samples = none  # type: ignore[method-assign]
    with pytest.raises(LinkError, match="its samples ended"):
        await polish_for(fake, 0.1, LIMITS)


async def test_a_sensor_that_was_tared_has_answered(fake: FakeCell, sensor: FakeForceSensor) -> None:
    answered: list[bool] = []
    fake.spindle.acts.before["set_speed"] = lambda: answered.append("force_sensor" in fake.cell.answered_s)
    await polish_for(fake, 0.1, LIMITS)
    assert answered[0]


async def test_a_tare_has_its_time_and_that_of_an_answer(fake: FakeCell, sensor: FakeForceSensor) -> None:
    sensor.times, plain = SensorTimes(tare_s=0.0), sensor.tare

    async def slow() -> None:
        await asyncio.sleep(0.01)
        await plain()

    sensor.tare = slow  # type: ignore[method-assign]
    await polish_for(fake, 0.1, LIMITS)


async def test_what_hangs_on_it_is_not_known_at_first_nor_after_a_person_was_there(
    fake: FakeCell, sensor: FakeForceSensor
) -> None:
    sensor.reads = lambda r: replace(r, force_n=r.force_n + (7.0 if "force_sensor.tare" not in fake.events else 0.0))
    await polish_for(fake, 0.1, LIMITS)
    assert fake.cell.tared == {"force_sensor"}
    fake.events.clear()
    fake.cell.tared.clear()
    await polish_for(fake, 0.1, LIMITS)


async def test_a_sensor_that_cannot_be_tared_leaves_the_tool_up(fake: FakeCell, sensor: FakeForceSensor) -> None:
    sensor.acts.fails["tare"] = DeviceFault("force_sensor: does not settle")
    with pytest.raises(DeviceFault, match="does not settle"):
        await polish_for(fake, 0.1, LIMITS)
    assert not [event for event in fake.events if event.startswith("actuator.set_force")]
    assert fake.cell.tared == set()


async def test_a_sensor_that_does_not_answer_the_tare(
    fake: FakeCell, sensor: FakeForceSensor, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("polishd.daemon.contact.safety.ANSWERS_S", 0.01)
    sensor.times, sensor.silent = SensorTimes(tare_s=0.01), True
    with pytest.raises(LinkError, match=r"force_sensor: was not tared within 0.02 s"):
        await polish_for(fake, 0.1, LIMITS)
