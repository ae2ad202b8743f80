"""What the sampler tells of the motion, as the plant wants it. Pure of I/O; wall times are handed in."""

from __future__ import annotations

import hashlib
from bisect import bisect_left
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from polishd.model.surface import FloatArray

LINE, RUNS, PAUSED, HELD = range(5, 9)
COLUMNS = 9
SAMPLE_S = 0.005
"""Between two samples, on LinuxCNC's clock: it makes up for what it was late."""
STILL_SAMPLES = 4
"""So many alike are a rest; with no program under way, a standstill."""
MARK = b"(MSG,polishd "


@dataclass(frozen=True, slots=True)
class LinuxCncProgram:
    """A program file, without the lines that polishd's driver put between."""

    sha256: str
    blocks: int
    inserted: tuple[int, ...]

    @classmethod
    def read(cls, path: Path) -> LinuxCncProgram:
        """Take the file apart."""
        lines = path.read_bytes().removesuffix(b"\n").split(b"\n")
        own = [line for line in lines if not line.startswith(MARK)]
        inserted = tuple(at for at, line in enumerate(lines) if line.startswith(MARK))
        return cls(hashlib.sha256(b"\n".join(own)).hexdigest(), len(own), inserted)

    def block_at(self, line: int) -> int:
        """0-based block of a 1-based line; -1 for none."""
        return line - 1 - bisect_left(self.inserted, line - 1) if line > 0 else -1


@dataclass(slots=True)
class Sampled:
    """Samples in, rows for the plant out (``bus.ROW``)."""

    pose: tuple[float, ...]
    wall_s: float
    """When the last samples came."""
    program: LinuxCncProgram | None = None
    moving: bool = False
    running: bool = False
    seq: int = -1
    """Block of the last motion; LinuxCNC tells none for a dwell, whose time is booked with the move before it."""
    _still: int = STILL_SAMPLES
    _rest: bytes = b""
    rows: list[list[float]] = field(default_factory=list)
    to_pose: Callable[[Sequence[float]], tuple[float, ...]] = tuple
    """Of joints."""

    @property
    def rests(self) -> bool:
        """It stands while its program runs: a dwell."""
        return self.running and self._still >= STILL_SAMPLES

    def feed(self, data: bytes, now_s: float) -> None:
        """Samples that came now; they are spread over the time since the last ones.

        What the part is polished for is LinuxCNC's own time: on a busy machine samples come late, then many at once.
        """
        *lines, self._rest = (self._rest + data).split(b"\n")
        samples = [s for s in (line.split() for line in lines) if len(s) == COLUMNS]
        edges = np.linspace(self.wall_s, now_s, len(samples) + 1).tolist()
        for sample, begin, end in zip(samples, edges[:-1], edges[1:], strict=True):
            self._take([float(value) for value in sample], begin, end)
        if samples:
            self.wall_s = now_s

    def take_rows(self) -> FloatArray:
        """(n, 9) since the last call."""
        rows, self.rows = self.rows, []
        return np.array(rows).reshape(-1, 9)

    def _take(self, sample: list[float], begin_s: float, end_s: float) -> None:
        here = self.to_pose(sample[:5])
        changed = here != self.pose
        self.running = bool(sample[RUNS]) and not sample[PAUSED] and not sample[HELD]
        self._still = 0 if changed else self._still + 1
        self.moving = self.running or self._still < STILL_SAMPLES
        if self.moving:
            self.seq = self._block(int(sample[LINE]))
            middle = [(a + b) / 2 for a, b in zip(self.pose, here, strict=True)]
            self.rows.append([self.seq, begin_s, end_s, SAMPLE_S, *middle])
        self.pose = here

    def _block(self, line: int) -> int:
        if self.program is None or not (line or self.running):
            return -1
        return self.program.block_at(line) if line else self.seq
