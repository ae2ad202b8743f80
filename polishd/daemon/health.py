"""Health of a cell's computer: figures with limits, checked while the daemon runs.

The limits follow from the devices' watchdogs and from the data that the present pass still has to write; none is a
config key. A figure beyond its limit makes a polishing daemon leave contact and hold, before it is too late
(docs/how-to/host.md).
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterator, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from dataclasses import asdict, dataclass
from functools import partial
from heapq import nlargest
from pathlib import Path
from typing import Any

from polishd.daemon.cell.cell import Cell
from polishd.daemon.cell.device_polling import running_beside
from polishd.daemon.job.job import Job
from polishd.daemon.job.part_handling import approve
from polishd.daemon.job_assembly import NoJob
from polishd.daemon.journal.store import LATE_S
from polishd.daemon.runtime.events import EventBus
from polishd.daemon.runtime.memory import LEAST_MB, process_memory_mb
from polishd.daemon.socket.server import Handler
from polishd.model import events
from polishd.model.errors import ConfigError
from polishd.pipeline.disk_space import MB, SpaceNeeded, free_space

log = logging.getLogger(__name__)

BEAT_S = 0.1
"""Interval of the checks of the event loop."""
SLOW_S = 2.0
"""Interval of the checks of disks and memory."""
WINDOW_S = 60.0
"""Time for which a lag of the event loop counts."""
MEMORY_SHARE = 0.02
"""Smallest free share of the computer's memory; below it the kernel begins to kill processes."""
CGROUPS, OWN_CGROUPS = Path("/sys/fs/cgroup"), Path("/proc/self/cgroup")
V1_FILES, V2_FILES = ("memory.limit_in_bytes", "memory.usage_in_bytes"), ("memory.max", "memory.current")
MOST_MEMORY = 1 << 50
"""A larger limit of a control group counts as no limit."""
SHARE = 0.5
"""Largest lag as a share of a watchdog: after a larger one the next may be too late."""


NEAR = 0.75
"""Share of the longest wait of a row for its commit; after the whole wait the pass ends."""


@dataclass(frozen=True, slots=True)
class HealthFigure:
    """One figure; its name contains the unit."""

    name: str
    value: float
    limit: float
    advice: str
    least: bool = False
    """The limit is a minimum, else a maximum."""

    @property
    def fits(self) -> bool:
        """Whether it is within its limit."""
        return self.value >= self.limit if self.least else self.value <= self.limit

    def __str__(self) -> str:
        """Return the figure with its limit."""
        return f"{self.name} {self.value:.4g}, at {'least' if self.least else 'most'} {self.limit:.4g}"


class Health:
    """Health of one daemon's computer."""

    def __init__(self, cell: Cell, job: Callable[[], Job | NoJob]) -> None:
        self._cell = cell
        self._job = job
        self._lags: deque[tuple[float, float]] = deque()
        self._left: dict[str, HealthFigure] = {}

    def figures(self) -> list[HealthFigure]:
        """Return the present figures; those of disks and memory from the latest check."""
        return [*self._of_contact(), *self._left.values()]

    def wrong(self, *, in_contact: bool) -> str:
        """Return each figure beyond its limit with advice; empty if all fit. Loop and journal count in contact only."""
        figures = self.figures() if in_contact else list(self._left.values())
        return "; ".join(f"{figure}: {figure.advice}" for figure in figures if not figure.fits)

    def ages_s(self) -> Mapping[str, float]:
        """Return the time since the latest answer of each device that has answered, s."""
        now_s = time.monotonic()
        return {name: now_s - answered_s for name, answered_s in self._cell.answered_s.items()}

    def device(self, name: str) -> dict[str, Any]:
        """Return its identity, whether the job uses it, and the time since its latest answer."""
        found = self._cell.identities.get(name)
        age_s = self.ages_s().get(name)
        return {**(asdict(found) if found else {}), "used": self._cell.uses(name), "heard_s_ago": age_s}

    async def look(self) -> None:
        """Check disks and memory."""
        job = self._job()
        journal, begun = job.journal, job.journal.unfinished()
        state_dir = journal.store.path.parent
        if isinstance(job, NoJob):
            writes, run_dir = SpaceNeeded.of(0), state_dir
        else:
            # a program that is rewritten keeps its lines
            blocks, done = (job.program.lines, 0) if begun is None else (begun.blocks, journal.tally(begun.cycle).done)
            writes, run_dir = SpaceNeeded.of(blocks, done, journal.done - done), job.folder.path
        try:
            self._left = await asyncio.to_thread(_left, state_dir, run_dir, writes)
        except OSError as error:
            log.warning("the free space of the disks cannot be read: %s", error)

    @asynccontextmanager
    async def watching(self, danger: Callable[[str], None]) -> AsyncIterator[None]:
        """Check all figures inside this block; ``danger`` gets each message at every check while it applies."""
        async with running_beside({"check event loop": self._beat(danger), "check disks and memory": self._look_on()}):
            yield

    async def _beat(self, danger: Callable[[str], None]) -> None:
        pressed = False
        while True:
            due_s = time.monotonic() + BEAT_S
            await asyncio.sleep(BEAT_S)
            now_s = time.monotonic()
            pressing = self._cell.pressing
            if pressing and not pressed:
                self._lags.clear()  # out of contact the loop may be late
            pressed = pressing
            self._lags.append((now_s, now_s - due_s))
            while self._lags[0][0] < now_s - WINDOW_S:
                self._lags.popleft()
            if found := self.wrong(in_contact=pressing):
                danger(found)

    async def _look_on(self) -> None:
        while True:
            await self.look()
            await asyncio.sleep(SLOW_S)

    def _of_contact(self) -> list[HealthFigure]:
        limits = self._cell.limits
        fed_s = min(limits.actuator.watchdog_s, limits.spindle.watchdog_s, limits.robot.watchdog_s)
        lags = nlargest(2, (lag for _, lag in self._lags))
        second = lags[1] if len(lags) > 1 else 0.0  # a single one may be chance
        busy, slow = "too much else runs on this computer", "the disk of cell.state_dir is too slow"
        return [
            HealthFigure("loop_lag_s", second, SHARE * fed_s, busy),
            HealthFigure("journal_s", self._job().journal.unsaved_s, NEAR * LATE_S, slow),
        ]


def _left(state_dir: Path, run_dir: Path, writes: SpaceNeeded) -> dict[str, HealthFigure]:
    """Return figures of the disk space that a pass and its job still need, and of memory."""
    found = []
    for room in free_space(state_dir, run_dir, writes):
        advice = f"make room on the disk of {room.folder}"
        found.append(HealthFigure(room.name, room.left_mb, room.needed_mb, advice, least=True))
        if room.left_files is not None:
            advice = f"delete files on the disk of {room.folder}, which runs out of inodes (df -i shows them)"
            found.append(HealthFigure(room.files_name, room.left_files, room.needed_files, advice, least=True))
    if (memory := _memory_mb()) is not None:
        total_mb, left_mb = memory
        advice = "end other programs on this computer, or give the service more (MemoryMax)"
        found.append(HealthFigure("memory_mb", left_mb, MEMORY_SHARE * total_mb, advice, least=True))
    if (own := process_memory_mb()) is not None:
        left_mb, limit = own
        advice = f"raise the limit of the daemon's process ({limit}), or restart it and find what grows in it"
        found.append(HealthFigure("process_memory_mb", left_mb, LEAST_MB, advice, least=True))
    return {figure.name: figure for figure in found}


def _memory_mb() -> tuple[float, float] | None:
    """Return total and available memory; None if the kernel does not report it.

    Of the computer or of the control group (service, container), whichever has the smaller share left.
    """
    found = [*([host] if (host := _host_memory_mb()) else []), *_group_memory_mb()]
    return min(found, key=lambda one: one[1] / one[0], default=None)


def _group_memory_mb(root: Path = CGROUPS, own: Path = OWN_CGROUPS) -> Iterator[tuple[float, float]]:
    """Yield limit and free memory of each control group of this process that has a limit."""
    try:
        lines = own.read_text().splitlines()
    except OSError:
        return
    for line in lines:
        _, controllers, path = line.split(":", 2)
        if controllers and "memory" not in controllers.split(","):
            continue
        base = root / "memory" if controllers else root
        limit, used = V1_FILES if controllers else V2_FILES
        folder = base / path.lstrip("/")
        while True:
            with suppress(OSError, ValueError):  # a group without a limit says "max", or the root has no such file
                total = int((folder / limit).read_text())
                cache = dict(line.split() for line in (folder / "memory.stat").read_text().splitlines())
                left = total - int((folder / used).read_text()) + int(cache.get("inactive_file", 0))
                if 0 < total < MOST_MEMORY:
                    yield total / MB, max(left, 0) / MB
            if folder == base:
                break
            folder = folder.parent


def _host_memory_mb() -> tuple[float, float] | None:
    try:
        lines = dict(line.split(":", 1) for line in Path("/proc/meminfo").read_text().splitlines())
    except OSError:
        return None
    total_mb, left_mb = (int(lines[key].split()[0]) * 1024 / MB for key in ("MemTotal", "MemAvailable"))
    return total_mb, left_mb


# Commands of status displays: answered from memory in bounded time, without a request to a device.

MOST_ALARMS = 1000
"""Largest number of alarms that one command acknowledges."""


def status_snapshot(
    cell: Cell, health: Health, bus: EventBus, standing: Callable[[], Mapping[str, Any]]
) -> dict[str, Handler]:
    """Return the handlers of these commands; ``standing`` returns the state of the daemon."""
    return {
        "live": partial(_live, cell, health, standing),
        "acknowledge": partial(_acknowledge, bus),
        "approve": partial(approve, cell, bus.publish),
    }


async def _live(cell: Cell, health: Health, standing: Callable[[], Mapping[str, Any]]) -> Mapping[str, Any]:
    return {
        **standing(),
        "pressing": cell.pressing,
        "leaving": cell.leaving if cell.pressing else "",
        "approval": cell.approval.wanted,
        "readings": cell.live.facts(),
        "ages_s": health.ages_s(),
        **health_snapshot(cell, health),
    }


def health_snapshot(cell: Cell, health: Health) -> dict[str, Any]:
    """Return devices not confirmed safe, the refused map while another is due, signals and figures."""
    return {
        "unsafe": list(cell.unsafe),
        "map_refused": None if cell.map_refusal is None else asdict(cell.map_refusal),
        "signals": cell.signals.facts(),
        "health": {figure.name: {**asdict(figure), "fits": figure.fits} for figure in health.figures()},
    }


async def _acknowledge(bus: EventBus, alarms: Sequence[Any], by: str = "") -> Mapping[str, Any]:
    """Publish the acknowledgment, which is journalled; the reader of the journal matches it with the alarms."""
    if len(alarms) > MOST_ALARMS or not all(type(one) is int and one > 0 for one in alarms):
        raise ConfigError(f"alarms must be numbers of events in the journal, {MOST_ALARMS} at most. Check the numbers")
    bus.publish(events.AlarmAcknowledged(alarms=list(alarms), by=by))
    return {"acknowledged": list(alarms)}
