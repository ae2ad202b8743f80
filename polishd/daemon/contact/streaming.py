"""Stream a plan to the robot, a bounded time ahead of execution, and record the executed blocks."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

from polishd.daemon.cell.cell import Cell
from polishd.daemon.cell.device_polling import root_cause
from polishd.daemon.cell.time_limits import LOOK_S
from polishd.daemon.contact.contact_record import ContactRecord
from polishd.daemon.contact.interruption import ASK_S, mark_interrupted
from polishd.daemon.contact.progress import STEP_S, Progress, ProgressLimits, low_override
from polishd.daemon.contact.safety import reraise_after_safe, run_to_completion
from polishd.daemon.journal.journal import Journal
from polishd.interfaces import Clock, Robot
from polishd.model.devices import ExecutedBlock, RobotProgress
from polishd.model.errors import DeviceError, DeviceFault, DeviceRefused, PolishdError, SafetyStop
from polishd.model.program import Plan
from polishd.process.removal.excess import ExcessMap

log = logging.getLogger(__name__)

OnProgress = Callable[[RobotProgress], None]
Ended = Callable[[asyncio.Task[None]], None]

CHUNK = 128
"""Number of blocks sent at once."""
WATCH_S = 0.1
SLOW_LOOKS = 2
"""Consecutive reports of a low speed override: a single one may show an acceleration."""
STANDS = 3
"""Consecutive reports of a standstill: fewer may be a coincidence of timing."""


class Stream:
    """One pass of a plan on a robot: approach, polish, retreat; each block once and in order."""

    def __init__(
        self,
        plan: Plan,
        robot: Robot,
        clock: Clock,
        stream_ahead_s: float,
        least_s: float,
        *,
        on_progress: OnProgress = lambda _: None,
        limits: ProgressLimits | None = None,
        excess: ExcessMap | None = None,
    ) -> None:
        """``least_s`` of motion must be left in contact, enough until the tool is up after any fault.

        ``on_progress`` receives each progress report of the robot. ``limits`` and ``excess`` of its progress.
        """
        self._limits = limits or ProgressLimits()
        self._progress = Progress(plan, self._limits, excess)
        self._lands = False
        """The tool moves to the part or is on it."""
        self._on_progress = on_progress
        self._plan = plan
        self._robot = robot
        self._clock = clock
        self._stream_ahead_s = stream_ahead_s
        self._least_s = least_s
        self._in_contact = False
        self._sent = 0
        self._executed = robot.executed(0)
        self._filled = asyncio.Event()
        self._short: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        """Fails when the robot holds too little motion."""
        self._target: int | None = None
        """The robot has to run the blocks below it; None while it has to stand."""

    async def feed(self) -> None:
        """Keep the robot's buffer between one and two look-aheads until all blocks are sent."""
        segments = self._plan.segments
        while self._sent < len(segments):
            chunk = segments[self._sent : self._sent + CHUNK]
            await self._robot.send(chunk)
            self._sent += len(chunk)
            if self._robot.buffer_s >= self._stream_ahead_s:
                self._filled.set()
            while self._robot.buffer_s >= 2 * self._stream_ahead_s:
                self._filled.set()
                await self._clock.sleep(self._stream_ahead_s / 10)
        self._filled.set()

    async def watch(self) -> None:
        """Raise SafetyStop if the robot reports a standstill when it has to run, or holds too little motion.

        Also if it reports a speed override that is too low while the tool moves to the part or is on it.
        """
        standing = slow = 0
        while True:
            await self._clock.sleep(WATCH_S)
            robot = await self._robot.progress()
            self._on_progress(robot)
            self._progress.reported(robot.executed, self._clock.now_s())
            problem = low_override(robot, self._limits.least_override) if self._lands else ""
            slow = slow + 1 if problem else 0
            if slow >= SLOW_LOOKS:
                raise SafetyStop(problem)
            self._check_supply()
            stands = self._target is not None and robot.state != "running" and robot.executed < self._target
            standing = standing + 1 if stands else 0
            if standing >= STANDS:
                raise SafetyStop(
                    f"the robot stands at block {robot.executed} of {self._target} ({robot.state}: {robot.detail})"
                )

    async def advance(self) -> None:
        """Raise SafetyStop if the robot executes nothing or is slower than planned, whatever state it reports."""
        while True:
            await self._clock.sleep(STEP_S)
            if self._target is not None and self._progress.executed < self._target:
                self._progress.look(self._clock.now_s(), in_contact=self._in_contact)

    async def supplied(self) -> None:
        """Raise SafetyStop as soon as the robot holds too little motion; the recording of its blocks goes on."""
        await self._short

    async def approach(self) -> None:
        """Move to the landing point, tool retracted, and stand there. DeviceRefused if the robot holds too little."""
        with contextlib.suppress(TimeoutError):  # the buffer of a robot may be shorter than the look-ahead
            async with asyncio.timeout(2 * self._stream_ahead_s):
                await self._filled.wait()
        if self._starves() and not self._robot.times.held_instructions:  # of which the plan has been checked
            raise DeviceRefused(
                f"the robot buffers {self._robot.buffer_s:.2f} s of motion; {self._least_s:.2f} s are needed to lift "
                "the tool if the actuator stops answering. Increase the controller's buffer, or reduce the actuator's "
                "watchdog or actuator.retract_s; nothing was moved"
            )
        if self._plan.approach_blocks:
            await self._robot.resume(until=self._plan.approach_blocks)
            async for _ in self._until(self._plan.approach_blocks):
                pass
        if problem := low_override(await self._robot.progress(), self._limits.least_override):
            raise DeviceRefused(f"{problem}; the tool did not land")
        self._lands = True

    async def polish(self) -> AsyncIterator[ExecutedBlock]:
        """Run the blocks in contact and yield each executed one; the robot then stands at the other landing point."""
        self._in_contact = True
        try:
            await self._robot.resume(until=self._plan.contact_blocks)
            async for block in self._until(self._plan.contact_blocks):
                yield block
        finally:
            self._in_contact = self._lands = False
            if self._progress.worst > 0.0:
                log.info("excess removal, at most %.0f%% of its limit", 100 * self._progress.worst)

    def leave(self) -> None:
        """Stop the checks while contact is left: the robot may stand or run dry. Executed blocks are still recorded."""
        self._in_contact, self._lands, self._target = False, False, None

    async def retreat(self) -> None:
        """Run the rest of the program, tool retracted."""
        last = len(self._plan.segments)
        if self._plan.contact_blocks < last:
            await self._robot.resume()
            async for _ in self._until(last):
                pass

    async def _until(self, end: int) -> AsyncIterator[ExecutedBlock]:
        self._progress.start(self._clock.now_s())
        self._target = end
        try:
            async for block in self._executed:
                self._progress.record(block, self._clock.now_s(), in_contact=self._in_contact)
                self._check_supply()
                yield block
                if block.seq >= end - 1:
                    return
        finally:
            self._target = None  # the robot has to stand then, whatever ended this part
        progress = await self._robot.progress()
        raise DeviceFault(
            f"the robot ended the program at block {progress.executed} of {end} ({progress.state}: {progress.detail})"
        )

    def _check_supply(self) -> None:
        """Leave contact while motion is left: a robot that runs dry stops with the tool on the part."""
        if self._in_contact and self._starves() and not self._short.done():
            self._short.set_exception(
                SafetyStop(
                    f"only {self._robot.buffer_s:.2f} s of motion are left in the robot at block {self._sent}, and "
                    f"a lift may take {self._least_s:.2f} s: the stream cannot keep up. "
                    "Increase job.stream_ahead_s or check the link"
                )
            )

    def _starves(self) -> bool:
        return self._sent < len(self._plan.segments) and self._robot.buffer_s < self._least_s


@asynccontextmanager
async def streaming(
    plan: Plan,
    robot: Robot,
    clock: Clock,
    stream_ahead_s: float,
    *,
    least_s: float,
    on_progress: OnProgress = lambda _: None,
    ended: Ended = lambda _: None,
    limits: ProgressLimits | None = None,
    excess: ExcessMap | None = None,
) -> AsyncIterator[Stream]:
    """Prepare the robot and feed it in the background during this block; ``ended`` is a done callback."""
    await robot.prepare(plan)
    stream = Stream(plan, robot, clock, stream_ahead_s, least_s, on_progress=on_progress, limits=limits, excess=excess)
    try:
        async with asyncio.TaskGroup() as group:
            tasks = [
                group.create_task(stream.feed(), name="feed robot"),
                group.create_task(stream.watch(), name="watch robot"),
                group.create_task(stream.advance(), name="watch progress"),
                group.create_task(stream.supplied(), name="watch supply"),
            ]
            for task in tasks:
                task.add_done_callback(ended)
            yield stream
            for task in tasks:
                task.cancel()
    except BaseExceptionGroup as errors:
        raise root_cause(errors) from errors


# Blocks in contact are recorded as the robot reports them, from its start until it stands again.

TURN_BLOCKS = 50
"""Number of blocks of a long report after which other tasks run."""


class Recorder:
    """Records the executed blocks of one pass in contact."""

    def __init__(
        self, cell: Cell, journal: Journal, cycle: int, touch: ContactRecord, group: asyncio.TaskGroup
    ) -> None:
        self._cell = cell
        self._journal = journal
        self._cycle = cycle
        self._touch = touch
        self._group = group
        self._task: asyncio.Task[None] | None = None
        self._news = asyncio.Event()

    async def follow(self, stream: Stream) -> None:
        """Polish until all blocks in contact are reported and decided; SafetyStop if the disk does not keep up.

        Recording goes on until ``close``, whatever ends this.
        """
        self._touch.begin(self._cell.clock.now_s())
        self._task = self._group.create_task(self._take(stream.polish()), name="record what is executed")
        try:
            while not (await asyncio.wait({self._task}, timeout=LOOK_S))[0]:
                self._journal.require_in_time()
        finally:
            stream.leave()
        self._task.result()
        await self._touch.known.wait()  # the actuator is monitored meanwhile: its silence ends this wait

    async def close(self) -> None:
        """After contact was left early: record the blocks that the robot still reports and the uncertain ones."""
        robot = None
        try:
            with contextlib.suppress(DeviceError, TimeoutError):
                async with asyncio.timeout(ASK_S):
                    robot = await self._caught_up()
            self._touch.flush()
            await mark_interrupted(self._cell, self._journal, self._cycle, self._touch, robot)
        except PolishdError as error:
            log.error("the uncertain blocks are not recorded (%s): the next start reads them from the robot", error)

    async def _take(self, blocks: AsyncIterator[ExecutedBlock]) -> None:
        turn = 0
        try:
            async for block in blocks:
                self._touch.add_block(block, self._cell.clock.now_s())
                self._news.set()
                turn += 1
                if turn % TURN_BLOCKS == 0:
                    await asyncio.sleep(0)
        except PolishdError as error:
            if not self._touch.left:
                raise
            log.warning("the robot stopped reporting while contact was left: %s", error)  # the first error comes first
        finally:
            self._news.set()

    async def _caught_up(self) -> RobotProgress:
        """Return the robot's progress once all blocks that it reports as executed are recorded."""
        robot = await self._cell.robot.progress()
        while self._task is not None and not self._task.done() and self._touch.last_seq + 1 < robot.executed:
            self._news.clear()
            await self._news.wait()
        return robot


@asynccontextmanager
async def recording(cell: Cell, journal: Journal, cycle: int, touch: ContactRecord) -> AsyncIterator[Recorder]:
    """Record executed blocks from before contact until it is left, including the blocks during the lift."""
    try:
        async with asyncio.TaskGroup() as group:
            recorder = Recorder(cell, journal, cycle, touch, group)
            try:
                yield recorder
            except BaseException as error:
                with reraise_after_safe(error):
                    await run_to_completion(recorder.close())
                raise
            touch.flush()
    except BaseExceptionGroup as errors:
        raise root_cause(errors) from errors
