"""The journal beside the plant's own account of contact: they agree, but for what the journal calls uncertain."""

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
"""What the plant's steps make of a block's time."""
SHARED, TOTAL = 0.6, 0.002
"""Of blocks that one report tells of: how far off the motion model may share out their time; and their sum."""


@dataclass(frozen=True, slots=True)
class Told:
    """What the journal tells of one pass; (n,) arrays by block."""

    sha256: str
    run_s: np.ndarray[Any, Any]
    """Process time; 0 where no record is."""
    touched: np.ndarray[Any, Any]
    """1, 0, NaN: not known; 0 where no record is."""
    told_s: np.ndarray[Any, Any]
    """When we heard of it; NaN where no record is."""
    contact: tuple[int, int]
    """The range in which the tool is on the part, as planned."""

    @classmethod
    def of_no_pass(cls, sha256: str, blocks: int) -> Told:
        """A program of which the journal has none: nothing was touched by it."""
        return cls(sha256, np.zeros(blocks), np.zeros(blocks), np.full(blocks, np.nan), (0, 0))

    @property
    def uncertain(self) -> np.ndarray[Any, Any]:
        """(k,) sequence numbers."""
        return np.flatnonzero(np.isnan(self.touched))


def passes(journal: Path) -> list[Told]:
    """All passes of a journal's file, read beside whoever writes it."""
    with contextlib.closing(sqlite3.connect(f"file:{journal}?mode=ro", uri=True)) as file:
        told = []
        columns = "job, cycle, program_sha256, blocks, contact_from, contact_to, uncertain_from, uncertain_to"
        for row in file.execute(f"SELECT {columns} FROM pass").fetchall():
            job, cycle, sha256, blocks, first, end, *tail = row
            run_s, touched, told_s = np.zeros(blocks), np.zeros(blocks), np.full(blocks, np.nan)
            rows = "SELECT seq, end_s - start_s, touched, told_s FROM segment WHERE job = ? AND cycle = ?"
            for seq, seconds, known, heard_s in file.execute(rows, (job, cycle)):
                run_s[seq], touched[seq] = seconds, np.nan if known is None else known
                told_s[seq] = np.nan if heard_s is None else heard_s
            if tail[0] is not None:
                touched[tail[0] : tail[1]] = np.nan
            told.append(Told(sha256, run_s, touched, told_s, (first, end)))
    return told


def disagreements(
    journal: Path, books: list[dict[str, Any]], *, by_model: bool = False, least_s: float = LEAST_S
) -> list[str]:
    """Where they contradict each other: by pass and block, what the journal says, and what the plant saw.

    ``by_model``: the controller shows the line that it executes. Where several ended between two reports, the motion
    model has shared out the time between these.
    ``least_s``: permitted difference of a time; larger where the controller has no clock, so that times are those of
    readings.

    A program that was no pass is a touch-off's: the robot stands while the tool touches, so that no block is touched.
    A controller that is sent scripts of our own making knows no program by its hash: those are the passes in turn.
    """
    ours = passes(journal)
    told, found = {one.sha256: one for one in ours}, []
    if not told.keys() & {book["sha256"] for book in books}:
        left = iter(ours)
        told, one = {}, next(left, None)
        for book in books:  # a touch-off's program is shorter than a pass
            if one is not None and len(book["contact_s"]) >= len(one.run_s):
                told[book["sha256"]], one = one, next(left, None)
    for book in books:
        one = told.get(book["sha256"]) or Told.of_no_pass(book["sha256"], len(book["contact_s"]))
        contact_s, beyond_s = np.split(np.array(book["contact_s"]), [len(one.run_s)])
        if beyond_s.any():  # a script may have a line of its own behind the program's last block
            found.append(f"{one.sha256[:8]}: the plant saw {beyond_s.sum():.3f} s behind its last block")
        slack_s = SHARE * one.run_s + least_s
        if by_model:
            for run in _told_at_once(one):
                slack_s[run] += SHARED * one.run_s[run]
                if (one.touched[run] == 1).all() and not _sum_holds(one, contact_s, run, least_s):
                    found.append(_of_sum(one, contact_s, run))
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


def _told_at_once(one: Told) -> list[slice]:
    """Runs of several blocks that one report told of."""
    edges = np.flatnonzero(np.diff(one.told_s, prepend=np.nan, append=np.nan) != 0)
    return [slice(a, b) for a, b in pairwise(edges.tolist()) if b - a > 1]


def _sum_holds(one: Told, contact_s: np.ndarray[Any, Any], run: slice, least_s: float) -> bool:
    ours_s = one.run_s[run].sum()
    return bool(abs(contact_s[run].sum() - ours_s) <= TOTAL * ours_s + least_s)


def _of_sum(one: Told, contact_s: np.ndarray[Any, Any], run: slice) -> str:
    ours_s, seen_s = one.run_s[run].sum(), contact_s[run].sum()
    return f"{one.sha256[:8]} blocks {run.start} to {run.stop - 1}: {ours_s:.3f} s in all; the plant saw {seen_s:.3f} s"


def require_agreement(files: DemoFiles) -> None:
    """Of a cell that rests, or polishes whole passes."""
    assert disagreements(files.state_dir / "journal.sqlite", account(files)["programs"]) == []
