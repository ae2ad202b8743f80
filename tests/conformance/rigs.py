"""Every driver on every link, each against a peer that speaks the documented protocol over a real socket or terminal.

A rig for another peer (a simulator, a real machine) is another function here: the suites know nothing else of it.
"""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import TypeVar

from polishd.api import ForceActuator, ForceSensor, Loader, Monitor, MonitorTimes, SensorTimes, Spindle
from polishd.drivers.force_sensor_line import ForceSensorLine
from polishd.drivers.linuxcnc.driver import LinuxCnc
from polishd.drivers.loader_line import LoaderLine
from polishd.drivers.monitor_line import MonitorLine
from polishd.drivers.profiled import make
from polishd.drivers.robot_link import RobotLink
from polishd.drivers.spindle_can import SpindleCan
from polishd.drivers.transport.address import SerialLine, Slcan, Socketcand, Tcp
from polishd.drivers.universal_robots.driver import UniversalRobot
from polishd.drivers.universal_robots.sample import Registers
from polishd.drivers.universal_robots.script import Settings
from polishd.model.times import ActuatorTimes, LoaderTimes, RobotTimes, SpindleTimes
from polishd.testing.rig import D, Rig, Scope
from polishd.testing.suites.actuator import ActuatorRig
from polishd.testing.suites.force_sensor import ForceSensorRig
from polishd.testing.suites.loader import LoaderRig
from polishd.testing.suites.monitor import MonitorRig
from polishd.testing.suites.robot import RobotRig
from polishd.testing.suites.spindle import SpindleRig
from tests.fakes import cia402, handover
from tests.fakes.actuator import AsciiCoil, Coil, ModbusCoil
from tests.fakes.devices_by_profile import file_of, shipped, voice_coil_modbus, voice_coil_serial
from tests.fakes.drive import Drive, SlcanPeer, SocketcandPeer
from tests.fakes.linuxcnc import FakeLinuxCnc
from tests.fakes.loader import FakeLoader
from tests.fakes.looking import FakeAmplifier, FakeInputs
from tests.fakes.profiled import IdealDrive, ProfiledPeer, gauge, inverter
from tests.fakes.robot import FakeRobot
from tests.fakes.universal_robot import FakeController, urscript
from tests.fakes.wires import NumberedPeer, PtyWire, TcpWire, dribbled
from tests.kinds import kind

TOUCHES = Scope(touch_mm=5.0)
URSCRIPT = Scope(block=urscript)
PATIENT = ActuatorTimes(silence_s=1.0, watchdog_s=2.0)
PATIENT_SPINDLE = SpindleTimes(silence_s=1.5, watchdog_s=2.0)
PATIENT_ROBOT = RobotTimes(silence_s=1.0)
PATIENT_LOADER = LoaderTimes(silence_s=1.0)
PATIENT_SENSOR = SensorTimes(silence_s=1.0)
PATIENT_MONITOR = MonitorTimes(silence_s=1.0)
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
    device = LinuxCnc(Tcp("127.0.0.1", wire.port), folder)
    try:
        mute = lambda: setattr(fake, "silent", True)  # noqa: E731
        yield Rig(device, wire.cut, mute, lambda: fake.status != "RUNNING", whole_file=True)
    finally:
        await device.close()
        await wire.close()


@asynccontextmanager
async def universal_robots(_: Path) -> AsyncIterator[RobotRig]:
    """A Universal Robots controller over RTDE, dashboard and primary interface."""
    async with _universal_robots(FakeController()) as rig:
        yield rig


@asynccontextmanager
async def universal_robots_dribbled(_: Path) -> AsyncIterator[RobotRig]:
    """The same with RTDE byte by byte."""
    fake = FakeController()
    fake.filter = dribbled
    async with _universal_robots(fake) as rig:
        yield rig


@asynccontextmanager
async def _universal_robots(fake: FakeController) -> AsyncIterator[RobotRig]:
    await fake.start()
    device = UniversalRobot(fake.addresses, Settings(Registers(), PATIENT_ROBOT.watchdog_s), PATIENT_ROBOT)
    try:
        mute = lambda: setattr(fake, "silent", True)  # noqa: E731
        yield Rig(device, fake.cut, mute, lambda: fake.stands, whole_file=True, scope=URSCRIPT)
    finally:
        await device.close()
        await fake.close()


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
async def actuator_line_drive(folder: Path) -> AsyncIterator[ActuatorRig]:
    """A profile of the user's own: plain lines, in which the set point alone lands the tool."""
    peer = ProfiledPeer(file_of("line_drive.toml"), IdealDrive)
    wire = PtyWire(peer, folder / "drive")
    device = make.actuator(shipped("line_drive.toml"), SerialLine(wire.path), PATIENT)
    try:
        yield Rig(device, wire.cut, lambda: setattr(peer, "silent", True), lambda: _stands(peer, "retracted", "fault"))
    finally:
        await device.close()
        await wire.close()


@asynccontextmanager
async def _actuator(coil: Coil, wire: PtyWire | TcpWire, device: ForceActuator) -> AsyncIterator[ActuatorRig]:
    try:
        yield Rig(device, wire.cut, lambda: setattr(wire.peer, "silent", True), lambda: coil.state == 0, scope=TOUCHES)
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
async def spindle_ms300(folder: Path) -> AsyncIterator[SpindleRig]:
    """An inverter on Modbus RTU whose profile knows the fault of its watchdog."""
    peer = ProfiledPeer(file_of("delta_ms300"), inverter)
    async with _inverter("delta_ms300", peer, PtyWire(peer, folder / "drive")) as rig:
        yield rig


@asynccontextmanager
async def spindle_gs2(folder: Path) -> AsyncIterator[SpindleRig]:
    """An inverter on Modbus RTU whose faults are all a person's."""
    peer = ProfiledPeer(file_of("automationdirect_gs2"), inverter)
    async with _inverter("automationdirect_gs2", peer, PtyWire(peer, folder / "drive"), forgives=False) as rig:
        yield rig


@asynccontextmanager
async def spindle_wj200(_: Path) -> AsyncIterator[SpindleRig]:
    """An inverter of coils and of values of two words, behind a gateway to Modbus TCP."""
    peer = ProfiledPeer(file_of("hitachi_wj200"), inverter, tcp=True)
    async with _inverter("hitachi_wj200", peer, await TcpWire(peer).start(), forgives=False) as rig:
        yield rig


@asynccontextmanager
async def _inverter(
    name: str, peer: ProfiledPeer, wire: PtyWire | TcpWire, *, forgives: bool = True
) -> AsyncIterator[SpindleRig]:
    address = SerialLine(wire.path) if isinstance(wire, PtyWire) else Tcp("127.0.0.1", wire.port)
    device = make.spindle(shipped(name), address, PATIENT_SPINDLE)
    safe = lambda: _stands(peer, "stopped", "fault")  # noqa: E731
    try:
        yield Rig(device, wire.cut, lambda: setattr(peer, "silent", True), safe, scope=Scope(forgives=forgives))
    finally:
        await device.close()
        await wire.close()


def _stands(peer: ProfiledPeer, *states: str) -> bool:
    peer.step()
    return peer.machine.state() in states and peer.machine.values().get("speed", 0.0) == 0.0


@asynccontextmanager
async def _spindle(drive: Drive, wire: PtyWire | TcpWire, device: Spindle) -> AsyncIterator[SpindleRig]:
    try:
        yield Rig(device, wire.cut, lambda: setattr(wire.peer, "silent", True), lambda: drive.rpm == 0)
    finally:
        drive.stop()
        await device.close()
        await wire.close()


@asynccontextmanager
async def cia402_spindle_slcan(folder: Path) -> AsyncIterator[SpindleRig]:
    """A drive of CiA 402 behind a serial adapter, in profile velocity."""
    drive, motor = cia402.sim_motor()
    wire = PtyWire(SlcanPeer(drive), folder / "slcan")
    async with _cia402(drive, wire, cia402.cia402_spindle(Slcan(wire.path), PATIENT_SPINDLE)) as rig:
        rig.safe = lambda: motor.rpm == 0.0
        yield rig


@asynccontextmanager
async def cia402_spindle_socketcand(_: Path) -> AsyncIterator[SpindleRig]:
    """The same behind a socketcand server."""
    drive, motor = cia402.sim_motor()
    wire = await TcpWire(SocketcandPeer(drive)).start()
    address = Socketcand("127.0.0.1", wire.port, "can0")
    async with _cia402(drive, wire, cia402.cia402_spindle(address, PATIENT_SPINDLE)) as rig:
        rig.safe = lambda: motor.rpm == 0.0
        yield rig


@asynccontextmanager
async def cia402_actuator_spring(folder: Path) -> AsyncIterator[ActuatorRig]:
    """A drive of CiA 402 behind a serial adapter, in profile torque; a spring lifts."""
    drive, coil = cia402.sim_coil()
    wire = PtyWire(SlcanPeer(drive), folder / "slcan")
    async with _cia402(drive, wire, cia402.cia402_actuator(Slcan(wire.path), PATIENT)) as rig:
        rig.safe = lambda: coil.position_mm == 0.0
        yield rig


@asynccontextmanager
async def cia402_actuator_position(_: Path) -> AsyncIterator[ActuatorRig]:
    """The same behind a socketcand server; profile position lifts."""
    drive, coil = cia402.sim_coil()
    wire = await TcpWire(SocketcandPeer(drive)).start()
    address = Socketcand("127.0.0.1", wire.port, "can0")
    async with _cia402(drive, wire, cia402.cia402_actuator(address, PATIENT, lift="position")) as rig:
        rig.safe = lambda: coil.position_mm <= 0.1
        yield rig


@asynccontextmanager
async def _cia402(drive: cia402.SimDrive, wire: PtyWire | TcpWire, device: D) -> AsyncIterator[Rig[D]]:
    try:
        mute = lambda: setattr(wire.peer, "silent", True)  # noqa: E731
        yield Rig(device, wire.cut, mute, lambda: not drive.node.power.live)
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


@asynccontextmanager
async def force_sensor_serial(folder: Path) -> AsyncIterator[ForceSensorRig]:
    """force_sensor_line on a serial line."""
    wire = PtyWire(FakeAmplifier(), folder / "force_sensor")
    async with _looking(wire, ForceSensorLine(SerialLine(wire.path), PATIENT_SENSOR)) as rig:
        yield rig


@asynccontextmanager
async def force_sensor_laumas(_: Path) -> AsyncIterator[ForceSensorRig]:
    """A weight transmitter by its profile, behind a gateway to Modbus TCP."""
    async with _profiled_sensor("laumas_tlb") as rig:
        yield rig


@asynccontextmanager
async def force_sensor_gauge(_: Path) -> AsyncIterator[ForceSensorRig]:
    """A force gauge by its profile, on plain lines."""
    async with _profiled_sensor("mark10_series5") as rig:
        yield rig


@asynccontextmanager
async def _profiled_sensor(name: str) -> AsyncIterator[ForceSensorRig]:
    peer = ProfiledPeer(file_of(name), gauge(lambda: 3.0), tcp=True)
    wire = await TcpWire(peer).start()
    device = make.force_sensor(shipped(name), Tcp("127.0.0.1", wire.port), PATIENT_SENSOR)
    try:
        yield Rig(device, wire.cut, lambda: setattr(peer, "silent", True), lambda: True)
    finally:
        await device.close()
        await wire.close()


@asynccontextmanager
async def force_sensor_tcp_dribbled(_: Path) -> AsyncIterator[ForceSensorRig]:
    """force_sensor_line over TCP, byte by byte, with garbage before each answer."""
    wire = await TcpWire(_dribbling(FakeAmplifier())).start()
    async with _looking(wire, ForceSensorLine(Tcp("127.0.0.1", wire.port), PATIENT_SENSOR)) as rig:
        yield rig


@asynccontextmanager
async def monitor_tcp(_: Path) -> AsyncIterator[MonitorRig]:
    """monitor_line over TCP."""
    wire = await TcpWire(FakeInputs()).start()
    async with _looking(wire, MonitorLine(Tcp("127.0.0.1", wire.port), PATIENT_MONITOR)) as rig:
        yield rig


@asynccontextmanager
async def monitor_serial_dribbled(folder: Path) -> AsyncIterator[MonitorRig]:
    """monitor_line on a serial line, byte by byte, with garbage before each answer."""
    wire = PtyWire(_dribbling(FakeInputs()), folder / "monitor")
    async with _looking(wire, MonitorLine(SerialLine(wire.path), PATIENT_MONITOR)) as rig:
        yield rig


def _dribbling(fake: NumberedPeer) -> NumberedPeer:
    fake.filter = lambda data: [b"\xff*noise$", *dribbled(data)]
    return fake


L = TypeVar("L", ForceSensor, Monitor)


@asynccontextmanager
async def _looking(wire: PtyWire | TcpWire, device: L) -> AsyncIterator[Rig[L]]:
    """A device that exerts nothing is safe whatever happens."""
    try:
        yield Rig(device, wire.cut, lambda: setattr(wire.peer, "silent", True), lambda: True)
    finally:
        await device.close()
        await wire.close()


ROBOTS = [
    *kind(robot_tcp, robot_dribbled),
    *kind(linuxcnc, linuxcnc_dribbled),
    *kind(universal_robots, universal_robots_dribbled),
    *kind(handover_direct, handover_opcua, handover_ads),
]
ACTUATORS = [
    *kind(actuator_rtu, actuator_tcp),
    *kind(actuator_ascii, actuator_ascii_dribbled),
    *kind(actuator_line_drive),
    *kind(cia402_actuator_spring, cia402_actuator_position),
]
SPINDLES = [
    *kind(spindle_slcan, spindle_socketcand),
    *kind(cia402_spindle_slcan, cia402_spindle_socketcand),
    *kind(spindle_ms300, spindle_gs2, spindle_wj200),
]
LOADERS = kind(loader_serial, loader_tcp_dribbled)
FORCE_SENSORS = [*kind(force_sensor_serial, force_sensor_tcp_dribbled), *kind(force_sensor_laumas, force_sensor_gauge)]
MONITORS = kind(monitor_tcp, monitor_serial_dribbled)
