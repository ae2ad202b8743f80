"""Devices that only look: force sensors and monitors."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from pathlib import Path
from typing import TypeVar

from polishd.api import ForceSensor, Monitor, MonitorTimes, SensorTimes
from polishd.drivers.monitor_line import MonitorLine
from polishd.drivers.profile_device import build
from polishd.drivers.transport.address import SerialLine, Tcp
from polishd.testing.device_rig import Rig
from polishd.testing.suites.force_sensor import ForceSensorRig
from polishd.testing.suites.monitor import MonitorRig
from tests.conformance.rigs.wired import on_wire
from tests.fakes.devices_by_profile import file_of, shipped
from tests.fakes.profiled import ProfiledPeer, gauge
from tests.fakes.sensors_and_monitors import FakeAmplifier, FakeInputs
from tests.fakes.wires import NumberedPeer, PtyWire, TcpWire, dribbled
from tests.selection import kind

PATIENT_SENSOR = SensorTimes(silence_s=1.0)
PATIENT_MONITOR = MonitorTimes(silence_s=1.0)
"""A busy machine is silent for longer than most wires would be."""
L = TypeVar("L", ForceSensor, Monitor)


def _line_sensor(address: SerialLine | Tcp) -> ForceSensor:
    return build.force_sensor(shipped("force_sensor_line"), address, PATIENT_SENSOR)


@asynccontextmanager
async def force_sensor_serial(folder: Path) -> AsyncIterator[ForceSensorRig]:
    """The profile force_sensor_line on a serial line."""
    wire = PtyWire(FakeAmplifier(), folder / "force_sensor")
    async with _looking(wire, _line_sensor(SerialLine(wire.path))) as rig:
        yield rig


@asynccontextmanager
async def force_sensor_tcp_dribbled(_: Path) -> AsyncIterator[ForceSensorRig]:
    """The profile force_sensor_line over TCP, byte by byte, with garbage before each answer."""
    wire = await TcpWire(_dribbling(FakeAmplifier())).start()
    async with _looking(wire, _line_sensor(Tcp("127.0.0.1", wire.port))) as rig:
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
    wire = await TcpWire(ProfiledPeer(file_of(name), gauge(lambda: 3.0), tcp=True)).start()
    device = build.force_sensor(shipped(name), Tcp("127.0.0.1", wire.port), PATIENT_SENSOR)
    async with _looking(wire, device) as rig:
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


def _looking(wire: PtyWire | TcpWire, device: L) -> AbstractAsyncContextManager[Rig[L]]:
    """A device that exerts nothing is safe whatever happens."""
    return on_wire(wire, device, lambda: True)


def _dribbling(fake: NumberedPeer) -> NumberedPeer:
    fake.filter = lambda data: [b"\xff*noise$", *dribbled(data)]
    return fake


FORCE_SENSORS = [*kind(force_sensor_serial, force_sensor_tcp_dribbled), *kind(force_sensor_laumas, force_sensor_gauge)]
MONITORS = kind(monitor_tcp, monitor_serial_dribbled)
