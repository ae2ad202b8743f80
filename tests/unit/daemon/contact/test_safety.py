"""Every way out of contact: force off, tool lifted, and only then motion stops; whatever fails on the way.

The fakes take the times that hardware takes: landing 2 s, lifting 4 s of their clock.
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator, Callable
from dataclasses import replace
from functools import partial
from typing import Any

import pytest

from polishd.config.cell import PORTS
from polishd.daemon.cell import time_limits
from polishd.daemon.cell.cell import Cell, Signals
from polishd.daemon.cell.device_polling import read_samples, root_cause
from polishd.daemon.contact.contact_record import ContactRecord
from polishd.daemon.contact.safety import LOOK_S, ContactLimits, contact, make_safe
from polishd.model.devices import ActuatorTimes, ForceSample, RobotTimes, Signal, SignalLimits, SpindleTimes
from polishd.model.errors import ConfigError, DeviceFault, LinkError, PolishdError, SafetyStop
from polishd.util.wire_recording import record_received, tap
from tests.fakes.devices import FakeCell, FakeDevice, blank
from tests.time_limits import SOON_S

LIMITS = ContactLimits(force_n=12.0, rpm=1000.0, force_band=0.25, alarm_delay_s=0.3)
SAFE = ["spindle.make_safe", "actuator.make_safe", "lifted", "robot.make_safe"]
INTO = ["spindle.set_speed 1000", "actuator.set_force 12"]
LIFTED = ["actuator.set_force 0", "actuator.retract", "lifted"]
UNTOUCHED = [step for step in SAFE if step != "lifted"]


def unused_record() -> ContactRecord:
    """Return a contact record that saves nothing."""
    return ContactRecord(lambda records: None, 1.5)


@pytest.fixture
def fake() -> FakeCell:
    return FakeCell()


async def polish_for(fake: FakeCell, seconds: float = 1.0, limits: ContactLimits = LIMITS) -> None:
    """Stay in contact for that long by the fake clock, which readings advance."""
    async with contact(fake.cell, limits, unused_record()):
        fake.events.append("pressing")
        end_s = fake.clock.at_s + seconds
        while fake.clock.at_s < end_s:  # noqa: ASYNC110
            await asyncio.sleep(0)


async def forever(fake: FakeCell) -> None:
    async with contact(fake.cell, LIMITS, unused_record()):
        fake.events.append("pressing")
        await asyncio.Event().wait()


def left_at(fake: FakeCell) -> list[float]:
    """When the daemon began to leave contact, by the fake clock."""
    times: list[float] = []
    fake.spindle.acts.before["make_safe"] = lambda: times.append(fake.clock.at_s)
    return times


async def until(fake: FakeCell, event: str) -> None:
    """pytest's timeout is the limit."""
    while event not in fake.events:  # noqa: ASYNC110
        await asyncio.sleep(0)


# the way out


async def test_the_normal_end_lifts_and_leaves_motion_alone(fake: FakeCell) -> None:
    await polish_for(fake)
    assert fake.events == [*INTO, "pressing", *LIFTED, "spindle.set_speed 0"]
    assert fake.actuator.retracted


async def test_an_exception_in_the_block(fake: FakeCell) -> None:
    with pytest.raises(KeyError, match="mine"):
        async with contact(fake.cell, LIMITS, unused_record()):
            raise KeyError("mine")
    assert fake.events == [*INTO, *SAFE]


async def test_an_error_of_ours_in_the_block_comes_out_as_itself(fake: FakeCell) -> None:
    with pytest.raises(LinkError, match="the robot is gone"):
        async with contact(fake.cell, LIMITS, unused_record()):
            raise LinkError("the robot is gone")
    assert fake.events[-4:] == SAFE


async def test_cancellation(fake: FakeCell) -> None:
    task = asyncio.ensure_future(forever(fake))
    await until(fake, "pressing")
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert fake.events == [*INTO, "pressing", *SAFE]


async def test_cancellation_while_landing(fake: FakeCell) -> None:
    fake.actuator.reads = blank
    task = asyncio.ensure_future(forever(fake))
    await until(fake, "actuator.set_force 12")
    await asyncio.sleep(0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert fake.events == [*INTO, *SAFE]


@pytest.mark.parametrize(
    ("device", "call", "expected"),
    [
        ("spindle", "set_speed", ["spindle.set_speed 1000", *UNTOUCHED]),
        ("actuator", "set_force", [*INTO, *UNTOUCHED]),
        ("actuator", "retract", [*INTO, "pressing", *LIFTED[:2], *SAFE]),
    ],
)
async def test_a_device_that_refuses(fake: FakeCell, device: str, call: str, expected: list[str]) -> None:
    fake.devices[device].acts.fails[call] = DeviceFault(f"{device}: broken")
    with pytest.raises(DeviceFault, match=f"{device}: broken"):
        await polish_for(fake)
    assert fake.events == expected


# what is watched


@pytest.mark.parametrize("force_n", [8.9, 15.1, 0.0, -12.0, float("nan")])
async def test_force_outside_its_band(fake: FakeCell, force_n: float) -> None:
    fake.actuator.reads = lambda s: replace(s, force_n=force_n) if "pressing" in fake.events else s
    with pytest.raises(SafetyStop, match=r"force .* is outside 12 N"):
        await polish_for(fake)
    assert fake.events == [*INTO, "pressing", *SAFE]


async def test_a_tool_that_lost_the_part_though_the_force_reads_right(fake: FakeCell) -> None:
    fake.actuator.reads = lambda s: replace(s, in_contact=False) if "pressing" in fake.events else s
    with pytest.raises(SafetyStop):
        await polish_for(fake)


@pytest.mark.parametrize("force_n", [9.1, 14.9])
async def test_force_within_its_band(fake: FakeCell, force_n: float) -> None:
    fake.actuator.reads = lambda s: replace(s, force_n=force_n if s.setpoint_n else 0.0)
    await polish_for(fake)
    assert fake.events[-4:-1] == LIFTED


@pytest.mark.parametrize(("lasts_s", "stops"), [(0.2, False), (0.5, True)])
async def test_force_out_of_band_for_less_and_more_than_its_grace(fake: FakeCell, lasts_s: float, stops: bool) -> None:
    begun: list[float] = []

    def reads(sample: ForceSample) -> ForceSample:
        if "pressing" not in fake.events:
            return sample
        begun.append(sample.at_s)
        return replace(sample, force_n=20.0) if sample.at_s - begun[0] < lasts_s else sample

    fake.actuator.reads = reads
    left = left_at(fake)
    if stops:
        with pytest.raises(SafetyStop, match=r"more than 0\.3 s"):
            await polish_for(fake, 2.0)
        assert left[0] < begun[0] + 0.45, "as soon as the grace is over"
    else:
        await polish_for(fake, 2.0)
    assert ("robot.make_safe" in fake.events) is stops


CAPPED = replace(LIMITS, force_max_n=18.0)


async def test_one_reading_above_the_largest_force_is_enough(fake: FakeCell) -> None:
    spiked: list[float] = []

    def reads(sample: ForceSample) -> ForceSample:
        if "pressing" not in fake.events or spiked:
            return sample
        spiked.append(sample.at_s)
        return replace(sample, force_n=48.0)

    fake.actuator.reads = reads
    left = left_at(fake)
    with pytest.raises(SafetyStop, match=r"the actuator reads 48.00 N; at most 18 N may act \(process.force_max_n\)"):
        await polish_for(fake, 2.0, CAPPED)
    assert fake.events == [*INTO, "pressing", *SAFE]
    assert left[0] - spiked[0] < 0.02


async def test_a_landing_with_too_much_force_ends_at_once(fake: FakeCell) -> None:
    """It never was in its band: no force that counts, for as long as a landing may take."""
    fake.actuator.reads = lambda s: replace(s, force_n=49.0, in_contact=True) if fake.actuator.position_mm > 4 else s
    with pytest.raises(SafetyStop, match=r"the actuator reads 49.00 N; at most 18 N may act"):
        await polish_for(fake, 2.0, CAPPED)
    assert fake.events == [*INTO, *SAFE]
    assert fake.clock.at_s < 7.0, "landing 2 s, lift 4 s"


async def test_a_landing_in_vain_says_what_was_read_last(fake: FakeCell) -> None:
    fake.actuator.times = ActuatorTimes(landing_s=0.05)
    fake.actuator.reads = lambda s: replace(s, force_n=3.0, in_contact=True)
    with pytest.raises(SafetyStop, match=r"did not land: .*; the actuator reads 3.00 N, on the part"):
        await polish_for(fake)


async def test_a_signal_that_measures_the_force_has_the_same_limit(fake: FakeCell) -> None:
    limits = SignalLimits("load", "monitor", "AI7", "N", None, 0.0, None, 0.0, "hold", measures_force=True)
    fake.cell.signals = Signals([limits], {"monitor": 1.0})
    fake.cell.signals.update("monitor", Signal(0.0, "AI7", 30.0))  # not in contact yet

    async def send() -> None:
        async with contact(fake.cell, CAPPED, unused_record()):
            for value in (12.0, None, 17.9):
                fake.cell.signals.update("monitor", Signal(0.0, "AI7", value))
            fake.cell.signals.update("monitor", Signal(0.0, "AI6", 30.0))
            await asyncio.sleep(0)
            fake.events.append("so far")
            fake.cell.signals.update("monitor", Signal(0.0, "AI7", 30.0))
            await asyncio.Event().wait()

    with pytest.raises(SafetyStop, match=r"the signal load reads 30.00 N; at most 18 N may act"):
        await send()
    assert fake.events == [*INTO, "so far", *SAFE]


@pytest.mark.parametrize("setpoint_n", [0.0, 12.0])
async def test_an_actuator_that_retracts_by_itself_is_not_taken_for_leaving(fake: FakeCell, setpoint_n: float) -> None:
    """Its watchdog does that. Going on would journal blocks as polished that never touched the part."""
    lifted = {"force_n": 0.0, "setpoint_n": setpoint_n, "in_contact": False, "retracted": True}
    fake.actuator.reads = lambda s: replace(s, **lifted) if "pressing" in fake.events else s
    with pytest.raises(SafetyStop):
        await polish_for(fake)
    assert fake.events[-4:] == SAFE


@pytest.mark.parametrize(("rpm", "stops"), [(940.0, True), (960.0, False), (-1000.0, True), (float("nan"), True)])
async def test_spindle_speed(fake: FakeCell, rpm: float, stops: bool) -> None:
    fake.spindle.reads = lambda s: replace(s, rpm=rpm)
    if stops:
        with pytest.raises(SafetyStop, match="instead of 1000"):
            await polish_for(fake)
        assert fake.events[-4:] == SAFE
    else:
        await polish_for(fake)


@pytest.mark.parametrize(("rpm", "stops"), [(4.5, False), (-5.5, True)])
async def test_a_spindle_at_rest_may_creep(fake: FakeCell, rpm: float, stops: bool) -> None:
    fake.spindle.reads = lambda s: replace(s, rpm=rpm)
    resting = replace(LIMITS, rpm=0.0)
    if stops:
        with pytest.raises(SafetyStop, match="instead of 0 "):
            await polish_for(fake, limits=resting)
    else:
        await polish_for(fake, limits=resting)


@pytest.mark.parametrize("device", ["actuator", "spindle"])
async def test_a_fault_is_reported_at_once(fake: FakeCell, device: str) -> None:
    left = left_at(fake)
    watched = fake.devices[device]
    watched.reads = lambda s: replace(s, fault=4) if "pressing" in fake.events else s  # type: ignore[attr-defined]
    with pytest.raises(DeviceFault, match=f"{device}: fault"):
        await polish_for(fake, 100.0)
    assert left[0] < 3.0
    assert fake.events[-4:] == SAFE


async def test_a_fault_while_leaving_is_seen(fake: FakeCell) -> None:
    fake.actuator.reads = lambda s: replace(s, fault=1) if LIFTED[0] in fake.events else s
    fake.actuator.acts.hangs.add("retract")
    with pytest.raises(DeviceFault, match="fault bits 0x0001"):
        await polish_for(fake)
    assert fake.events[-5:] == [LIFTED[1], *SAFE]


async def test_leaving_slowly_is_not_a_force_out_of_band(fake: FakeCell) -> None:
    """Between force off and lifted the readings are what they are."""
    gate = asyncio.Event()
    fake.actuator.reads = lambda s: replace(s, force_n=5.0) if LIFTED[0] in fake.events else s
    plain = fake.actuator.retract

    async def slowly() -> None:
        await gate.wait()
        await plain()

    fake.actuator.retract = slowly  # type: ignore[method-assign]
    task = asyncio.ensure_future(polish_for(fake, 0.1))
    await until(fake, LIFTED[0])
    late_s = fake.clock.at_s + 1.0
    while fake.clock.at_s < late_s and not task.done():  # noqa: ASYNC110
        await asyncio.sleep(0)
    gate.set()
    await task
    assert "robot.make_safe" not in fake.events


async def test_silence_of_the_spindle(fake: FakeCell) -> None:
    fake.spindle.times = SpindleTimes(silence_s=0.02)
    task = asyncio.ensure_future(forever(fake))
    await until(fake, "pressing")
    fake.spindle.silent = True
    with pytest.raises(LinkError, match="spindle: no sample"):
        await task
    assert fake.events == [*INTO, "pressing", *SAFE]


async def test_an_actuator_that_falls_silent_is_left_by_the_robot_at_once(fake: FakeCell) -> None:
    """No step waits for it: the spindle stops and the robot takes the tool away while it still moves."""
    fake.actuator.times = ActuatorTimes(silence_s=0.02, stroke_mm=12.0)
    task = asyncio.ensure_future(forever(fake))
    await until(fake, "pressing")
    fake.actuator.silent = True
    fake.actuator.acts.fails["make_safe"] = LinkError("no answer")
    with pytest.raises(LinkError, match="actuator: no sample"):
        await task
    left = fake.events[3:]
    assert left == ["spindle.make_safe", "actuator.make_safe", "robot.lift 17", "robot.make_safe"]
    assert fake.cell.unsafe == ("actuator: no answer; the robot has lifted the tool off the part by 17 mm",)


@pytest.mark.parametrize(("unpowered", "is_off"), [("lifts", True), ("stays", False)])
async def test_a_silent_actuator_is_off_alone_only_where_it_lifts_without_power(
    fake: FakeCell, unpowered: Any, is_off: bool
) -> None:
    fake.robot.lifts = False
    fake.actuator.times = ActuatorTimes(watchdog_s=0.0, release_s=0.0, retract_s=0.0, unpowered=unpowered)
    fake.actuator.acts.fails["make_safe"] = LinkError("no answer")
    touch = unused_record()
    touch.begin(0.0)
    await make_safe(fake.cell, touch)
    assert (touch.off_s < math.inf) is is_off


async def test_a_robot_that_cannot_lift_goes_on_until_the_actuator_has_let_go_by_itself(fake: FakeCell) -> None:
    fake.robot.lifts = False
    fake.actuator.acts.fails["make_safe"] = LinkError("no answer")
    task = asyncio.ensure_future(forever(fake))
    await until(fake, "pressing")
    task.cancel()
    await until(fake, "robot.lift 15")
    begun_s, alone_s = fake.clock.at_s, fake.actuator.times.alone_s
    while "robot.make_safe" not in fake.events:
        fake.clock.advance(0.05)
        for _ in range(4):
            await asyncio.sleep(0)
    assert fake.clock.at_s - begun_s >= alone_s - 0.1, "watchdog, force off, lift"
    with pytest.raises(asyncio.CancelledError):
        await task


async def test_an_actuator_that_answers_after_all_ends_the_waiting(fake: FakeCell) -> None:
    """Silent for its samples, but it takes the order to lift: confirmed is confirmed."""
    fake.actuator.times = ActuatorTimes(silence_s=0.02)
    fake.robot.lifts = False
    task = asyncio.ensure_future(forever(fake))
    await until(fake, "pressing")
    fake.actuator.silent = True
    while not task.done():
        fake.clock.advance(0.01)
        await asyncio.sleep(0)
    with pytest.raises(LinkError, match="actuator: no sample"):
        await task
    assert fake.events.index("lifted") < fake.events.index("robot.make_safe")
    assert fake.cell.unsafe == ()


async def test_an_actuator_that_does_not_lift_is_left_by_the_robot(fake: FakeCell) -> None:
    fake.actuator.acts.fails["make_safe"] = DeviceFault("does not retract")
    with pytest.raises(KeyError):
        async with contact(fake.cell, LIMITS, unused_record()):
            raise KeyError
    steps = [*INTO, "spindle.make_safe", "actuator.make_safe", "robot.lift 15", "robot.make_safe"]
    assert fake.events == steps
    assert fake.cell.unsafe == ("actuator: does not retract; the robot has lifted the tool off the part by 15 mm",)


async def test_motion_goes_on_until_the_lift_is_confirmed(fake: FakeCell) -> None:
    """A lift takes 4 s here: the robot was stopped after 3 s, with the tool on the part."""
    stopped: list[bool] = []
    fake.robot.acts.before["make_safe"] = lambda: stopped.append(fake.actuator.retracted)
    task = asyncio.ensure_future(forever(fake))
    await until(fake, "pressing")
    begun_s = fake.clock.at_s
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert stopped == [True]
    assert fake.clock.at_s - begun_s >= 4.0


async def test_the_spindle_stops_beside_the_lift(fake: FakeCell, monkeypatch: pytest.MonkeyPatch) -> None:
    """It used to wait for actuator and robot: a dead actuator left it turning for 6 s."""
    monkeypatch.setattr(time_limits, "ANSWERS_S", 1.0)
    fake.actuator.times = ActuatorTimes(release_s=0.0, retract_s=0.0)
    task = asyncio.ensure_future(forever(fake))
    await until(fake, "pressing")
    fake.actuator.acts.hangs.add("make_safe")
    task.cancel()
    await until(fake, "spindle.make_safe")
    assert "robot.make_safe" not in fake.events, "the actuator has not answered yet"
    with pytest.raises(asyncio.CancelledError):
        await task


async def test_an_emergency_stops_motion_at_once(fake: FakeCell) -> None:
    fake.cell.emergency = True
    stopped: list[bool] = []
    fake.robot.acts.before["make_safe"] = lambda: stopped.append(fake.actuator.retracted)
    with pytest.raises(KeyError):
        async with contact(fake.cell, LIMITS, unused_record()):
            raise KeyError
    assert stopped == [False], "whatever the part costs"
    assert sorted(fake.events[2:]) == sorted(SAFE)


async def test_an_emergency_stops_motion_at_once_also_while_the_tool_is_lifted(fake: FakeCell) -> None:
    stopped: list[bool] = []
    lifting, up, given_up = asyncio.Event(), asyncio.Event(), asyncio.Event()

    async def lift() -> None:
        lifting.set()
        try:
            await up.wait()
        except asyncio.CancelledError:
            given_up.set()
            raise

    fake.actuator.make_safe = lift  # type: ignore[method-assign]
    fake.robot.acts.before["make_safe"] = lambda: stopped.append(up.is_set() or given_up.is_set())
    pressing = asyncio.ensure_future(forever(fake))
    await until(fake, "pressing")
    pressing.cancel()
    await lifting.wait()
    fake.cell.emergency = True
    await until(fake, "robot.make_safe")
    assert LOOK_S < 0.1, "the caller does not wait for it"
    up.set()
    with pytest.raises(asyncio.CancelledError):
        await pressing
    assert stopped == [False], "whatever the part costs"


async def test_an_order_that_comes_while_a_fault_leaves_contact_does_not_take_its_place(fake: FakeCell) -> None:
    lifting, up = asyncio.Event(), asyncio.Event()

    async def lift() -> None:
        lifting.set()
        await up.wait()

    fake.actuator.make_safe = lift  # type: ignore[method-assign]
    fake.actuator.reads = lambda s: replace(s, fault=4) if "pressing" in fake.events else s
    pressing = asyncio.ensure_future(forever(fake))
    await lifting.wait()
    pressing.cancel()
    await asyncio.sleep(0)
    up.set()
    with pytest.raises(DeviceFault, match="fault bits"):
        await pressing


@pytest.mark.parametrize("device", ["actuator", "spindle"])
async def test_samples_that_end_are_silence(fake: FakeCell, device: str) -> None:
    task = asyncio.ensure_future(forever(fake))
    await until(fake, "pressing")
    fake.devices[device].ends = True  # type: ignore[attr-defined]
    with pytest.raises(LinkError, match=device):
        await asyncio.wait_for(task, SOON_S)
    assert {"robot.make_safe", "spindle.make_safe", "lifted"} <= set(fake.events)


async def test_a_tool_that_does_not_land(fake: FakeCell) -> None:
    fake.actuator.reads = blank
    fake.actuator.times = ActuatorTimes(landing_s=0.02)
    with pytest.raises(SafetyStop, match="did not land: no force within 25% of 12 N"):
        await polish_for(fake, limits=replace(LIMITS, alarm_delay_s=0.0))
    assert fake.events == [*INTO, *SAFE]


async def test_both_are_watched_and_fed_while_the_tool_lands(fake: FakeCell) -> None:
    """Iterating the samples feeds spindle and actuator: unfed, a drive stops after its watchdog's time."""
    fed: dict[str, list[float]] = {"spindle": [], "actuator": []}

    def noted(name: str) -> Callable[[Any], Any]:
        return lambda sample: fed[name].append(fake.clock.at_s) or sample

    fake.spindle.reads, fake.actuator.reads = noted("spindle"), noted("actuator")
    fake.actuator.landing_s = 8.0
    await polish_for(fake, 0.1)
    for name, at_s in fed.items():
        gaps = [b - a for a, b in zip([0.0, *at_s], at_s, strict=False)]
        assert max(gaps) < 0.3, name


async def test_a_spindle_that_trips_while_the_tool_lands_is_noticed(fake: FakeCell) -> None:
    fake.spindle.reads = lambda s: replace(s, fault=4) if fake.clock.at_s > 1.0 else s
    with pytest.raises(DeviceFault, match="spindle: fault 4"):
        await polish_for(fake)
    assert "pressing" not in fake.events
    assert fake.clock.at_s < 2.0 + 4.5


async def test_landing_takes_its_time_without_a_stop(fake: FakeCell) -> None:
    """Force outside its band is no fault before the first contact, however long its grace is over."""
    fake.actuator.reads = lambda s: blank(s) if s.at_s < 2.0 else s
    await polish_for(fake)
    assert fake.clock.at_s >= 3.0


async def test_each_sample_is_judged() -> None:
    async def two() -> AsyncIterator[int]:
        yield 1
        yield 2

    judged: list[int] = []
    with pytest.raises(LinkError, match="scale: its samples ended"):
        await read_samples(two(), judged.append, "scale", 1.0)
    assert judged == [1, 2]


# make_safe


@pytest.mark.parametrize("broken", ["actuator", "robot", "spindle"])
@pytest.mark.parametrize("error", [LinkError("gone"), OSError("wire"), ValueError("a plugin's own bug")])
async def test_make_safe_attempts_all(fake: FakeCell, broken: str, error: Exception) -> None:
    fake.devices[broken].acts.fails["make_safe"] = error
    await make_safe(fake.cell)
    assert fake.events == UNTOUCHED
    assert fake.cell.unsafe == (f"{broken}: {error}",)


async def test_a_link_that_is_opened_to_make_a_device_safe_is_recorded_as_its_own(fake: FakeCell) -> None:
    received: list[tuple[str, str]] = []
    names = ("actuator", "robot", "spindle")
    for name in names:
        fake.devices[name].acts.before["make_safe"] = partial(tap, f"tcp://{name}:1")
    with record_received(lambda passed: received.append((passed.role, passed.link))):
        await make_safe(fake.cell)
    assert sorted(received) == [(name, f"tcp://{name}:1") for name in names]


@pytest.mark.parametrize("broken", ["actuator", "robot", "spindle"])
async def test_make_safe_does_not_wait_for_ever(fake: FakeCell, broken: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time_limits, "ANSWERS_S", 0.02)
    own_s = {device: 0.0 if device == broken else SOON_S for device in ("actuator", "robot", "spindle")}
    fake.actuator.times = ActuatorTimes(release_s=0.0, retract_s=own_s["actuator"])
    fake.robot.times, fake.spindle.times = RobotTimes(stop_s=own_s["robot"]), SpindleTimes(spin_s=own_s["spindle"])
    fake.devices[broken].acts.hangs.add("make_safe")
    await make_safe(fake.cell)
    assert fake.events == UNTOUCHED
    assert fake.cell.unsafe == (f"{broken}: no answer within 0.02 s",)


async def test_at_rest_the_robot_is_never_commanded_to_lift(fake: FakeCell) -> None:
    """At a start nothing moves, whatever the actuator reports."""
    fake.actuator.acts.fails["make_safe"] = LinkError("gone")
    await make_safe(fake.cell)
    assert not fake.of("robot.lift")


async def test_make_safe_forgets_what_was_unsafe_before(fake: FakeCell) -> None:
    fake.cell.unsafe = ("robot: gone",)
    await make_safe(fake.cell)
    assert fake.cell.unsafe == ()


async def test_everything_broken_is_reported(fake: FakeCell) -> None:
    for name in ("actuator", "robot", "spindle"):
        fake.devices[name].acts.fails["make_safe"] = LinkError(f"no {name}")
    with pytest.raises(KeyError):
        async with contact(fake.cell, LIMITS, unused_record()):
            raise KeyError
    assert fake.events[-3:] == ["actuator.make_safe", "robot.lift 15", "robot.make_safe"]
    lifted = "actuator: no actuator; the robot has lifted the tool off the part by 15 mm"
    assert fake.cell.unsafe == (lifted, "robot: no robot", "spindle: no spindle")


async def test_a_second_cancellation_does_not_abort_make_safe(fake: FakeCell) -> None:
    go_on = asyncio.Event()
    plain = fake.actuator.make_safe

    async def slowly() -> None:
        fake.events.append("asked")
        await go_on.wait()
        await plain()

    fake.actuator.make_safe = slowly  # type: ignore[method-assign]
    task = asyncio.ensure_future(forever(fake))
    await until(fake, "pressing")
    task.cancel()
    await until(fake, "asked")
    for _ in range(3):
        task.cancel()
        await asyncio.sleep(0)
    assert not task.done()
    go_on.set()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert fake.events[-4:] == ["asked", "actuator.make_safe", "lifted", "robot.make_safe"]
    assert fake.actuator.retracted


async def test_make_safe_hands_on_a_cancellation_that_came_meanwhile(fake: FakeCell) -> None:
    task = asyncio.ensure_future(make_safe(fake.cell))
    fake.actuator.acts.before["make_safe"] = task.cancel
    with pytest.raises(asyncio.CancelledError):
        await task
    assert fake.events == UNTOUCHED


# a cell with several devices


class Twins:
    """Two robots, each with one tool; the job uses the left ones."""

    def __init__(self) -> None:
        self.left, self.right = FakeCell(), FakeCell()
        devices: dict[str, FakeDevice] = {}
        for side, fake in (("left", self.left), ("right", self.right)):
            for device in fake.devices.values():
                if device.name == "metrology":
                    continue
                device.events, device.clock = self.left.events, self.left.clock
                device.name = f"{device.name}.{side}"
                devices[device.name] = device
        order = sorted(devices, key=lambda name: list(PORTS).index(name.split(".")[0]))
        used = {port: f"{port}.left" for port in ("actuator", "robot", "spindle")}
        self.cell = Cell({name: devices[name] for name in order}, used, self.left.clock, opened=set(order))

    def safe(self) -> list[str]:
        return [event for event in self.left.events if event.endswith("make_safe")]

    async def right_robot_stops_s(self) -> float:
        """Make the cell safe; the clock's time at which the idle robot was stopped."""
        stopped_s: list[float] = []
        self.right.robot.acts.before["make_safe"] = lambda: stopped_s.append(self.left.clock.at_s)
        task = asyncio.ensure_future(make_safe(self.cell))
        while not task.done():
            self.left.clock.advance(0.05)
            for _ in range(5):
                await asyncio.sleep(0)
        await task
        return stopped_s[0]


async def test_all_devices_are_made_safe_and_named() -> None:
    twins = Twins()
    twins.right.robot.acts.fails["make_safe"] = LinkError("gone")
    await make_safe(twins.cell)
    sides = ("left", "right")
    tools = [f"{port}.{side}.make_safe" for port in ("spindle", "actuator") for side in sides]
    assert twins.safe() == [*tools, "robot.left.make_safe", "robot.right.make_safe"]
    assert twins.cell.unsafe == ("robot.right: gone",)


async def test_only_the_jobs_devices_are_in_contact_and_its_robot_waits_for_its_own_tool() -> None:
    twins, go_on = Twins(), asyncio.Event()
    plain = twins.right.actuator.make_safe

    async def slowly() -> None:
        await go_on.wait()
        await plain()

    twins.right.actuator.make_safe = slowly  # type: ignore[method-assign]
    twins.left.robot.acts.before["make_safe"] = go_on.set
    with pytest.raises(KeyError):
        async with contact(twins.cell, LIMITS, unused_record()):
            raise KeyError
    events = twins.left.events
    assert "actuator.left.set_force 12" in events
    assert not [event for event in events if "right" in event and "make_safe" not in event]
    lifted, stopped = events.index("actuator.left.make_safe"), events.index("robot.left.make_safe")
    assert lifted < stopped < events.index("actuator.right.make_safe") < events.index("robot.right.make_safe")


async def test_an_idle_robot_that_moves_stops_once_every_tool_has_let_go() -> None:
    """At a start it is unknown which robot was in contact with which part."""
    twins = Twins()
    twins.right.actuator.acts.fails["make_safe"] = LinkError("gone")
    twins.right.robot.until = None  # it runs
    assert await twins.right_robot_stops_s() >= ActuatorTimes().alone_s - 0.1
    assert twins.cell.unsafe == ("actuator.right: gone",)


async def test_only_what_this_process_has_opened_is_made_safe() -> None:
    """Another program may be in contact with the rest."""
    twins = Twins()
    twins.cell.opened -= {"robot.left", "actuator.left", "spindle.left"}
    await make_safe(twins.cell)
    assert set(twins.safe()) == {f"{port}.right.make_safe" for port in ("spindle", "actuator", "robot")}
    assert not [event for event in twins.left.events if "left" in event]
    assert twins.cell.unsafe == ()
    twins.left.events.clear()
    twins.cell.opened.clear()
    await make_safe(twins.cell)
    assert twins.left.events == []


@pytest.mark.parametrize("runs", [True, False])
async def test_a_robot_that_runs_waits_for_a_tool_that_this_process_could_not_open(*, runs: bool) -> None:
    """The tool may press: it has let go once its own watchdog has had the time."""
    twins = Twins()
    twins.cell.opened -= {"actuator.left", "actuator.right"}
    if runs:
        twins.right.robot.until = None
    stopped_s = await twins.right_robot_stops_s()
    assert (stopped_s >= ActuatorTimes().alone_s - 0.1) is runs


# the error that is raised


@pytest.mark.parametrize(
    ("errors", "raised"),
    [
        ([ValueError("x"), LinkError("l"), SafetyStop("s")], SafetyStop),
        ([ValueError("x"), LinkError("l")], LinkError),
        ([asyncio.CancelledError(), ValueError("x")], ValueError),
        ([asyncio.CancelledError(), BaseExceptionGroup("in", [ConfigError("deep"), KeyError()])], ConfigError),
        ([asyncio.CancelledError()], asyncio.CancelledError),
    ],
)
def test_root_cause(errors: list[BaseException], raised: type[BaseException]) -> None:
    assert type(root_cause(BaseExceptionGroup("group", errors))) is raised


async def test_two_faults_at_once_tell_the_safety_stop(fake: FakeCell) -> None:
    async def starves() -> None:
        async with contact(fake.cell, LIMITS, unused_record()):
            try:
                await asyncio.Event().wait()
            finally:
                raise SafetyStop("and the stream starves")

    fake.spindle.reads = lambda s: replace(s, fault=3) if fake.clock.at_s > 2.5 else s
    with pytest.raises(PolishdError) as raised:
        await starves()
    assert type(raised.value) is SafetyStop
    assert fake.events[-4:] == SAFE
