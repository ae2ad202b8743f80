"""Watch a program that a controller runs: its file, the link that is polled, and the record of executed blocks.

A robot adapter has three parts. A ``PollingConnection`` reads snapshots from the controller. A ``ProgramTracker`` turns
the snapshots into executed blocks. A ``ProgramRobot`` (program_robot.py) gives the commands.
"""

from __future__ import annotations

import asyncio
import math
import re
import time
from abc import ABC, abstractmethod
from array import array
from bisect import bisect_left
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Sequence
from typing import Generic, Protocol, TypeVar

import numpy as np

from polishd.drivers.transport.background import Background, Ready
from polishd.model.devices import ExecutedBlock, RobotProgress, RobotState
from polishd.model.errors import DeviceFault, LinkError
from polishd.model.program import Plan
from polishd.model.surface import FloatArray

_COMMENT = re.compile(rb"\([^()]*\)|;.*")
_END = re.compile(rb"(?<![A-Z#])M0*(?:2|30)(?:\.0*)?(?![0-9.])")


class ProgramFile:
    """A program as one file: its blocks, ``at_stop(stop)`` before each of ``stops``, ``at_end(end)`` before its end.

    The last line of ``at_stop`` pauses the controller. A pause keeps all modal state, which *run from line* would lose.
    A program without an end gets ``end_line``; where that is empty, the program is no G-code and has its own end.
    """

    def __init__(
        self,
        blocks: Sequence[bytes],
        stops: Iterable[int],
        at_stop: Callable[[int], Sequence[bytes]],
        at_end: Callable[[int], Sequence[bytes]],
        end_line: bytes = b"M2",
    ) -> None:
        self.blocks = len(blocks)
        ends = (seq for seq, block in enumerate(blocks) if _ends(block, seq)) if end_line else ()
        end = next(iter(ends), self.blocks)
        self.stops = tuple(sorted({stop for stop in stops if 0 < stop <= min(end, self.blocks - 1)}))
        self.inserted: list[int] = []
        """Indices, in the file, of the lines that the driver added."""
        self.pauses: dict[int, int] = {}
        """1-based line of each pause: number of blocks that are executed there."""
        lines: list[bytes] = []
        at = 0
        for stop in self.stops:
            lines += blocks[at:stop]
            self._insert(lines, at_stop(stop), stop)
            at = stop
        lines += blocks[at:end]
        self._insert(lines, at_end(end), end)
        self.lines = (*lines, *(blocks[end:] or [end_line] * bool(end_line)))
        self.text = b"\n".join([*self.lines, b""])

    def _insert(self, lines: list[bytes], own: Sequence[bytes], executed: int) -> None:
        self.inserted += range(len(lines), len(lines) + len(own))
        lines += own
        if own:
            self.pauses[len(lines)] = executed

    def block_at(self, line: int) -> int:
        """The block at a 1-based line of the file, or the next one where the driver added the line."""
        index = max(line - 1, 0)
        return min(index - bisect_left(self.inserted, index), self.blocks)


def _ends(block: bytes, seq: int) -> bool:
    """Whether the interpreter ends the program here: M2, M30, or the second ``%``."""
    code = b"".join(_COMMENT.sub(b"", block).split()).upper()
    return bool(_END.search(code)) or (code == b"%" and seq > 0)


def planned_block_s(plan: Plan, blocks: int) -> FloatArray:
    """Planned time of each block, (blocks,) s; 0 without one.

    Where dwells carry the time, that of the move to the point belongs to the block before the dwell: in reports that
    come seldom, a dwell and the next move end together, and share the time between two reports.
    """
    program, planned = plan.program, np.zeros(blocks)
    is_inside = program.block < blocks
    timed, expected_s = program.block[is_inside], plan.expected_time_s[is_inside]
    planned[timed] = expected_s
    if program.encoding == "dwell":
        before = timed - 1
        moves = (before >= 0) & ~np.isin(before, timed)
        move_s = np.maximum(expected_s - program.time_s[is_inside], 0.0)[moves]
        planned[before[moves]] = move_s
        planned[timed[moves]] -= move_s
    return planned


class LoadedProgram(Protocol):
    """A program that the controller has loaded, with its stops."""

    stops: tuple[int, ...]
    """Blocks before which it stops."""


BLOCK_S = 0.01
"""Approximate time of a block beyond its dwell."""
START_S = 1.0
"""Longest time from the command to run until the controller reports that it runs."""


class ProgramTracker:
    """What a controller has executed of one program, and when, from its load to its end. Sans-IO.

    An adapter adds ``update(snapshot)``: it calls ``tick`` with the controller's time and ``stretch`` with the blocks
    that are over, and sets ``state``, ``detail``, ``stopped``, ``runs`` and ``held_at``. Times are process time, which
    does not advance while the robot is held.
    """

    def __init__(self, plan: Plan, blocks: int) -> None:
        self.sha256 = plan.program.sha256
        self.blocks = blocks
        self.state: RobotState = "held"
        self.detail = ""
        self.dropped = False
        """The rest of the program will not be executed."""
        self.stopped = ""
        """Why the robot stands although it was commanded to run; empty if it does not, or for an unknown reason."""
        self.started = False
        self.file: LoadedProgram | None = None
        """The file that the controller has loaded."""
        self.held_at: int | None = None
        """The stop of the file at which the robot stands."""
        self.runs = False
        """The controller has reported that it runs since the last command to run."""
        self.clock_s = 0.0
        self.began_s = 0.0
        """When the block under way began."""
        self.seen_s = self._commanded_s = 0.0
        self._start_s, self._end_s = array("d"), array("d")
        # left_s is read at each period of contact: the sums are made once
        self._timed = plan.program.block
        self._ahead_s = np.cumsum(np.append(plan.expected_time_s, 0.0)[::-1])[::-1]

    def __len__(self) -> int:
        return len(self._end_s)

    def __getitem__(self, seq: int) -> ExecutedBlock:
        return ExecutedBlock(seq, self._start_s[seq], self._end_s[seq])

    @property
    def ended(self) -> bool:
        """No more records will come."""
        return self.dropped or self.state in ("done", "fault")

    @property
    def is_start_over(self) -> bool:
        """The controller runs, or has had the time to start: from now on a stop is a stop."""
        return self.runs or self.clock_s - self._commanded_s > START_S

    def left_s(self) -> float:
        """Approximate time of the rest of the plan."""
        timed_s = float(self._ahead_s[np.searchsorted(self._timed, len(self))])
        return timed_s + BLOCK_S * (self.blocks - len(self))

    def expected_s(self, to: int) -> float:
        """Planned time of the blocks below ``to`` that are not executed yet."""
        first, last = np.searchsorted(self._timed, (len(self), to))
        return float(self._ahead_s[first] - self._ahead_s[last])

    def progress(self, accepted: int, buffer_s: float, override: float | None = None) -> RobotProgress:
        """The answer to ``Robot.progress``."""
        return RobotProgress(
            state=self.state,
            program_sha256=self.sha256,
            accepted=max(accepted, len(self)),
            executed=len(self),
            buffer_s=buffer_s,
            detail=self.detail,
            override=override,
        )

    def go(self, time_s: float, detail: str = "") -> None:
        """Begin to run at that time of the controller's clock."""
        self.state, self.detail, self.started = "running", detail, True
        self.held_at = None
        self.seen_s, self._commanded_s, self.runs = time_s, self.clock_s, False

    def tick(self, time_s: float) -> None:
        """Advance the process time: the robot ran until that time of the controller's clock."""
        self.clock_s += max(time_s - self.seen_s, 0.0)
        self.seen_s = time_s

    def drop(self, reason: str) -> None:
        """End the program before its end."""
        self.dropped, self.detail = True, reason
        if self.state == "running":
            self.state = "held"

    def stretch(
        self,
        shares_s: FloatArray,
        *,
        low_s: float | None = None,
        high_s: float | None = None,
        reaches: bool = True,
        spread: float = 0.0,
    ) -> None:
        """Record the next n blocks as executed, each with its share of the time, (n,) s: see ``stretch_ends``.

        ``low_s`` defaults to the begin of the block under way, ``high_s`` to the present process time.
        """
        low_s = self.began_s if low_s is None else low_s
        high_s = self.clock_s if high_s is None else high_s
        ends = stretch_ends(self.began_s, shares_s, low_s, high_s, reaches=reaches, spread=spread).tolist()
        self._start_s.extend([self.began_s, *ends[:-1]])
        self._end_s.extend(ends)
        self.began_s = ends[-1]


def stretch_ends(
    began_s: float, shares_s: FloatArray, low_s: float, high_s: float, *, reaches: bool = True, spread: float = 0.0
) -> FloatArray:
    """Ends of n blocks in a row, (n,) s, rising: by their expected times, within the reports that they lie between.

    Args:
        began_s: When the first block began, at most ``low_s``.
        shares_s: Expected time of each block, (n,) s. All zero: the blocks share the time evenly.
        low_s: No block had ended by then.
        high_s: All blocks have ended by then.
        reaches: The last block ended at ``high_s``.
        spread: Share of the time that is spread evenly, so that no block lasts no time at all.
    """
    even = np.arange(1, len(shares_s) + 1) / len(shares_s)
    total_s = float(shares_s.sum())
    ends = began_s + (np.cumsum(shares_s) if total_s > 0.0 else (high_s - began_s) * even)
    if total_s > 0.0 and (reaches or ends[-1] > high_s):
        ends = began_s + np.cumsum(shares_s) * (high_s - began_s) / total_s
    ends = np.clip(ends, low_s, high_s)
    if reaches:
        ends[-1] = high_s
    return np.asarray((1.0 - spread) * ends + spread * (low_s + (high_s - low_s) * even))


def time_shares(took_s: float, asked_s: FloatArray, asked_total_s: float, rest: np.ndarray) -> FloatArray:
    """Shares of ``took_s`` for n blocks that one report finds executed, (n,) s.

    Args:
        took_s: Time of all n blocks.
        asked_s: Time that each block asks for, (n,) s; 0 where it asks for none.
        asked_total_s: Time of all blocks that ask for one; they share it in proportion.
        rest: Blocks that share the rest evenly, (n,) bool. None: the blocks that ask for a time have it all.
    """
    asked_sum_s, shares = float(asked_s.sum()), np.zeros(len(asked_s))
    if asked_sum_s > 0.0:
        asked_total_s = min(asked_total_s, took_s) if rest.any() else took_s
        shares = asked_s * (asked_total_s / asked_sum_s)
    if rest.any():
        shares[rest] += max(took_s - float(shares.sum()), 0.0) / np.count_nonzero(rest)
    return np.asarray(shares)


Link = TypeVar("Link")
Snapshot = TypeVar("Snapshot")
STANDS = 2
"""Snapshots in a row that show a standstill. One may be damaged, or from before a command."""
REST_S = 0.1
"""Time without motion after which a stop is over: a robot that brakes across an exact stop stands there briefly."""


async def comes_to_rest(
    read: Callable[[], Awaitable[Snapshot]],
    moves: Callable[[Snapshot, Snapshot], bool],
    every_s: float,
    within_s: float,
) -> bool:
    """Read snapshots over a link that is not polled until ``REST_S`` shows no motion. False: not within the time.

    ``moves(before, last)``: whether two snapshots in a row show motion, or a program that runs.
    """
    began_s = moved_s = time.monotonic()
    last = await read()
    while True:
        await asyncio.sleep(every_s)
        before, last = last, await read()
        now_s = time.monotonic()
        if moves(before, last):
            moved_s = now_s
        elif now_s - moved_s >= REST_S:
            return True
        if now_s - began_s > within_s:
            return False


class PollingConnection(Background, ABC, Generic[Link, Snapshot]):
    """A link to a controller from ``open`` to ``close``, read all the time. It can be opened again.

    An adapter fills in ``_connect``, ``_disconnect``, ``_snapshots`` and ``_stands``. All waiters get the error that
    ended the link.
    """

    def __init__(self, name: str, open_s: float, on_snapshot: Callable[[Snapshot], Awaitable[None]]) -> None:
        """``on_snapshot`` is called with each snapshot, before the waiters see it."""
        super().__init__(name)
        self._open_s = open_s
        self._on_snapshot = on_snapshot
        self._link: Link | None = None
        self._recent: tuple[Snapshot, ...] = ()
        """The last ``STANDS``, oldest first."""
        self.count = 0
        """Snapshots since the object was made."""
        self._moved_s = -math.inf
        """Time of the last snapshot that showed motion, on the event loop's clock."""

    @abstractmethod
    async def _connect(self) -> Link:
        """Open a new link and leave nothing open where that fails. Moves nothing."""

    @abstractmethod
    async def _disconnect(self, link: Link) -> None:
        """Close the link; idempotent."""

    @abstractmethod
    def _snapshots(self, link: Link) -> AsyncIterator[Snapshot]:
        """Yield snapshots until the link ends: poll and pause, or wait for what the controller sends."""

    @abstractmethod
    def _stands(self, recent: Sequence[Snapshot]) -> bool:
        """Whether the last ``STANDS`` snapshots show that no program runs and nothing moves."""

    @property
    def link(self) -> Link:
        """The open link. LinkError while there is none, and the link's own error once it is lost."""
        if self._link is None:
            raise LinkError(f"{self.name}: is not open")
        self.check()
        return self._link

    @property
    def last(self) -> Snapshot:
        """The last snapshot; errors as ``link``."""
        self.check()
        if not self._recent:
            raise LinkError(f"{self.name}: is not open")
        return self._recent[-1]

    @property
    def stands(self) -> bool:
        """No program runs and nothing moves, by ``STANDS`` snapshots in a row."""
        return len(self._recent) == STANDS and self._stands(self._recent)

    async def open(self) -> None:
        """Connect and take ``STANDS`` snapshots."""
        self._link = await self._connect()
        try:
            await self.start(self._follow, self._open_s)
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        """Disconnect; idempotent."""
        await self.stop()
        link, self._link = self._link, None
        self._recent = ()
        if link is not None:
            await self._disconnect(link)

    async def standstill(self, command: str, within_s: float, after: int = STANDS) -> None:
        """Wait until a snapshot at least ``after`` later than now shows a standstill; DeviceFault otherwise.

        No snapshot of the last ``REST_S`` shows motion.
        """
        count, now_s = self.count + after, asyncio.get_running_loop().time

        def is_over() -> bool:
            return self.count >= count and self.stands and now_s() - self._moved_s >= REST_S

        if not await self.until(is_over, within_s):
            raise DeviceFault(f"{self.name}: still moving {within_s:g} s after {command}. Stop it at its controller.")

    async def _follow(self, ready: Ready) -> None:
        if self._link is None:
            raise LinkError(f"{self.name}: is not open")
        async for snapshot in self._snapshots(self._link):
            self._recent = (*self._recent, snapshot)[-STANDS:]
            self.count += 1
            if not self.stands:
                self._moved_s = asyncio.get_running_loop().time()
            await self._on_snapshot(snapshot)
            if len(self._recent) == STANDS:
                ready()
            self.fire()
