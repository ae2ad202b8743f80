"""Simulate a watched folder in virtual time: an instrument that writes in every bad way, faults, restarts.

The daemon's side is the real ``WatchedFolder`` over a real folder; polls are called, not waited for. Clocks are
numbers: the instrument's, the folder's, and the monotonic one. Nothing sleeps.
"""

from __future__ import annotations

import errno
import hashlib
import heapq
import itertools
import os
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from polishd.api import DeviceContext, SurfaceMap
from polishd.plugins.interferometer import map_files
from polishd.plugins.interferometer.formats.metropro import METROPRO
from polishd.plugins.interferometer.map_files import SettledFiles
from polishd.plugins.interferometer.watched_folder import FolderOptions, MapWait, WatchedFolder
from polishd.sim_backends.common.metropro import DatMap, pack

PART = "DEMO-100"
POLL_S, STABLE_S = 0.25, 2.0
BASE_S = 1_700_000_000.0
LOST_AFTER_S = 90.0
"""Virtual seconds after which a complete map that was not taken counts as lost."""
Step = tuple[float, Callable[[], None]]
"""Seconds to wait, and the action after them."""


class Killed(BaseException):
    """The daemon's process was killed: no code may catch this."""


class Disk:
    """Disk for the daemon's writes and renames, which can fail, be full, report wrong results, or kill the daemon."""

    def __init__(self, patch: pytest.MonkeyPatch, rng: np.random.Generator) -> None:
        self.rng = rng
        self.broken = 0.0
        """Probability that an operation fails."""
        self.full = False
        self.dies_in: int | None = None
        self.faults = 0
        patch.setattr(Path, "rename", self.around(Path.rename, writes=False))
        for module in (map_files, map_files):
            patch.setattr(module, "write_atomic", self.around(module.write_atomic, writes=True))

    def around(self, act: Callable[..., Any], *, writes: bool) -> Callable[..., Any]:
        """Return the operation with possible faults before and after it."""

        def acted(*args: Any) -> Any:
            dying = self.dies_in is not None and self.dies_in <= 0
            if self.dies_in is not None:
                self.dies_in -= 1
            failing = self.rng.random() < self.broken
            late = self.rng.random() < 0.5
            if dying and not late:
                raise Killed
            if writes and self.full:
                self.faults += 1
                raise OSError(errno.ENOSPC, "No space left on device", str(args[0]))
            if failing and not late:
                self.faults += 1
                raise OSError(self.rng.choice([errno.ESTALE, errno.EBUSY, errno.EIO]), "the share", str(args[0]))
            done = act(*args)
            if dying:
                raise Killed
            if failing and not writes:
                self.faults += 1
                raise OSError(errno.ESTALE, "done, and said not to be", str(args[0]))
            return done

        return acted


@dataclass(slots=True)
class Content:
    """Content that the instrument wrote, by its hash."""

    kind: str
    """Kind of content: good, other (another part), old, torn."""
    ask: int
    taken_s: int
    """Time by the instrument's clock."""


@dataclass(slots=True)
class World:
    """Folder with all that was ever written into it and what the daemon took."""

    root: Path
    rng: np.random.Generator
    disk: Disk
    now_s: float = 0.0
    instrument_off_s: float = 0.0
    folder_off_s: float = 0.0
    contents: dict[str, Content] = field(default_factory=dict)
    journal: list[str] = field(default_factory=list)
    handed: dict[str, int] = field(default_factory=dict)
    ask: int = 0
    writes: int = 0
    stepped: bool = False
    """Whether a clock was wrong since the last map was taken: then a refusal may be a mistake."""
    put_back: int = 0
    restarts: int = 0
    latencies_s: list[float] = field(default_factory=list)
    done_s: float | None = None
    """When a good map of this request was complete."""
    disturbed: bool = False
    queue: list[tuple[float, int, Iterator[Step], Callable[[], None]]] = field(default_factory=list)
    numbers: Iterator[int] = field(default_factory=itertools.count)
    device: WatchedFolder | None = None
    wait: MapWait | None = None

    @property
    def maps(self) -> Path:
        """The watched folder."""
        return self.root / "maps"

    def integer(self, low: int, high: int) -> int:
        """Return a random whole number below ``high``."""
        return int(self.rng.integers(low, high))

    # the instrument

    def content(self, kind: str, part: str = PART, before_last_s: float | None = None) -> bytes:
        """Return a new file, measured now, or a time before the last that was taken, by the instrument's clock."""
        height = self.rng.normal(0.0, 30.0, (self.integer(6, 30), self.integer(6, 30)))
        height[0, :2] = np.nan
        taken_s = int(BASE_S + self.now_s + self.instrument_off_s)
        if before_last_s is not None:
            # what a clock dated that was fast then, and has been put right since, nothing in the file gives away
            last = self.contents.get(self.journal[-1])
            taken_s = int(min(last.taken_s if last else BASE_S, taken_s) - before_last_s)
        data = pack(DatMap(height, 0.5, part=part, taken_s=taken_s, comment=str(next(self.numbers))))
        self.contents[hashlib.sha256(data).hexdigest()] = Content(kind, self.ask, taken_s)
        return data

    def start(self, steps: Iterator[Step]) -> None:
        """Start a writer."""
        self.writes += 1
        self._next(steps)

    def _next(self, steps: Iterator[Step]) -> None:
        for delay_s, act in steps:
            heapq.heappush(self.queue, (self.now_s + delay_s, next(self.numbers), steps, act))
            return

    def run_due(self, until_s: float) -> None:
        """Run the writers until that time."""
        while self.queue and self.queue[0][0] <= until_s:
            at_s, _, steps, act = heapq.heappop(self.queue)
            self.now_s = max(self.now_s, at_s)
            act()
            self._next(steps)

    def put(self, path: Path, data: bytes, mode: str = "wb", at: int | None = None) -> None:
        """Write some bytes; the file is dated by the folder's clock."""
        with path.open(mode) as file:
            if at is not None:
                file.seek(at)
            file.write(data)
        self.date(path)

    def date(self, path: Path) -> None:
        """Date the file as a write does, each a little later than the one before."""
        stamp = int((BASE_S + self.now_s + self.folder_off_s) * 1e9) + next(self.numbers)
        os.utime(path, ns=(stamp, stamp))

    def during_read(self) -> None:
        """Act while the daemon reads: a writer continues, or the file is replaced."""
        if self.queue and self.rng.random() < 0.1:
            *_, steps, act = heapq.heappop(self.queue)
            act()
            self._next(steps)

    # the daemon

    def boot(self) -> None:
        """Start a new process, which knows only what is on the disk."""

        def read(path: Path) -> SurfaceMap:
            self.during_read()
            found = METROPRO.read(path)
            self.during_read()
            return found

        context = DeviceContext(self.root, self.root / "state", PART, (replace(METROPRO, read=read),))
        options = FolderOptions.model_validate({"folder": "maps", "poll_s": POLL_S, "stable_s": STABLE_S})
        self.device = WatchedFolder(options, context)
        self.wait = None

    def poll(self) -> bool:
        """Poll once and return whether a map came into the journal; the daemon may be killed meanwhile."""
        self.now_s += POLL_S * float(self.rng.uniform(0.9, 1.1))
        self.run_due(self.now_s)
        if self.device is None:
            self.boot()
        assert self.device is not None
        if self.wait is None:
            self.wait = MapWait(self.journal[-1], SettledFiles(3, STABLE_S))
        try:
            found = self.device._poll(self.wait, self.now_s)
        except Killed:
            found = None
            self._die()
        if found is None:
            return False
        self.handed[found.sha256] = self.handed.get(found.sha256, 0) + 1
        if self.handed[found.sha256] == 1 and self.rng.random() < 0.05:
            self._die()  # it was handed on, and the journal does not know
            return False
        self.device._load().handed(found.sha256)
        self._journal(found)
        return True

    def _die(self) -> None:
        self.device = self.wait = None
        self.disk.dies_in = None
        self.restarts += 1
        self.disturbed = True

    def _journal(self, found: SurfaceMap) -> None:
        known = self.contents.get(found.sha256)
        assert known is not None, "what was taken was never written as a whole: torn"
        assert known.kind == "good", f"a map of kind {known.kind} was taken"
        assert known.ask == self.ask, f"a map of ask {known.ask} was taken for ask {self.ask}"
        assert found.sha256 not in self.journal, "taken twice"
        assert found.path is not None
        assert hashlib.sha256(found.path.read_bytes()).hexdigest() == found.sha256
        self.journal.append(found.sha256)
        self.wait = None

    def operator(self) -> None:
        """Follow the advice for a good map that was refused because of a wrong clock."""
        for reason in (self.maps / "quarantine").glob("*.reason.txt"):
            path = reason.with_name(reason.name.removesuffix(".reason.txt"))
            if not path.exists():
                continue
            known = self.contents.get(hashlib.sha256(path.read_bytes()).hexdigest())
            if known is None or known.kind != "good" or known.ask != self.ask:
                continue
            hint = re.search(r"move it back as (\S+) while", reason.read_text())
            if hint is None:
                continue  # a duplicate of it
            assert self.stepped, f"a good map was refused with the clocks right: {reason.read_text()}"
            path.replace(self.maps / hint[1])
            reason.unlink()
            self.put_back += 1

    def clock(self, folder: Path) -> datetime:
        """Return the time of the folder's clock."""
        assert folder == self.maps
        return datetime.fromtimestamp(BASE_S + self.now_s + self.folder_off_s, UTC)
