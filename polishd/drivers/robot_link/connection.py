"""One connection to the robot: reader, heartbeat, and answers matched to commands."""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any, Literal

from polishd.api import (
    ByteStream,
    DeviceBusy,
    DeviceError,
    DeviceRefused,
    LinkError,
    ProtocolError,
    RobotTimes,
    Segment,
)
from polishd.drivers.robot_link.frames import FrameType, encode
from polishd.drivers.robot_link.messages import PROTOCOL, Ack, Nak, RobotLinkStatus, Welcome, command
from polishd.drivers.robot_link.session import ExecutionRecord, RobotLinkSession
from polishd.drivers.transport.address import Tcp
from polishd.drivers.transport.background import Background, Ready
from polishd.drivers.transport.streams import open_stream

SILENCE_SHARE = 0.4
"""Of the robot's own watchdog time: at most so long may it be silent, since it hears as little of us then."""
PING_S = 0.2
CONNECT_S = 1.0
ANSWER_S = 1.0
RESEND_S = 0.5
"""A robot takes blocks within its window at once; so long without is a lost frame."""
RESENDS = 3

Role = Literal["writer", "reader"]


class RobotLinkConnection(Background):
    """From HELLO to the end of the link; never opened again. Whoever waits hears of its end by LinkError."""

    def __init__(self, address: Tcp, role: Role, record: ExecutionRecord | None, times: RobotTimes) -> None:
        super().__init__(str(address))
        self.session = RobotLinkSession(record)
        self._times = times
        self._address = address
        self._role = role
        self._silence_s = CONNECT_S
        self._stream: ByteStream | None = None
        self._pending: dict[int, deque[asyncio.Future[Ack]]] = {}

    @property
    def welcome(self) -> Welcome:
        """What the robot said first."""
        if self.session.welcome is None:
            raise LinkError(f"{self._address}: is not open")
        return self.session.welcome

    @property
    def progress(self) -> RobotLinkStatus:
        """The robot's last word; LinkError once the link is down."""
        self.check()
        return self.session.present()

    async def open(self, client: str, lease: str = "") -> None:
        """Connect and be welcomed; DeviceBusy where another writer has it, DeviceRefused: too short a watchdog."""
        self._stream = await open_stream(self._address, CONNECT_S)
        try:
            hello = {
                "protocol": PROTOCOL,
                "role": self._role,
                "client": client,
                "executed_from": self.session.executed_from,
                "lease": lease,
            }
            await self._stream.write(command(FrameType.HELLO, hello))
            await self.start(self._run, CONNECT_S)
            self._require_lease()
            self._require_watchdog()
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        """Hang up; idempotent."""
        await self.stop()
        if self._stream is not None:
            await self._stream.close()

    async def command(self, kind: FrameType, content: Mapping[str, Any], within_s: float = ANSWER_S) -> Ack:
        """Send once and wait for its ACK; ``within_s`` comes on top of the silence that the link is allowed.

        DeviceRefused on NAK, LinkError without an answer.
        """
        answer: asyncio.Future[Ack] = asyncio.get_running_loop().create_future()
        waiting = self._pending.setdefault(kind, deque())
        waiting.append(answer)
        try:
            await self._write(command(kind, content))
            return await self.result(answer, within_s + self._silence_s)
        finally:
            answer.cancel()
            if answer in waiting:
                waiting.remove(answer)

    async def deliver(self, segments: Sequence[Segment]) -> None:
        """Send blocks as credit allows, again from where the robot asks, until it has accepted them all."""
        credit, end = self.session.credit, segments[-1].seq + 1
        refusal: asyncio.Future[Ack] = asyncio.get_running_loop().create_future()
        self._pending[FrameType.BLOCKS] = deque([refusal])
        credit.go_back()
        rounds = 0
        try:
            while credit.accepted < end:
                accepted = credit.accepted
                in_vain = await self._deliver_once(segments, refusal)
                if credit is not self.session.credit:
                    raise DeviceRefused(f"{self._address}: the program was dropped while its blocks were being sent")
                rounds = 0 if credit.accepted > accepted else rounds + in_vain
                if rounds > RESENDS:
                    raise ProtocolError(f"{self._address}: does not accept block {credit.accepted}")
        finally:
            self._pending.pop(FrameType.BLOCKS, None)
            if not refusal.cancel() and not refusal.cancelled():
                refusal.exception()

    async def _deliver_once(self, segments: Sequence[Segment], refusal: asyncio.Future[Ack]) -> bool:
        """Send what is due, then wait until the robot says something to it. True where it must be sent again."""
        credit = self.session.credit
        while frame := self.session.next_blocks(segments):
            await self._write(frame)
        sent, known, before = credit.sent, (credit.accepted, credit.limit), self.session.heard

        def changed() -> bool:
            dropped = credit is not self.session.credit
            return dropped or refusal.done() or credit.sent < sent or (credit.accepted, credit.limit) != known

        in_flight = sent > credit.accepted
        heard = await self.until(changed, RESEND_S if in_flight else None)
        if refusal.done():
            refusal.result()
        if not heard and self.session.heard > before:  # else it may not have had them yet: the link stalls
            credit.go_back()
        return credit.sent < sent

    def _require_lease(self) -> None:
        """A writer without one would be refused only when it gives its first order."""
        if self._role == "writer" and not self.welcome.lease:
            raise DeviceBusy(
                f"{self._address}: the robot welcomes us without a lease: another client may write. Stop that client."
            )

    def _require_watchdog(self) -> None:
        """The daemon reckons with the time that the config says; who only watches and holds asks for nothing."""
        has_s, needed_s = self.welcome.watchdog_s, self._times.watchdog_s
        if self._role == "writer" and has_s < needed_s:
            raise DeviceRefused(
                f"{self._address}: the robot stops by itself after {has_s:g} s of silence, robot.watchdog_s says "
                f"{needed_s:g}: set the controller's watchdog to that, or the key to what the controller has"
            )

    async def _write(self, data: bytes) -> None:
        self.check()
        if self._stream is not None:
            await self._stream.write(data)

    async def _run(self, ready: Ready) -> None:
        async with asyncio.TaskGroup() as group:
            group.create_task(self._receive(ready))
            if self._role == "writer":
                group.create_task(self._ping())

    async def _ping(self) -> None:
        while True:
            await asyncio.sleep(PING_S)
            if self._stream is not None:
                await self._stream.write(encode(FrameType.PING))

    async def _receive(self, ready: Ready) -> None:
        heard = time.monotonic()
        while self._stream is not None:
            left_s = heard + self._silence_s - time.monotonic()
            data = await self._stream.read(1 << 16, max(left_s, 0.0))
            if self.session.receive(data):
                heard = time.monotonic()
            elif time.monotonic() > heard + self._silence_s:
                raise LinkError(f"{self._address}: nothing sound within {self._silence_s:g} s")
            self._match_answers()
            if self.session.welcome is not None:
                self._silence_s = min(self._times.silence_s, SILENCE_SHARE * self.session.welcome.watchdog_s)
                ready()
            self.fire()

    def _match_answers(self) -> None:
        answers, self.session.answers = self.session.answers, []
        for answer in answers:
            if isinstance(answer, Nak) and answer.of == FrameType.HELLO:
                raise _refused(self._address, answer)
            waiting = self._pending.get(answer.of)
            future = waiting.popleft() if waiting else None
            if future is None or future.done():
                continue
            if isinstance(answer, Ack):
                future.set_result(answer)
            else:
                future.set_exception(_refused(self._address, answer))


def _refused(address: Tcp, nak: Nak) -> DeviceError:
    kinds: dict[str, type[DeviceError]] = {"protocol": ProtocolError, "busy": DeviceBusy}
    name = FrameType(nak.of).name if nak.of in tuple(FrameType) else f"frame type {nak.of}"
    return kinds.get(nak.code, DeviceRefused)(f"{address}: {name} was refused: {nak.code}: {nak.text}")
