"""Parts of a session that are under way, or have ended and are not judged yet, and how they are judged."""

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
from tests.campaigns.soak.judge import measured_of, truth_of, untouched
from tests.campaigns.soak.parts import Part
from tests.campaigns.soak.records import Record
from tests.campaigns.soak.scripts import ACCEPTED, Visit
from tests.campaigns.soak.usage import held

Keep = Callable[[Record, SoakCell], None]


@dataclass(slots=True)
class Under:
    """Part that is under way or not yet judged."""

    part: Part
    record: Record
    expected: deque[Visit]
    """Expected visits of the operator, in order."""
    began_s: float
    until_s: float = math.inf
    """Time at which the next part begins."""
    row: Row | None = None
    """Last row of the queue; None: the job has not ended."""


class Ledger:
    """Ledger of one session. The plant writes a part's true surface once another part is seated."""

    def __init__(self, cell: SoakCell, session: str, keep: Keep) -> None:
        self.open: list[Under] = []
        """Parts in the order in which they began."""
        self._cell, self._session, self._keep = cell, session, keep
        self._life = self._age = 0
        self._used: Counter[str] = Counter()
        self._written_mb = 0.0

    def started(self) -> None:
        """Count a new daemon process."""
        self._life, self._age = self._life + 1, 0

    def begin(self, part: Part) -> Under:
        """Open the record of a part whose job is added now, or is next."""
        record = Record(part.number, part.name, part.script.name, self._session, tolerance_nm=part.tolerance_nm)
        under = Under(part, record, deque(part.script.visits), time.monotonic())
        for earlier in self.open:
            earlier.until_s = min(earlier.until_s, under.began_s)
        self.open.append(under)
        return under

    def end(self, under: Under, row: Row) -> None:
        """Record what a job used when it ended and what daemon and worker hold; judge earlier parts."""
        record, cell, under.row = under.record, self._cell, row
        cell.look()
        total = cell.meter.total_s()
        record.cpu_s = {name: round(total[name] - self._used[name], 3) for name in total}
        self._used = total
        record.wall_s, record.late_s = round(row.took_s or 0.0, 3), round(cell.meter.late_s, 3)
        cell.meter.late_s = 0.0
        record.life, record.age, self._age = f"{self._session}/{self._life}", self._age, self._age + 1
        record.held = self._held()
        for earlier in [one for one in self.open if one is not under and not one.expected]:
            kept = self._kept(earlier.part.name)
            if kept.exists() or not self._came(earlier.part.name):
                self._judge(earlier, kept)

    def close(self) -> None:
        """Judge all remaining parts; the cell is idle."""
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
        """Return the plant's file of a part that was unloaded."""
        return self._cell.files.sim_dir / "parts" / f"{part}.npz"

    def _came(self, part: str) -> bool:
        """Return whether the part was seated: the loader may have brought another one."""
        return any(e["event"] == "loader_clear" and e["seat"] == part for e in self._cell.log.look())

    def _judge(self, under: Under, surface: Path) -> None:
        self.open.remove(under)
        record, row = under.record, under.row
        if row is not None:
            record.verdict, record.fault, record.reason = str(row.verdict), row.fault, row.reason
            if self._came(under.part.name):
                found = truth_of(self._cell, row, surface, under.began_s, under.until_s)
                record.true_rms_nm, record.deeper_nm = round(found.rms_nm, 4), round(found.deeper_nm, 3)
                record.passes, record.measured = found.passes, measured_of(row.run_dir)
                record.wrong += found.wrong
            record.wrong += ends_wrongly(under)
        other = self._kept(ANOTHER)
        if other.exists() and not untouched(other):
            record.wrong.append(f"damage: {ANOTHER}, which was not requested, was polished")
        self._keep(record, self._cell)
        if row is not None and row.run_dir:
            shutil.rmtree(row.run_dir, ignore_errors=True)
        for path in (other, self._kept(under.part.name)):
            path.unlink(missing_ok=True)


def ends_wrongly(under: Under) -> list[str]:
    """Return the differences between a part's end and the end that its script requires."""
    record, script = under.record, under.part.script
    end, faults, restarts = (script.end, script.faults, script.restarts) if record.struck else (ACCEPTED, ("",), 0)
    wrong = [f"held: {reason}" for reason in record.unexpected]
    if record.verdict != end or record.fault not in faults:
        wrong.append(f"end: {record.verdict} ({record.reason}), where {end} {'/'.join(faults)} was expected")
    if record.restarts != restarts:
        wrong.append(f"end: {record.restarts} starts of the daemon, where {restarts} were expected")
    known = record.struck and not math.isinf(under.until_s)  # what follows the last part is unknown
    if known and under.expected:
        wrong.append(f"end: the cell was not held over {[visit.says for visit in under.expected]}")
    return wrong
