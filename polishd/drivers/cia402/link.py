"""One connection to a drive: its objects are read and written one at a time, its heartbeat is timed, ours is sent."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Any

from polishd.api import DeviceRefused, LinkError, ProtocolError
from polishd.drivers.cia402 import codec, objects
from polishd.drivers.cia402.codec import (
    Address,
    EmergencyMessage,
    NodeHeartbeat,
    NodeState,
    Request,
    SdoAborted,
    SdoAnswer,
    SdoValue,
)
from polishd.drivers.cia402.dictionary import Dictionary, abort_text
from polishd.drivers.transport.address import SlcanAddress, SocketcandAddress
from polishd.drivers.transport.background import Background, Ready
from polishd.drivers.transport.can_bus import CanBus, CanFrame, open_bus
from polishd.drivers.transport.can_nodes import NodesHeard
from polishd.drivers.transport.requests import RequestQueue

OPEN_S = 1.0
BOOT_S = 3.0
BEAT_S = 0.1
"""Period of both heartbeats, as long as the drive has no power."""


def free() -> None:
    """A write that nothing forbids."""


class CanopenConnection(Background):
    """From opening the bus to its end; never opened again.

    Answers bear the object's address, and a drive answers in order: the first request of a link is one that no other
    repeats, so that answers to an earlier link's requests are over when it is answered. A request that is not
    answered in time is the link's end: its answer could come later, and be taken for another's.
    """

    def __init__(
        self,
        address: SlcanAddress | SocketcandAddress,
        node: int,
        controller: int,
        dictionary: Dictionary,
        silence_s: float,
    ) -> None:
        """``silence_s`` without an answer, or without a heartbeat once these are asked for, is the link's end."""
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
        """The bus or we were away while the motor had no power: that has harmed nobody."""
        self.emergency: EmergencyMessage | None = None
        """What the drive last told of, until somebody has seen that it is over."""
        self.told = False
        """Settings have been written: a drive that starts anew has lost them, and the link ends."""
        self.driving = False
        """The motor has power, for all that is known: our heartbeats go out by ``beat`` only."""

    async def open(self) -> None:
        """Open the bus and see that a drive of CiA 402 answers. Changes nothing in it but that it is operational."""
        self._bus = await open_bus(self._address, self._node)
        try:
            await self.start(self._run, OPEN_S)
            await self._queue.start()
            self._send(codec.start_node(self._node))
            kind = await self.read(objects.DEVICE_TYPE)
            if kind & 0xFFFF != objects.PROFILE_402:
                raise DeviceRefused(f"{self.name}: is of CiA profile {kind & 0xFFFF}, no drive (402)")
        except BaseException:
            await self.close()
            raise

    async def time_heartbeats(self) -> None:
        """From now on the drive's heartbeats are waited for."""
        self._beat_at, self._timed = None, True
        if not await self.until(lambda: self._beat_at is not None, self._silence_s):
            raise LinkError(f"{self.name}: no heartbeat within {self._silence_s:g} s")

    async def reset_communication(self) -> None:
        """Let the drive boot as a node: it has forgotten its heartbeats then, but not what it moves."""
        self.told = self._timed = self._booted = False
        self._send(codec.reset_communication(self._node))
        if not await self.until(lambda: self._booted, BOOT_S):
            raise LinkError(f"{self.name}: no boot message within {BOOT_S:g} s")
        self._send(codec.start_node(self._node))

    async def close(self) -> None:
        """Leave the bus; idempotent."""
        await self._queue.stop()
        await self.stop()
        bus, self._bus = self._bus, None
        if bus is not None:
            await bus.close()

    def beat(self) -> None:
        """Tell the drive that somebody cares."""
        self.check()
        self._send(codec.heartbeat(self._controller))

    async def read(self, address: Address, *, urgent: bool = False) -> int:
        """The value of an object. ProtocolError where the drive has no such value."""
        answer = await self._queue.ask(lambda: self._exchange(Request(address)), urgent=urgent)
        if isinstance(answer, SdoValue):
            return self._dictionary.decode(address, answer.data, sized=answer.sized)
        raise ProtocolError(f"{self.name}: {self._refusal(answer)} when it was read")

    async def write(
        self, address: Address, value: int, *, urgent: bool = False, unless: Callable[[], None] = free
    ) -> None:
        """Write an object, once; ``unless`` may raise right before. DeviceRefused where the drive refuses."""
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
        """LinkError when an answer stayed out, and when the drive falls silent or starts anew."""
        while True:
            either: set[asyncio.Future[Any]] = {self.news(), self._broken}
            await asyncio.wait(either, timeout=BEAT_S, return_when=asyncio.FIRST_COMPLETED)
            if self._broken.done():
                raise LinkError(self._broken.result())
            if self._restarted:
                raise LinkError(f"{self.name}: the drive was started anew: it has forgotten what it was told")
            silent_s = time.monotonic() - (self._beat_at or time.monotonic())
            if self._timed and silent_s > self._silence_s:
                raise LinkError(f"{self.name}: no heartbeat for {self._silence_s:g} s")

    async def _beat_idly(self) -> None:
        while True:
            if not self.driving:
                self._send(codec.heartbeat(self._controller))
            await asyncio.sleep(BEAT_S)

    def _send(self, frame: CanFrame) -> None:
        if self._bus is not None:
            self._bus.send(frame)

    def _told(self, emergency: EmergencyMessage) -> None:
        """Keep what is worst. That it is over (00xx) is looked at where it matters, not believed."""
        if emergency.of_connection and not self.driving:
            self.silent_idly = True
        elif emergency.code >> 8 and (self.emergency is None or self.emergency.of_connection):
            self.emergency = emergency

    def _on_frame(self, frame: CanFrame) -> None:
        self._heard.add(frame)
        message = codec.decode(self._node, frame)
        if isinstance(message, NodeHeartbeat):
            self._booted = self._booted or message.state is NodeState.BOOT
            self._restarted = self._restarted or (self.told and message.state is NodeState.BOOT)
            self._beat_at = time.monotonic()
        elif isinstance(message, EmergencyMessage):
            self._told(message)
        elif message is not None and self._asked is not None:
            request, answer = self._asked
            if not request.answered_by(message) or answer.done():
                return
            self._answered = True
            answer.set_result(message)
        else:
            return
        self.fire()
