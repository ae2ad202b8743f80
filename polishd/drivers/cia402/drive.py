"""Common base of CiA 402 drives: settings, power stage, faults, and reconnecting."""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from polishd.api import DeviceFault, DeviceIdentity, DeviceRefused, LinkError, ProtocolError
from polishd.drivers.cia402 import protocol
from polishd.drivers.cia402.protocol import (
    Address,
    Dictionary,
    DriveState402,
    EmergencyMessage,
    NodeHeartbeat,
    NodeState,
    Request,
    SdoAborted,
    SdoAnswer,
    SdoValue,
    abort_text,
    emergency_text,
)
from polishd.drivers.transport.address import SlcanAddress, SocketcandAddress
from polishd.drivers.transport.background import Background, Ready, RequestQueue
from polishd.drivers.transport.can_frames import CanFrame, NodesHeard

if TYPE_CHECKING:
    from polishd.drivers.transport.can_bus import CanBus

# Connection to a drive: one object request at a time; monitors its heartbeat and sends ours.

OPEN_S = 1.0
BOOT_S = 3.0
BEAT_S = 0.1
"""Period of both heartbeats while the power stage is off."""


def free() -> None:
    """Allow the write: the default of ``unless``."""


class CanopenConnection(Background):
    """Connection from opening the bus to its end; never reopened.

    Answers contain the object's address, and a drive answers in order. The first request of a link is unique: its
    answer shows that no answers to an earlier link's requests follow. A request without an answer in time ends the
    link, because a late answer could be taken for another's.
    """

    def __init__(
        self,
        address: SlcanAddress | SocketcandAddress,
        node: int,
        controller: int,
        dictionary: Dictionary,
        silence_s: float,
    ) -> None:
        """``silence_s`` without an answer, or without a heartbeat once they are monitored, ends the link."""
        super().__init__(f"{address} node {node}")
        self._address, self._node, self._controller = address, node, controller
        self._dictionary = dictionary
        self._silence_s = silence_s
        self._queue = RequestQueue(self.name)
        self._bus: CanBus | None = None
        self._heard = NodesHeard()
        self._asked: tuple[Request, asyncio.Future[SdoAnswer]] | None = None
        self._broken: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        self._beat_at: float | None = None
        self._timed = False
        self._booted = self._restarted = self._answered = False
        self.silent_idly = False
        """The bus or our heartbeat was lost while the motor had no power: this is harmless."""
        self.emergency: EmergencyMessage | None = None
        """Last fault that the drive reported, until a read shows that it is cleared."""
        self.is_configured = False
        """Settings have been written: a drive that restarts has lost them, and the link ends."""
        self.driving = False
        """The motor may have power: our heartbeats are sent by ``beat`` only."""

    async def open(self) -> None:
        """Open the bus and check that a CiA 402 drive answers. Only sets the drive operational."""
        from polishd.drivers.transport.can_bus import open_bus  # imports python-can, which is slow

        self._bus = await open_bus(self._address, self._node)
        try:
            await self.start(self._run, OPEN_S)
            await self._queue.start()
            self._send(protocol.start_node(self._node))
            kind = await self.read(protocol.DEVICE_TYPE)
            if kind & 0xFFFF != protocol.PROFILE_402:
                raise DeviceRefused(f"{self.name}: has CiA profile {kind & 0xFFFF}; a drive has 402")
        except BaseException:
            await self.close()
            raise

    async def time_heartbeats(self) -> None:
        """Monitor the drive's heartbeats from now on."""
        self._beat_at, self._timed = None, True
        if not await self.until(lambda: self._beat_at is not None, self._silence_s):
            raise LinkError(f"{self.name}: no heartbeat within {self._silence_s:g} s")

    async def reset_communication(self) -> None:
        """Reset the drive's communication: it forgets its heartbeats, but keeps its motion state."""
        self.is_configured = self._timed = self._booted = False
        self._send(protocol.reset_communication(self._node))
        if not await self.until(lambda: self._booted, BOOT_S):
            raise LinkError(f"{self.name}: no boot message within {BOOT_S:g} s")
        self._send(protocol.start_node(self._node))

    async def close(self) -> None:
        """Close the bus; idempotent."""
        await self._queue.stop()
        await self.stop()
        bus, self._bus = self._bus, None
        if bus is not None:
            await bus.close()

    def beat(self) -> None:
        """Send our heartbeat."""
        self.check()
        self._send(protocol.heartbeat(self._controller))

    async def read(self, address: Address, *, urgent: bool = False) -> int:
        """Read an object. ProtocolError if the drive has no such value."""
        answer = await self._queue.ask(lambda: self._exchange(Request(address)), urgent=urgent)
        if isinstance(answer, SdoValue):
            return self._dictionary.decode(address, answer.data, sized=answer.sized)
        raise ProtocolError(f"{self.name}: {self._refusal(answer)} when it was read")

    async def write(
        self, address: Address, value: int, *, urgent: bool = False, unless: Callable[[], None] = free
    ) -> None:
        """Write an object once; ``unless`` may raise right before. DeviceRefused if the drive refuses."""
        request = Request(address, self._dictionary.encode(address, value))

        async def work() -> SdoAnswer:
            unless()
            return await self._exchange(request)

        answer = await self._queue.ask(work, urgent=urgent)
        if isinstance(answer, SdoAborted):
            raise DeviceRefused(f"{self.name}: {self._refusal(answer)} when {value} was written")

    def _refusal(self, answer: SdoAnswer) -> str:
        code = answer.code if isinstance(answer, SdoAborted) else 0
        name = self._dictionary[answer.address].name
        return f"{answer.address} ({name}) was refused with {code:#010x}, {abort_text(code)},"

    async def _exchange(self, request: Request) -> SdoAnswer:
        self.check()
        answer: asyncio.Future[SdoAnswer] = asyncio.get_running_loop().create_future()
        self._asked = request, answer
        try:
            self._send(request.frame(self._node))
            return await self.result(answer, self._silence_s)
        except LinkError as error:
            broken = LinkError(f"{error} ({request.address} was asked for)")
            if not self._broken.done():
                self._broken.set_result(str(broken))
            raise broken from error
        finally:
            self._asked = None

    def _unanswered(self, within_s: float) -> str:
        said = super()._unanswered(within_s)
        return said if self._answered else f"{said}; {self._heard.without(self._node, self._address)}"

    async def _run(self, ready: Ready) -> None:
        if self._bus is None:
            return
        ready()
        async with asyncio.TaskGroup() as group:
            group.create_task(self._bus.receive(self._on_frame))
            group.create_task(self._watch())
            group.create_task(self._beat_idly())

    async def _watch(self) -> None:
        """Raise LinkError if an answer is missing, and if the drive falls silent or restarts."""
        while True:
            either: set[asyncio.Future[Any]] = {self.news(), self._broken}
            await asyncio.wait(either, timeout=BEAT_S, return_when=asyncio.FIRST_COMPLETED)
            if self._broken.done():
                raise LinkError(self._broken.result())
            if self._restarted:
                raise LinkError(f"{self.name}: the drive has restarted and lost its settings")
            silent_s = time.monotonic() - (self._beat_at or time.monotonic())
            if self._timed and silent_s > self._silence_s:
                raise LinkError(f"{self.name}: no heartbeat for {self._silence_s:g} s")

    async def _beat_idly(self) -> None:
        while True:
            if not self.driving:
                self._send(protocol.heartbeat(self._controller))
            await asyncio.sleep(BEAT_S)

    def _send(self, frame: CanFrame) -> None:
        if self._bus is not None:
            self._bus.send(frame)

    def _on_emergency(self, emergency: EmergencyMessage) -> None:
        """Keep the worst fault. An end of fault (00xx) is not trusted but read from the drive if it matters."""
        if emergency.of_connection and not self.driving:
            self.silent_idly = True
        elif emergency.code >> 8 and (self.emergency is None or self.emergency.of_connection):
            self.emergency = emergency

    def _on_frame(self, frame: CanFrame) -> None:
        self._heard.add(frame)
        message = protocol.decode(self._node, frame)
        if isinstance(message, NodeHeartbeat):
            self._booted = self._booted or message.state is NodeState.BOOT
            self._restarted = self._restarted or (self.is_configured and message.state is NodeState.BOOT)
            self._beat_at = time.monotonic()
        elif isinstance(message, EmergencyMessage):
            self._on_emergency(message)
        elif message is not None and self._asked is not None:
            request, answer = self._asked
            if not request.answered_by(message) or answer.done():
                return
            self._answered = True
            answer.set_result(message)
        else:
            return
        self.fire()


POLL_S = 0.02
RESET_S = 0.5
GENERIC = 0x1000
"""Error code of a fault without a code of the drive."""

_IDENTITY = (protocol.VENDOR, protocol.PRODUCT, protocol.REVISION, protocol.SERIAL)
_READ = (protocol.VENDOR, protocol.DEVICE_TYPE, protocol.ERROR_REGISTER, protocol.STATUS_WORD)
_WRITTEN = (protocol.CONTROL_WORD, protocol.MODE)

Unless = Callable[[], None]


@dataclass(frozen=True, slots=True)
class CanNodeAddress:
    """Bus and node number of the drive, and our node number."""

    bus: SlcanAddress | SocketcandAddress
    node: int
    controller: int
    """Node number of our heartbeat, unique for each driver on a bus."""
    silence_s: float
    watchdog_s: float


class Cia402Drive:
    """A CiA 402 drive. A lost link stays lost until ``open``; only ``reach`` reconnects."""

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
        """``open`` writes those ``settings`` that differ; ``read`` and ``write`` are the other objects that are used.

        ConfigError if the EDS file lacks one of them. ``on_silence`` is the drive's reaction to a lost heartbeat: a
        value of 6007h.
        """
        watch = place.controller << 16 | round(1000 * place.watchdog_s)
        self._settings = {
            protocol.PRODUCER_HEARTBEAT: round(1000 * BEAT_S),
            protocol.QUICK_STOP_OPTION: protocol.STOP_AND_DISABLE,
            protocol.ABORT_CONNECTION: on_silence,
            protocol.CONSUMER_HEARTBEAT: watch,
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
        """A serial adapter can be opened only once."""

    @property
    def link(self) -> CanopenConnection:
        """The open connection; LinkError if there is none."""
        if self._link is None:
            raise LinkError(f"{self.name}: is not open")
        self._link.check()
        return self._link

    async def open(self, look: Callable[[CanopenConnection], Awaitable[None]]) -> None:
        """Connect; check that it is the drive of the EDS file; write the reaction to a lost heartbeat and read it back.

        ``look`` makes further checks and may refuse the drive.
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
        """Vendor, product, serial number and revision are CiA 301 numbers; 0 if the drive has none."""
        link = self.link
        known = [address in self.dictionary and await link.read(address) for address in _IDENTITY]
        vendor, product, revision, serial = map(int, known)
        return DeviceIdentity(f"0x{vendor:08x}", f"0x{product:08x}", str(serial), f"0x{revision:08x}")

    def take_over(self) -> Unless:
        """Begin a new command: later writes of an earlier one are refused.

        The returned function raises DeviceRefused once there is a newer command.
        """
        self._orders += 1
        order = self._orders

        def overtaken() -> None:
            if self._orders != order:
                raise DeviceRefused(f"{self.name}: was replaced by a newer command")

        return overtaken

    async def reach(self, act: Callable[[CanopenConnection], Awaitable[None]]) -> None:
        """Run ``act`` on the open link; if there is none, or it is lost meanwhile, once on a temporary link."""
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
        """Read the state of the power stage."""
        state = protocol.state_of(await link.read(protocol.STATUS_WORD, urgent=urgent))
        link.driving = state.drives
        return state

    async def fault(self, link: CanopenConnection, state: DriveState402) -> EmergencyMessage | None:
        """Return the drive's fault, or None."""
        if state.failed and (link.emergency is None or link.emergency.of_connection):
            code = protocol.ERROR_CODE in self.dictionary and await link.read(protocol.ERROR_CODE)
            return EmergencyMessage(code or GENERIC, 0)
        return link.emergency

    async def require_sound(self, link: CanopenConnection, what: str) -> DriveState402:
        """Return the state; DeviceFault if the drive has a fault."""
        state = await self.state(link)
        if (fault := await self.fault(link, state)) is not None:
            raise DeviceFault(f"{self.name}: {what}: {describe(fault)}")
        return state

    async def wake(self, link: CanopenConnection) -> None:
        """Before power-up: reset what a lost heartbeat left while the drive had no power."""
        if link.silent_idly:
            link.silent_idly = False
            await self.reset(link)

    async def power_up(self, link: CanopenConnection, mode: int, unless: Unless, within_s: float) -> None:
        """Switch to operation enabled in that mode, after its target is set. No effect on an enabled drive."""
        deadline = time.monotonic() + within_s
        state = await self.require_sound(link, "cannot be switched on")
        if state is DriveState402.ENABLED:
            return
        await link.write(protocol.MODE, mode, unless=unless)
        for control, wanted in protocol.power_up(state):
            link.driving = link.driving or control == protocol.ENABLE
            await link.write(protocol.CONTROL_WORD, control, unless=unless)
            while await self.require_sound(link, f"on the way to {wanted.value}") is not wanted:
                unless()
                if time.monotonic() > deadline:
                    raise DeviceFault(f"{self.name}: not {wanted.value} after {within_s:g} s")
                link.beat()
                await asyncio.sleep(POLL_S)

    async def reset(self, link: CanopenConnection) -> None:
        """Reset the faults of a lost connection only: the operator resets other faults."""
        state = await self.state(link)
        fault = await self.fault(link, state)
        if fault is None or not fault.of_connection:
            return
        if state is DriveState402.FAULT and not await self._reset_fault(link):
            await link.reset_communication()  # some drives require this after a missed heartbeat
            await self._tell(link)
            await self._reset_fault(link)
        if not (await self.state(link)).failed and await self._clears(link, protocol.ERROR_REGISTER, 0xFF):
            link.emergency = None

    async def _reset_fault(self, link: CanopenConnection) -> bool:
        """Reset the fault; return whether the drive has left it."""
        await link.write(protocol.CONTROL_WORD, protocol.DISABLE_VOLTAGE)
        await link.write(protocol.CONTROL_WORD, protocol.FAULT_RESET)
        return await self._clears(link, protocol.STATUS_WORD, protocol.FAULT_BIT)

    async def _clears(self, link: CanopenConnection, address: Address, bits: int) -> bool:
        """Wait until these bits of an object are cleared; return whether they are."""
        deadline = time.monotonic() + RESET_S
        while await link.read(address) & bits:
            if time.monotonic() > deadline:
                return False
            await asyncio.sleep(POLL_S)
        return True

    async def _tell(self, link: CanopenConnection) -> None:
        """Write the reaction to a lost heartbeat, and the ramps."""
        link.is_configured = True
        for address, value in self._settings.items():
            await self._settle(link, address, value)
        await link.time_heartbeats()

    def _new_link(self) -> CanopenConnection:
        place = self._place
        return CanopenConnection(place.bus, place.node, place.controller, self.dictionary, place.silence_s)

    async def _recognise(self, link: CanopenConnection) -> None:
        for address, what in ((protocol.VENDOR, "vendor"), (protocol.PRODUCT, "product")):
            wanted = self.dictionary[address].default if address in self.dictionary else None
            if wanted and (found := await link.read(address)) != wanted:
                raise DeviceRefused(f"{self.name}: has {what} {found:#010x}, its EDS file has {wanted:#010x}")
        if protocol.SUPPORTED_MODES in self.dictionary:
            supported = await link.read(protocol.SUPPORTED_MODES)
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
    """Return code and text of a fault."""
    return f"{emergency_text(fault.code)} ({fault.code:04X}h)"
