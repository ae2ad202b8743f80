"""What is watched in contact, sample by sample and at the very edge of each limit."""

from __future__ import annotations

import asyncio
import itertools
import math
import time
from collections.abc import AsyncIterator, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from polishd.daemon.cell import device_polling
from polishd.daemon.contact import safety
from polishd.daemon.contact.contact_record import ContactRecord
from polishd.daemon.contact.safety import STILL_RPM, ContactLimits
from polishd.model.devices import ForceSample, SpeedSample
from polishd.model.errors import DeviceFault, LinkError, SafetyStop, WrongSeat
from tests.fakes.devices import FakeCell

LIMITS = ContactLimits(force_n=12.0, rpm=1000.0, force_band=0.25, alarm_delay_s=0.5, deepest_mm=8.0)


def force(
    at_s: float, force_n: float = 12.0, *, on: bool = True, fault: int = 0, mm: float | None = 5.0
) -> ForceSample:
    return ForceSample(at_s, force_n, 12.0, on, False, fault, mm)


def speed(at_s: float, rpm: float = 1000.0, *, fault: int = 0) -> SpeedSample:
    return SpeedSample(at_s, rpm, 1000.0, fault)


class InputRecord(ContactRecord):
    """Contact record that keeps its inputs for the test."""

    def __init__(self) -> None:
        super().__init__(lambda records: None, 1.5)
        self.forces: list[ForceSample] = []
        self.speeds: list[SpeedSample] = []

    def force(self, sample: ForceSample) -> None:
        self.forces.append(sample)
        super().force(sample)

    def speed(self, sample: SpeedSample) -> None:
        self.speeds.append(sample)
        super().speed(sample)


class Watched:
    """Contact monitor with the result of its samples."""

    def __init__(self, limits: ContactLimits = LIMITS) -> None:
        self.fake, self.touch = FakeCell(), InputRecord()
        self.watch = safety._ContactMonitor(limits, self.touch, safety._force_check(limits))

    async def read(self, samples: Sequence[Any]) -> BaseException | None:
        """Return the error that ends the monitor; None where it would continue."""
        over = asyncio.Event()

        async def readings() -> AsyncIterator[Any]:
            for sample in samples:
                yield sample
            over.set()
            await asyncio.Event().wait()

        device: Any = self.fake.actuator if isinstance(samples[0], ForceSample) else self.fake.spindle
        device.samples = readings
        watching = safety._watch_force if device is self.fake.actuator else safety._watch_speed
        task = asyncio.ensure_future(watching(self.fake.cell, self.watch))
        waiting = asyncio.ensure_future(over.wait())
        await asyncio.wait({task, waiting}, return_when=asyncio.FIRST_COMPLETED)
        for one in (task, waiting):
            one.cancel()
        (found, _) = await asyncio.gather(task, waiting, return_exceptions=True)
        return found if isinstance(found, Exception) else None


@pytest.mark.parametrize(
    ("samples", "error"),
    [
        ([force(0.0), force(1.0, 9.0), force(2.0, 15.0)], None),
        ([force(0.0), force(0.5, 15.1)], None),
        ([force(0.0), force(0.6, 15.1)], SafetyStop),
        ([force(0.0), force(0.6, 8.9)], SafetyStop),
        ([force(0.0), force(0.6, on=False)], SafetyStop),
        ([force(0.0), force(0.4, 0.0), force(0.5), force(1.0, 0.0)], None),
        ([force(0.0, 0.0, on=False), force(60.0, 0.0, on=False)], None),  # it has not landed yet
        ([force(40.0), force(40.4, 0.0), force(40.6, 0.0)], SafetyStop),
        ([force(0.0), force(0.0, fault=2)], DeviceFault),
        ([force(0.0, mm=8.0), force(0.1, mm=None)], None),
        ([force(0.0, mm=8.1)], WrongSeat),
        ([force(0.0, 0.0, on=False, mm=8.1)], WrongSeat),  # whether it touches or not
    ],
)
async def test_force_and_place_of_the_tool(samples: list[ForceSample], error: type[Exception] | None) -> None:
    watched = Watched()
    assert type(await watched.read(samples)) is (error or type(None))
    assert watched.touch.forces == samples[: len(watched.touch.forces)]
    assert len(watched.touch.forces) >= 1
    assert list(watched.fake.cell.answered_s) == ["actuator"]
    assert not watched.watch.silent


@pytest.mark.parametrize(("mm", "on", "stops"), [(10.0, True, False), (10.1, True, True), (10.1, False, False)])
async def test_a_contact_beyond_the_stroke_is_none(mm: float, on: bool, stops: bool) -> None:
    watched = Watched(replace(LIMITS, deepest_mm=math.inf))
    assert watched.fake.actuator.times.stroke_mm == 10.0
    found = await watched.read([force(0.0), force(0.1, mm=mm, on=on)])
    assert isinstance(found, SafetyStop) is stops
    assert not stops or "contact at 10.10 mm extension, and its stroke is 10 mm" in str(found)


async def test_once_it_is_left_only_faults_count_and_the_place() -> None:
    """The daemon has commanded the force off."""
    watched = Watched()
    watched.touch.left = True
    assert await watched.read([force(0.0), force(9.0, 0.0, on=False)]) is None
    assert not watched.watch.landed.is_set()
    assert isinstance(await watched.read([force(10.0, fault=1)]), DeviceFault)
    assert isinstance(await watched.read([force(10.0, mm=9.0)]), WrongSeat)


async def test_it_has_landed_with_the_first_sample_in_its_band() -> None:
    watched = Watched()
    await watched.read([force(0.0, 8.9), force(0.1, on=False)])
    assert not watched.watch.landed.is_set()
    await watched.read([force(0.2, 9.0)])
    assert watched.watch.landed.is_set()


@pytest.mark.parametrize(
    ("samples", "error"),
    [
        ([speed(0.0), speed(1.0, 950.0), speed(2.0, 1050.0)], None),
        ([speed(0.0, 0.0), speed(0.5, 0.0)], None),  # it spins up
        ([speed(40.0, 0.0), speed(40.6, 949.0)], SafetyStop),
        ([speed(0.0), speed(0.4, 1051.0), speed(0.6)], None),
        ([speed(40.0), speed(40.4, 1051.0), speed(40.6), speed(41.0, 949.0)], None),
        ([speed(0.0), speed(0.6, 1051.0)], SafetyStop),
        ([speed(0.0), speed(0.6, -1000.0)], SafetyStop),
        ([speed(0.0, fault=3)], DeviceFault),
    ],
)
async def test_speed_of_the_spindle(samples: list[SpeedSample], error: type[Exception] | None) -> None:
    watched = Watched()
    assert type(await watched.read(samples)) is (error or type(None))
    assert watched.touch.speeds == samples[: len(watched.touch.speeds)]
    assert len(watched.touch.speeds) >= 1
    assert list(watched.fake.cell.answered_s) == ["spindle"]


@pytest.mark.parametrize(("rpm", "stops"), [(STILL_RPM, False), (-STILL_RPM, False), (STILL_RPM + 0.1, True)])
async def test_a_stopped_spindle_may_read_a_little(rpm: float, stops: bool) -> None:
    assert STILL_RPM == 5.0
    watched = Watched(ContactLimits(force_n=0.5, rpm=0.0, force_band=0.25, alarm_delay_s=0.5))
    found = await watched.read([speed(0.0, 0.0), speed(9.0, rpm)])
    assert isinstance(found, SafetyStop) is stops


async def test_one_that_turns_the_other_way_is_held_against_its_own_speed() -> None:
    watched = Watched(ContactLimits(force_n=0.5, rpm=-1000.0, force_band=0.25, alarm_delay_s=0.5))
    assert await watched.read([speed(0.0, -1000.0), speed(9.0, -960.0)]) is None


@pytest.mark.parametrize("sample", [force(0.0), speed(0.0)])
async def test_samples_that_end_are_a_lost_link(sample: Any) -> None:
    watched = Watched()
    device: Any = watched.fake.actuator if isinstance(sample, ForceSample) else watched.fake.spindle
    device.ends = True
    watching = safety._watch_force if device is watched.fake.actuator else safety._watch_speed
    with pytest.raises(LinkError, match=f"^{device.name}: its samples ended while in contact"):
        await watching(watched.fake.cell, watched.watch)
    assert watched.watch.silent is isinstance(sample, ForceSample), "then the robot lifts at once"


@pytest.mark.parametrize("force_n", [math.nan, math.inf, -12.0])
async def test_a_force_that_is_no_force_is_not_in_its_band(force_n: float) -> None:
    assert isinstance(await Watched().read([force(0.0), force(0.6, force_n)]), SafetyStop)


async def test_a_device_with_steady_samples_is_not_silent() -> None:
    received: list[int] = []

    async def samples() -> AsyncIterator[int]:
        ends_s = time.monotonic() + 0.06
        while time.monotonic() < ends_s:
            yield 1
            await asyncio.sleep(0)

    with pytest.raises(LinkError, match=r"^it: its samples ended while in contact"):
        await device_polling.read_samples(samples(), received.append, "it", 0.01)
    assert len(received) > 1


async def looks_until_silent(monkeypatch: pytest.MonkeyPatch, silence_s: float) -> list[float | None]:
    """How long each of them was to be."""
    looks: list[float | None] = []
    plain = asyncio.timeout

    def timeout(seconds: float | None) -> asyncio.Timeout:
        looks.append(seconds)
        return plain(seconds)

    async def samples() -> AsyncIterator[int]:
        await asyncio.Event().wait()
        yield 1

    monkeypatch.setattr(asyncio, "timeout", timeout)
    with pytest.raises(LinkError, match=f"^it: no sample for {silence_s:g} s while in contact"):
        await device_polling.read_samples(samples(), lambda sample: None, "it", silence_s)
    return looks


@pytest.mark.parametrize(("silence_s", "look_s"), [(0.06, safety.LOOK_S), (0.02, 0.02)])
async def test_silence_is_counted_in_small_steps(
    monkeypatch: pytest.MonkeyPatch, silence_s: float, look_s: float
) -> None:
    assert set(await looks_until_silent(monkeypatch, silence_s)) == {look_s}


@pytest.mark.parametrize(("step_s", "looks"), [(0.05, 5), (0.09, 3), (100.0, 3)])
async def test_time_in_which_this_process_did_not_run_is_no_silence(
    monkeypatch: pytest.MonkeyPatch, step_s: float, looks: int
) -> None:
    """After a long pause two checks count: the monitor reads first."""
    ticks = itertools.count(1000)
    monkeypatch.setattr(device_polling, "time", SimpleNamespace(monotonic=lambda: next(ticks) * step_s))
    assert len(await looks_until_silent(monkeypatch, 0.22)) == looks
