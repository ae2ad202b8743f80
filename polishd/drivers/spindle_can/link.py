"""One connection to the drive: its heartbeat is timed, its commands are repeated, its objects are read."""

from __future__ import annotations

import asyncio
import time

from polishd.api import DeviceFault, LinkError, ProtocolError
from polishd.drivers.spindle_can import codec
from polishd.drivers.spindle_can.codec import DriveObject, DriveStatus, Heartbeat, SdoAnswer
from polishd.drivers.transport.address import SlcanAddress, SocketcandAddress
from polishd.drivers.transport.background import Background, Ready
from polishd.drivers.transport.can_bus import CanBus, CanFrame, open_bus
from polishd.drivers.transport.can_nodes import NodesHeard

OPEN_S = 1.0
REPEAT_S = 0.1
LEASE_S = 1.0
"""So long after somebody last cared, commands are repeated no more."""
SDO_S = 3.0
"""For an object that is read. Whether the drive lives is told by its heartbeat, and sooner."""


class DriveLink(Background):
    """From opening the bus to its end; never opened again."""

    def __init__(self, address: SlcanAddress | SocketcandAddress, node: int, silence_s: float) -> None:
        """``silence_s`` of heartbeats, or of process data, is the link's end."""
        super().__init__(f"{address} node {node}")
        self._address = address
        self._node = node
        self._silence_s = silence_s
        self._sdo = asyncio.Lock()
        self._uploads: dict[DriveObject, asyncio.Future[SdoAnswer]] = {}
        self._bus: CanBus | None = None
        self._heard = NodesHeard()
        self._status: DriveStatus | None = None
        self._status_at = self._beat_at = -1.0
        self._beating = False
        self._restarted = False
        self._counter = self._first_counter = 0
        self._repeating = False
        self._lease_until = 0.0
        self.answered = False
        """The drive's last word is about the present command, not about an earlier one."""
        self.running = False
        """The last command was to run."""
        self.rpm = 0
        """Set point of the last command."""

    @property
    def status(self) -> DriveStatus:
        """The drive's last word; LinkError once the link is down."""
        self.check()
        if self._status is None:
            raise LinkError(f"{self.name}: has said nothing yet")
        return self._status

    async def open(self) -> None:
        """Open the bus and wait until the drive's heartbeat and process data are heard."""
        self._bus = await open_bus(self._address, self._node)
        try:
            await self.start(self._run, OPEN_S)
            # so that no answer to the last connection's commands is taken for one to ours
            self._counter = self.status.counter
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        """Leave the bus; idempotent."""
        await self.stop()
        bus, self._bus = self._bus, None
        if bus is not None:
            await bus.close()

    async def next_status(self) -> None:
        """Wait for the next process data."""
        heard = self._status_at
        await self.until(lambda: self._status_at != heard)

    def command(self, *, run: bool, rpm: int) -> None:
        """Command now, and again every 100 ms while somebody cares."""
        self.check()
        self.running, self.rpm = run, rpm
        self._repeating = True
        self.answered = False
        self._first_counter = (self._counter + 1) % 256
        self.renew_lease()
        self._send_command()

    def rest(self) -> None:
        """Repeat the command no more: the drive stands."""
        self._repeating = False

    def renew_lease(self) -> None:
        """Somebody cares."""
        self._lease_until = time.monotonic() + LEASE_S

    async def upload(self, what: DriveObject) -> int:
        """Read an object of the drive."""
        async with self._sdo:
            self.check()
            self._uploads[what] = asyncio.get_running_loop().create_future()
            try:
                self._send(codec.encode_upload(self._node, what))
                answer = await self.result(self._uploads[what], SDO_S)
            finally:
                self._uploads.pop(what).cancel()
        if answer.aborted:
            raise ProtocolError(
                f"{self.name}: object {what.index:#06x} sub {what.sub} aborted with {answer.value:#010x}"
            )
        return answer.value

    def _unanswered(self, within_s: float) -> str:
        said = super()._unanswered(within_s)
        heard = self._status is not None and self._beating
        return said if heard else f"{said}; {self._heard.without(self._node, self._address)}"

    async def _run(self, ready: Ready) -> None:
        if self._bus is None:
            return
        async with asyncio.TaskGroup() as group:
            group.create_task(self._bus.receive(self._on_frame))
            group.create_task(self._watch(ready))
            group.create_task(self._repeat())

    async def _watch(self, ready: Ready) -> None:
        """Ready once the drive is heard; LinkError when it falls silent, DeviceFault when it starts anew."""
        while not (self._status is not None and self._beating):
            await self.news()
        ready()
        while True:
            await asyncio.wait({self.news()}, timeout=self._silence_s / 4)
            if self._restarted:
                raise DeviceFault(f"{self.name}: the drive was started anew")
            for what, at in (("heartbeat", self._beat_at), ("process data", self._status_at)):
                if time.monotonic() > at + self._silence_s:
                    raise LinkError(f"{self.name}: no {what} for {self._silence_s:g} s")

    async def _repeat(self) -> None:
        while True:
            await asyncio.sleep(REPEAT_S)
            if self._repeating and time.monotonic() < self._lease_until:
                self._send_command()

    def _send_command(self) -> None:
        self._counter = (self._counter + 1) % 256
        self._send(codec.encode_command(self._node, run=self.running, counter=self._counter, rpm=self.rpm))

    def _send(self, frame: CanFrame) -> None:
        if self._bus is not None:
            self._bus.send(frame)

    def _on_frame(self, frame: CanFrame) -> None:
        self._heard.add(frame)
        message = codec.decode(self._node, frame)
        now = time.monotonic()
        if isinstance(message, DriveStatus):
            self._status, self._status_at = message, now
            since = (message.counter - self._first_counter) % 256
            self.answered = self.answered or since <= (self._counter - self._first_counter) % 256
        elif isinstance(message, Heartbeat):
            self._restarted = self._restarted or (message.boot and self._beating)
            self._beating, self._beat_at = True, now
        elif isinstance(message, SdoAnswer):
            waiting = self._uploads.get(message.what)
            if waiting is not None and not waiting.done():
                waiting.set_result(message)
        else:
            return
        self.fire()
