"""What every drive of CiA 402 has, whatever it moves: its settings, its power, its faults, and the way back to it."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass

from polishd.api import DeviceFault, DeviceIdentity, DeviceRefused, LinkError, ProtocolError
from polishd.drivers.cia402 import objects, states
from polishd.drivers.cia402.codec import Address, EmergencyMessage
from polishd.drivers.cia402.dictionary import Dictionary, emergency_text
from polishd.drivers.cia402.link import BEAT_S, CanopenConnection
from polishd.drivers.cia402.states import DriveState402
from polishd.drivers.transport.address import SlcanAddress, SocketcandAddress

POLL_S = 0.02
RESET_S = 0.5
GENERIC = 0x1000
"""Error code of a fault that the drive has no code for."""

_IDENTITY = (objects.VENDOR, objects.PRODUCT, objects.REVISION, objects.SERIAL)
_READ = (objects.VENDOR, objects.DEVICE_TYPE, objects.ERROR_REGISTER, objects.STATUS_WORD)
_WRITTEN = (objects.CONTROL_WORD, objects.MODE)

Unless = Callable[[], None]


@dataclass(frozen=True, slots=True)
class CanNodeAddress:
    """Where the drive is, and who we are."""

    bus: SlcanAddress | SocketcandAddress
    node: int
    controller: int
    """Node number of our own heartbeat; every driver on a bus has its own."""
    silence_s: float
    watchdog_s: float


class Cia402Drive:
    """A drive. A lost link stays lost until ``open``; only ``reach`` connects by itself."""

    def __init__(
        self,
        place: CanNodeAddress,
        dictionary: Dictionary,
        *,
        modes: tuple[int, ...],
        on_silence: int,
        settings: Mapping[Address, int],
        read: tuple[Address, ...],
        write: tuple[Address, ...],
    ) -> None:
        """``settings`` are written at ``open`` where they differ; ``read`` and ``write`` is what else is used.

        ConfigError where the EDS file does not have all of it. ``on_silence`` is what the drive does when it does not
        hear us: a value of 6007h.
        """
        watch = place.controller << 16 | round(1000 * place.watchdog_s)
        self._settings = {
            objects.PRODUCER_HEARTBEAT: round(1000 * BEAT_S),
            objects.QUICK_STOP_OPTION: objects.STOP_AND_DISABLE,
            objects.ABORT_CONNECTION: on_silence,
            objects.CONSUMER_HEARTBEAT: watch,
            **settings,
        }
        dictionary.require(read=(*_READ, *self._settings, *read), write=(*_WRITTEN, *self._settings, *write))
        self.dictionary = dictionary
        self.name = f"{place.bus} node {place.node}"
        self._place = place
        self._modes = modes
        self._orders = 0
        self._link: CanopenConnection | None = None
        self._opening = asyncio.Lock()
        """A serial adapter is open once only."""

    @property
    def link(self) -> CanopenConnection:
        """The open one; LinkError where there is none."""
        if self._link is None:
            raise LinkError(f"{self.name}: is not open")
        self._link.check()
        return self._link

    async def open(self, look: Callable[[CanopenConnection], Awaitable[None]]) -> None:
        """Connect; see that it is the drive of the EDS file; write and read back what it has to do in our absence.

        ``look`` is what else is to be read, and may refuse it.
        """
        async with self._opening:
            await self.close()
            link = self._new_link()
            await link.open()
            try:
                await self._recognise(link)
                await self._tell(link)
                await self.state(link)
                await look(link)
            except BaseException:
                await link.close()
                raise
            self._link = link

    async def close(self) -> None:
        """Idempotent."""
        link, self._link = self._link, None
        if link is not None:
            await link.close()

    async def identify(self) -> DeviceIdentity:
        """Vendor, product, serial number and revision are numbers of CiA 301; 0 where the drive has none."""
        link = self.link
        known = [address in self.dictionary and await link.read(address) for address in _IDENTITY]
        vendor, product, revision, serial = map(int, known)
        return DeviceIdentity(f"0x{vendor:08x}", f"0x{product:08x}", str(serial), f"0x{revision:08x}")

    def take_over(self) -> Unless:
        """A new order: what an earlier one would still write is refused from now on.

        What is returned raises DeviceRefused once there is a newer one.
        """
        self._orders += 1
        order = self._orders

        def overtaken() -> None:
            if self._orders != order:
                raise DeviceRefused(f"{self.name}: was commanded otherwise on the way")

        return overtaken

    async def reach(self, act: Callable[[CanopenConnection], Awaitable[None]]) -> None:
        """Do that on the open link; where there is none, or it is lost over it, on another one for this once."""
        if self._link is not None and self._link.alive:
            with contextlib.suppress(LinkError, ProtocolError):
                return await act(self._link)
        async with self._opening:
            if self._link is not None:
                await self._link.close()
            link = self._new_link()
            await link.open()
            try:
                await act(link)
            finally:
                await link.close()

    async def state(self, link: CanopenConnection, *, urgent: bool = False) -> DriveState402:
        """Of the power stage, by the drive's own word."""
        state = states.state_of(await link.read(objects.STATUS_WORD, urgent=urgent))
        link.driving = state.drives
        return state

    async def fault(self, link: CanopenConnection, state: DriveState402) -> EmergencyMessage | None:
        """What is wrong with it; None: nothing."""
        if state.failed and (link.emergency is None or link.emergency.of_connection):
            told = objects.ERROR_CODE in self.dictionary and await link.read(objects.ERROR_CODE)
            return EmergencyMessage(told or GENERIC, 0)
        return link.emergency

    async def require_sound(self, link: CanopenConnection, what: str) -> DriveState402:
        """The state; DeviceFault where something is wrong."""
        state = await self.state(link)
        if (fault := await self.fault(link, state)) is not None:
            raise DeviceFault(f"{self.name}: {what}: {describe(fault)}")
        return state

    async def wake(self, link: CanopenConnection) -> None:
        """Before it is switched on: end what silence has left behind while it had no power."""
        if link.silent_idly:
            link.silent_idly = False
            await self.reset(link)

    async def power_up(self, link: CanopenConnection, mode: int, unless: Unless, within_s: float) -> None:
        """To operation enabled, in that mode; its target is set before. Nothing where it is enabled already."""
        deadline = time.monotonic() + within_s
        state = await self.require_sound(link, "cannot be switched on")
        if state is DriveState402.ENABLED:
            return
        await link.write(objects.MODE, mode, unless=unless)
        for control, wanted in states.power_up(state):
            link.driving = link.driving or control == states.ENABLE
            await link.write(objects.CONTROL_WORD, control, unless=unless)
            while await self.require_sound(link, f"on the way to {wanted.value}") is not wanted:
                unless()
                if time.monotonic() > deadline:
                    raise DeviceFault(f"{self.name}: not {wanted.value} after {within_s:g} s")
                link.beat()
                await asyncio.sleep(POLL_S)

    async def reset(self, link: CanopenConnection) -> None:
        """End what a lost connection has left behind, and only that: other faults are a person's business."""
        state = await self.state(link)
        fault = await self.fault(link, state)
        if fault is None or not fault.of_connection:
            return
        if state is DriveState402.FAULT and not await self._reset_fault(link):
            await link.reset_communication()  # as some drives ask for, once they have missed a heartbeat
            await self._tell(link)
            await self._reset_fault(link)
        if not (await self.state(link)).failed and await self._clears(link, objects.ERROR_REGISTER, 0xFF):
            link.emergency = None

    async def _reset_fault(self, link: CanopenConnection) -> bool:
        """Whether it has left the fault over it."""
        await link.write(objects.CONTROL_WORD, states.DISABLE_VOLTAGE)
        await link.write(objects.CONTROL_WORD, states.FAULT_RESET)
        return await self._clears(link, objects.STATUS_WORD, states.FAULT_BIT)

    async def _clears(self, link: CanopenConnection, address: Address, bits: int) -> bool:
        """Whether these bits of an object are gone in a while."""
        deadline = time.monotonic() + RESET_S
        while await link.read(address) & bits:
            if time.monotonic() > deadline:
                return False
            await asyncio.sleep(POLL_S)
        return True

    async def _tell(self, link: CanopenConnection) -> None:
        """What it has to do in our absence, and how it is to ramp."""
        link.told = True
        for address, value in self._settings.items():
            await self._settle(link, address, value)
        await link.time_heartbeats()

    def _new_link(self) -> CanopenConnection:
        place = self._place
        return CanopenConnection(place.bus, place.node, place.controller, self.dictionary, place.silence_s)

    async def _recognise(self, link: CanopenConnection) -> None:
        for address, what in ((objects.VENDOR, "vendor"), (objects.PRODUCT, "product")):
            wanted = self.dictionary[address].default if address in self.dictionary else None
            if wanted and (found := await link.read(address)) != wanted:
                raise DeviceRefused(f"{self.name}: is {what} {found:#010x}, its EDS file is of {wanted:#010x}")
        if objects.SUPPORTED_MODES in self.dictionary:
            supported = await link.read(objects.SUPPORTED_MODES)
            for mode in self._modes:
                if not supported & 1 << mode - 1:
                    raise DeviceRefused(f"{self.name}: has no mode {mode} (6502h says {supported:#x})")

    async def _settle(self, link: CanopenConnection, address: Address, value: int) -> None:
        if await link.read(address) == value:
            return
        await link.write(address, value)
        if (found := await link.read(address)) != value:
            name = self.dictionary[address].name
            raise DeviceRefused(f"{self.name}: {address} ({name}) reads {found} after {value} was written to it")


def describe(fault: EmergencyMessage) -> str:
    """Code and text."""
    return f"{emergency_text(fault.code)} ({fault.code:04X}h)"
