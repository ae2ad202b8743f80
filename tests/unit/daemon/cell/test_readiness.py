"""Before contact each device of the job has to be ready; the error has the status of a device that is not."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path

import pytest

from polishd.daemon.cell import cell
from polishd.model.devices import ActuatorTimes, DeviceStatus, SpindleTimes
from polishd.model.errors import DeviceFault, LinkError
from polishd.model.part_handling import BetweenPasses, HandlingStep
from polishd.model.states import Outcome
from tests.unit.daemon.job.test_part_handling import proving
from tests.unit.daemon.small_job import Bench, open_journal, small_recipe
from tests.unit.daemon.test_app import Running

READY = DeviceStatus(ready=True, safe=True, state="idle")
DISABLED = DeviceStatus(ready=False, safe=True, state="fault", detail="drive disabled")


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with open_journal(tmp_path) as journal:
        yield Bench(tmp_path, journal)


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize("name", ["actuator", "robot", "spindle", "metrology"])
async def test_a_device_that_is_not_ready_is_reported_by_its_own_words_and_nothing_moves(
    bench: Bench, name: str
) -> None:
    bench.fake.devices[name].status_reply = DISABLED
    async with Running(bench) as running:
        await running.held()
        said = f"DeviceFault: {name} is not ready: fault: drive disabled. Correct it; no pass was begun"
        assert running.daemon.reason == said
        assert [event.data["kind"] for event in running.published if event.name == "cell_held"] == ["DeviceFault"]
        assert bench.fake.of("robot.resume", "actuator.set_force", "spindle.set_speed") == []
        assert bench.journal.passes == ()
        bench.fake.devices[name].status_reply = READY
        await running.daemon.handlers["resume"]()
        assert await running.outcome() is Outcome.IN_TOLERANCE


async def test_all_that_are_not_ready_stand_in_one_line(bench: Bench) -> None:
    for device in (bench.fake.actuator, bench.fake.spindle):
        device.status_reply = DISABLED
    message = r"^actuator is not ready: fault: drive disabled; spindle is not ready: fault: drive disabled\. Correct it"
    with pytest.raises(DeviceFault, match=message):
        await bench.polish()


async def test_what_a_watchdog_left_is_taken_back(bench: Bench) -> None:
    spindle = bench.fake.spindle
    spindle.status_reply = DeviceStatus(ready=False, safe=True, state="fault", detail="watchdog ran out")
    spindle.acts.before["make_safe"] = lambda: setattr(spindle, "status_reply", READY)
    assert await bench.polish(bench.job(max_cycles=1)) is Outcome.CYCLES_USED


@pytest.mark.full
async def test_a_device_that_cannot_be_cleared_is_still_reported_by_its_own_words(bench: Bench) -> None:
    bench.fake.spindle.status_reply = DISABLED
    bench.fake.spindle.acts.fails["make_safe"] = DeviceFault("spindle: refuses")
    with pytest.raises(DeviceFault, match="spindle is not ready: fault: drive disabled"):
        await bench.polish()


async def test_a_robot_may_take_an_alarm_back_as_it_gets_its_program(bench: Bench) -> None:
    robot = bench.fake.robot
    robot.status_reply = DISABLED
    robot.acts.before["prepare"] = lambda: setattr(robot, "status_reply", READY)
    assert await bench.polish(bench.job(max_cycles=1)) is Outcome.CYCLES_USED


async def test_a_device_that_the_job_does_not_use_is_not_asked_to_be_ready(bench: Bench) -> None:
    loader = bench.fake.with_loader()
    loader.status_reply, bench.fake.cell.used = DISABLED, {name: name for name in bench.fake.devices}
    assert await bench.polish(bench.job(max_cycles=1)) is Outcome.CYCLES_USED


@pytest.mark.full
async def test_no_touch_off_and_no_conditioning_with_a_device_that_is_not_ready(bench: Bench, tmp_path: Path) -> None:
    bench.fake.actuator.status_reply = DISABLED
    with pytest.raises(DeviceFault, match="drive disabled"):
        await bench.polish(proving(bench))
    assert bench.moved() == []
    bench.fake.actuator.status_reply = READY
    dressed = tmp_path / "dressed"
    step = HandlingStep(command=("touch", str(dressed)), folder=tmp_path)
    recipe = small_recipe(part_handling=BetweenPasses(condition=step), tolerance_nm=1e-6)
    bench.fake.actuator.acts.before["retract"] = lambda: setattr(bench.fake.actuator, "status_reply", DISABLED)
    with pytest.raises(DeviceFault, match="drive disabled"):
        await bench.polish(bench.job(recipe=recipe))
    assert [record.how for record in bench.journal.passes] == ["done"]
    assert not dressed.exists()


async def test_a_slow_lift_is_no_lost_link_when_a_link_is_opened_again(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What opening may take is no limit to what making safe may: a lift of 20 s is none of a dead device."""
    monkeypatch.setattr(cell, "OPEN_S", 0.5)
    actuator = bench.fake.actuator
    actuator.times = ActuatorTimes(retract_s=20.0)
    actuator.acts.fails["status"] = LinkError("sleeping")
    actuator.acts.before["open"] = actuator.acts.fails.clear
    lifted = asyncio.Event()

    async def lift() -> None:
        actuator.events.append("actuator.make_safe")
        asyncio.get_running_loop().call_later(1.0, lifted.set)
        await lifted.wait()

    monkeypatch.setattr(actuator, "make_safe", lift)
    await bench.fake.cell.restore_links()
    assert bench.fake.of("actuator.open", "actuator.make_safe") == ["actuator.open", "actuator.make_safe"]


@pytest.mark.full
async def test_a_device_that_never_becomes_safe_is_a_lost_link(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("polishd.daemon.cell.time_limits.ANSWERS_S", 0.02)
    spindle = bench.fake.spindle
    spindle.times, spindle.status_reply = SpindleTimes(spin_s=0.02), DISABLED
    spindle.acts.hangs.add("make_safe")
    with pytest.raises(LinkError, match=r"spindle: no answer within 0\.04 s"):
        await bench.polish()
