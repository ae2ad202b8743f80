"""A robot whose controller gets the whole program before it runs any of it, and is watched meanwhile."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import AsyncIterator, Callable, Sequence
from typing import Generic, TypeVar

from polishd.api import DeviceFault, DeviceRefused, ExecutedBlock, Plan, RobotProgress, RobotTimes, Segment
from polishd.drivers.transport.background import Background
from polishd.drivers.transport.blocks import new_blocks
from polishd.drivers.transport.program_watch import ProgramTracker
from polishd.model.devices import RobotState

Tracker = TypeVar("Tracker", bound=ProgramTracker)


class ProgramRobot(ABC, Generic[Tracker]):
    """Of the Robot port what such robots share: blocks are collected, what is executed is told as it is watched."""

    longest_line: int
    """Bytes."""

    def __init__(self, name: str, times: RobotTimes) -> None:
        self._name = name
        """For messages."""
        self._times = times
        self._plan: Plan | None = None
        self._lines: list[bytes] = []
        self._watch: Tracker | None = None
        self._target: int | None = None
        """Blocks below it are to be run; None for all."""
        self._pending = False
        """Told to run before the program was complete."""

    @property
    @abstractmethod
    def _background(self) -> Background:
        """What looks at the controller all the time, and fires at each look."""

    @abstractmethod
    def _running(self) -> bool:
        """Something runs that was not told to stand."""

    @property
    def times(self) -> RobotTimes:
        """See Robot."""
        return self._times

    def _override(self) -> float | None:
        """Speed override of the controller's last report, as a fraction; None: it reports none."""
        return None

    @property
    def buffer_s(self) -> float:
        """See Robot. All that is left, once the controller has the program. 0 before, and while the link is down."""
        watch, plan = self._watch, self._plan
        if watch is None or plan is None or len(self._lines) < watch.blocks or not self._background.alive:
            return 0.0
        return watch.left_s()

    async def progress(self) -> RobotProgress:
        """See Robot."""
        self._background.check()
        if self._watch is None:
            state: RobotState = "running" if self._running() else "idle"
            return RobotProgress(state, "", 0, 0, 0.0, override=self._override())
        return self._watch.progress(len(self._lines), self.buffer_s, self._override())

    async def executed(self, from_seq: int = 0) -> AsyncIterator[ExecutedBlock]:
        """See Robot. DeviceFault when the controller stops by itself, or ends the program before its end."""
        self._background.check()
        watch, seq = self._watch, from_seq
        while watch is not None:
            while seq < len(watch):
                yield watch[seq]
                seq += 1
            if watch is self._watch and watch.stopped:
                raise DeviceFault(f"{self._name}: {watch.stopped}")  # at once: a tool that stands digs
            if watch is not self._watch or watch.ended:
                if watch.state == "fault":
                    raise DeviceFault(f"{self._name}: {watch.detail}")
                return
            await self._background.until(_news(watch))

    def _announce(self, plan: Plan, make: Callable[[Plan, int], Tracker]) -> None:
        """Begin to collect its blocks, and to watch it; what was there before is dropped."""
        self._plan, self._lines, self._target, self._pending = plan, [], None, False
        self._watch = make(plan, len(plan.segments) or plan.program.block_count)

    def _collect(self, segments: Sequence[Segment]) -> bool:
        """Take blocks; tells whether these make the program complete. DeviceRefused as in ``new_blocks``."""
        _, watch = self._loaded()
        new = new_blocks(segments, len(self._lines), self.longest_line, self._name)
        self._lines += [segment.text for segment in new]
        return bool(new) and len(self._lines) >= watch.blocks

    def _waits(self, until: int | None) -> bool:
        """Be told to run to there; tells whether that waits for the rest of the program."""
        _, watch = self._loaded()
        self._target = until
        if len(self._lines) >= watch.blocks:
            return False
        self._pending = True
        watch.state, watch.detail = "running", "waits for the rest of the program"
        return True

    def _stay(self) -> None:
        """Nothing is asked of it any more."""
        if self._pending and self._watch is not None:
            self._watch.state, self._watch.detail = "held", ""
        self._pending, self._target = False, 0

    def _drop(self) -> None:
        """What was under way is not gone on with."""
        if self._watch is not None and not self._watch.ended:
            self._watch.drop("aborted")
        self._background.fire()

    def _loaded(self) -> tuple[Plan, Tracker]:
        if self._plan is None or self._watch is None:
            raise DeviceRefused(f"{self._name}: no program: prepare one first")
        return self._plan, self._watch


def _news(watch: ProgramTracker) -> Callable[[], bool]:
    """Tells whether anything was executed since now, or the program is over."""
    count = len(watch)
    return lambda: len(watch) > count or watch.ended or bool(watch.stopped)
