"""Base of robots whose controller holds the whole program before it runs."""

from __future__ import annotations

import asyncio
import contextlib
from abc import ABC, abstractmethod
from collections.abc import AsyncIterator, Callable, Sequence
from typing import Any, Generic, TypeVar

from polishd.drivers.transport.program_tracker import PollingConnection, ProgramTracker
from polishd.model.devices import ExecutedBlock, RobotProgress, RobotState, RobotTimes
from polishd.model.errors import DeviceFault, DeviceRefused, LinkError, ProtocolError
from polishd.model.program import DATA_FILE_STAYS, Plan, Segment


def new_blocks(segments: Sequence[Segment], accepted: int, longest_line: int, name: str) -> list[Segment]:
    """Return the blocks that the robot does not hold. DeviceRefused for a gap, and for a block that is not one line."""
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
IsWanted = Callable[[float], bool]
"""Called right before the command to run, with the controller's time: whether the start is still wanted. Marks it."""


class ProgramRobot(ABC, Generic[Tracker]):
    """The Robot interface, except for what differs between controllers: see the abstract methods.

    The robot stops only where its file has a pause: at the stops of the plan, and at the first ``until``. It continues
    from a stop that is not wanted. A controller that can stop before any block sets ``stops_anywhere``.
    """

    longest_line: int
    """Longest line of the controller, bytes."""
    stops_anywhere = False
    delivers_data_file = False
    """The controller also gets the file beside the program."""

    def __init__(self, name: str, times: RobotTimes) -> None:
        """``name``: for messages."""
        self._name = name
        self._times = times
        self._plan: Plan | None = None
        self._lines: list[bytes] = []
        self._tracker: Tracker | None = None
        self._target: int | None = None
        """Run the blocks below it; None for all."""
        self._pending = False
        """Commanded to run before the program was complete."""
        self._holds = 0
        """Number of holds: a start from before the last one is not wanted any more."""
        self._starts = 0
        """Number of commands to run."""
        self._start_lock = asyncio.Lock()

    @property
    @abstractmethod
    def _connection(self) -> PollingConnection[Any, Any]:
        """The link that is polled."""

    @abstractmethod
    def _moves(self) -> bool:
        """Whether the controller reports that it runs a program."""

    @abstractmethod
    async def _clear(self) -> None:
        """Make the controller ready for another program. DeviceRefused where it is not ready for one."""

    @abstractmethod
    def _track(self, plan: Plan, blocks: int) -> Tracker:
        """A tracker for that program."""

    @abstractmethod
    async def _load(self, plan: Plan, tracker: Tracker) -> None:
        """Load the program into the controller, and set ``tracker.file``. DeviceRefused where it refuses it."""

    @abstractmethod
    async def _run(self, tracker: Tracker, wanted: IsWanted) -> None:
        """Command the controller to run, from the beginning or on from where it stands, if ``wanted`` agrees."""

    @abstractmethod
    async def _stop(self) -> None:
        """Stop whatever runs over the open link, and see that the robot stands."""

    @abstractmethod
    async def _stop_anew(self) -> None:
        """The same over a new link."""

    def _obstacle(self) -> str:
        """Why the controller would not run a program as written, by its last report; empty where it would."""
        return ""

    def _override(self) -> float | None:
        """Speed override of the controller's last report, as a fraction; None: it reports none."""
        return None

    @property
    def times(self) -> RobotTimes:
        """See Robot."""
        return self._times

    @property
    def buffer_s(self) -> float:
        """See Robot. All that is left, once the controller has the program. 0 before, and while the link is down."""
        tracker, plan = self._tracker, self._plan
        if tracker is None or plan is None or len(self._lines) < tracker.blocks or not self._connection.alive:
            return 0.0
        return tracker.left_s()

    async def make_safe(self) -> None:
        """See Device. Ends whatever runs, and the program with it. Connects for it if it has to."""
        self._stay()
        self._drop()
        if self._connection.alive:
            with contextlib.suppress(LinkError, ProtocolError):
                await self._stop()
                return
        await self._stop_anew()

    async def progress(self) -> RobotProgress:
        """See Robot."""
        self._connection.check()
        if self._tracker is None:
            state: RobotState = "running" if self._running() else "idle"
            return RobotProgress(state, "", 0, 0, 0.0, override=self._override())
        return self._tracker.progress(len(self._lines), self.buffer_s, self._override())

    async def executed(self, from_seq: int = 0) -> AsyncIterator[ExecutedBlock]:
        """See Robot. DeviceFault when the controller stops, or ends the program before its end."""
        self._connection.check()
        tracker, seq = self._tracker, from_seq
        while tracker is not None:
            while seq < len(tracker):
                yield tracker[seq]
                seq += 1
            if tracker is self._tracker and tracker.stopped:
                raise DeviceFault(f"{self._name}: {tracker.stopped}")  # at once: a tool that stands digs
            if tracker is not self._tracker or tracker.ended:
                if tracker.state == "fault":
                    raise DeviceFault(f"{self._name}: {tracker.detail}")
                return
            await self._connection.until(_has_news(tracker))

    async def prepare(self, plan: Plan) -> None:
        """See Robot. DeviceRefused while the controller runs a program, or is not ready to."""
        self._connection.check()
        if plan.program.beside and not self.delivers_data_file:
            raise DeviceRefused(f"{self._name}: {DATA_FILE_STAYS}")
        if self._tracker is not None and len(self._tracker) >= self._tracker.blocks:  # its program is about to end
            await self._connection.until(lambda: not self._running(), self._times.stop_s)
        if self._running():
            raise DeviceRefused(f"{self._name}: a program is running; hold it first")
        await self._clear()
        self._plan, self._lines, self._target, self._pending = plan, [], None, False
        self._tracker = self._track(plan, len(plan.segments) or plan.program.block_count)

    async def send(self, segments: Sequence[Segment]) -> None:
        """See Robot. With the last block the controller gets the file. DeviceRefused where it cannot read it."""
        plan, tracker = self._loaded()
        new = new_blocks(segments, len(self._lines), self.longest_line, self._name)
        self._lines += [segment.text for segment in new]
        if new and len(self._lines) >= tracker.blocks:
            await self._load(plan, tracker)
            if self._pending:
                await self._start(plan, tracker)

    async def resume(self, until: int | None = None) -> None:
        """See Robot. DeviceRefused where the controller would not run the program as written."""
        plan, tracker = self._loaded()
        if tracker.ended:
            raise DeviceRefused(f"{self._name}: the program is over ({tracker.state}: {tracker.detail}); prepare one")
        self._connection.check()
        if until is not None and until <= len(tracker):
            return
        if why := self._obstacle():
            raise DeviceRefused(f"{self._name}: {why}. Correct it at the controller, then try again")
        file = None if self.stops_anywhere or not tracker.started else tracker.file
        if file is not None and until not in (None, *file.stops, tracker.blocks):
            stops = ", ".join(map(str, file.stops))
            raise DeviceRefused(f"{self._name}: can stop at {stops}, not at block {until}: prepare it anew")
        self._target = until
        if len(self._lines) < tracker.blocks:
            self._pending = True
            tracker.state, tracker.detail = "running", "waits for the rest of the program"
        elif self.stops_anywhere or tracker.state != "running":
            await self._start(plan, tracker)

    async def lift(self, distance_mm: float) -> None:
        """See Robot. Refused: the controller would have to stop first, with the tool on the part.

        The controller has the whole program, so motion continues until the actuator has released the tool.
        """
        raise DeviceRefused(f"{self._name}: cannot lift by {distance_mm:g} mm out of a running program")

    def _stops(self, plan: Plan) -> set[int]:
        """Blocks before which the file has a pause."""
        return {plan.approach_blocks, plan.contact_blocks, self._target or 0}

    def _has_to_load(self, tracker: Tracker) -> bool:
        """Whether the controller needs the file, or another one, before it can run to the target."""
        file = tracker.file
        return file is None or (not tracker.started and self._target not in (None, *file.stops))

    async def _start(self, plan: Plan, tracker: Tracker) -> None:
        """From the beginning, or on from where it stands. One start at a time: a controller refuses the second."""
        holds, starts = self._holds, self._starts
        self._pending = False

        def wanted(time_s: float) -> bool:
            if holds == self._holds:
                self._starts += 1
                tracker.go(time_s)
            return holds == self._holds

        async with self._start_lock:
            if holds != self._holds or (starts != self._starts and not self.stops_anywhere):
                return  # held, or started by another call, while this one waited
            if self._has_to_load(tracker):
                await self._load(plan, tracker)
            await self._run(tracker, wanted)

    async def _pass_stops(self) -> None:
        """Continue from a stop that is not wanted. Called with each snapshot: a start that is under way does it."""
        if self._start_lock.locked():
            return
        plan, tracker = self._plan, self._tracker
        if plan is None or tracker is None or tracker.held_at is None or tracker.dropped:
            return
        if self._target is None or self._target > tracker.held_at:
            await self._start(plan, tracker)

    def _running(self) -> bool:
        """A program runs, or is about to."""
        return self._moves() or (self._tracker is not None and self._tracker.state == "running")

    def _stay(self) -> None:
        """Cancel every start that is under way."""
        if self._pending and self._tracker is not None:
            self._tracker.state, self._tracker.detail = "held", ""
        self._pending, self._target = False, 0
        self._holds += 1

    def _drop(self) -> None:
        """End the program under way before its end."""
        if self._tracker is not None and not self._tracker.ended:
            self._tracker.drop("aborted")
        self._connection.fire()

    def _loaded(self) -> tuple[Plan, Tracker]:
        if self._plan is None or self._tracker is None:
            raise DeviceRefused(f"{self._name}: no program: prepare one first")
        return self._plan, self._tracker


def _has_news(tracker: ProgramTracker) -> Callable[[], bool]:
    """A condition: a block was executed since now, or the program is over."""
    count = len(tracker)
    return lambda: len(tracker) > count or tracker.ended or bool(tracker.stopped)
