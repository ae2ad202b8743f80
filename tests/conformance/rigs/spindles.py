"""Spindles."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from pathlib import Path

from polishd.api import Spindle
from polishd.drivers.profile_device import build
from polishd.drivers.transport.address import SerialLine, SlcanAddress, SocketcandAddress, Tcp
from polishd.model.devices import SpindleTimes
from polishd.testing.device_rig import TestScope
from polishd.testing.suites.spindle import SpindleRig
from tests.conformance.rigs.wired import cia402_drive, on_wire, stands
from tests.fakes import cia402
from tests.fakes.can_peers import SlcanPeer, SocketcandPeer
from tests.fakes.devices_by_profile import file_of, shipped
from tests.fakes.profiled import ProfiledPeer, inverter
from tests.fakes.wires import PtyWire, TcpWire
from tests.selection import kind

PATIENT_SPINDLE = SpindleTimes(silence_s=1.5, watchdog_s=2.0)
"""A busy machine is silent for longer than most wires would be."""


@asynccontextmanager
async def cia402_spindle_slcan(folder: Path) -> AsyncIterator[SpindleRig]:
    """A drive of CiA 402 behind a serial adapter, in profile velocity."""
    drive, motor = cia402.sim_motor()
    wire = PtyWire(SlcanPeer(drive), folder / "slcan")
    device: Spindle = cia402.cia402_spindle(SlcanAddress(wire.path), PATIENT_SPINDLE)
    async with cia402_drive(drive, wire, device, lambda: motor.rpm == 0.0) as rig:
        yield rig


@asynccontextmanager
async def cia402_spindle_socketcand(_: Path) -> AsyncIterator[SpindleRig]:
    """A drive of CiA 402 behind a socketcand server."""
    drive, motor = cia402.sim_motor()
    wire = await TcpWire(SocketcandPeer(drive)).start()
    address = SocketcandAddress("127.0.0.1", wire.port, "can0")
    device: Spindle = cia402.cia402_spindle(address, PATIENT_SPINDLE)
    async with cia402_drive(drive, wire, device, lambda: motor.rpm == 0.0) as rig:
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


def _inverter(
    name: str, peer: ProfiledPeer, wire: PtyWire | TcpWire, *, forgives: bool = True
) -> AbstractAsyncContextManager[SpindleRig]:
    address = SerialLine(wire.path) if isinstance(wire, PtyWire) else Tcp("127.0.0.1", wire.port)
    device = build.spindle(shipped(name), address, PATIENT_SPINDLE)
    return on_wire(wire, device, lambda: stands(peer, "stopped", "fault"), scope=TestScope(forgives=forgives))


SPINDLES = [
    *kind(cia402_spindle_slcan, cia402_spindle_socketcand),
    *kind(spindle_ms300, spindle_gs2, spindle_wj200),
]
