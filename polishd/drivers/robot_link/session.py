"""The state of one connection: bytes in, facts out. Sans-IO: no clock, no sockets, no tasks."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

from polishd.api import ExecutedBlock, LinkError, Segment
from polishd.drivers.robot_link import messages
from polishd.drivers.robot_link.frames import Frame, FrameReader, FrameType
from polishd.drivers.robot_link.messages import Ack, Nak, RobotLinkStatus, Welcome

MAX_BLOCKS = 256
"""Blocks in one frame: small enough that one lost frame costs little."""
MAX_BYTES = 1 << 18


@dataclass(slots=True)
class Credit:
    """Go-back-N: what the robot has, what it may be sent, what was sent."""

    accepted: int = 0
    limit: int = 0
    sent: int = 0

    def grant(self, accepted: int, limit: int) -> None:
        """The robot holds all below ``accepted``; both only grow, so that an old word does no harm."""
        self.accepted = max(self.accepted, accepted)
        self.limit = max(self.limit, limit)
        self.sent = max(self.sent, self.accepted)

    def go_back(self, seq: int = 0) -> None:
        """Send again from there, but nothing that the robot holds already."""
        self.sent = max(self.accepted, min(self.sent, seq))


class ExecutionRecord:
    """Executed blocks from 0 on, without gaps, each once; 16 bytes a block. Outlives connections, not the program."""

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
        """Add what is new. LinkError where records were lost: the robot gives them again after a reconnect."""
        for one in executed:
            if one.seq > len(self):
                raise LinkError(
                    f"robot: records of blocks {len(self)} to {one.seq - 1} were lost on the wire: reconnect"
                )
            if one.seq == len(self):
                self._start_s.append(one.start_s)
                self._end_s.append(one.end_s)


class RobotLinkSession:
    """What the robot has said on this connection."""

    def __init__(self, record: ExecutionRecord | None) -> None:
        self._frames = FrameReader()
        self._handlers: dict[int, Callable[[bytes], None]] = {
            FrameType.WELCOME: self._welcome,
            FrameType.ACK: self._ack,
            FrameType.NAK: lambda payload: self.answers.append(messages.nak(payload)),
            FrameType.ACCEPTED: self._accepted,
            FrameType.EXECUTED: self._executed,
            FrameType.STATUS: lambda payload: self._progressed(messages.status(payload)),
            FrameType.RESEND: lambda payload: self.credit.go_back(messages.resend(payload)),
        }
        self.welcome: Welcome | None = None
        self.progress: RobotLinkStatus | None = None
        self.credit = Credit()
        self.record = ExecutionRecord() if record is None else record
        self.follows = record is not None
        """Records of executed blocks are wanted."""
        self.heard = 0
        """Sound frames so far."""
        self.answers: list[Ack | Nak] = []
        """To be taken by the driver, in order."""

    @property
    def skipped(self) -> int:
        """Bytes that belonged to no sound frame."""
        return self._frames.skipped

    @property
    def executed_from(self) -> int:
        """What HELLO asks for."""
        return len(self.record) if self.follows else 0xFFFF_FFFF

    def present(self) -> RobotLinkStatus:
        """The last STATUS, with what ACCEPTED and EXECUTED have said since."""
        if self.progress is None:
            raise LinkError("the robot has said nothing yet")
        if self.progress.program_sha256 != self.record.program_sha256:
            return self.progress
        accepted = max(self.progress.accepted, self.credit.accepted)
        return replace(self.progress, accepted=accepted, executed=max(self.progress.executed, len(self.record)))

    def receive(self, data: bytes) -> int:
        """Take bytes; number of sound frames among them."""
        frames = self._frames.feed(data)
        self.heard += len(frames)
        for frame in frames:
            self._handle(frame)
        return len(frames)

    def next_blocks(self, segments: Sequence[Segment]) -> bytes:
        """A BLOCKS frame with those of the segments that are due now; empty when none is."""
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
        frame = messages.blocks(self.credit.sent, lines)
        self.credit.sent += len(lines)
        return frame

    def _handle(self, frame: Frame) -> None:
        if frame.kind not in self._handlers or (
            self.welcome is None and frame.kind not in (FrameType.WELCOME, FrameType.NAK)
        ):
            return  # of a later version, or of before we were welcome
        self._handlers[frame.kind](frame.payload)

    def _welcome(self, payload: bytes) -> None:
        self.welcome = messages.welcome(payload)
        progress = replace(self.welcome.progress, boot_id=self.welcome.identity.boot_id)
        ours = (self.record.program_sha256, self.record.boot_id) == (progress.program_sha256, progress.boot_id)
        if not ours or progress.executed < len(self.record):
            self.follows = self.follows and not len(self.record)
            self.record = ExecutionRecord(progress.program_sha256, progress.boot_id)
        self._progressed(progress)

    def _ack(self, payload: bytes) -> None:
        answer = messages.ack(payload)
        if answer.of == FrameType.LOAD and self.welcome is not None:
            self.record = ExecutionRecord(answer.progress.program_sha256, self.welcome.identity.boot_id)
            self.credit = Credit(limit=self.welcome.window)
        self._progressed(answer.progress)
        self.answers.append(answer)

    def _accepted(self, payload: bytes) -> None:
        next_seq, credit, buffer_s = messages.accepted(payload)
        self.credit.grant(next_seq, next_seq + credit)
        if self.progress is not None and next_seq >= self.progress.accepted:
            self.progress = replace(self.progress, accepted=next_seq, buffer_s=buffer_s)

    def _executed(self, payload: bytes) -> None:
        if self.follows:
            self.record.extend(messages.executed(payload))

    def _progressed(self, progress: RobotLinkStatus) -> None:
        boot_id = self.welcome.identity.boot_id if self.welcome is not None else ""
        if progress.boot_id and progress.boot_id != boot_id:
            raise LinkError(f"the robot was started anew (boot id {progress.boot_id}, not {boot_id})")
        self.progress = replace(progress, boot_id=boot_id)
        if progress.program_sha256 == self.record.program_sha256:
            self.credit.grant(progress.accepted, 0)
        else:  # dropped, or another in its place: who sends blocks of the old one, or follows it, hears of that
            self.record, self.credit = ExecutionRecord(progress.program_sha256, boot_id), Credit()
