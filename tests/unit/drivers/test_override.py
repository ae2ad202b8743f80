"""Each robot's driver reports the speed override of its controller, as a fraction, and how old its reports may be."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path

import pytest

from polishd.api import ProtocolError
from polishd.config.controller_profile import load_controller_profile
from polishd.drivers.linuxcnc.driver import LinuxCnc
from polishd.drivers.linuxcnc.protocol import override_of
from polishd.drivers.plc_robot.driver import times_of
from polishd.drivers.robot_link import protocol
from polishd.drivers.transport.address import Tcp
from polishd.drivers.universal_robots.rtde import RtdeSample, UrRegisters, UrRuntimeState
from polishd.model.devices import RobotTimes
from polishd.sim_backends.universal_robots import device as ur_device
from tests.fakes.linuxcnc import FakeLinuxCnc
from tests.fakes.plc_robot import PROFILE, FakePlc, direct
from tests.fakes.wires import TcpWire
from tests.programs import plan_of

STATUS = {"state": "running", "accepted": 3, "executed": 1, "stops": 0, "buffer_s": 0.5}


@pytest.mark.parametrize(("value", "reported"), [(0, 0.0), (0.5, 0.5), (1, 1.0), (1.2, 1.2), (None, None)])
def test_the_robot_link_may_report_it(value: float | None, reported: float | None) -> None:
    assert protocol.status(json.dumps({**STATUS, "override": value}).encode()).override == reported


def test_a_robot_link_of_before_reports_none() -> None:
    assert protocol.status(json.dumps({**STATUS, "unheard_of": [1]}).encode()).override is None


@pytest.mark.parametrize("value", ["-0.1", "11", "1e400", "NaN", '"1"', "true", "[]", "1" + "0" * 400])
def test_a_robot_link_that_reports_no_fraction_is_not_believed(value: str) -> None:
    status = json.dumps({**STATUS, "override": 0})[:-2] + value + "}"
    with pytest.raises(ProtocolError, match="override"):
        protocol.status(status.encode())


@pytest.mark.parametrize(("value", "reported"), [("100", 1.0), ("0", 0.0), ("50", 0.5), ("120", 1.2)])
def test_linuxcnc_reports_percent(value: str, reported: float) -> None:
    assert override_of(value) == reported


@pytest.mark.parametrize("value", ["-1", "nan", "", "1 2", "5000", "fifty"])
def test_a_linuxcnc_that_reports_no_percent_is_not_believed(value: str) -> None:
    with pytest.raises(ProtocolError, match="linuxcncrsh"):
        override_of(value)


async def test_the_linuxcnc_driver_reports_it_with_a_program_and_without(tmp_path: Path) -> None:
    fake = FakeLinuxCnc()
    fake.feed_override = 50
    wire = await TcpWire(fake).start()
    robot = LinuxCnc(Tcp("127.0.0.1", wire.port), tmp_path)
    await robot.open()
    assert (await robot.progress()).override == 0.5
    await robot.prepare(plan_of([b"G1 X1 F60"]))
    fake.feed_override = 120
    while (await robot.progress()).override == 0.5:  # noqa: ASYNC110 -- the port has only progress
        await asyncio.sleep(0.005)
    assert (await robot.progress()).override == 1.2
    await robot.close()
    await wire.close()


def sample(**values: float) -> RtdeSample:
    names = ("timestamp", "runtime_state", "robot_mode", "safety_mode", "target_speed_fraction", "speed_scaling")
    usual = dict(zip(names, (1.0, UrRuntimeState.PLAYING, 7, 1, 1.0, 1.0), strict=True))
    outputs = {name: (float(values.get(name, value)),) for name, value in usual.items()}
    registers = dict.fromkeys(UrRegisters().outputs(), (0.0,))
    return RtdeSample.of({**outputs, **registers, "target_TCP_speed": (0.0,) * 6}, UrRegisters())


def test_universal_robots_reports_slider_times_scaling_and_the_slider_alone_at_rest() -> None:
    assert sample().override == 1.0
    assert sample(target_speed_fraction=0.5, speed_scaling=0.5).override == 0.25
    assert sample(target_speed_fraction=0.5, speed_scaling=0.0, runtime_state=UrRuntimeState.STOPPED).override == 0.5
    assert {"target_speed_fraction", "speed_scaling"} <= ur_device.OUTPUTS.keys()


@pytest.mark.parametrize("scaling", [-0.1, 1.5, float("nan"), float("inf")])
def test_a_scaling_that_cannot_be_is_not_believed(scaling: float) -> None:
    with pytest.raises(ProtocolError, match="speed_scaling"):
        sample(speed_scaling=scaling)


async def test_a_controller_reports_it_where_its_profile_names_the_variable(tmp_path: Path) -> None:
    fake = FakePlc(tmp_path)
    fake.override = 60.0
    async with direct(fake) as robot:
        await robot.open()
        assert (await robot.progress()).override == 0.6
    unnamed = PROFILE.variables.model_copy(update={"feed_override": None})
    async with direct(fake, PROFILE.model_copy(update={"variables": unnamed})) as robot:
        await robot.open()
        assert (await robot.progress()).override is None


def test_a_report_is_as_old_as_it_is_renewed_looked_at_and_under_way() -> None:
    profile = load_controller_profile("plc-opcua", Path())
    assert times_of(profile).report_s == pytest.approx(0.05), "20 + 10 + 20 ms"
    assert times_of(load_controller_profile("sinumerik-opcua", Path())).report_s > 0.1
    assert RobotTimes().report_s == 0.1
