"""Part handling on a cell in memory: touch-off before contact, and steps between passes."""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polishd.model.devices import ForceSample, SensedForce
from polishd.model.errors import (
    DeviceFault,
    DeviceRefused,
    HandlingError,
    LinkError,
    PartNotSettled,
    PlanRefused,
    RemovalCheckStop,
    SafetyStop,
    SeatNotLeft,
    WrongSeat,
)
from polishd.model.part_handling import BetweenPasses, HandlingStep, SettleRule, TouchOff
from polishd.model.states import Outcome
from polishd.model.surface import SurfaceMap
from polishd.pipeline import steps
from tests.unit.daemon.small_job import Bench, as_map, open_journal, small_map, small_recipe

RIM_MM, PLACE_MM = 12.0, 11.0
TURN = np.radians([90.0, 210.0, 330.0])
PLACES = np.stack([PLACE_MM * np.cos(TURN), PLACE_MM * np.sin(TURN), np.zeros(3)], axis=1)
UP = np.tile([0.0, 0.0, 1.0], (3, 1))
ASKED = TouchOff(0.8, None, 0.3, each_pass=False, points_mm=PLACES, normal=UP, axis=UP, rim_mm=RIM_MM)
LANDED = "actuator.set_force 0.8"
CONTACT = "actuator.set_force 12"


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with open_journal(tmp_path) as journal:
        yield Bench(tmp_path, journal)


def proving(bench: Bench, asked: TouchOff = ASKED, **job: Any) -> Any:
    """A job that proves the seat."""
    return bench.job(recipe=small_recipe(touch_off=asked, tolerance_nm=1e-6), **{"max_cycles": 1, **job})


def sits(bench: Bench, *positions_mm: float | None) -> None:
    """Set the positions at which the tool touches the part at each place; later ones are nominal."""
    left = list(positions_mm)
    bench.fake.actuator.touch_mm = lambda: left.pop(0) if left else 5.0


def ended(bench: Bench, *phases: str) -> list[str]:
    return [line for line in bench.phases() if line.split()[1] in phases]


# the seat


@pytest.mark.full
async def test_the_seat_is_proved_at_three_places_before_contact_with_the_spindle_at_rest(bench: Bench) -> None:
    job = proving(bench)
    assert await bench.polish(job) is Outcome.CYCLES_USED
    calls = bench.fake.of("robot.prepare", "spindle.set_speed", "actuator.set_force", "actuator.retract")
    touch = [
        "robot.prepare",
        "spindle.set_speed 0",
        LANDED,
        "actuator.set_force 0",
        "actuator.retract",
        "spindle.set_speed 0",
    ]
    assert calls[: 3 * len(touch)] == 3 * touch
    assert calls[3 * len(touch) :][:3] == ["robot.prepare", "spindle.set_speed 1000", CONTACT]
    assert ended(bench, "touch_off", "run") == ["0 touch_off done", "0 run done"]
    (published,) = [event for event in job.published if event.name == "part_touched_off"]
    assert published.seat.worst_mm == pytest.approx(0.0, abs=1e-9)
    kept = json.loads((bench.tmp_path / "run/cycle-00/touch_off.json").read_text())
    assert kept["seat"]["off_mm"] == pytest.approx([0.0, 0.0, 0.0])
    assert kept["notes"] == [], "it sits as it should: nothing to note"


@pytest.mark.full
async def test_the_robot_stands_at_the_place_while_the_tool_is_down(bench: Bench) -> None:
    """It goes there with the tool up, and leaves after the lift."""
    await bench.polish(proving(bench))
    first = bench.fake.events.index(LANDED)
    before = [event for event in bench.fake.events[:first] if event.startswith("robot.resume")]
    assert len(before) == 1
    lifted = bench.fake.events.index("lifted", first)
    assert not [event for event in bench.fake.events[first:lifted] if event.startswith("robot.resume")]
    assert bench.fake.of("robot.resume")[1] == "robot.resume None"


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize("sign", [1, -1])
async def test_a_part_that_sits_a_little_off_is_polished(bench: Bench, sign: int) -> None:
    sits(bench, *[5.0 + 0.2 * sign] * 3)
    job = proving(bench)
    assert await bench.polish(job) is Outcome.CYCLES_USED
    (published,) = [event for event in job.published if event.name == "part_touched_off"]
    assert published.seat.height_mm == pytest.approx(-0.2 * sign, abs=0.02)


@pytest.mark.full
@pytest.mark.parametrize(
    ("positions_mm", "said"),
    [
        (
            (4.5, 4.5, 4.5),
            r"0\.50\d mm too high, tilted.*0\.50 mm too high at x 0\.0, y 11\.0 mm; .*nothing was polished",
        ),
        ((4.8, 5.1, 5.1), r"0\.20 mm too high at x 0\.0, y 11\.0 mm; 0\.10 mm too low.*touch_off\.max_offset_mm"),
    ],
)
async def test_a_part_that_sits_wrong_is_not_polished(bench: Bench, positions_mm: tuple[float, ...], said: str) -> None:
    sits(bench, *positions_mm)
    asked = replace(ASKED, max_offset_mm=0.2)
    with pytest.raises(WrongSeat, match=f"(?i){said}"):
        await bench.polish(proving(bench, asked))
    assert CONTACT not in bench.fake.events
    assert "spindle.set_speed 1000" not in bench.fake.events
    assert bench.phases()[-1] == "0 touch_off failed"
    assert bench.journal.passes == ()
    assert bench.fake.actuator.retracted
    assert bench.fake.of("robot.resume")[-1] == "robot.resume None", "the robot has left the place"
    assert (bench.tmp_path / "run/cycle-00/touch_off.json").exists()


async def test_a_tool_that_meets_nothing_is_driven_no_deeper_than_the_seat_may_be(bench: Bench) -> None:
    sits(bench, None)
    deepest: list[float] = []
    bench.fake.actuator.reads = lambda sample: deepest.append(sample.position_mm or 0.0) or sample
    with pytest.raises(WrongSeat, match=r"no part was found at x 0\.0, y 11\.0 mm down to 0\.3 mm below"):
        await bench.polish(proving(bench))
    assert 5.3 < max(deepest) < 5.4
    assert bench.fake.events.count(LANDED) == 1
    assert bench.fake.actuator.retracted
    assert bench.fake.events[-1] == "robot.resume None", "the tool is up: the robot leaves"


async def test_where_the_tool_is_not_known_to_be_up_the_robot_stays(bench: Bench) -> None:
    sits(bench, None)
    bench.fake.actuator.acts.fails["make_safe"] = LinkError("the coil is gone")
    with pytest.raises(SeatNotLeft, match=r"The robot still stands at that point: .*the coil is gone"):
        await bench.polish(proving(bench))
    assert "robot.resume None" not in bench.fake.events
    assert bench.fake.cell.unsafe


async def test_a_robot_that_cannot_leave_does_not_hide_why(bench: Bench) -> None:
    sits(bench, None)
    bench.fake.robot.acts.before["make_safe"] = lambda: bench.fake.robot.acts.fails.update(
        resume=DeviceRefused("the program is over")
    )
    with pytest.raises(SeatNotLeft, match=r"no part was found.*the program is over"):
        await bench.polish(proving(bench))


async def test_more_force_than_the_band_ends_the_touch_off_as_it_ends_contact(bench: Bench) -> None:
    touched: list[float] = []

    def reads(sample: ForceSample) -> ForceSample:
        touched.extend([sample.at_s] if sample.in_contact else [])
        return replace(sample, force_n=1.3) if len(touched) > 3 else sample

    bench.fake.actuator.reads = reads
    with pytest.raises(SafetyStop, match=r"force 1\.30 N is outside 0\.8 N"):
        await bench.polish(proving(bench))
    assert bench.fake.events[-4:] == ["spindle.make_safe", "actuator.make_safe", "lifted", "robot.make_safe"]


@pytest.mark.full
@pytest.mark.parametrize("who", ["actuator", "force sensor"])
async def test_the_touch_off_has_a_largest_force_of_its_own(bench: Bench, who: str) -> None:
    """2 N, whatever polishing presses with: one reading is enough."""
    if who == "actuator":
        bench.fake.actuator.reads = lambda s: replace(s, force_n=2.1) if s.setpoint_n == ASKED.force_n else s
    else:
        sensor = bench.fake.with_force_sensor()
        sensor.reads = lambda r: replace(r, force_n=2.1) if r.force_n else r
    with pytest.raises(SafetyStop, match=rf"the {who} reads 2.10 N; at most 2 N may act \(touch_off.force_max_n\)"):
        await bench.polish(proving(bench))
    assert CONTACT not in bench.fake.events


async def test_a_position_counts_once_the_force_sensor_says_that_the_force_acts(bench: Bench) -> None:
    sensor, read = bench.fake.with_force_sensor(), list[float]()

    def settles(reading: SensedForce) -> SensedForce:
        read.append(reading.force_n)
        return replace(reading, force_n=min(reading.force_n, 0.01 * len(read)))

    sensor.reads = settles
    sits(bench, *[5.1, 5.1, 5.1])
    assert await bench.polish(proving(bench)) is Outcome.CYCLES_USED
    assert len(read) > 60, "of three places, and of the pass"


async def test_a_force_sensor_watches_the_newton(bench: Bench) -> None:
    """The actuator measures too small a force: its reading is in the band, and more than 1 N acts."""
    sensor = bench.fake.with_force_sensor()
    sensor.reads = lambda reading: replace(reading, force_n=1.75 * reading.force_n)
    with pytest.raises(
        SafetyStop, match=r"by the force sensor 1\.40 N is outside 0\.8 N .* the actuator reads 0\.80 N"
    ):
        await bench.polish(proving(bench))
    assert bench.fake.events[-4:] == ["spindle.make_safe", "actuator.make_safe", "lifted", "robot.make_safe"]
    assert CONTACT not in bench.fake.events


async def test_a_spindle_that_turns_ends_the_touch_off(bench: Bench) -> None:
    bench.fake.spindle.reads = lambda sample: replace(sample, rpm=300.0 if LANDED in bench.fake.events else 0.0)
    with pytest.raises(SafetyStop, match="spindle at 300 rpm instead of 0"):
        await bench.polish(proving(bench))
    assert CONTACT not in bench.fake.events


@pytest.mark.full
async def test_a_spindle_at_rest_may_read_a_little(bench: Bench) -> None:
    bench.fake.spindle.reads = lambda sample: replace(sample, rpm=sample.rpm + 2.0)
    assert await bench.polish(proving(bench)) is Outcome.CYCLES_USED


@pytest.mark.full
async def test_cancelled_while_the_tool_is_down(bench: Bench) -> None:
    task = asyncio.ensure_future(bench.polish(proving(bench)))
    while LANDED not in bench.fake.events:  # noqa: ASYNC110  pytest's timeout is the limit
        await asyncio.sleep(0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert bench.fake.events[-1] == "robot.make_safe"
    assert bench.fake.actuator.retracted
    assert bench.phases()[-1] == "0 touch_off cancelled"


async def test_a_fault_of_the_actuator_at_a_place(bench: Bench) -> None:
    bench.fake.actuator.acts.fails["set_force"] = DeviceFault("actuator: encoder")
    with pytest.raises(DeviceFault, match="encoder"):
        await bench.polish(proving(bench))
    assert bench.fake.events[-1] == "robot.make_safe"


async def test_an_actuator_without_a_position_is_named(bench: Bench) -> None:
    bench.fake.actuator.reads = lambda sample: replace(sample, position_mm=None)
    with pytest.raises(DeviceRefused, match=r"no position.*\[touch_off\]"):
        await bench.polish(proving(bench))
    assert bench.fake.actuator.retracted
    assert CONTACT not in bench.fake.events


async def test_a_touch_off_is_checked_like_any_plan(bench: Bench) -> None:
    job = proving(bench, check_plan=lambda plan, envelope: ["guard: z"] if "touch" in plan.program.name else [])
    with pytest.raises(PlanRefused, match="guard: z"):
        await bench.polish(job)
    assert bench.moved() == []


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize(("each_pass", "proofs"), [(False, 1), (True, 2)])
async def test_how_often_it_is_proved(bench: Bench, each_pass: bool, proofs: int) -> None:
    bench.rate = 0.9
    await bench.polish(proving(bench, replace(ASKED, each_pass=each_pass), max_cycles=2))
    assert bench.fake.events.count(LANDED) == 3 * proofs
    assert len(bench.journal.passes) == 2


@pytest.mark.full
async def test_after_a_hold_it_is_proved_again(bench: Bench) -> None:
    """A step may have moved the part."""
    job = proving(bench)
    sits(bench, 4.0, 4.0, 4.0)
    with pytest.raises(WrongSeat):
        await bench.polish(job)
    assert await bench.polish(job) is Outcome.CYCLES_USED
    assert bench.fake.events.count(LANDED) == 6


@pytest.mark.full
async def test_the_place_of_the_actuator_may_be_said(bench: Bench) -> None:
    sits(bench, 4.0, 4.0, 4.0)
    assert await bench.polish(proving(bench, replace(ASKED, position_mm=4.0))) is Outcome.CYCLES_USED


# between passes


def between(bench: Bench, what: BetweenPasses, **job: Any) -> Any:
    bench.rate = 0.9
    return bench.job(recipe=small_recipe(part_handling=what, tolerance_nm=1e-6), **{"max_cycles": 2, **job})


def said(path: Path, code: str = "") -> tuple[str, ...]:
    """A command that records its step and cycle."""
    variables = "' '.join(os.environ['POLISHD_' + key] for key in ('STEP', 'CYCLE', 'PART', 'JOB'))"
    return (sys.executable, "-c", f"import os, sys; print({variables}, file=open({str(path)!r}, 'a')); {code}")


@pytest.mark.full
async def test_commands_run_between_passes_in_their_order(bench: Bench, tmp_path: Path) -> None:
    step = HandlingStep(command=said(tmp_path / "said"), folder=tmp_path)
    await bench.polish(between(bench, BetweenPasses(clean=step, condition=step)))
    written = (tmp_path / "said").read_text().splitlines()
    assert written == ["clean 1 P-1 small", "condition 1 P-1 small", "clean 2 P-1 small"]
    order = [line.split()[1] for line in bench.phases() if line.startswith("1 ")]
    assert order == ["clean", "measure", "learn", "solve", "plan", "condition", "run"]


async def test_a_step_of_a_person_is_asked_for_once(bench: Bench) -> None:
    job = between(bench, BetweenPasses(clean=HandlingStep(operator="wipe the part")), max_cycles=1)
    with pytest.raises(HandlingError, match=r"clean: wipe the part\. Then run polishd resume"):
        await bench.polish(job)
    assert bench.journal.unfinished() is None, "nothing is under way while the person is at it"
    assert await bench.polish(job) is Outcome.CYCLES_USED
    assert ended(bench, "clean") == ["1 clean failed"]


@pytest.mark.full
async def test_a_command_that_failed_is_run_again(bench: Bench, tmp_path: Path) -> None:
    code = f"sys.exit(len(open({str(tmp_path / 'said')!r}).readlines()) == 1 and 'no water')"
    step = HandlingStep(command=said(tmp_path / "said", code), folder=tmp_path)
    job = between(bench, BetweenPasses(clean=step), max_cycles=1)
    with pytest.raises(HandlingError, match=r"clean: .* exit code 1: no water"):
        await bench.polish(job)
    assert await bench.polish(job) is Outcome.CYCLES_USED
    assert ended(bench, "clean") == ["1 clean failed", "1 clean done"]


# settling


def warming(bench: Bench, *swellings_nm: float) -> Callable[[], SurfaceMap]:
    """Maps of a part with these heights at its rim, one after the other; then no map."""
    measure, left = bench.measure, list(swellings_nm)
    radius = small_map().grid.radius_mm() / RIM_MM

    def seen() -> SurfaceMap:
        noise = 0.01 * np.random.default_rng(len(left) + 1000 * len(bench.journal.history)).standard_normal(
            radius.shape
        )
        return as_map(measure().height_nm + (left.pop(0) if left else 0.0) * radius**2 + noise)

    return seen


@pytest.mark.full
async def test_maps_are_taken_until_two_in_a_row_agree(bench: Bench) -> None:
    bench.fake.metrology.measure = warming(bench, 0.0, 0.0, 9.0, 3.0, 1.0, 0.9)
    bench.fake.clock.sleep = no_sleep  # type: ignore[method-assign]
    job = between(bench, BetweenPasses(settle=SettleRule(limit_nm=0.2, max_maps=6, wait_s=60.0)), max_cycles=1)
    assert await bench.polish(job) is Outcome.CYCLES_USED
    published = [(event.cycle, event.maps) for event in job.published if event.name == "map_repeated"]
    assert published == [(0, 2), (1, 2), (1, 3), (1, 4)]
    rows = bench.journal._store.read("SELECT cycle, sha256 FROM map ORDER BY id")
    assert [cycle for cycle, _ in rows] == [0, 0, 1, 1, 1, 1], "all of them are journalled"
    assert bench.journal.history[-1].sha256 == rows[-1][1], "the last one counts"
    folder = bench.tmp_path / "run/cycle-01"
    kept = json.loads((folder / "settling.json").read_text())
    assert kept["settled"]
    assert len(kept["change_nm"]) == 3
    assert sorted(path.name for path in folder.glob("settling-*")) == ["settling-00", "settling-01", "settling-02"]
    assert (folder / "settling-02/surface.npz").exists()
    assert (folder / "surface.npz").exists()
    assert ended(bench, "settle") == ["0 settle done", "1 settle done"]


async def test_a_part_that_does_not_settle_is_reported(bench: Bench) -> None:
    bench.fake.metrology.measure = warming(bench, 9.0, 8.0, 7.0, 6.0)
    bench.fake.clock.sleep = no_sleep  # type: ignore[method-assign]
    job = between(bench, BetweenPasses(settle=SettleRule(limit_nm=0.2, max_maps=3, wait_s=60.0)))
    with pytest.raises(PartNotSettled, match=r"does not settle: it changed by 0\.\d\d, 0\.\d\d nm from map to map"):
        await bench.polish(job)
    assert len(bench.fake.of("metrology.next_map")) == 3
    assert bench.moved() == []
    assert bench.phases()[-1] == "0 settle failed"


async def no_sleep(seconds: float) -> None:
    """The cell's clock stands still: a waiting task runs at once."""
    await asyncio.sleep(0)


class WarmPart:
    """A part that swells in each pass and cools from map to map: its maps and its true surface."""

    def __init__(self, bench: Bench, swells_nm: float) -> None:
        self._truth = bench.measure
        self._journal = bench.journal
        self._swells_nm = swells_nm
        self._thermal_nm = 0.0
        self._passes = 0
        self.true_nm = 0.0
        bench.fake.clock.sleep = no_sleep  # type: ignore[method-assign]
        bench.fake.metrology.measure = self.measure

    def measure(self) -> SurfaceMap:
        true = self._truth()
        self.true_nm = steps.condition(small_recipe(), true).stats.rms_nm
        self._thermal_nm *= 0.3
        if len(self._journal.passes) > self._passes:
            self._passes, self._thermal_nm = len(self._journal.passes), self._swells_nm
        radius = true.grid.radius_mm() / RIM_MM
        return as_map(true.height_nm + self._thermal_nm * radius**2)


@pytest.mark.full
@pytest.mark.one_of_each
@pytest.mark.parametrize("settle", [SettleRule(limit_nm=0.2, max_maps=9, wait_s=60.0), None])
async def test_a_warm_part_is_judged_rightly_once_it_has_settled(bench: Bench, settle: SettleRule | None) -> None:
    """Its first map after a pass shows a swelling that is no figure: by that the good part would be polished on.

    Without a settle rule, power that no removal explains is diagnosed, and the daemon measures again.
    """
    part = WarmPart(bench, swells_nm=12.0)
    recipe = small_recipe(tolerance_nm=1.5, part_handling=BetweenPasses(settle=settle))
    job = bench.job(recipe=recipe, max_cycles=1)
    assert await bench.polish(job) is Outcome.IN_TOLERANCE
    assert part.true_nm < 1.0
    assert bench.journal.history[-1].stats["rms_nm"] == pytest.approx(part.true_nm, abs=0.05)
    learned = json.loads((bench.tmp_path / "run/cycle-01/gate.json").read_text())
    named = [one["cause"] for one in learned["named"]]
    assert named == ([] if settle else ["settling"]), "a settled part needs no diagnosis"
    assert ended(bench, "learn") == ["0 learn done", *(["1 learn done"] * (1 if settle else 2))]


@pytest.mark.full
async def test_a_mount_that_prints_through_otherwise_each_time_holds_the_cell(bench: Bench) -> None:
    measure, trefoils = bench.measure, iter([0.0, 9.0, -7.0, 4.0])
    grid = small_map().grid
    x, y = (axis / RIM_MM for axis in grid.axes_mm)

    def seen() -> SurfaceMap:
        return as_map(measure().height_nm + next(trefoils) * (3 * x**2 * y - y**3))

    bench.fake.metrology.measure = seen
    bench.fake.clock.sleep = no_sleep  # type: ignore[method-assign]
    job = bench.job(max_cycles=1)
    with pytest.raises(RemovalCheckStop, match=r"a trefoil changed by .* nm: three points of the mount"):
        await bench.polish(job)
    assert bench.phases()[-1] == "1 settle failed"
    published = [event for event in job.published if event.name == "map_repeated"]
    assert [event.maps for event in published] == [2], "it does not come to rest: no more maps are waited for"
    assert "mount" in published[0].notes[0]
    assert (bench.tmp_path / "run/cycle-01/settling-00").is_dir()
    kept = json.loads((bench.tmp_path / "run/cycle-01/again.json").read_text())
    assert kept["change_nm"][0] > kept["limit_nm"]
    assert not kept["settled"]
    assert not (bench.tmp_path / "run/cycle-01/learned.json").exists(), "nothing is learned from such maps"


@pytest.mark.full
@pytest.mark.parametrize(("tolerance_nm", "held"), [(1.0, True), (4.0, False)])
async def test_a_part_that_goes_on_changing_holds_the_cell_where_the_tolerance_does_not_bear_it(
    bench: Bench, tolerance_nm: float, held: bool
) -> None:
    bench.fake.metrology.measure = warming(bench, 0.0, 12.0, 8.0, 13.0, 7.0)
    bench.fake.clock.sleep = no_sleep  # type: ignore[method-assign]
    job = bench.job(recipe=small_recipe(tolerance_nm=tolerance_nm), max_cycles=1)
    if held:
        with pytest.raises(PartNotSettled, match=r"power changed by .* a part that is warm still"):
            await bench.polish(job)
        assert bench.phases()[-1] == "1 settle failed"
    else:
        await bench.polish(job)
    published = [event.maps for event in job.published if event.name == "map_repeated"]
    assert published == [2, 3], "it does not come nearer: no more maps are waited for"
