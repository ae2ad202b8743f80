"""Blocks in contact are recorded as the robot tells of them, from its start until it stands again, whatever ends it."""

from __future__ import annotations

import asyncio
import contextlib
import logging
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from polishd.daemon.cell import Cell
from polishd.daemon.interruption import ASK_S, mark_interrupted
from polishd.daemon.journal import Journal
from polishd.daemon.listening import root_cause
from polishd.daemon.safety import reraise_after_safe, run_to_completion
from polishd.daemon.stream import Stream
from polishd.daemon.time_limits import LOOK_S
from polishd.daemon.touch import ContactRecord
from polishd.model.devices import ExecutedBlock, RobotProgress
from polishd.model.errors import DeviceError, PolishdError

TURN_BLOCKS = 50
"""Where many are told at once, others have their turns after so many."""

log = logging.getLogger(__name__)


class Recorder:
    """Follows the robot of one pass in contact."""

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
        """Polish: returns when all blocks in contact are told and judged, SafetyStop where the disk does not keep up.

        The robot is followed further until ``close``, whatever ends this.
        """
        self._touch.begin(self._cell.clock.now_s())
        self._task = self._group.create_task(self._take(stream.polish()), name="record what is executed")
        try:
            while not (await asyncio.wait({self._task}, timeout=LOOK_S))[0]:
                self._journal.require_in_time()
        finally:
            stream.leave()
        self._task.result()
        await self._touch.known.wait()  # the actuator is watched meanwhile: a silence ends it

    async def close(self) -> None:
        """After contact was left too early: record what the robot still tells, and how far the tool may have come."""
        robot = None
        try:
            with contextlib.suppress(DeviceError, TimeoutError):
                async with asyncio.timeout(ASK_S):
                    robot = await self._caught_up()
            self._touch.flush()
            await mark_interrupted(self._cell, self._journal, self._cycle, self._touch, robot)
        except PolishdError as error:
            log.error("what the tool may have touched is not recorded (%s): the next start asks the robot", error)

    async def _take(self, blocks: AsyncIterator[ExecutedBlock]) -> None:
        turn = 0
        try:
            async for block in blocks:
                self._touch.told(block, self._cell.clock.now_s())
                self._news.set()
                turn += 1
                if turn % TURN_BLOCKS == 0:
                    await asyncio.sleep(0)
        except PolishdError as error:
            if not self._touch.left:
                raise
            log.warning("while contact was left, the robot tells no more: %s", error)  # what ended it is told first
        finally:
            self._news.set()

    async def _caught_up(self) -> RobotProgress:
        """The robot's last word, once all that it says it executed is recorded."""
        robot = await self._cell.robot.progress()
        while self._task is not None and not self._task.done() and self._touch.last_seq + 1 < robot.executed:
            self._news.clear()
            await self._news.wait()
        return robot


@asynccontextmanager
async def recording(cell: Cell, journal: Journal, cycle: int, touch: ContactRecord) -> AsyncIterator[Recorder]:
    """From before contact until it is left: what runs while the tool is lifted is recorded, too."""
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
