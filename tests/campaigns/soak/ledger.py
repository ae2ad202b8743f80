"""The parts of a sitting that are under way, or that ended and were not judged; and how they are judged."""

from __future__ import annotations

import contextlib
import math
import shutil
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from polishd.daemon.socket import client
from polishd.model.errors import PolishdError
from polishd.sim_backends.loader import ANOTHER
from tests.campaigns.soak.cell import Row, SoakCell
from tests.campaigns.soak.judge import told_of, truth_of, untouched
from tests.campaigns.soak.parts import Part
from tests.campaigns.soak.records import Record
from tests.campaigns.soak.scripts import ACCEPTED, Visit
from tests.campaigns.soak.usage import held

Keep = Callable[[Record, SoakCell], None]


@dataclass(slots=True)
class Under:
    """A part under way, or not yet judged."""

    part: Part
    record: Record
    expected: deque[Visit]
    """Of a person, in their order."""
    began_s: float
    until_s: float = math.inf
    """From then on it is another part's time."""
    row: Row | None = None
    """The queue's last word; None: it has not ended."""


class Ledger:
    """Of one sitting. A part's truth is there once another one has taken its seat."""

    def __init__(self, cell: SoakCell, sitting: str, keep: Keep) -> None:
        self.open: list[Under] = []
        """In the order in which they began."""
        self._cell, self._sitting, self._keep = cell, sitting, keep
        self._life = self._age = 0
        self._used: Counter[str] = Counter()
        self._written_mb = 0.0

    def started(self) -> None:
        """A daemon came up: its life begins."""
        self._life, self._age = self._life + 1, 0

    def begin(self, part: Part) -> Under:
        """Its job is about to be added, or is next."""
        record = Record(part.number, part.name, part.script.name, self._sitting, tolerance_nm=part.tolerance_nm)
        under = Under(part, record, deque(part.script.visits), time.monotonic())
        for earlier in self.open:
            earlier.until_s = min(earlier.until_s, under.began_s)
        self.open.append(under)
        return under

    def end(self, under: Under, row: Row) -> None:
        """Its job has ended: what it used, and what daemon and worker hold now. Earlier ones are judged."""
        record, cell, under.row = under.record, self._cell, row
        cell.look()
        total = cell.meter.total_s()
        record.cpu_s = {name: round(total[name] - self._used[name], 3) for name in total}
        self._used = total
        record.wall_s, record.late_s = round(row.took_s or 0.0, 3), round(cell.meter.late_s, 3)
        cell.meter.late_s = 0.0
        record.life, record.age, self._age = f"{self._sitting}/{self._life}", self._age, self._age + 1
        record.held = self._held()
        for earlier in [one for one in self.open if one is not under and not one.expected]:
            kept = self._kept(earlier.part.name)
            if kept.exists() or not self._came(earlier.part.name):
                self._judge(earlier, kept)

    def close(self) -> None:
        """Judge all that is left, of a cell that rests."""
        for under in list(self.open):
            kept = self._kept(under.part.name)
            self._judge(under, kept if kept.exists() else self._cell.files.sim_dir / "truth.npz")

    def _held(self) -> dict[str, float]:
        cell, before, self._written_mb = self._cell, self._written_mb, self._cell.written_mb()
        found = {"written_mb": round(self._written_mb - before, 4)}
        if cell.process is not None and (daemon := held(cell.process.pid)) is not None:
            found["daemon_rss_mb"] = round(daemon.rss_mb, 3)
            found |= {"descriptors": float(daemon.descriptors), "threads": float(daemon.threads)}
        if workers := [worker for pid in cell.workers() if (worker := held(pid)) is not None]:
            found["worker_rss_mb"] = round(sum(worker.rss_mb for worker in workers), 3)
        with contextlib.suppress(PolishdError):  # it has ended meanwhile, which is seen to elsewhere
            found["tasks"] = float(client.request(cell.files.state_dir, "status", 5.0)["tasks"])
        return found

    def _kept(self, part: str) -> Path:
        """The plant's file of a part that was taken off."""
        return self._cell.files.sim_dir / "parts" / f"{part}.npz"

    def _came(self, part: str) -> bool:
        """It was on the seat: the loader may have brought another one."""
        return any(e["event"] == "loader_clear" and e["seat"] == part for e in self._cell.log.look())

    def _judge(self, under: Under, surface: Path) -> None:
        self.open.remove(under)
        record, row = under.record, under.row
        if row is not None:
            record.verdict, record.fault, record.reason = str(row.verdict), row.fault, row.reason
            if self._came(under.part.name):
                found = truth_of(self._cell, row, surface, under.began_s, under.until_s)
                record.true_rms_nm, record.deeper_nm = round(found.rms_nm, 4), round(found.deeper_nm, 3)
                record.passes, record.told = found.passes, told_of(row.run_dir)
                record.wrong += found.wrong
            record.wrong += ends_wrongly(under)
        other = self._kept(ANOTHER)
        if other.exists() and not untouched(other):
            record.wrong.append(f"damage: {ANOTHER}, which nobody asked for, was polished")
        self._keep(record, self._cell)
        if row is not None and row.run_dir:
            shutil.rmtree(row.run_dir, ignore_errors=True)
        for path in (other, self._kept(under.part.name)):
            path.unlink(missing_ok=True)


def ends_wrongly(under: Under) -> list[str]:
    """In what a part did not end as what befell it says."""
    record, script = under.record, under.part.script
    end, faults, restarts = (script.end, script.faults, script.restarts) if record.struck else (ACCEPTED, ("",), 0)
    wrong = [f"held: {reason}" for reason in record.unexpected]
    if record.verdict != end or record.fault not in faults:
        wrong.append(f"end: {record.verdict} ({record.reason}), where {end} {'/'.join(faults)} was expected")
    if record.restarts != restarts:
        wrong.append(f"end: {record.restarts} starts of the daemon, where {restarts} were expected")
    known = record.struck and not math.isinf(under.until_s)  # of the last part nobody knows what comes after
    if known and under.expected:
        wrong.append(f"end: the cell was not held over {[visit.says for visit in under.expected]}")
    return wrong
