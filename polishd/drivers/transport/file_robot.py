"""A robot whose controller takes its program as one file, runs it by itself, and is watched meanwhile."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import TypeVar

from polishd.api import DeviceRefused, Plan, RobotTimes, Segment
from polishd.drivers.transport.file_watch import FileProgramTracker
from polishd.drivers.transport.program_robot import ProgramRobot

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
