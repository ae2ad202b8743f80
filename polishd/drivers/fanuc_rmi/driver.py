"""Driver of a FANUC controller: TP program lines are streamed as instructions of the Remote Motion Interface.

The controller holds at most 8 instructions. It answers each with its sequence number when it has been executed: these
answers are the credits of the stream and the record of executed blocks.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Sequence
from dataclasses import replace
from typing import Annotated

import numpy as np
from pydantic import Field

from polishd.api import (
    DeviceContext,
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
from polishd.drivers.fanuc_rmi.motion_speed import MotionSpeed
from polishd.drivers.fanuc_rmi.program import LONGEST_LINE, RmiInstruction, TpReader, instructions_of
from polishd.drivers.fanuc_rmi.protocol import (
    IN_HOLD,
    MOST_OUTSTANDING,
    NOT_RUNNING,
    PAUSED,
    RmiSession,
    RmiSnapshot,
    RmiStatus,
    error_text,
)
from polishd.drivers.transport.address import Tcp, tcp_address
from polishd.drivers.transport.program_robot import new_blocks
from polishd.drivers.transport.program_tracker import PollingConnection, ProgramTracker, comes_to_rest

LOOK_S = 0.03
"""Pause between two polls of status and pose."""
OPEN_S = 3.0
ACTION_S = 5.0
"""Longest time of FRC_Initialize, FRC_Abort, FRC_Reset: the controller makes or ends a TP program."""
WINDOW = 128
"""Instructions that the driver takes before they can be sent: as many blocks as the daemon sends at once."""
EXPLAIN_S = 0.05
"""Longest wait for the controller's error text after a fault, which is reported without it then."""
START_S = 1.0
"""Time after a command to run in which the controller may still report its earlier state."""
STILL_MM, STILL_DEG = 1e-3, 1e-3
"""Change of the pose below which the robot stands: the last digit that the controller sends."""


class RmiProgramTracker(ProgramTracker):
    """Tracker of one program: its instructions, and the blocks that their answers report as executed.

    Times are those of the answers' arrival. Lines that neither move nor wait take no time.
    """

    def __init__(self, plan: Plan, reader: TpReader, blocks: int) -> None:
        super().__init__(plan, blocks)
        self.reader = reader
        self.accepted = 0
        """Blocks that the driver has read."""
        self.instructions: list[RmiInstruction] = []
        self.sent = self.answered = 0
        """Instructions that were sent, and that were executed."""
        self.target: int | None = 0
        """Blocks below it may run; None for all."""
        self.first_sequence = 1
        self.speed = MotionSpeed()
        self._expected_s = np.full(blocks, np.nan)
        """Planned time of each block that is a timed point; of a dwell with its move."""
        timed = plan.program.block
        self._expected_s[timed] = plan.expected_time_s[: len(timed)]
        self._untimed = range(int(timed[0]), int(timed[-1])) if plan.program.encoding == "dwell" and len(timed) else ()
        """Blocks whose moves are in the planned time of the dwell behind them."""

    def seconds_of(self, instruction: RmiInstruction) -> float:
        """Return the time that an instruction takes by the plan; outside of the timed points its least time."""
        planned_s = float(self._expected_s[instruction.block])
        if not np.isnan(planned_s):
            return planned_s
        return 0.0 if instruction.block in self._untimed else instruction.seconds

    @property
    def end(self) -> int:
        """Blocks below it may run now."""
        return self.accepted if self.target is None else min(self.target, self.accepted)

    def take(self, segments: Sequence[Segment], most_s: float) -> None:
        """Read more blocks, in order. DeviceRefused for one that the controller cannot execute: it is not taken."""
        for segment in segments:
            instruction = self.reader.read(segment.seq, segment.text)
            if instruction is not None and instruction.seconds > most_s / 2.0:
                raise DeviceRefused(
                    f"block {segment.seq} takes {instruction.seconds:g} s; at most {most_s / 2.0:g} s, half of "
                    "robot.watchdog_s: without a link the robot stops after it. Split it, or increase robot.watchdog_s."
                )
            self.accepted += 1
            if instruction is not None:
                self.instructions.append(instruction)

    def next(self) -> RmiInstruction | None:
        """Return the next instruction that may be sent; None if there is none."""
        if self.sent < len(self.instructions) and self.instructions[self.sent].block < self.end:
            return self.instructions[self.sent]
        return None

    def has_credit(self, instruction: RmiInstruction, time_s: float, most_s: float) -> bool:
        """Whether the controller may hold one more: at most 8, and without a link it stops within ``most_s``.

        An instruction takes half of that at most, so that one goes out before half is used up.
        """
        if self.sent - self.answered >= MOST_OUTSTANDING:
            return False
        held_s = self._motion_s(self.sent, time_s)
        return held_s <= most_s / 2.0 or held_s + self.seconds_of(instruction) <= most_s

    def ahead_s(self, time_s: float) -> float:
        """Return the least time that the motion ahead of the tool takes at that time of the clock.

        The instructions that the controller holds; where the driver holds others back on purpose, as before a start,
        those that the controller would hold.
        """
        held = self.sent if self.next() is not None and self.state == "running" else self.answered + MOST_OUTSTANDING
        return self._motion_s(max(held, self.sent), time_s)

    def _motion_s(self, to: int, time_s: float) -> float:
        """Return the time of the instructions below ``to`` that are not executed."""
        ahead = self.instructions[self.answered : to]
        spent_s = self.clock_s - self.began_s + (max(time_s - self.seen_s, 0.0) if self.state == "running" else 0.0)
        first_s = max(self.seconds_of(ahead[0]) - spent_s, 0.0) if ahead else 0.0
        return first_s + sum(map(self.seconds_of, ahead[1:]))

    def executed(self, time_s: float) -> None:
        """Record the oldest outstanding instruction as executed at that time."""
        self.tick(time_s)
        block = self.instructions[self.answered].block
        self.answered += 1
        self._advance(block + 1, block)
        self.pass_idle()

    def measure_speed(self, snapshot: RmiSnapshot) -> None:
        """Take the pose of the instruction that is executed."""
        if self.answered < self.sent:
            x, y, z = snapshot.pose[:3]
            move = self.instructions[self.answered].move
            self.speed.add(self.answered, move, (x, y, z), snapshot.pose_times)

    def pass_idle(self) -> None:
        """Record the next lines that neither move nor wait; the program is held at its target, or done at its end."""
        if self.state == "running" and self.answered == self.sent:
            waiting = self.sent < len(self.instructions)
            self._advance(min(self.instructions[self.sent].block, self.end) if waiting else self.end)
            if len(self) == self.blocks:
                self.state, self.detail = "done", ""
            elif self.target is not None and len(self) >= self.target:
                self.state, self.detail = "held", ""

    def fail(self, why: str) -> None:
        """The program cannot be continued."""
        if not self.ended:
            self.state, self.detail = "fault", why

    def _advance(self, to: int, timed: int = -1) -> None:
        """Record all blocks below ``to``; block ``timed`` took all the time, the others none."""
        first = len(self)
        if to <= first:
            return
        shares = np.zeros(to - first)
        if timed >= first:
            shares[timed - first] = self.clock_s - self.began_s
            self.stretch(shares)
        else:
            self.stretch(shares, high_s=self.began_s)


class RmiPoller(PollingConnection[RmiSession, RmiSnapshot]):
    """The session of the driver, with status and pose read all the time."""

    def __init__(
        self,
        make: Callable[[], RmiSession],
        name: str,
        on_snapshot: Callable[[RmiSnapshot], Awaitable[None]],
    ) -> None:
        super().__init__(name, OPEN_S, on_snapshot)
        self._make = make

    async def _connect(self) -> RmiSession:
        session = self._make()
        await session.open()
        return session

    async def _disconnect(self, link: RmiSession) -> None:
        await link.close()

    async def _snapshots(self, link: RmiSession) -> AsyncIterator[RmiSnapshot]:
        while True:
            yield await link.look()
            await asyncio.sleep(LOOK_S)

    def _stands(self, recent: Sequence[RmiSnapshot]) -> bool:
        return not _moves(recent[0], recent[-1]) and not any(snapshot.runs for snapshot in recent)


def _moves(first: RmiSnapshot, last: RmiSnapshot) -> bool:
    """Whether the later snapshot shows that instructions are executed, or that the robot has moved since the first."""
    steps = [abs(a - b) for a, b in zip(first.pose, last.pose, strict=True)]
    turns = [min(step, 360.0 - step) for step in steps[3:]]
    return last.runs or max(steps[:3]) > STILL_MM or max(turns) > STILL_DEG


class FanucRmi:
    """A Robot over RMI. A lost link stays lost until ``open``; only ``make_safe`` reconnects.

    It never resets a fault of the robot, releases a stop or switches the mode: the operator does that at the pendant.
    """

    def __init__(self, address: Tcp, times: RobotTimes, group: int = 1) -> None:
        self._address = address
        self._times = times
        self._group = group
        self._name = str(address)
        self._poller = RmiPoller(self._session, self._name, self._seen)
        self._tracker: RmiProgramTracker | None = None
        self._sequence = itertools.count(1)
        self._is_paused = False
        """Paused by this driver: to be continued by it."""
        self._is_held_up = False
        """The controller takes no instructions before a reset."""
        self._started_s = 0.0
        self._holds = 0
        self._sending = asyncio.Lock()
        self._pumping = asyncio.Lock()
        self._stopping = asyncio.Lock()

    @property
    def times(self) -> RobotTimes:
        """See Robot."""
        return self._times

    @property
    def buffer_s(self) -> float:
        """See Robot. 0 while the link is down."""
        tracker = self._tracker
        if tracker is None or tracker.ended or not self._alive:
            return 0.0
        return tracker.ahead_s(time.monotonic())

    async def open(self) -> None:
        """See Device. Sends no instruction. A program that ran when the link was lost is over: see the protocol."""
        await self.close()
        tracker = self._tracker
        if tracker is not None and tracker.started and not tracker.ended:
            count = tracker.sent - tracker.answered
            tracker.fail(f"the link was lost; the last {count} instructions that were sent may have been executed")
        await self._poller.open()

    async def close(self) -> None:
        """See Device."""
        self._stay()
        await self._poller.close()

    async def identify(self) -> DeviceIdentity:
        """See Device. RMI reports no serial number."""
        return DeviceIdentity("FANUC", "robot controller with RMI", "unknown", self._poller.link.firmware)

    async def status(self) -> DeviceStatus:
        """See Device. Ready: it would run a program as written. Safe: nothing is executed, and standstill."""
        status = await self._poller.link.status()
        states = {1: "running", 2: "paused"}
        state = states.get(status.program, "aborted") if status.rmi_runs else "idle"
        why = await self._obstacle(self._poller.link, status)
        return DeviceStatus(ready=not why, safe=self._poller.stands, state=state, detail=why)

    async def make_safe(self) -> None:
        """See Device. Ends RMI_MOVE, and with it the instructions that the controller holds."""
        self._stay()
        self._drop("aborted")
        async with self._stopping:
            if self._alive:
                with contextlib.suppress(LinkError, ProtocolError):
                    await self._abort(self._poller.link)
                    await self._poller.standstill("FRC_Abort", self._times.stop_s)
                    return
            await self._stop_anew()

    async def prepare(self, plan: Plan) -> None:
        """See Robot. Starts RMI_MOVE, which waits for instructions. DeviceRefused in a wrong mode."""
        session = self._poller.link
        if self._tracker is not None and self._tracker.state == "running":
            raise DeviceRefused(f"{self._name}: a program is running; hold it first")
        if not plan.segments:
            raise DeviceRefused(f"{self._name}: the plan has no lines")
        await self._require_ready(session)
        try:
            reader = await asyncio.to_thread(TpReader.of, [segment.text for segment in plan.segments])
        except DeviceRefused as refusal:
            raise DeviceRefused(f"{self._name}: {refusal}") from None
        self._drop("replaced")
        await self._abort(session)
        await self._initialize(session)
        if reader.frames is not None:
            await self._select_frames(session, *reader.frames)
        self._sequence = itertools.count((await session.status()).next_sequence)
        self._is_paused = False
        self._tracker = RmiProgramTracker(plan, reader, len(plan.segments))
        self._poller.fire()

    async def send(self, segments: Sequence[Segment]) -> None:
        """See Robot. A running robot has accepted a block when its instruction is sent.

        While it stands the driver takes ``WINDOW`` instructions, so that a start finds them. Lines that neither move
        nor wait are taken at once.
        """
        async with self._sending:
            tracker = self._loaded()
            self._poller.check()
            new = new_blocks(segments, tracker.accepted, LONGEST_LINE, self._name)
            for segment in new:
                await self._room(tracker)
                try:
                    tracker.take([segment], self._times.watchdog_s)
                except DeviceRefused as refusal:
                    raise DeviceRefused(f"{self._name}: {refusal}") from None
            await self._pump()
            if new:
                await self._room(tracker)

    async def _room(self, tracker: RmiProgramTracker) -> None:
        """Wait until more blocks may be taken: by credit of the controller, or in the window while it stands."""

        def has_room() -> bool:
            waits = len(tracker.instructions) - tracker.sent
            is_sending = tracker.state == "running" and tracker.next() is not None
            return tracker is not self._tracker or tracker.ended or waits < (MOST_OUTSTANDING if is_sending else WINDOW)

        if not has_room():
            await self._pump()
            await self._poller.until(has_room)
        if tracker is not self._tracker or tracker.dropped:
            raise DeviceRefused(f"{self._name}: the program was dropped while its blocks were being sent")

    async def progress(self) -> RobotProgress:
        """See Robot."""
        snapshot, tracker = self._poller.last, self._tracker
        if tracker is None:
            return RobotProgress("idle", "", 0, 0, 0.0, override=snapshot.status.override)
        progress = tracker.progress(tracker.accepted, self.buffer_s, snapshot.status.override)
        return replace(progress, measured_speed=tracker.speed.share)

    async def executed(self, from_seq: int = 0) -> AsyncIterator[ExecutedBlock]:
        """See Robot. DeviceFault when the controller reports a fault or leaves its mode."""
        self._poller.check()
        tracker, seq = self._tracker, from_seq
        while tracker is not None:
            while seq < len(tracker):
                yield tracker[seq]
                seq += 1
            if tracker is not self._tracker or tracker.ended:
                if tracker.state == "fault":
                    raise DeviceFault(f"{self._name}: {tracker.detail}")
                return
            count, now = len(tracker), tracker
            await self._poller.until(lambda: len(now) > count or now.ended or now is not self._tracker)  # noqa: B023

    async def hold(self) -> None:
        """See Robot. The controller decelerates along the path and keeps what it holds."""
        session, tracker = self._poller.link, self._tracker
        self._stay()
        if tracker is not None and tracker.sent > tracker.answered and not self._is_paused:
            self._is_paused = True
            await session.command("FRC_Pause", urgent=True, allow=NOT_RUNNING, within_s=self._times.stop_s)
        await self._poller.standstill("FRC_Pause", self._times.stop_s)

    async def resume(self, until: int | None = None) -> None:
        """See Robot. It can stop before any block: later ones are not sent."""
        tracker = self._loaded()
        session = self._poller.link
        if tracker.ended:
            raise DeviceRefused(
                f"{self._name}: the program is over ({tracker.state}: {tracker.detail}). Prepare it anew."
            )
        if until is not None and until <= len(tracker):
            return
        holds = self._holds
        await self._require_ready(session)
        if self._is_paused:
            await session.command("FRC_Continue", within_s=ACTION_S)
            self._is_paused = False
        if holds != self._holds:
            if tracker.sent > tracker.answered:
                self._is_paused = True
                await session.command("FRC_Pause", urgent=True, allow=NOT_RUNNING, within_s=self._times.stop_s)
            return
        self._started_s = time.monotonic()
        tracker.target = until
        if tracker.state != "running":
            tracker.speed.interrupt()
            tracker.go(self._started_s)
        tracker.pass_idle()
        await self._pump()
        self._poller.fire()

    async def lift(self, distance_mm: float) -> None:
        """See Robot. Refused: what the controller holds would come first, or the tool would stand on the part."""
        raise DeviceRefused(f"{self._name}: cannot lift by {distance_mm:g} mm out of a running program")

    @property
    def _alive(self) -> bool:
        try:
            self._poller.link.check()
        except (LinkError, ProtocolError, DeviceRefused, DeviceFault):
            return False
        return True

    def _session(self) -> RmiSession:
        return RmiSession(self._address, self._times, self._answered, self._faulted, self._credit)

    def _loaded(self) -> RmiProgramTracker:
        if self._tracker is None or self._tracker.dropped:
            raise DeviceRefused(f"{self._name}: no program: prepare one first")
        return self._tracker

    async def _require_ready(self, session: RmiSession) -> None:
        if why := await self._obstacle(session, await session.status()):
            raise DeviceRefused(f"{self._name}: {why}. Correct it at the robot, then try again.")

    async def _obstacle(self, session: RmiSession, status: RmiStatus) -> str:
        """Return why the controller would not run a program, with its latest error; empty if it would."""
        why = status.obstacle(await session.control_mode())
        error = await session.latest_error() if why else ""
        return f"{why}: {error}" if error else why

    async def _select_frames(self, session: RmiSession, uframe: int, utool: int) -> None:
        """Select the frames of the program's positions. DeviceRefused if the controller does not work in them."""
        await session.command(
            "FRC_SetUFrameUTool", UFrameNumber=uframe, UToolNumber=utool, Group=self._group, within_s=ACTION_S
        )
        answer = await session.command("FRC_GetUFrameUTool", Group=self._group)
        if (answer.get("UFrameNumber"), answer.get("UToolNumber")) != (uframe, utool):
            raise DeviceRefused(
                f"{self._name}: the controller works in user frame {answer.get('UFrameNumber')} and user tool "
                f"{answer.get('UToolNumber')}, the program in {uframe} and {utool}. Select those at the pendant."
            )

    def _stay(self) -> None:
        """Send no more instructions, and cancel a start that is under way."""
        self._holds += 1
        tracker = self._tracker
        if tracker is not None:
            if tracker.state == "running":
                tracker.tick(time.monotonic())
                tracker.state, tracker.detail = "held", ""
            tracker.target = 0

    def _drop(self, why: str) -> None:
        if self._tracker is not None and not self._tracker.ended:
            self._tracker.drop(why)
        self._poller.fire()

    async def _abort(self, session: RmiSession) -> None:
        """End RMI_MOVE; a controller on which it does not run refuses the command, and executes nothing."""
        try:
            await session.command("FRC_Abort", urgent=True, within_s=ACTION_S)
        except DeviceRefused:
            if (await session.status()).rmi_runs:
                raise
        session.forget()

    async def _stop_anew(self) -> None:
        session = RmiSession(self._address, self._times)
        await session.open()
        try:
            await self._abort(session)
            if not await comes_to_rest(session.look, _moves, LOOK_S, self._times.stop_s):
                raise DeviceFault(
                    f"{self._name}: still moving {self._times.stop_s:g} s after FRC_Abort. Stop it at the pendant."
                )
        finally:
            await session.close()

    async def _initialize(self, session: RmiSession) -> None:
        """Start RMI_MOVE. The HOLD state of RMI, into which a refused instruction puts it, is reset first."""
        if self._is_held_up:
            await session.command("FRC_Reset", within_s=ACTION_S)
            self._is_held_up = False
        answer = await session.command("FRC_Initialize", within_s=ACTION_S, allow=IN_HOLD, GroupMask=self._group)
        if answer.get("ErrorID") == IN_HOLD:
            await session.command("FRC_Reset", within_s=ACTION_S)
            await session.command("FRC_Initialize", within_s=ACTION_S, GroupMask=self._group)

    async def _pump(self) -> None:
        """Send instructions as credit allows."""
        async with self._pumping:
            tracker = self._tracker
            while (
                tracker is not None
                and tracker is self._tracker
                and tracker.state == "running"
                and not self._is_paused
                and (instruction := tracker.next()) is not None
                and tracker.has_credit(instruction, time.monotonic(), self._times.watchdog_s)
            ):
                sequence = next(self._sequence)
                if not tracker.sent:
                    tracker.first_sequence = sequence
                tracker.sent += 1
                await self._poller.link.send(sequence, instruction.fields)

    def _answered(self, sequence: int, error: int) -> None:
        """Take the answer to an instruction: it was executed, or refused."""
        tracker = self._tracker
        if tracker is None or tracker.dropped:
            return
        at = sequence - tracker.first_sequence
        if error:
            self._is_held_up = True
            block = tracker.instructions[at].block if 0 <= at < len(tracker.instructions) else -1
            tracker.fail(f"the controller refuses block {block}: {error_text(error)}")
        elif at == tracker.answered:
            tracker.executed(time.monotonic())

    async def _credit(self) -> None:
        """Send what an answer has let go, and then wake all waiters: they see the motion that is held again."""
        await self._pump()
        self._poller.fire()

    async def _faulted(self) -> None:
        await self._fail("the controller reports a fault")

    async def _fail(self, why: str) -> None:
        """Fail the running program, with the controller's latest error if it answers promptly."""
        tracker = self._tracker
        if tracker is None or tracker.state != "running":
            return
        error = ""
        with contextlib.suppress(LinkError, ProtocolError, TimeoutError):
            async with asyncio.timeout(EXPLAIN_S):
                error = await self._poller.link.latest_error()
        if tracker.state == "running":
            tracker.fail(f"{why}: {error}" if error else why)
        self._poller.fire()

    async def _seen(self, snapshot: RmiSnapshot) -> None:
        """Detect a stop from another source while the program runs."""
        tracker = self._tracker
        if tracker is None or tracker.state != "running" or snapshot.time_s < self._started_s:
            return
        if why := snapshot.status.obstacle():
            await self._fail(why)
        elif snapshot.status.program == PAUSED and snapshot.time_s > self._started_s + START_S:
            tracker.fail("the program was paused at the controller")
        elif not snapshot.status.rmi_runs:
            tracker.fail("the program was ended at the controller")
        else:
            tracker.measure_speed(snapshot)
            await self._pump()  # credit by time comes back while an instruction is executed


# The device type ``fanuc_rmi``: a robot on a FANUC controller with option R912 (docs/protocols/fanuc_rmi.md).

JITTER_S = 0.01
"""Standard deviation of the arrival of an answer: the controller's cycle and the network."""


class FanucRmiOptions(ConfigSection):
    """Keys of ``[robot]`` with ``type = "fanuc_rmi"``."""

    address: str
    """Address of the controller: ``tcp://host:16001``."""
    group: Annotated[int, Field(ge=1, le=127)] = 1
    """Motion group mask of ``FRC_Initialize``. [1]"""
    watchdog_s: Annotated[float, Field(gt=0.0, le=600.0)] = 60.0
    """Longest time that the 8 instructions which the controller holds may take: without a link it stops after them."""
    silence_s: Annotated[float, Field(ge=0.2, le=60.0)] = 1.5
    """Longest time without an answer; then the link is lost and contact is left."""
    stop_s: Annotated[float, Field(gt=0.0, le=60.0)] = 5.0
    """Longest time to stop."""


def _build(options: FanucRmiOptions, context: DeviceContext) -> FanucRmi:
    address = tcp_address(options.address, context.base_dir, "fanuc_rmi")
    times = RobotTimes(
        options.silence_s,
        options.watchdog_s,
        options.stop_s,
        lifts=False,
        block_end_s=JITTER_S,
        report_s=0.05,
        held_instructions=MOST_OUTSTANDING,
    )
    return FanucRmi(address, times, options.group)


def _takes(blocks: Sequence[bytes]) -> str:
    """Return why the controller cannot run the blocks: it runs only TP programs, and of those only motion and waits."""
    try:
        found = any(True for _ in instructions_of(blocks))
    except DeviceRefused as refusal:
        return str(refusal)
    return "" if found else "no line of the program moves or waits. Check [program] format."


DEVICE_TYPES = [
    DeviceType(
        "fanuc_rmi",
        "robot",
        FanucRmiOptions,
        _build,
        _takes,
        program_format="fanuc-tp",
        simulated_by="fanuc_rmi",
        simulation_speed=1.0,
        usual_address="tcp://robot-controller:16001",
    )
]
