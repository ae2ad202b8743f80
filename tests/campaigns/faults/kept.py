"""Results: docs/data/fault-matrix.jsonl, a line a case, and docs/data/fault-losses.jsonl, a line a link."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from functools import cache
from pathlib import Path

from tests.campaigns import result_files
from tests.campaigns.faults.judge import Finding, load
from tests.campaigns.faults.links import LINKS
from tests.campaigns.faults.losses import Loss
from tests.campaigns.result_files import Row
from tests.system.sim_rig import ROOT

DATA = ROOT / "docs" / "data"
CASES = [(name, fault) for name, link in LINKS.items() for fault in link.faults]
LOSES = [name for name, link in LINKS.items() if link.loses()]
EXAMPLES = 5
"""Of losses that went wrong, kept in words."""


@cache
def of_case(link: str) -> str:
    """The hash of what a case on that link depends on, as it is now."""
    return result_files.sources(LINKS[link].parts())


class Kept:
    """Both files. Several threads may add."""

    def __init__(self, folder: Path = DATA, cells: int = 1) -> None:
        """``cells``: so many run side by side, for the rows."""
        self._cases, self._losses = folder / "fault-matrix.jsonl", folder / "fault-losses.jsonl"
        self._cells, self._lock = cells, threading.Lock()

    def cases(self) -> list[Row]:
        """In the order of the page; of cases that there are no more, none."""
        found = {(row["link"], row["fault"]): row for row in result_files.read(self._cases)}
        return [found[case] for case in CASES if case in found]

    def losses(self) -> list[Row]:
        """The same, a row a link and sources."""
        rows = [row for row in result_files.read(self._losses) if row["link"] in LOSES]
        return sorted(rows, key=lambda row: LOSES.index(row["link"]))

    def left(self, *, new: bool = False, again: bool = False) -> list[tuple[str, str]]:
        """Cases to measure: those without a row, then those of other sources; all, or only the first of these."""
        of = {(row["link"], row["fault"]): row["of"] for row in self.cases()}
        missing = [case for case in CASES if case not in of]
        older = [case for case in CASES if case in of and (again or of[case] != of_case(case[0]))]
        return missing if new else missing + older

    def add(self, finding: Finding) -> None:
        """In the place of what was known of that case."""
        with self._lock:
            found = {(row["link"], row["fault"]): row for row in self.cases()}
            about: Row = {"cells": self._cells, "date": result_files.today(), "of": of_case(finding.link)}
            found[finding.link, finding.fault] = {**asdict(finding), **about}
            result_files.keep(self._cases, (found[case] for case in CASES if case in found))

    def lost(self, link: str) -> int:
        """Losses of that link that are counted, of these sources."""
        return sum(count(row) for row in self.losses() if row["link"] == link and row["of"] == of_case(link))

    def add_loss(self, loss: Loss) -> None:
        """To those of its link; once these are as many as those of other sources, the others go."""
        with self._lock:
            rows, of = self.losses(), of_case(loss.link)
            mine = next((row for row in rows if (row["link"], row["of"]) == (loss.link, of)), None)
            if mine is None:
                mine = {"link": loss.link, "limit_s": loss.limit_s, "load": 0.0, "cells": 0, "date": "", "of": of}
                mine |= {"wrong": 0, "examples": [], "hangs": [], "unplugged": []}
                rows.append(mine)
            _count(mine, loss)
            mine |= {"load": max(mine["load"], load()), "cells": max(mine["cells"], self._cells)}
            mine["date"] = result_files.today()
            result_files.keep(self._losses, _without_fewer(rows, mine))


def count(row: Row) -> int:
    """How many losses are in it."""
    return len(row["hangs"]) + len(row["unplugged"])


def _count(row: Row, loss: Loss) -> None:
    row["hangs" if loss.how == "hang" else "unplugged"].append([loss.detection_s, loss.force_off_s])
    row["wrong"] += bool(loss.wrong)
    row["examples"] = [*row["examples"], *loss.wrong][:EXAMPLES]


def _without_fewer(rows: Sequence[Row], mine: Row) -> Iterable[Row]:
    """Less those of the same link, and other sources, that are no more than these."""
    return (row for row in rows if row is mine or row["link"] != mine["link"] or count(row) > count(mine))
