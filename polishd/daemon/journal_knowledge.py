"""What the journal knows of a job: from memory, but for what grows with the job and is read from its file."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from polishd.daemon.journal_memory import JobMemory
from polishd.daemon.journal_records import BlockCounts, JournalBlocks, MapRecord, PassRecord, joined
from polishd.daemon.journal_store import Store
from polishd.model.cycle import CyclePhase
from polishd.model.errors import WrongSeat

NOTHING = BlockCounts()

_EXECUTED = (
    "SELECT seq, start_s, end_s, touched, recovered, force_n, rpm, told_s, sensor_force_n FROM segment "
    "WHERE job = ? AND cycle = ? ORDER BY seq"
)


class JournalView:
    """What is known of one job."""

    def __init__(self, store: Store, job: int, known: JobMemory) -> None:
        self._store = store
        self._job = self.number = job
        """Of its job's row; ``NO_JOB`` between jobs."""
        self._known = known

    @property
    def unsaved_s(self) -> float:
        """For how long the oldest record that is not durable has waited for the disk, s."""
        return self._store.unsaved_s

    @property
    def begun(self) -> bool:
        """Whether this job has measured anything: from then on it goes on with what it was begun with."""
        return bool(self._known.maps or self._known.passes)

    @property
    def terms(self) -> Mapping[str, Any] | None:
        """What this job was begun with; None where the polishd that began it did not write it down."""
        return self._known.terms

    @property
    def run_dir(self) -> str:
        """Its run folder; empty where none was made yet."""
        return self._known.run_dir

    def remaining(self, cycles: int) -> Iterator[int]:
        """Cycles yet to do of so many: each starts with a measurement, so one after a begun pass is a new one."""
        yield from range(max(self._known.passes, default=-1) + 1, cycles)

    @property
    def last_map_id(self) -> str | None:
        """sha256 of the last map taken, by any job of this cell."""
        return self._known.last_map_id

    @property
    def history(self) -> tuple[MapRecord, ...]:
        """The maps of this job, the last one of each cycle."""
        return tuple(self._known.maps.values())

    @property
    def passes(self) -> tuple[PassRecord, ...]:
        """The passes begun by this job."""
        return tuple(self._known.passes.values())

    @property
    def phase_now(self) -> tuple[int | None, str | None]:
        """The cycle and the phase that began last, in this run of the daemon or an earlier one."""
        return self._known.phase or (None, None)

    def tally(self, cycle: int) -> BlockCounts:
        """How much of that cycle's pass is recorded as executed."""
        return self._known.tallies.get(cycle, NOTHING)

    @property
    def done(self) -> int:
        """Blocks that are recorded as executed, of all passes of this job."""
        return sum(tally.done for tally in self._known.tallies.values())

    def contact_s(self, cycle: int) -> float:
        """Process time of the blocks that are known to have been executed in contact in that cycle's pass."""
        return self.tally(cycle).contact_s

    def uncertain(self, cycle: int) -> tuple[tuple[int, int], ...]:
        """Blocks of that cycle's pass of which nobody knows whether the tool touched: ranges, ends excluded."""
        record = self._known.passes.get(cycle)
        tail = () if record is None or record.uncertain is None else (record.uncertain,)
        return joined([*self._known.unknown.get(cycle, ()), *tail])

    def executed(self, cycle: int) -> JournalBlocks:
        """What the robot executed in that cycle's pass; empty where there was none. Grows with it: call in a thread."""
        found = self._store.read_columns(_EXECUTED, (self._job, cycle), 9)
        seq, start_s, end_s, touched, recovered, *rest = found
        return JournalBlocks(seq.astype(np.int64), start_s, end_s, touched, recovered.astype(bool), *rest)

    def phase_times_s(self) -> dict[str, float]:
        """Seconds that each phase of this job took in all, by the clock on the wall, in the order of a cycle."""
        sql = "SELECT phase, sum(ended - started) FROM phase WHERE job = ? AND ended IS NOT NULL GROUP BY phase"
        found = dict(self._store.read(sql, (self._job,)))
        return {phase.value: found[phase.value] for phase in CyclePhase if phase.value in found}

    def errors(self) -> list[tuple[float, str, Mapping[str, Any]]]:
        """What held or ended this job's daemon, in time order: Unix time, event's name, its data.

        Between jobs those of this run: earlier ones are nobody's.
        """
        sql = "SELECT at, name, data FROM event WHERE job = ? AND id > ? AND name IN ('held', 'failed') ORDER BY id"
        found = self._store.read(sql, (self._job, self._known.events_before))
        return [(at, name, json.loads(data)) for at, name, data in found]

    def held_last(self) -> str:
        """Why the cell was held, or its queue stopped, when its last daemon ended; empty where neither was so."""
        sql = (
            "SELECT data FROM event WHERE (name = 'state' AND json_extract(data, '$.state') NOT IN ('starting', "
            "'finished')) OR (name = 'job_ended' AND json_extract(data, '$.stops') != '') ORDER BY id DESC LIMIT 1"
        )
        for (text,) in self._store.read(sql):
            data = json.loads(text)
            if "stops" in data:  # without a person it ends there, and is never held
                return f"the queue stopped: {data['stops']}; {data['job']} was {data['verdict']}: {data['reason']}"
            return str(data["reason"]) if data["state"] == "held" else ""
        return ""

    def unfinished(self) -> PassRecord | None:
        """The pass that was begun and never ended, or None."""
        return next((record for record in self.passes if record.ended_s is None), None)

    def cut_off(self) -> int | None:
        """The last pass or touch-off of this cell, where it did not come to its end: the robot stands there.

        None where it did; a wrong seat is an end, once the robot has left it. By its row among the phases.
        """
        sql = "SELECT id, outcome, error FROM phase WHERE phase IN (?, ?) ORDER BY id DESC LIMIT 1"
        for number, outcome, error in self._store.read(sql, (CyclePhase.RUN.value, CyclePhase.TOUCH_OFF.value)):
            if outcome != "done" and not (error or "").startswith(f"{WrongSeat.__name__}:"):
                return int(number)
        return None

    def passes_before(self, cycle: int, most: int) -> list[Mapping[str, Any]]:
        """Facts of the last whole passes of any job of this cell before that cycle's, the latest first."""
        sql = (
            "SELECT facts FROM pass WHERE how = 'done' AND (job < ? OR (job = ? AND cycle < ?)) "
            "ORDER BY job DESC, cycle DESC LIMIT ?"
        )
        return [json.loads(facts) for (facts,) in self._store.read(sql, (self._job, self._job, cycle, most))]
