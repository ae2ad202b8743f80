"""Driver of a robot on polishd's robot link."""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
from collections.abc import AsyncIterator, Callable, Sequence
from typing import Annotated

from pydantic import Field

from polishd.api import (
    DeviceContext,
    DeviceFault,
    DeviceIdentity,
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
from polishd.drivers.robot_link.connection import ExecutionRecord, RobotLinkConnection, Role
from polishd.drivers.robot_link.protocol import LONGEST_LINE, FrameType
from polishd.drivers.transport.address import Tcp, tcp_address
from polishd.drivers.transport.program_robot import new_blocks

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
