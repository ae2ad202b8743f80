"""Results of ``make replies``: docs/data/replies.jsonl, a line per driver, and the table in results.md."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pytest

from tests.campaigns import result_files
from tests.campaigns.codecs.controllers import MAKERS, Make, read_until
from tests.campaigns.codecs.driver_cases import TALKS, campaign
from tests.campaigns.codecs.faulty_peer import BAD, Talk, require_all_kinds
from tests.campaigns.result_files import Row
from tests.system.sim_rig import ROOT

PAGE = ROOT / "docs" / "reference" / "results.md"
LINES = ROOT / "docs" / "data" / "replies.jsonl"
BEGIN, END = "<!-- written by make replies -->\n", "<!-- end of what make replies writes -->"
HEADER = """\
| driver | broken | doubled | late | of them taken | refused or link lost | values taken | left out | seeds | measured |
|---|---|---|---|---|---|---|---|---|---|
"""
KINDS = ("broken", "doubled", "late")
COUNTS = (*KINDS, "taken", "refused", "values", "left_out")
"""Counts of a line; where a library hides the wire, none of doubled and late replies."""
COMMON = ("polishd/drivers/transport", "tests/campaigns/codecs")
"""Folders that each line depends on."""


@dataclass(frozen=True)
class Driver:
    """A driver that the campaign tests."""

    run: Callable[[pytest.MonkeyPatch, int, int], Row]
    """Send so many malformed and late replies of a seed, return the counts: (patch, replies, seed)."""
    parts: Sequence[str]
    """Sources that the counts depend on."""

    @property
    def of(self) -> str:
        """The hash of these sources, as they are now."""
        return result_files.sources((*COMMON, *self.parts))


def _run_talk(make: type[Talk], patch: pytest.MonkeyPatch, bad: int, seed: int) -> Row:
    peer, outcomes = campaign(patch, make, bad, seed)
    require_all_kinds(peer, outcomes)
    counts = peer.counts
    counted = [*(counts[kind] for kind in BAD), outcomes["taken"], outcomes["refused"] + outcomes["lost"]]
    return dict(zip(COUNTS, [*counted, outcomes["value"], counts["left out"]], strict=True))


def _run_variables(make: Make, patch: pytest.MonkeyPatch, bad: int, seed: int) -> Row:
    server, variables = make(patch, seed)
    outcomes = asyncio.run(read_until(variables, server, bad))
    counted = [server.counts["broken"], None, None, outcomes["taken"], outcomes["refused"], outcomes["value"], 0]
    return dict(zip(COUNTS, counted, strict=True))


DRIVERS = {
    **{make.name: Driver(partial(_run_talk, make), (f"polishd/drivers/{make.driver}",)) for make in TALKS},
    **{name: Driver(partial(_run_variables, make), ("polishd/drivers/plc_robot",)) for name, make in MAKERS.items()},
}


def seed_counts(name: str, replies: int, seed: int) -> Row:
    """Run a seed of a driver in this process, without its log; return its counts."""
    logging.disable()  # pymodbus logs each broken reply
    with pytest.MonkeyPatch.context() as patch:
        return DRIVERS[name].run(patch, replies, seed)


class Results:
    """The file."""

    def __init__(self, path: Path = LINES) -> None:
        self._path = path

    def rows(self) -> list[Row]:
        """In the order of the page; of a driver that of other sources, where there is one, and then that of these."""
        rows = [row for row in result_files.read(self._path) if row["driver"] in DRIVERS]
        return sorted(rows, key=lambda row: list(DRIVERS).index(row["driver"]))

    def row(self, name: str) -> Row:
        """The driver's line of these sources; an empty one where there is none."""
        of = DRIVERS[name].of
        mine = (row for row in self.rows() if (row["driver"], row["of"]) == (name, of))
        return next(mine, {"driver": name, "seeds": 0, **dict.fromkeys(COUNTS), "date": "", "of": of})

    def add(self, name: str, counted: Row) -> None:
        """Add the counts of one more seed. A line of other sources goes once it is of no more replies."""
        row = self.row(name)
        sums = {key: _sum(row[key], counted[key]) for key in COUNTS}
        row = {**row, "seeds": row["seeds"] + 1, **sums, "date": result_files.today()}
        others = [one for one in self.rows() if one["driver"] != name or bad(one) > bad(row)]
        result_files.keep(self._path, sorted([*others, row], key=lambda one: list(DRIVERS).index(one["driver"])))


def bad(row: Row) -> int:
    """Malformed and late replies."""
    return sum(row[kind] or 0 for kind in KINDS)


def _sum(*parts: int | None) -> int | None:
    known = [part for part in parts if part is not None]
    return sum(known) if known else None


def text(results: Results) -> str:
    """The page's table."""
    return HEADER + "".join(map(_line, results.rows()))


def _line(row: Row) -> str:
    counts = ["" if row[key] is None else f"{row[key]:,}" for key in COUNTS]
    if row["taken"]:
        counts[COUNTS.index("taken")] = f"**{row['taken']:,}**"
    return f"| {row['driver']} | {' | '.join(counts)} | {row['seeds']} | {result_files.when(row)} |\n"
