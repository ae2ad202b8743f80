"""A device on a wire whose far end is a peer of ours."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import TypeVar

from polishd.api import Device
from polishd.testing.device_rig import USUAL, Rig, TestScope
from tests.fakes import cia402
from tests.fakes.profiled import ProfiledPeer
from tests.fakes.wires import PtyWire, TcpWire

D = TypeVar("D", bound=Device)


@asynccontextmanager
async def on_wire(
    wire: PtyWire | TcpWire, device: D, safe: Callable[[], bool], *, whole_file: bool = False, scope: TestScope = USUAL
) -> AsyncIterator[Rig[D]]:
    """The rig; device and wire are closed with it."""
    try:
        mute = lambda: setattr(wire.peer, "silent", True)  # noqa: E731
        yield Rig(device, wire.cut, mute, safe, whole_file=whole_file, scope=scope)
    finally:
        await device.close()
        await wire.close()


@asynccontextmanager
async def cia402_drive(
    drive: cia402.SimDrive, wire: PtyWire | TcpWire, device: D, safe: Callable[[], bool]
) -> AsyncIterator[Rig[D]]:
    """A drive of CiA 402, which ends with its rig."""
    try:
        async with on_wire(wire, device, safe) as rig:
            yield rig
    finally:
        drive.stop()


def stands(peer: ProfiledPeer, *states: str) -> bool:
    """A machine by its profile is in one of those states, and turns nothing."""
    peer.step()
    return peer.machine.state() in states and peer.machine.values().get("speed", 0.0) == 0.0
