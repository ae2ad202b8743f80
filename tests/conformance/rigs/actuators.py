"""Force actuators."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from pathlib import Path

from polishd.api import ForceActuator
from polishd.drivers.profile_device import build
from polishd.drivers.transport.address import SerialLine, SlcanAddress, SocketcandAddress, Tcp
from polishd.model.devices import ActuatorTimes
from polishd.testing.device_rig import TestScope
from polishd.testing.suites.actuator import ActuatorRig
from tests.conformance.rigs.wired import cia402_drive, on_wire, stands
from tests.fakes import cia402
from tests.fakes.actuator import AsciiCoil, Coil, ModbusCoil
from tests.fakes.can_peers import SlcanPeer, SocketcandPeer
from tests.fakes.devices_by_profile import file_of, shipped, voice_coil_modbus, voice_coil_serial
from tests.fakes.profiled import IdealDrive, ProfiledPeer
from tests.fakes.wires import PtyWire, TcpWire, dribbled
from tests.selection import kind

TOUCHES = TestScope(touch_mm=5.0)
PATIENT = ActuatorTimes(silence_s=1.0, watchdog_s=2.0)
"""A busy machine is silent for longer than most wires would be."""


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


def _actuator(coil: Coil, wire: PtyWire | TcpWire, device: ForceActuator) -> AbstractAsyncContextManager[ActuatorRig]:
    return on_wire(wire, device, lambda: coil.state == 0, scope=TOUCHES)


@asynccontextmanager
async def actuator_line_drive(folder: Path) -> AsyncIterator[ActuatorRig]:
    """A profile of the user's own: plain lines, in which the set point alone lands the tool."""
    peer = ProfiledPeer(file_of("line_drive.toml"), IdealDrive)
    wire = PtyWire(peer, folder / "drive")
    device: ForceActuator = build.actuator(shipped("line_drive.toml"), SerialLine(wire.path), PATIENT)
    async with on_wire(wire, device, lambda: stands(peer, "retracted", "fault")) as rig:
        yield rig


@asynccontextmanager
async def cia402_actuator_spring(folder: Path) -> AsyncIterator[ActuatorRig]:
    """A drive of CiA 402 behind a serial adapter, in profile torque; a spring lifts."""
    drive, coil = cia402.sim_coil()
    wire = PtyWire(SlcanPeer(drive), folder / "slcan")
    device: ForceActuator = cia402.cia402_actuator(SlcanAddress(wire.path), PATIENT)
    async with cia402_drive(drive, wire, device, lambda: coil.position_mm <= 0.1) as rig:
        yield rig


@asynccontextmanager
async def cia402_actuator_position(_: Path) -> AsyncIterator[ActuatorRig]:
    """A drive of CiA 402 behind a socketcand server; profile position lifts."""
    drive, coil = cia402.sim_coil()
    wire = await TcpWire(SocketcandPeer(drive)).start()
    address = SocketcandAddress("127.0.0.1", wire.port, "can0")
    device: ForceActuator = cia402.cia402_actuator(address, PATIENT, lift="position")
    async with cia402_drive(drive, wire, device, lambda: coil.position_mm <= 0.1) as rig:
        yield rig


ACTUATORS = [
    *kind(actuator_rtu, actuator_tcp),
    *kind(actuator_ascii, actuator_ascii_dribbled),
    *kind(actuator_line_drive),
    *kind(cia402_actuator_spring, cia402_actuator_position),
]
