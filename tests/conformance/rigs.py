"""Every driver on every link, each against a peer that speaks the documented protocol over a real socket or terminal.

A rig for another peer (a simulator, a real machine) is another function here: the suites know nothing else of it.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

from polishd.api import ForceActuator, Loader, Robot, Spindle
from polishd.drivers.linuxcnc.driver import LinuxCnc
from polishd.drivers.loader_line import LoaderLine
from polishd.drivers.robot_link import RobotLink
from polishd.drivers.spindle_can import SpindleCan
from polishd.drivers.transport.address import SerialLine, Slcan, Socketcand, Tcp
from polishd.drivers.voice_coil import voice_coil_modbus, voice_coil_serial
from polishd.model.times import ActuatorTimes, LoaderTimes, SpindleTimes
from tests.fakes import handover
from tests.fakes.actuator import AsciiCoil, Coil, ModbusCoil
from tests.fakes.drive import Drive, SlcanPeer, SocketcandPeer
from tests.fakes.linuxcnc import FakeLinuxCnc
from tests.fakes.loader import FakeLoader
from tests.fakes.robot import FakeRobot
from tests.fakes.wires import PtyWire, TcpWire, dribbled
from tests.kinds import kind

D = TypeVar("D")
PATIENT = ActuatorTimes(silence_s=1.0, watchdog_s=2.0)
PATIENT_SPINDLE = SpindleTimes(silence_s=1.5, watchdog_s=2.0)
PATIENT_LOADER = LoaderTimes(silence_s=1.0)
"""A busy machine is silent for longer than the wires of actuators and spindles would be."""


@dataclass
class Rig(Generic[D]):
    """A device, and what may happen to it."""

    device: D
    cut: Callable[[], None]
    """Pull the plug for good."""
    mute: Callable[[], None]
    """The peer goes on living and says nothing more: a half-open link."""
    safe: Callable[[], bool]
    """The machine itself, not the driver: it exerts nothing and stands still."""
    whole_file: bool = False
    """A robot that takes its program in one piece: nobody waits for credit."""


RobotRig = Rig[Robot]
ActuatorRig = Rig[ForceActuator]
SpindleRig = Rig[Spindle]
LoaderRig = Rig[Loader]


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
    device = LinuxCnc(Tcp("127.0.0.1", wire.port), folder)
    try:
        mute = lambda: setattr(fake, "silent", True)  # noqa: E731
        yield Rig(device, wire.cut, mute, lambda: fake.status != "RUNNING", whole_file=True)
    finally:
        await device.close()
        await wire.close()


@asynccontextmanager
async def handover_direct(folder: Path) -> AsyncIterator[RobotRig]:
    """handover at the controller's variables themselves."""
    fake = handover.FakePlc(folder)
    async with handover.direct(fake) as device:
        yield Rig(device, fake.cut, lambda: setattr(fake, "silent", True), lambda: fake.stands, whole_file=True)


@asynccontextmanager
async def handover_opcua(folder: Path) -> AsyncIterator[RobotRig]:
    """handover over OPC UA."""
    fake = handover.FakePlc(folder)
    async with handover.over_opcua(fake) as (device, relay):
        yield Rig(device, relay.cut, lambda: setattr(fake, "silent", True), lambda: fake.stands, whole_file=True)


@asynccontextmanager
async def handover_ads(folder: Path) -> AsyncIterator[RobotRig]:
    """handover over ADS."""
    fake = handover.FakePlc(folder)
    async with handover.over_ads(fake) as (device, cut):
        yield Rig(device, cut, lambda: setattr(fake, "silent", True), lambda: fake.stands, whole_file=True)


@asynccontextmanager
async def actuator_rtu(folder: Path) -> AsyncIterator[ActuatorRig]:
    """voice_coil_modbus on a serial line."""
    coil = Coil()
    wire = PtyWire(ModbusCoil(coil, rtu=True), folder / "rtu")
    async with _actuator(coil, wire, voice_coil_modbus(SerialLine(wire.path), PATIENT)) as rig:
        yield rig


@asynccontextmanager
async def actuator_tcp(_: Path) -> AsyncIterator[ActuatorRig]:
    """voice_coil_modbus on TCP."""
    coil = Coil()
    wire = await TcpWire(ModbusCoil(coil, rtu=False)).start()
    async with _actuator(coil, wire, voice_coil_modbus(Tcp("127.0.0.1", wire.port), PATIENT)) as rig:
        yield rig


@asynccontextmanager
async def actuator_ascii(folder: Path) -> AsyncIterator[ActuatorRig]:
    """voice_coil_serial on a serial line."""
    coil = Coil()
    wire = PtyWire(AsciiCoil(coil), folder / "ascii")
    async with _actuator(coil, wire, voice_coil_serial(SerialLine(wire.path), PATIENT)) as rig:
        yield rig


@asynccontextmanager
async def actuator_ascii_dribbled(folder: Path) -> AsyncIterator[ActuatorRig]:
    """voice_coil_serial on a serial line, byte by byte, with garbage before each answer."""
    coil = Coil()
    wire = PtyWire(AsciiCoil(coil), folder / "ascii")
    wire.peer.filter = lambda data: [b"\xff*noise$", *dribbled(data)]
    async with _actuator(coil, wire, voice_coil_serial(SerialLine(wire.path), PATIENT)) as rig:
        yield rig


@asynccontextmanager
async def _actuator(coil: Coil, wire: PtyWire | TcpWire, device: ForceActuator) -> AsyncIterator[ActuatorRig]:
    try:
        yield Rig(device, wire.cut, lambda: setattr(wire.peer, "silent", True), lambda: coil.state == 0)
    finally:
        await device.close()
        await wire.close()


@asynccontextmanager
async def spindle_slcan(folder: Path) -> AsyncIterator[SpindleRig]:
    """spindle_can behind a serial adapter."""
    drive = Drive()
    wire = PtyWire(SlcanPeer(drive), folder / "slcan")
    async with _spindle(drive, wire, SpindleCan(Slcan(wire.path), PATIENT_SPINDLE)) as rig:
        yield rig


@asynccontextmanager
async def spindle_socketcand(_: Path) -> AsyncIterator[SpindleRig]:
    """spindle_can behind a socketcand server."""
    drive = Drive()
    wire = await TcpWire(SocketcandPeer(drive)).start()
    async with _spindle(drive, wire, SpindleCan(Socketcand("127.0.0.1", wire.port, "can0"), PATIENT_SPINDLE)) as rig:
        yield rig


@asynccontextmanager
async def _spindle(drive: Drive, wire: PtyWire | TcpWire, device: Spindle) -> AsyncIterator[SpindleRig]:
    try:
        yield Rig(device, wire.cut, lambda: setattr(wire.peer, "silent", True), lambda: drive.rpm == 0)
    finally:
        drive.stop()
        await device.close()
        await wire.close()


@asynccontextmanager
async def loader_serial(folder: Path) -> AsyncIterator[LoaderRig]:
    """loader_line on a serial line."""
    fake = FakeLoader()
    wire = PtyWire(fake, folder / "loader")
    async with _loader(fake, wire, LoaderLine(SerialLine(wire.path), PATIENT_LOADER)) as rig:
        yield rig


@asynccontextmanager
async def loader_tcp_dribbled(_: Path) -> AsyncIterator[LoaderRig]:
    """loader_line over TCP, byte by byte, with garbage before each answer."""
    fake = FakeLoader()
    fake.filter = lambda data: [b"\xff*noise$", *dribbled(data)]
    wire = await TcpWire(fake).start()
    async with _loader(fake, wire, LoaderLine(Tcp("127.0.0.1", wire.port), PATIENT_LOADER)) as rig:
        yield rig


@asynccontextmanager
async def _loader(fake: FakeLoader, wire: PtyWire | TcpWire, device: Loader) -> AsyncIterator[LoaderRig]:
    try:
        yield Rig(device, wire.cut, lambda: setattr(fake, "silent", True), lambda: fake.state != 1)
    finally:
        await device.close()
        await wire.close()


ROBOTS = [
    *kind(robot_tcp, robot_dribbled),
    *kind(linuxcnc, linuxcnc_dribbled),
    *kind(handover_direct, handover_opcua, handover_ads),
]
ACTUATORS = [*kind(actuator_rtu, actuator_tcp), *kind(actuator_ascii, actuator_ascii_dribbled)]
SPINDLES = kind(spindle_slcan, spindle_socketcand)
LOADERS = kind(loader_serial, loader_tcp_dribbled)
