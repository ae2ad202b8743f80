"""Every driver on every link, each against a peer that speaks the documented protocol over a real socket or terminal.

A rig for another peer (a simulator, a real machine) is another function here: the suites know nothing else of it.
"""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

from polishd.api import ForceActuator, Loader, Spindle
from polishd.drivers.linuxcnc.driver import LinuxCnc
from polishd.drivers.loader_line import LoaderLine
from polishd.drivers.profiled import make
from polishd.drivers.robot_link import RobotLink
from polishd.drivers.spindle_can import SpindleCan
from polishd.drivers.transport.address import SerialLine, Slcan, Socketcand, Tcp
from polishd.model.times import ActuatorTimes, LoaderTimes, SpindleTimes
from polishd.testing.rig import D, Rig, Scope
from polishd.testing.suites.actuator import ActuatorRig
from polishd.testing.suites.loader import LoaderRig
from polishd.testing.suites.robot import RobotRig
from polishd.testing.suites.spindle import SpindleRig
from tests.fakes import cia402
from tests.fakes.actuator import AsciiCoil, Coil, ModbusCoil
from tests.fakes.devices_by_profile import file_of, shipped, voice_coil_modbus, voice_coil_serial
from tests.fakes.drive import Drive, SlcanPeer, SocketcandPeer
from tests.fakes.linuxcnc import FakeLinuxCnc
from tests.fakes.loader import FakeLoader
from tests.fakes.profiled import IdealDrive, ProfiledPeer, inverter
from tests.fakes.robot import FakeRobot
from tests.fakes.wires import PtyWire, TcpWire, dribbled
from tests.kinds import kind

TOUCHES = Scope(touch_mm=5.0)
PATIENT = ActuatorTimes(silence_s=1.0, watchdog_s=2.0)
PATIENT_SPINDLE = SpindleTimes(silence_s=1.5, watchdog_s=2.0)
PATIENT_LOADER = LoaderTimes(silence_s=1.0)
"""A busy machine is silent for longer than the wires of actuators and spindles would be."""


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


ROBOTS = [*kind(robot_tcp, robot_dribbled), *kind(linuxcnc, linuxcnc_dribbled)]
ACTUATORS = [*kind(actuator_rtu, actuator_tcp), *kind(actuator_ascii, actuator_ascii_dribbled)]
ACTUATORS += [*kind(cia402_actuator_spring, cia402_actuator_position), *kind(actuator_line_drive)]
SPINDLES = [*kind(spindle_slcan, spindle_socketcand), *kind(cia402_spindle_slcan, cia402_spindle_socketcand)]
SPINDLES += kind(spindle_ms300, spindle_gs2, spindle_wj200)
LOADERS = kind(loader_serial, loader_tcp_dribbled)
