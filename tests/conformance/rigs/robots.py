"""Robots."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

from polishd.api import Robot
from polishd.drivers.abb_rws.driver import AbbRobot
from polishd.drivers.fanuc_rmi.driver import FanucRmi
from polishd.drivers.linuxcnc.driver import LinuxCnc
from polishd.drivers.robot_link.driver import RobotLink
from polishd.drivers.transport.address import Tcp
from polishd.drivers.universal_robots.driver import UniversalRobot
from polishd.drivers.universal_robots.rtde import UrRegisters
from polishd.drivers.universal_robots.script import Settings
from polishd.model.devices import RobotTimes
from polishd.testing.device_rig import Rig, TestScope
from polishd.testing.suites.robot import RobotRig
from tests.conformance.rigs.wired import on_wire
from tests.fakes import plc_robot
from tests.fakes.abb_rws import FakeAbb, rapid_move
from tests.fakes.fanuc_rmi import FakeFanuc
from tests.fakes.kuka import FakeKuka, krl, kuka_robot
from tests.fakes.linuxcnc import FakeLinuxCnc
from tests.fakes.robot import FakeRobot
from tests.fakes.universal_robot import FakeController, urscript
from tests.fakes.wires import TcpWire, dribbled
from tests.selection import kind

TP = TestScope(block=lambda at: b"%4d:  WAIT   .02(sec) ;" % (at + 1))
URSCRIPT = TestScope(block=urscript)
RAPID = TestScope(block=rapid_move)
KRL = TestScope(block=krl)
PATIENT_ROBOT = RobotTimes(silence_s=1.0)
"""A busy machine is silent for longer than most wires would be."""


@asynccontextmanager
async def robot_tcp(_: Path) -> AsyncIterator[RobotRig]:
    """robot_link over TCP."""
    async with _robot(FakeRobot()) as rig:
        yield rig


@asynccontextmanager
async def robot_dribbled(_: Path) -> AsyncIterator[RobotRig]:
    """robot_link over TCP, byte by byte, with garbage between frames."""
    fake = FakeRobot()
    fake.outgoing = lambda kind, frame: [b"P", b"PL\0", *dribbled(frame)]
    async with _robot(fake) as rig:
        yield rig


@asynccontextmanager
async def _robot(fake: FakeRobot) -> AsyncIterator[RobotRig]:
    await fake.start()
    device = RobotLink(Tcp("127.0.0.1", fake.port))
    try:
        yield Rig(device, fake.cut, lambda: setattr(fake, "silent", True), lambda: fake.state != "running")
    finally:
        await device.close()
        await fake.close()


@asynccontextmanager
async def linuxcnc(folder: Path) -> AsyncIterator[RobotRig]:
    """LinuxCNC over linuxcncrsh."""
    async with _linuxcnc(FakeLinuxCnc(), folder) as rig:
        yield rig


@asynccontextmanager
async def linuxcnc_dribbled(folder: Path) -> AsyncIterator[RobotRig]:
    """LinuxCNC over linuxcncrsh, byte by byte, with garbage and blank lines between."""
    fake = FakeLinuxCnc()
    fake.filter = lambda data: [b"\r\n\xff*\r\n", *dribbled(data)]
    async with _linuxcnc(fake, folder) as rig:
        yield rig


@asynccontextmanager
async def _linuxcnc(fake: FakeLinuxCnc, folder: Path) -> AsyncIterator[RobotRig]:
    wire = await TcpWire(fake).start()
    device: Robot = LinuxCnc(Tcp("127.0.0.1", wire.port), folder)
    async with on_wire(wire, device, lambda: fake.status != "RUNNING", whole_file=True) as rig:
        yield rig


@asynccontextmanager
async def universal_robots(_: Path) -> AsyncIterator[RobotRig]:
    """A Universal Robots controller over RTDE, dashboard and primary interface."""
    async with _universal_robots(FakeController()) as rig:
        yield rig


@asynccontextmanager
async def universal_robots_dribbled(_: Path) -> AsyncIterator[RobotRig]:
    """A Universal Robots controller with RTDE byte by byte."""
    fake = FakeController()
    fake.filter = dribbled
    async with _universal_robots(fake) as rig:
        yield rig


@asynccontextmanager
async def _universal_robots(fake: FakeController) -> AsyncIterator[RobotRig]:
    await fake.start()
    device = UniversalRobot(fake.addresses, Settings(UrRegisters(), PATIENT_ROBOT.watchdog_s), PATIENT_ROBOT)
    try:
        mute = lambda: setattr(fake, "silent", True)  # noqa: E731
        yield Rig(device, fake.cut, mute, lambda: fake.stands, whole_file=True, scope=URSCRIPT)
    finally:
        await device.close()
        await fake.close()


@asynccontextmanager
async def fanuc_rmi(_: Path) -> AsyncIterator[RobotRig]:
    """A FANUC controller over the Remote Motion Interface."""
    async with _fanuc_rmi(FakeFanuc()) as rig:
        yield rig


@asynccontextmanager
async def kuka_kvp(folder: Path) -> AsyncIterator[RobotRig]:
    """A KUKA controller behind C3 Bridge."""
    async with _kuka_kvp(FakeKuka(folder)) as rig:
        yield rig


@asynccontextmanager
async def fanuc_rmi_dribbled(_: Path) -> AsyncIterator[RobotRig]:
    """A FANUC controller over RMI byte by byte, with blank lines between."""
    fake = FakeFanuc()
    fake.filter = lambda data: [b"\r\n", *dribbled(data)]
    async with _fanuc_rmi(fake) as rig:
        yield rig


@asynccontextmanager
async def kuka_kvp_dribbled(folder: Path) -> AsyncIterator[RobotRig]:
    """A KUKA controller with answers byte by byte."""
    fake = FakeKuka(folder)
    fake.filter = dribbled
    async with _kuka_kvp(fake) as rig:
        yield rig


@asynccontextmanager
async def _fanuc_rmi(fake: FakeFanuc) -> AsyncIterator[RobotRig]:
    await fake.start()
    device = FanucRmi(Tcp("127.0.0.1", fake.port), PATIENT_ROBOT)
    try:
        yield Rig(device, fake.cut, lambda: setattr(fake, "silent", True), lambda: fake.stands, scope=TP)
    finally:
        await device.close()
        await fake.close()


@asynccontextmanager
async def _kuka_kvp(fake: FakeKuka) -> AsyncIterator[RobotRig]:
    await fake.start()
    device = kuka_robot(fake)
    try:
        mute = lambda: setattr(fake, "silent", True)  # noqa: E731
        yield Rig(device, fake.cut, mute, lambda: fake.stands, whole_file=True, scope=KRL)
    finally:
        await device.close()
        await fake.close()


@asynccontextmanager
async def handover_direct(folder: Path) -> AsyncIterator[RobotRig]:
    """handover at the controller's variables themselves."""
    fake = plc_robot.FakePlc(folder)
    async with plc_robot.direct(fake) as device:
        yield Rig(device, fake.cut, lambda: setattr(fake, "silent", True), lambda: fake.stands, whole_file=True)


@asynccontextmanager
async def handover_opcua(folder: Path) -> AsyncIterator[RobotRig]:
    """PLC robot over OPC UA."""
    fake = plc_robot.FakePlc(folder)
    async with plc_robot.over_opcua(fake) as (device, relay):
        yield Rig(device, relay.cut, lambda: setattr(fake, "silent", True), lambda: fake.stands, whole_file=True)


@asynccontextmanager
async def handover_ads(folder: Path) -> AsyncIterator[RobotRig]:
    """PLC robot over ADS."""
    fake = plc_robot.FakePlc(folder)
    async with plc_robot.over_ads(fake) as (device, cut):
        yield Rig(device, cut, lambda: setattr(fake, "silent", True), lambda: fake.stands, whole_file=True)


@asynccontextmanager
async def abb_rws(folder: Path) -> AsyncIterator[RobotRig]:
    """An ABB controller over Robot Web Services 1.0, with a subscription."""
    async with _abb(FakeAbb(folder)) as rig:
        yield rig


@asynccontextmanager
async def abb_rws_polled(folder: Path) -> AsyncIterator[RobotRig]:
    """An ABB controller over Robot Web Services 1.0 without a subscription, byte by byte."""
    fake = FakeAbb(folder)
    fake.filter = dribbled
    async with _abb(fake, subscribes=False) as rig:
        yield rig


@asynccontextmanager
async def abb_rws_2(folder: Path) -> AsyncIterator[RobotRig]:
    """An ABB controller over Robot Web Services 2.0."""
    async with _abb(FakeAbb(folder, "2.0")) as rig:
        yield rig


@asynccontextmanager
async def _abb(fake: FakeAbb, *, subscribes: bool = True) -> AsyncIterator[RobotRig]:
    await fake.start()
    times = RobotTimes(silence_s=1.0, lifts=False)
    device = AbbRobot(fake.account, times, subscribes=subscribes)
    try:
        mute = lambda: setattr(fake, "silent", True)  # noqa: E731
        yield Rig(device, fake.cut, mute, lambda: fake.stands, whole_file=True, scope=RAPID)
    finally:
        await device.close()
        await fake.close()


ROBOTS = [
    *kind(robot_tcp, robot_dribbled),
    *kind(linuxcnc, linuxcnc_dribbled),
    *kind(universal_robots, universal_robots_dribbled),
    *kind(abb_rws, abb_rws_polled, abb_rws_2),
    *kind(fanuc_rmi, fanuc_rmi_dribbled),
    *kind(kuka_kvp, kuka_kvp_dribbled),
    *kind(handover_direct, handover_opcua, handover_ads),
]
