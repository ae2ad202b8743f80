"""Faults ``override`` and ``stand``: each simulated robot slows down or stands, and reports what a real one would."""

from __future__ import annotations

import json
import math
import struct
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polishd.config.simulator_devices import SimRobotSection
from polishd.config.simulator_faults import FaultSection
from polishd.sim_backends.common import framing as f
from polishd.sim_backends.common.faults import SpeedOverride
from polishd.sim_backends.linuxcnc import pendant
from polishd.sim_backends.plant.world import World
from polishd.sim_backends.plc_robot import device as plc_device
from polishd.sim_backends.plc_robot.device import ModbusServer
from polishd.sim_backends.universal_robots import device as ur_device
from polishd.sim_backends.universal_robots.controller import UrController
from tests.fakes.plc_robot import FakePlc
from tests.unit.sim_backends.fanuc_rmi.test_controller import Client
from tests.unit.sim_backends.plant.test_world import world
from tests.unit.sim_backends.robot.test_controller import Bench
from tests.unit.sim_backends.robot.test_motion import LINE, loaded
from tests.unit.sim_backends.universal_robots.test_universal_robots import FRAME_S, machine, pose, run

SECOND = ["G1 X1 F60", "X2", "X3"]
"""A second a block."""


def fault(what: str, **keys: Any) -> FaultSection:
    return FaultSection.model_validate({"device": "robot", "what": what, "at_s": 0.0, **keys})


def test_an_override_is_there_at_once_or_ramped_and_ends_with_its_fault() -> None:
    override, now_s = SpeedOverride(), time.monotonic()
    half, ramped = fault("override", percent=50), fault("override", percent=0, ramp_s=1000.0)
    override.suffer(half, True)
    assert override.actual(now_s) == override.reported(now_s) == 0.5
    override.suffer(ramped, True)
    assert override.actual(now_s + 500.0) == pytest.approx(0.25, abs=0.01)
    assert override.actual(now_s + 2000.0) == 0.0
    override.suffer(ramped, False)
    override.suffer(half, False)
    assert override.actual(now_s) == 1.0


def test_a_robot_that_stands_reports_nothing_of_it_nor_of_an_override_that_it_cannot_tell() -> None:
    override, now_s = SpeedOverride(), time.monotonic()
    override.suffer(fault("override", percent=50, reported=False), True)
    assert (override.actual(now_s), override.reported(now_s), override.stands) == (0.5, 1.0, False)
    override.suffer(fault("stand"), True)
    assert (override.actual(now_s), override.reported(now_s), override.stands) == (0.0, 1.0, True)


def test_half_speed_doubles_the_time_of_each_block_and_of_its_rows() -> None:
    motion = loaded(LINE)
    motion.advance(0.5)
    motion.set_pace(0.5, 0.5)
    motion.advance(100.0)
    assert motion.state == "done"
    spans = [end - start for _, start, end in motion.executed]
    # of the first second of motion half is done at full speed
    assert spans == pytest.approx([0.5 + 2 * 0.505, 2.0, 2 * 1.005], abs=0.02)
    rows = np.concatenate(motion.rows)
    assert rows[:, 3].sum() == pytest.approx(sum(spans))
    assert np.allclose(rows[:, 2] - rows[:, 1], rows[:, 3])
    for seq, span in enumerate(spans):
        assert rows[rows[:, 0] == seq, 3].sum() == pytest.approx(span)
    assert motion.changed_s == pytest.approx(sum(spans))


@pytest.mark.parametrize("speed", [1.0, 4.0])
def test_a_tool_that_stands_is_booked_in_its_block_while_the_state_is_running(speed: float) -> None:
    motion = loaded(SECOND, speed=speed)
    motion.advance(1.5 / speed)
    motion.set_pace(1.5 / speed, 0.0)
    place = motion.pose
    motion.rows.clear()
    for tick in range(1, 101):
        motion.advance((1.5 + 0.1 * tick) / speed)
    assert (motion.state, motion.pose, len(motion.executed)) == ("running", place, 1)
    rows = np.concatenate(motion.rows)
    assert set(rows[:, 0]) == {1.0}
    assert np.allclose(rows[:, 4:], place)
    assert rows[:, 3].sum() == pytest.approx(10.0), "the process clock goes on"
    assert (rows[-1, 2] - rows[0, 1]) * speed == pytest.approx(10.0)
    motion.set_pace(11.5 / speed, 1.0)
    motion.advance(100.0)
    assert motion.state == "done"
    assert motion.executed[1][2] - motion.executed[1][1] == pytest.approx(11.0, abs=0.02)


def test_a_tool_that_stands_is_held_at_once_and_goes_on_from_there() -> None:
    motion = loaded(SECOND)
    motion.advance(1.5)
    motion.set_pace(1.5, 0.0)
    motion.hold(2.0, "hold")
    assert (motion.state, motion.detail) == ("held", "hold")
    motion.set_pace(3.0, 1.0)
    motion.resume(3.0, None)
    motion.advance(100.0)
    assert [seq for seq, _, _ in motion.executed] == [0, 1, 2]
    assert motion.pose[0] == pytest.approx(3.0)


def test_one_that_brakes_when_it_comes_to_stand_is_held() -> None:
    motion = loaded(["G1 X50 F6000"], accel_mm_s2=100.0)
    motion.advance(0.5)
    motion.hold(0.5, "hold")
    assert motion.state == "running"
    motion.set_pace(0.6, 0.0)
    motion.advance(0.61)
    assert motion.state == "held"


def test_the_robot_link_reports_its_override_in_each_status() -> None:
    bench = Bench()
    client, got = bench.loaded()
    bench.resume(client)
    bench.controller.motion.set_pace(bench.now, 0.5)
    bench.controller.motion.reported_pace = 0.5
    bench.until(1.0, client)
    reported = [json.loads(payload) for kind, payload in got if kind == f.STATUS]
    assert {one["override"] for one in reported if one["state"] == "running"} == {0.5}
    assert 3 <= reported[-1]["executed"] <= 6, "10 mm/s, halved, for 1 s, a millimetre a block"


def test_a_plc_shows_its_feed_override_over_all_its_links(tmp_path: Path) -> None:
    plc = FakePlc(tmp_path).plc
    plc.motion.reported_pace = 0.5
    plc.tick(time.monotonic() + 1.0)
    assert plc.shown["feed_override"] == 50.0, "OPC UA reports the shown value"
    register = ModbusServer(plc).answer(bytes([4]) + struct.pack(">HH", 18, 1))
    assert register == bytes([4, 2, 0, 50])
    at = list(plc_device.KINDS).index("feed_override") * plc_device.STRING_BYTES
    error, value = plc_device.AdsServer(plc)._read(plc_device.DATA, at, 8)
    assert (error, struct.unpack("<d", value)) == (plc_device.OK, (50.0,))


def test_a_fanuc_controller_reports_its_override_and_stands_while_it_runs() -> None:
    client = Client()
    client.start()
    client.move(50.0, 1, 10)
    client.run(0.5)
    motion = client.controller.motion
    motion.set_pace(client.now_s, 0.5)
    motion.reported_pace = 0.5
    before = motion.pose[0]
    client.run(1.0)
    assert client.ask(Command="FRC_GetStatus")["Override"] == 50
    assert motion.pose[0] - before == pytest.approx(5.0, abs=0.3)
    motion.set_pace(client.now_s, 0.0)
    motion.reported_pace = 1.0
    place = motion.pose
    client.run(1.0)
    status = client.ask(Command="FRC_GetStatus")
    assert (status["Override"], status["ProgramStatus"], motion.pose) == (100, 1, place)
    assert client.answered() == []


def ur(*faults: FaultSection) -> UrController:
    found = machine()
    for one in faults:
        found.override.suffer(one, True)
    return found


def test_universal_robots_moves_slower_and_reports_its_slider() -> None:
    body = f"movel({pose(10)}, a=1, v=0.05)"
    full, half, silent = ur(), ur(fault("override", percent=50)), ur(fault("override", percent=50, reported=False))
    for found in (full, half, silent):
        run(found, body)
    took = [len(found.rows) * FRAME_S for found in (full, half, silent)]
    assert took[1] == pytest.approx(2 * took[0], rel=0.02)
    assert took[2] == took[1]
    assert [ur_device.value(found, "target_speed_fraction") for found in (full, half, silent)] == [1.0, 0.5, 1.0]
    assert {ur_device.value(found, "speed_scaling") for found in (full, half, silent)} == {1.0}


def test_universal_robots_stands_in_a_move_and_in_a_wait_and_plays_on() -> None:
    stand = fault("stand")
    for body in (f"movel({pose(10)}, a=1, v=0.05)", f"movel({pose(0.01)}, a=1, v=0.05)\nsleep(0.4)"):
        found = machine()
        found.load(f"def test():\n{body}\nend")
        for _ in range(50):
            found.frame()
        found.override.suffer(stand, True)
        place, rows = found.arm.place.xyz_mm, len(found.rows)
        for _ in range(1000):
            found.frame()
        assert found.arm.place.xyz_mm == place
        assert (found.runtime, ur_device.value(found, "target_speed_fraction")) == (2, 1.0)
        assert len(found.rows) - rows == 1000, "the plant gets its position"
        found.override.suffer(stand, False)
        for _ in range(1000):
            found.frame()
        assert found.runtime == 1


def test_universal_robots_comes_to_rest_where_it_stands() -> None:
    found = machine()
    found.load(f"def test():\nmovel({pose(10)}, a=1, v=0.05)\nend")
    for _ in range(50):
        found.frame()
    found.override.suffer(fault("stand"), True)
    found.stop()
    for _ in range(3):
        found.frame()
    assert found.arm.stands
    assert found.runtime == 1


def test_the_pendant_of_a_linuxcnc_reads_what_was_turned_last(tmp_path: Path) -> None:
    path = tmp_path / "pendant"
    pendant.write(path, 0.5, inhibit=False)
    assert pendant.read(path) == (5000, False)
    pendant.write(path, 1.0, inhibit=True)
    assert pendant.read(path) == (10000, True)
    assert sorted(path.parent.iterdir()) == [path]


def test_the_configuration_wires_the_pendant(tmp_path: Path) -> None:
    from polishd.sim_backends.linuxcnc.device import LinuxCncConfig as LinuxCnc

    LinuxCnc(SimRobotSection(kind="linuxcnc"), (0.0,) * 5, 900.0).write(tmp_path / "machine")
    hal = (tmp_path / "machine" / "machine.hal").read_text()
    assert "polishd-pendant.counts => halui.feed-override.counts" in hal
    assert "polishd-pendant.inhibit => motion.feed-inhibit" in hal
    assert (tmp_path / "machine" / "pendant.py").exists()


def test_the_plant_keeps_what_is_removed_beyond_plan() -> None:
    """Half as fast: as much again as planned; standing: all of it; pressing more: the difference; else nothing."""
    whole, excess = removed(pressed(), share=1.0)
    assert (whole > 50.0, excess) == (True, pytest.approx(0.0, abs=1e-9))
    whole, excess = removed(pressed(), share=0.5)
    assert excess == pytest.approx(whole / 2.0)
    whole, excess = removed(pressed(), share=0.0)
    assert excess == pytest.approx(whole)
    whole, excess = removed(pressed(force_n=24.0), share=1.0)
    assert 0.2 * whole < excess < 0.6 * whole


def test_nothing_before_the_first_wrong_moment_counts() -> None:
    plant = pressed()
    plant.pace.step(0.0, 0.0)
    plant.stand_until(0.5)
    plant.integrate(0.5)
    plant.mark_pit(0.5)
    plant.mark_pit(0.7)
    plant.stand_until(1.0)
    plant.integrate(math.inf)
    pit = plant.account.pit
    assert pit is not None
    reported = pit.report(plant.part)
    assert (reported["from_s"], reported["contact_s"]) == (0.5, pytest.approx(0.5))
    whole = float((plant.part.start_nm - plant.part.height_nm).max())
    assert reported["peak_nm"] == pytest.approx(whole / 2.0, rel=0.01)
    assert reported["part_nm"] == reported["peak_nm"], "the tool stands on the part"
    assert reported["planned_nm"] == pytest.approx(whole / 2.0, rel=0.01)
    row, column = np.unravel_index(int(pit.excess_nm.argmax()), pit.excess_nm.shape)
    assert reported["at_mm"] == [plant.part.grid.x_mm[column], plant.part.grid.y_mm[row]]


def pressed(force_n: float = 12.0) -> World:
    """A tool on the part that is to press 12 N."""
    plant = world(pose=(0.0, 0.0, 0.0, 15.0, 0.0))
    plant.force.push([(0.0, force_n)], math.inf)
    plant.set_point.step(0.0, 12.0)
    return plant


def removed(plant: World, share: float) -> tuple[float, float]:
    """nm at the deepest place of a second in one block, and beyond plan where that share of it was planned."""
    plant.mark_pit(0.0)
    plant.pace.step(0.0, share)
    edges = np.linspace(0.0, 1.0, 51)
    pose = np.tile(plant.pose, (50, 1))
    plant.move(np.column_stack([np.zeros(50), edges[:-1], edges[1:], np.diff(edges), pose]))
    plant.integrate(math.inf)
    assert plant.account.pit is not None
    whole = float((plant.part.start_nm - plant.part.height_nm).max())
    return whole, float(plant.account.pit.excess_nm.max())
