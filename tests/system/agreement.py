"""Compare the journal with the simulated plant's record of contact: they agree except for uncertain blocks."""

from __future__ import annotations

import contextlib
import sqlite3
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from polishd.commissioning.rehearsal.simulated_cell import DemoFiles
from tests.system.cell_rig import account

SHARE, LEAST_S = 0.02, 0.01
"""Permitted difference of a block's time, relative and in s: the plant calculates in time steps."""
SHARED, TOTAL = 0.6, 0.002
"""Permitted relative differences for blocks that one report covers: of each block's time, which the motion model
estimates, and of their sum."""


@dataclass(frozen=True, slots=True)
class JournalPass:
    """One pass as the journal records it; (n,) arrays by block."""

    sha256: str
    run_s: np.ndarray[Any, Any]
    """Process time; 0 where the journal has no record."""
    touched: np.ndarray[Any, Any]
    """1: touched, 0: not touched, NaN: unknown; 0 where the journal has no record."""
    reported_s: np.ndarray[Any, Any]
    """When the daemon received the report of the block; NaN where the journal has no record."""
    contact: tuple[int, int]
    """Planned range of blocks in which the tool is on the part."""

    @classmethod
    def of_no_pass(cls, sha256: str, blocks: int) -> JournalPass:
        """Return the pass of a program that is not in the journal: no block was touched."""
        return cls(sha256, np.zeros(blocks), np.zeros(blocks), np.full(blocks, np.nan), (0, 0))

    @property
    def uncertain(self) -> np.ndarray[Any, Any]:
        """Sequence numbers of the uncertain blocks, (k,)."""
        return np.flatnonzero(np.isnan(self.touched))


def passes(journal: Path) -> list[JournalPass]:
    """Return all passes of a journal file. A daemon may write the file at the same time."""
    with contextlib.closing(sqlite3.connect(f"file:{journal}?mode=ro", uri=True)) as file:
        found = []
        columns = "job, cycle, program_sha256, blocks, contact_from, contact_to, uncertain_from, uncertain_to"
        for row in file.execute(f"SELECT {columns} FROM pass").fetchall():
            job, cycle, sha256, blocks, first, end, *tail = row
            run_s, touched, reported_s = np.zeros(blocks), np.zeros(blocks), np.full(blocks, np.nan)
            rows = "SELECT seq, end_s - start_s, touched, told_s FROM segment WHERE job = ? AND cycle = ?"
            for seq, seconds, known, received_s in file.execute(rows, (job, cycle)):
                run_s[seq], touched[seq] = seconds, np.nan if known is None else known
                reported_s[seq] = np.nan if received_s is None else received_s
            if tail[0] is not None:
                touched[tail[0] : tail[1]] = np.nan
            found.append(JournalPass(sha256, run_s, touched, reported_s, (first, end)))
    return found


def disagreements(
    journal: Path, books: list[dict[str, Any]], *, by_model: bool = False, least_s: float = LEAST_S
) -> list[str]:
    """Return the contradictions between journal and plant: pass, block, the journal's time, the plant's time.

    ``by_model``: the controller reports the line that it executes. Where several blocks ended between two reports, the
    motion model has divided the time among them.
    ``least_s``: permitted difference of a time; larger where the controller has no clock, so that the daemon uses the
    times of its readings.

    A program that is not a pass is that of a touch-off: the robot stands still while the tool touches, so that no block
    is touched. A controller that receives generated scripts reports no program hash: its programs are matched with
    the passes in their order.
    """
    ours = passes(journal)
    by_hash, found = {one.sha256: one for one in ours}, []
    if not by_hash.keys() & {book["sha256"] for book in books}:
        left = iter(ours)
        by_hash, one = {}, next(left, None)
        for book in books:  # a touch-off's program is shorter than a pass
            if one is not None and len(book["contact_s"]) >= len(one.run_s):
                by_hash[book["sha256"]], one = one, next(left, None)
    for book in books:
        one = by_hash.get(book["sha256"]) or JournalPass.of_no_pass(book["sha256"], len(book["contact_s"]))
        contact_s, beyond_s = np.split(np.array(book["contact_s"]), [len(one.run_s)])
        if beyond_s.any():  # a script may have a further line after the program's last block
            found.append(f"{one.sha256[:8]}: the plant saw {beyond_s.sum():.3f} s after its last block")
        slack_s = SHARE * one.run_s + least_s
        if by_model:
            for run in _blocks_of_one_report(one):
                slack_s[run] += SHARED * one.run_s[run]
                if (one.touched[run] == 1).all() and not _sum_agrees(one, contact_s, run, least_s):
                    found.append(_sum_message(one, contact_s, run))
        wrong = {
            "touched": (one.touched == 1) & (np.abs(contact_s - one.run_s) > slack_s),
            "not touched": (one.touched == 0) & (contact_s > least_s),
            "executed": np.isnan(one.touched) & (one.run_s > 0) & (contact_s > one.run_s + slack_s),
        }
        found += [
            f"{one.sha256[:8]} block {seq}: {says} in {one.run_s[seq]:.3f} s; the plant saw {contact_s[seq]:.3f} s"
            for says, where in wrong.items()
            for seq in np.flatnonzero(where)
        ]
    return found


def _blocks_of_one_report(one: JournalPass) -> list[slice]:
    """Return the ranges of blocks that one report covers, where these are several."""
    edges = np.flatnonzero(np.diff(one.reported_s, prepend=np.nan, append=np.nan) != 0)
    return [slice(a, b) for a, b in pairwise(edges.tolist()) if b - a > 1]


def _sum_agrees(one: JournalPass, contact_s: np.ndarray[Any, Any], run: slice, least_s: float) -> bool:
    ours_s = one.run_s[run].sum()
    return bool(abs(contact_s[run].sum() - ours_s) <= TOTAL * ours_s + least_s)


def _sum_message(one: JournalPass, contact_s: np.ndarray[Any, Any], run: slice) -> str:
    ours_s, seen_s = one.run_s[run].sum(), contact_s[run].sum()
    return f"{one.sha256[:8]} blocks {run.start} to {run.stop - 1}: {ours_s:.3f} s in all; the plant saw {seen_s:.3f} s"


def require_agreement(files: DemoFiles) -> None:
    """Require that journal and plant agree. The cell is idle, or polishes whole passes."""
    assert disagreements(files.state_dir / "journal.sqlite", account(files)["programs"]) == []
