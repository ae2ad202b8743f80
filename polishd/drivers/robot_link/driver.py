"""Driver of a robot on polishd's robot link.

The connection has a reader, a heartbeat, and answers matched to commands.
"""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import time
from array import array
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

from pydantic import Field

from polishd.api import (
    ByteStream,
    DeviceBusy,
    DeviceContext,
    DeviceError,
    DeviceFault,
    DeviceIdentity,
    DeviceRefused,
    DeviceStatus,
    DeviceType,
    ExecutedBlock,
    LinkError,
    Plan,
    ProtocolError,
    RobotProgress,
    RobotTimes,
    Segment,
)
from polishd.config.fields import ConfigSection
from polishd.drivers.robot_link import protocol
from polishd.drivers.robot_link.protocol import (
    LONGEST_LINE,
    PROTOCOL,
    Ack,
    Frame,
    FrameReader,
    FrameType,
    Nak,
    RobotLinkStatus,
    Welcome,
    command,
    encode,
)
from polishd.drivers.transport.address import Tcp, tcp_address
from polishd.drivers.transport.background import Background, Ready
from polishd.drivers.transport.program_robot import new_blocks
from polishd.drivers.transport.streams import open_stream

# State of one connection. Sans-IO: no clock, no sockets, no tasks.

MAX_BLOCKS = 256
"""Blocks in one frame: few, so that a lost frame costs little."""
MAX_BYTES = 1 << 18


@dataclass(slots=True)
class Credit:
    """Go-back-N window: blocks that the robot holds, that may be sent, that were sent."""

    accepted: int = 0
    limit: int = 0
    sent: int = 0

    def grant(self, accepted: int, limit: int) -> None:
        """The robot holds all blocks below ``accepted``. Both values only grow: an old message has no effect."""
        self.accepted = max(self.accepted, accepted)
        self.limit = max(self.limit, limit)
        self.sent = max(self.sent, self.accepted)

    def go_back(self, seq: int = 0) -> None:
        """Send again from ``seq``, without blocks that the robot holds."""
        self.sent = max(self.accepted, min(self.sent, seq))


class ExecutionRecord:
    """Executed blocks from 0 on without gaps, 16 bytes each. Kept across connections, for one program."""

    def __init__(self, program_sha256: str = "", boot_id: str = "") -> None:
        self.program_sha256 = program_sha256
        self.boot_id = boot_id
        self._start_s = array("d")
        self._end_s = array("d")

    def __len__(self) -> int:
        return len(self._start_s)

    def __getitem__(self, seq: int) -> ExecutedBlock:
        return ExecutedBlock(seq, self._start_s[seq], self._end_s[seq])

    def extend(self, executed: Iterable[ExecutedBlock]) -> None:
        """Add new records. LinkError if records were lost: the robot sends them again after a reconnect."""
        for one in executed:
            if one.seq > len(self):
                raise LinkError(
                    f"robot: records of blocks {len(self)} to {one.seq - 1} were lost on the link. Reconnect."
                )
            if one.seq == len(self):
                self._start_s.append(one.start_s)
                self._end_s.append(one.end_s)


class RobotLinkSession:
    """State of the robot as received on this connection."""

    def __init__(self, record: ExecutionRecord | None) -> None:
        self._frames = FrameReader()
        self._handlers: dict[int, Callable[[bytes], None]] = {
            FrameType.WELCOME: self._welcome,
            FrameType.ACK: self._ack,
            FrameType.NAK: lambda payload: self.answers.append(protocol.nak(payload)),
            FrameType.ACCEPTED: self._accepted,
            FrameType.EXECUTED: self._executed,
            FrameType.STATUS: lambda payload: self._progressed(protocol.status(payload)),
            FrameType.RESEND: lambda payload: self.credit.go_back(protocol.resend(payload)),
        }
        self.welcome: Welcome | None = None
        self.progress: RobotLinkStatus | None = None
        self.credit = Credit()
        self.record = ExecutionRecord() if record is None else record
        self.follows = record is not None
        """Whether records of executed blocks are requested."""
        self.heard = 0
        """Valid frames so far."""
        self.answers: list[Ack | Nak] = []
        """Answers for the driver, in order."""

    @property
    def skipped(self) -> int:
        """Bytes that belonged to no valid frame."""
        return self._frames.skipped

    @property
    def executed_from(self) -> int:
        """First block whose record HELLO requests."""
        return len(self.record) if self.follows else 0xFFFF_FFFF

    def present(self) -> RobotLinkStatus:
        """The last STATUS, updated by later ACCEPTED and EXECUTED frames."""
        if self.progress is None:
            raise LinkError("the robot has sent no status yet")
        if self.progress.program_sha256 != self.record.program_sha256:
            return self.progress
        accepted = max(self.progress.accepted, self.credit.accepted)
        return replace(self.progress, accepted=accepted, executed=max(self.progress.executed, len(self.record)))

    def receive(self, data: bytes) -> int:
        """Process bytes; return the number of valid frames among them."""
        frames = self._frames.feed(data)
        self.heard += len(frames)
        for frame in frames:
            self._handle(frame)
        return len(frames)

    def next_blocks(self, segments: Sequence[Segment]) -> bytes:
        """Return a BLOCKS frame with the segments that are due now; empty if none is."""
        first = segments[0].seq
        begin = self.credit.sent - first
        end = min(self.credit.limit - first, len(segments), begin + MAX_BLOCKS)
        lines: list[bytes] = []
        size = 0
        for segment in segments[begin:end] if begin >= 0 else ():
            size += len(segment.text)
            if lines and size > MAX_BYTES:
                break
            lines.append(segment.text)
        if not lines:
            return b""
        frame = protocol.blocks(self.credit.sent, lines)
        self.credit.sent += len(lines)
        return frame

    def _handle(self, frame: Frame) -> None:
        if frame.kind not in self._handlers or (
            self.welcome is None and frame.kind not in (FrameType.WELCOME, FrameType.NAK)
        ):
            return  # of a later version, or from before WELCOME
        self._handlers[frame.kind](frame.payload)

    def _welcome(self, payload: bytes) -> None:
        self.welcome = protocol.welcome(payload)
        progress = replace(self.welcome.progress, boot_id=self.welcome.identity.boot_id)
        ours = (self.record.program_sha256, self.record.boot_id) == (progress.program_sha256, progress.boot_id)
        if not ours or progress.executed < len(self.record):
            self.follows = self.follows and not len(self.record)
            self.record = ExecutionRecord(progress.program_sha256, progress.boot_id)
        self._progressed(progress)

    def _ack(self, payload: bytes) -> None:
        answer = protocol.ack(payload)
        if answer.of == FrameType.LOAD and self.welcome is not None:
            self.record = ExecutionRecord(answer.progress.program_sha256, self.welcome.identity.boot_id)
            self.credit = Credit(limit=self.welcome.window)
        self._progressed(answer.progress)
        self.answers.append(answer)

    def _accepted(self, payload: bytes) -> None:
        next_seq, credit, buffer_s = protocol.accepted(payload)
        self.credit.grant(next_seq, next_seq + credit)
        if self.progress is not None and next_seq >= self.progress.accepted:
            self.progress = replace(self.progress, accepted=next_seq, buffer_s=buffer_s)

    def _executed(self, payload: bytes) -> None:
        if self.follows:
            self.record.extend(protocol.executed(payload))

    def _progressed(self, progress: RobotLinkStatus) -> None:
        boot_id = self.welcome.identity.boot_id if self.welcome is not None else ""
        if progress.boot_id and progress.boot_id != boot_id:
            raise LinkError(f"the robot has restarted (boot id {progress.boot_id}, not {boot_id})")
        self.progress = replace(progress, boot_id=boot_id)
        if progress.program_sha256 == self.record.program_sha256:
            self.credit.grant(progress.accepted, 0)
        else:  # dropped or replaced: the sender and the followers of the old program get an error
            self.record, self.credit = ExecutionRecord(progress.program_sha256, boot_id), Credit()


SILENCE_SHARE = 0.4
"""Longest silence of the robot, as a share of its watchdog time: it then receives as little from us."""
PING_S = 0.2
CONNECT_S = 1.0
ANSWER_S = 1.0
RESEND_S = 0.5
"""A robot accepts blocks within its window at once; after this time without ACCEPTED a frame is lost."""
RESENDS = 3

Role = Literal["writer", "reader"]


class RobotLinkConnection(Background):
    """Connection from HELLO to the end of the link; never reopened. Waiting calls get LinkError at its end."""

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
        """Content of the robot's WELCOME."""
        if self.session.welcome is None:
            raise LinkError(f"{self._address}: is not open")
        return self.session.welcome

    @property
    def progress(self) -> RobotLinkStatus:
        """Last status of the robot; LinkError once the link is down."""
        self.check()
        return self.session.present()

    async def open(self, client: str, lease: str = "") -> None:
        """Connect and wait for WELCOME. DeviceBusy: another client writes. DeviceRefused: the watchdog is short."""
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
        """Disconnect; idempotent."""
        await self.stop()
        if self._stream is not None:
            await self._stream.close()

    async def command(self, kind: FrameType, content: Mapping[str, Any], within_s: float = ANSWER_S) -> Ack:
        """Send once and wait for its ACK; ``within_s`` is added to the allowed silence of the link.

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
        """Send blocks as credit allows, again from the robot's RESEND, until the robot has accepted all."""
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
        """Send due blocks, then wait until the robot answers. Return True if they must be sent again."""
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
        if not heard and self.session.heard > before:  # otherwise the robot may not have them yet: the link stalls
            credit.go_back()
        return credit.sent < sent

    def _require_lease(self) -> None:
        """Check the lease now: without one the robot would refuse only the first command."""
        if self._role == "writer" and not self.welcome.lease:
            raise DeviceBusy(
                f"{self._address}: the robot granted no lease: another client may write. Stop that client."
            )

    def _require_watchdog(self) -> None:
        """Check that the robot's watchdog has the time of the config; a reader needs no check."""
        has_s, needed_s = self.welcome.watchdog_s, self._times.watchdog_s
        if self._role == "writer" and has_s < needed_s:
            raise DeviceRefused(
                f"{self._address}: the robot's watchdog is {has_s:g} s, robot.watchdog_s is {needed_s:g} s. "
                "Set both to the same time."
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
                raise LinkError(f"{self._address}: no valid frame within {self._silence_s:g} s")
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


# The driver on one connection.

HASHED = 4096
"""Blocks that are hashed in one step."""
HOLD_ANSWER_S = 1.0
REPORT_S = 0.1
"""Greatest age of EXECUTED: 50 ms by the protocol, and 50 ms for transmission."""


class RobotLink:
    """A Robot over TCP. A lost link stays lost until ``open``; only ``make_safe`` reconnects."""

    def __init__(
        self, address: Tcp, times: RobotTimes | None = None, *, client: str = "polishd", role: Role = "writer"
    ) -> None:
        self._address = address
        self._times = times or RobotTimes(watchdog_s=0.0, report_s=REPORT_S)
        self._client = client
        self._role = role
        self._record = ExecutionRecord()
        self._lease = ""
        self._connection: RobotLinkConnection | None = None
        self._sending = asyncio.Lock()

    @property
    def times(self) -> RobotTimes:
        """See Robot."""
        return self._times

    @property
    def buffer_s(self) -> float:
        """See Robot. 0 while the link is down."""
        if self._connection is None or not self._connection.alive:
            return 0.0
        return self._connection.progress.buffer_s

    async def open(self) -> None:
        """See Device. DeviceBusy while another writer has the robot. Requests the records that were missed."""
        await self.close()
        kept = self._record
        connection = await self._connect(kept)
        if not connection.session.follows:
            # The robot runs another program than the one of the record: request its records from the beginning.
            await connection.close()
            connection = await self._connect(ExecutionRecord())
        self._connection = connection

    async def close(self) -> None:
        """See Device."""
        connection, self._connection = self._connection, None
        if connection is not None:
            self._record = connection.session.record
            await connection.close()

    async def identify(self) -> DeviceIdentity:
        """See Device."""
        return self._open_connection().welcome.identity

    async def status(self) -> DeviceStatus:
        """See Device. Safe means standstill."""
        progress = self._open_connection().progress
        return DeviceStatus(
            ready=progress.state != "fault",
            safe=progress.state in ("idle", "held", "done"),
            state=progress.state,
            detail=progress.detail,
        )

    async def make_safe(self) -> None:
        """See Device. Hold and confirm standstill; if the link is down, connect once as a reader for that."""
        if self._connection is not None and self._connection.alive:
            with contextlib.suppress(LinkError, ProtocolError):
                return await self.hold()
        connection = RobotLinkConnection(self._address, "reader", None, self._times)
        await connection.open(self._client)
        try:
            await _hold(connection, self._times.stop_s)
        finally:
            await connection.close()

    async def prepare(self, plan: Plan) -> None:
        """See Robot. DeviceRefused while the robot runs."""
        sha256, long = plan.program.sha256, len(plan.segments) > HASHED  # for a short program a thread takes longer
        blocks_sha256 = await asyncio.to_thread(_hash_of, plan.segments) if long else _hash_of(plan.segments)
        load = {
            "program_sha256": sha256,
            "blocks_sha256": blocks_sha256,
            "blocks": len(plan.segments),
            "approach_blocks": plan.approach_blocks,
        }
        answer = await self._open_connection().command(FrameType.LOAD, load)
        if answer.progress.program_sha256 != sha256:
            raise ProtocolError(f"{self._address}: received program {sha256}, holds {answer.progress.program_sha256!r}")

    async def send(self, segments: Sequence[Segment]) -> None:
        """See Robot. Sends only blocks that the robot does not hold."""
        async with self._sending:
            connection = self._open_connection()
            new = new_blocks(segments, connection.session.credit.accepted, LONGEST_LINE, str(self._address))
            if not new:
                return
            await connection.deliver(new)

    async def progress(self) -> RobotProgress:
        """See Robot."""
        return self._open_connection().progress

    async def executed(self, from_seq: int = 0) -> AsyncIterator[ExecutedBlock]:
        """See Robot. DeviceFault if the robot reports a fault."""
        connection = self._open_connection()
        record, seq = connection.session.record, from_seq
        while True:
            while seq < len(record):
                yield record[seq]
                seq += 1
            if _ended(connection, record):
                return
            await connection.until(_news(connection, record))

    async def hold(self) -> None:
        """See Robot."""
        await _hold(self._open_connection(), self._times.stop_s)

    async def lift(self, distance_mm: float) -> None:
        """See Robot. DeviceRefused if another client has the lease."""
        await self._open_connection().command(FrameType.LIFT, {"distance_mm": distance_mm}, self._times.stop_s)

    async def resume(self, until: int | None = None) -> None:
        """See Robot. Return when the robot has accepted the command; DeviceRefused if it was stopped meanwhile."""
        connection = self._open_connection()
        await connection.command(FrameType.RESUME, {"until": until, "stops": connection.progress.stops})

    async def abort(self) -> None:
        """Hold, then drop the robot's program."""
        await self._open_connection().command(FrameType.ABORT, {}, self._times.stop_s)

    def _open_connection(self) -> RobotLinkConnection:
        if self._connection is None:
            raise LinkError(f"{self._address}: is not open")
        return self._connection

    async def _connect(self, record: ExecutionRecord) -> RobotLinkConnection:
        connection = RobotLinkConnection(self._address, self._role, record, self._times)
        await connection.open(self._client, self._lease)
        self._lease = connection.welcome.lease
        return connection


async def _hold(connection: RobotLinkConnection, stop_s: float) -> None:
    """Hold and confirm standstill; STATUS is enough if the ACK is lost."""
    with contextlib.suppress(LinkError):
        await connection.command(FrameType.HOLD, {}, HOLD_ANSWER_S)
    if not await connection.until(lambda: connection.progress.state != "running", stop_s):
        raise DeviceFault("the robot still runs after HOLD")


def _news(connection: RobotLinkConnection, record: ExecutionRecord) -> Callable[[], bool]:
    """Return a condition: the robot has sent a new message since this call."""
    count, progress = len(record), connection.session.progress
    return lambda: len(record) > count or connection.session.progress != progress


def _ended(connection: RobotLinkConnection, record: ExecutionRecord) -> bool:
    """Whether no more blocks of the record's program will be executed."""
    progress = connection.progress
    if connection.session.record is not record or progress.program_sha256 != record.program_sha256:
        return True
    if not record.program_sha256:
        return True
    if len(record) < progress.executed:
        return False
    if progress.state == "fault":
        raise DeviceFault(f"the robot reports a fault: {progress.detail}")
    return progress.state == "done"


def _hash_of(segments: Sequence[Segment]) -> str:
    """Return the sha256 of all blocks, each with a line feed. Call it in a thread for a long program."""
    found = hashlib.sha256()
    for first in range(0, len(segments), HASHED):
        found.update(b"".join(segment.text + b"\n" for segment in segments[first : first + HASHED]))
    return found.hexdigest()


# The device type ``robot_link``: a robot that speaks docs/protocols/robot_link.md.

_TIMES = RobotTimes()


class RobotLinkOptions(ConfigSection):
    """Keys of ``[robot]`` with ``type = "robot_link"``."""

    address: str
    """Address of the controller: ``tcp://host:port``."""
    watchdog_s: Annotated[float, Field(gt=0.0, le=600.0)] = _TIMES.watchdog_s
    """The controller's watchdog: after this time without a message it stops. A shorter one is refused."""
    silence_s: Annotated[float, Field(ge=0.3, le=60.0)] = _TIMES.silence_s
    """Longest time without a message; then the link is lost and contact is left. The robot sends every 50 ms."""
    stop_s: Annotated[float, Field(gt=0.0, le=60.0)] = _TIMES.stop_s
    """Longest time to stop, or to lift the tool off."""


def _build(options: RobotLinkOptions, context: DeviceContext) -> RobotLink:
    address = tcp_address(options.address, context.base_dir, "robot_link")
    times = RobotTimes(options.silence_s, options.watchdog_s, options.stop_s, report_s=REPORT_S)
    return RobotLink(address, times)


DEVICE_TYPES = [
    DeviceType(
        "robot_link",
        "robot",
        RobotLinkOptions,
        _build,
        simulated_by="robot_link",
        substitute={"watchdog_s": 60.0},
        usual_address="tcp://robot-controller:28500",
    )
]
