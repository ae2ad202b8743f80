"""The journal against a model: the same records after any order of calls and restarts."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import hypothesis
import numpy as np
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from polishd.daemon.journal.journal import Journal
from polishd.daemon.journal.records import BlockRecord
from polishd.model.devices import ExecutedBlock
from polishd.model.states import Outcome

CYCLES = 4
BLOCKS = 12


def record(seq: int, touched: bool | None) -> BlockRecord:
    return BlockRecord(ExecutedBlock(seq, float(seq), seq + 0.5), touched)


class JournalMachine(RuleBasedStateMachine):
    """One cell: maps, passes, blocks, restarts, ends of jobs."""

    def __init__(self) -> None:
        super().__init__()
        self.folder = tempfile.TemporaryDirectory()
        self.last_map: str | None = None
        self.maps_taken = 0
        self.jobs = 0
        self._new_job()

    def _new_job(self) -> None:
        self.maps: dict[int, str] = {}
        self.passes: dict[int, str | None] = {}
        self.blocks: dict[int, dict[int, bool | None]] = {}
        self.recovered: dict[int, set[int]] = {}
        self.fresh = True

    def _open(self) -> Journal:
        return Journal.open(Path(self.folder.name), job="job", part_id="P")

    @initialize()
    def start(self) -> None:
        self.journal = self._open()
        self.jobs = 1

    @property
    def next_cycle(self) -> int:
        return max(self.passes, default=-1) + 1

    @property
    def running(self) -> int | None:
        return next((cycle for cycle, how in self.passes.items() if how is None), None)

    @precondition(lambda self: self.running is None and self.next_cycle <= CYCLES)
    @rule()
    def take_map(self) -> None:
        self.maps_taken += 1
        sha = f"map{self.maps_taken}"
        self.journal.record_map(self.next_cycle, sha, "x", {"n": self.maps_taken})
        self.maps[self.next_cycle] = self.last_map = sha

    @precondition(lambda self: self.running is None and self.next_cycle < CYCLES)
    @rule()
    def begin(self) -> None:
        cycle = self.next_cycle
        self.journal.begin_pass(cycle, f"prog{cycle}", "boot", BLOCKS, contact=(2, BLOCKS - 2))
        self.passes[cycle], self.blocks[cycle], self.recovered[cycle] = None, {}, set()

    @precondition(lambda self: self.running is not None)
    @rule(number=st.integers(1, 4), touched=st.sampled_from([True, False, None]))
    def execute(self, number: int, touched: bool | None) -> None:
        cycle: Any = self.running
        for _ in range(number):
            seq = max(self.blocks[cycle], default=-1) + 1
            if seq < BLOCKS:
                self.journal.record_executed(cycle, [record(seq, touched)])
                self.blocks[cycle][seq] = touched

    @precondition(lambda self: self.running is not None)
    @rule(upto=st.integers(0, BLOCKS))
    def reconcile(self, upto: int) -> None:
        cycle: Any = self.running
        new = [seq for seq in range(upto) if seq not in self.blocks[cycle]]
        before = self.journal.tally(cycle).done
        self.journal.reconcile(cycle, [record(seq, None) for seq in range(upto)])
        assert self.journal.tally(cycle).done - before == len(new)
        self.blocks[cycle].update(dict.fromkeys(new))
        self.recovered[cycle].update(new)

    @precondition(lambda self: self.running is not None)
    @rule(how=st.sampled_from(["done", "stopped", "interrupted"]))
    def end(self, how: str) -> None:
        cycle: Any = self.running
        self.journal.end_pass(cycle, how)
        self.passes[cycle] = how

    @rule()
    def restart(self) -> None:
        self.journal.close()
        self.journal = self._open()
        assert self.journal.resumed

    @precondition(lambda self: self.running is None)
    @rule(outcome=st.sampled_from(list(Outcome)))
    def finish(self, outcome: Outcome) -> None:
        self.journal.record_outcome(outcome)
        self.journal.close()
        self.journal = self._open()
        assert not self.journal.resumed
        self._new_job()

    @invariant()
    def remembers(self) -> None:
        if self.jobs == 0:
            return
        journal = self.journal
        assert journal.last_map_id == self.last_map
        assert {record.cycle: record.sha256 for record in journal.history} == self.maps
        assert {record.cycle: record.how for record in journal.passes} == self.passes
        assert list(journal.remaining(CYCLES + 1)) == list(range(self.next_cycle, CYCLES + 1))
        for cycle, blocks in self.blocks.items():
            found = journal.executed(cycle)
            np.testing.assert_array_equal(found.seq, sorted(blocks))
            np.testing.assert_array_equal(found.recovered, [seq in self.recovered[cycle] for seq in sorted(blocks)])
            np.testing.assert_array_equal(found.touched, np.array([blocks[seq] for seq in sorted(blocks)], dtype=float))
            assert journal.contact_s(cycle) == float(found.duration_s[found.contact].sum())
            unknown = [seq for first, end in journal.uncertain(cycle) for seq in range(first, end)]
            assert unknown == [seq for seq in sorted(blocks) if blocks[seq] is None]

    @invariant()
    def tells_what_is_unfinished(self) -> None:
        if self.jobs == 0:
            return
        found = self.journal.unfinished()
        assert (None if found is None else found.cycle) == self.running
        if found is not None:
            done = self.blocks[found.cycle]
            tally = self.journal.tally(found.cycle)
            assert (tally.done, tally.last_seq) == (len(done), max(done, default=-1))

    def teardown(self) -> None:
        if self.jobs:
            self.journal.close()
        self.folder.cleanup()


JournalMachine.TestCase.settings = hypothesis.settings(max_examples=25, stateful_step_count=20, deadline=None)
TestJournal = JournalMachine.TestCase
