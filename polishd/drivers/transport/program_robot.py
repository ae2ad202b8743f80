"""A robot whose controller gets the whole program before it runs any of it, and is watched meanwhile."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import AsyncIterator, Callable, Sequence
from typing import Generic, TypeVar

from polishd.drivers.transport.background import Background
from polishd.drivers.transport.program_tracker import FileProgramTracker, ProgramTracker
from polishd.model.devices import ExecutedBlock, RobotProgress, RobotState, RobotTimes
from polishd.model.errors import DeviceFault, DeviceRefused
from polishd.model.program import Plan, Segment

# Blocks as a robot is handed them.


def new_blocks(segments: Sequence[Segment], accepted: int, longest_line: int, name: str) -> list[Segment]:
    """Those that the robot does not have yet; DeviceRefused for blocks out of turn, and for what is no line (bytes)."""
    if any(segment.seq != segments[0].seq + at for at, segment in enumerate(segments)):
        raise DeviceRefused(f"{name}: blocks are not numbered one by one")
    new = [segment for segment in segments if segment.seq >= accepted]
    if new and new[0].seq > accepted:
        raise DeviceRefused(f"{name}: the robot expects block {accepted}, not {new[0].seq}")
    for segment in new:
        if b"\n" in segment.text or len(segment.text) > longest_line:
            raise DeviceRefused(f"{name}: block {segment.seq} is no single line of at most {longest_line} bytes")
    return new


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


# A robot whose controller takes its program as one file, runs it by itself, and is watched meanwhile.

FileTracker = TypeVar("FileTracker", bound=FileProgramTracker)
Goes = Callable[[float], bool]
"""Asked right before the order to run, with the controller's time: whether it is still wanted."""


class FileRobot(ProgramRobot[FileTracker]):
    """The Robot port but for what differs between controllers: see the abstract methods.

    It stops only where the file has a pause: at the plan's own stops, and the first ``until``. A stop that nobody asked
    for is passed.
    """

    def __init__(self, name: str, times: RobotTimes) -> None:
        super().__init__(name, times)
        self._stays = 0
        """How often it was told to stay: a start from before counts no more."""

    @abstractmethod
    def _moves(self) -> bool:
        """Whether the controller runs a program, by its own word."""

    @abstractmethod
    async def _empty(self) -> None:
        """Make the controller ready for another program. DeviceRefused where it is not to have one."""

    @abstractmethod
    def _watched(self, plan: Plan, blocks: int) -> FileTracker:
        """What will follow that program."""

    @abstractmethod
    async def _load(self, plan: Plan, watch: FileTracker) -> None:
        """Give the controller the file, and set ``watch.file``. DeviceRefused where it does not take it."""

    @abstractmethod
    async def _run(self, watch: FileTracker, goes: Goes) -> None:
        """Order it to run, from the beginning or on from where it stands."""

    async def prepare(self, plan: Plan) -> None:
        """See Robot. DeviceRefused while the controller runs a program, or is not ready to."""
        self._background.check()
        if self._running():
            raise DeviceRefused(f"{self._name}: a program is running; hold it first")
        await self._empty()
        self._announce(plan, self._watched)

    async def send(self, segments: Sequence[Segment]) -> None:
        """See Robot. With the last block the controller gets the file. DeviceRefused where it cannot read it."""
        plan, watch = self._loaded()
        if self._collect(segments):
            await self._load(plan, watch)
            if self._pending:
                await self._start(plan, watch)

    async def resume(self, until: int | None = None) -> None:
        """See Robot."""
        plan, watch = self._loaded()
        if watch.ended:
            raise DeviceRefused(f"{self._name}: the program is over ({watch.state}: {watch.detail}); prepare one")
        self._background.check()
        if until is not None and until <= len(watch):
            return
        if watch.started and watch.file is not None and until not in (None, *watch.file.stops, watch.blocks):
            stops = ", ".join(map(str, watch.file.stops))
            raise DeviceRefused(f"{self._name}: can stop at {stops}, not at block {until}: prepare it anew")
        if not self._waits(until) and watch.state != "running":
            await self._start(plan, watch)

    async def lift(self, distance_mm: float) -> None:
        """See Robot. Refused: the controller would have to stop first, with the tool on the part.

        It has the whole program, so that motion goes on along that until the actuator has let go by itself.
        """
        raise DeviceRefused(f"{self._name}: cannot lift by {distance_mm:g} mm out of a running program")

    def _stops(self, plan: Plan) -> set[int]:
        """Where the file is to have a pause."""
        return {plan.approach_blocks, plan.contact_blocks, self._target or 0}

    async def _start(self, plan: Plan, watch: FileTracker) -> None:
        """From the beginning, or on from where it stands."""
        stays = self._stays
        self._pending = False
        if watch.file is None or (not watch.started and self._target not in (None, *watch.file.stops)):
            await self._load(plan, watch)

        def goes(time_s: float) -> bool:
            if stays == self._stays:
                watch.go(time_s)
            return stays == self._stays

        await self._run(watch, goes)

    async def _pass_stops(self) -> None:
        """Go on from a stop that nobody asked for."""
        plan, watch = self._plan, self._watch
        if plan is None or watch is None or watch.held_at is None or watch.dropped:
            return
        if self._target is None or self._target > watch.held_at:
            await self._start(plan, watch)

    def _running(self) -> bool:
        return self._moves() or (self._watch is not None and self._watch.state == "running")

    def _stay(self) -> None:
        super()._stay()
        self._stays += 1
