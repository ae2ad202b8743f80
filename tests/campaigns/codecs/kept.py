"""What ``make replies`` came to: docs/data/replies.jsonl, a line a driver, and docs/reference/results.md of it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pytest

from tests.campaigns import beside
from tests.campaigns.beside import Row
from tests.campaigns.codecs.controllers import MAKERS, Make, read_for_ever
from tests.campaigns.codecs.nasty import BAD, Talk, require_said
from tests.campaigns.codecs.talks import TALKS, campaign
from tests.system.sim_rig import ROOT

PAGE = ROOT / "docs" / "reference" / "results.md"
LINES = ROOT / "docs" / "data" / "replies.jsonl"
BEGIN, END = "<!-- written by make replies -->\n", "<!-- end of what make replies writes -->"
HEADER = """\
| driver | broken | doubled | late | of them taken | refused or link lost | values taken | left out | seeds | measured |
|---|---|---|---|---|---|---|---|---|---|
"""
KINDS = ("broken", "doubled", "late")
TOLD = (*KINDS, "taken", "refused", "values", "left_out")
"""What a seed adds to the line of its driver; where a library hides the wire, nothing comes twice or late."""
COMMON = ("polishd/drivers/transport", "tests/campaigns/codecs")
"""Folders that each line depends on."""


@dataclass(frozen=True)
class Driver:
    """Whom the campaign asks."""

    told: Callable[[pytest.MonkeyPatch, int, int], Row]
    """What so many malformed and late replies of a seed came to: (patch, replies, seed)."""
    parts: Sequence[str]
    """What that depends on."""

    @property
    def of(self) -> str:
        """The hash of that, as it is now."""
        return beside.sources((*COMMON, *self.parts))


def _of_talk(make: type[Talk], patch: pytest.MonkeyPatch, bad: int, seed: int) -> Row:
    nasty, outcomes = campaign(patch, make, bad, seed)
    require_said(nasty, outcomes)
    counts = nasty.counts
    told = [*(counts[kind] for kind in BAD), outcomes["taken"], outcomes["refused"] + outcomes["lost"]]
    return dict(zip(TOLD, [*told, outcomes["value"], counts["not to be told"]], strict=True))


def _of_variables(make: Make, patch: pytest.MonkeyPatch, bad: int, seed: int) -> Row:
    server, variables = make(patch, seed)
    outcomes = asyncio.run(read_for_ever(variables, server, bad))
    told = [server.counts["broken"], None, None, outcomes["taken"], outcomes["refused"], outcomes["value"], 0]
    return dict(zip(TOLD, told, strict=True))


DRIVERS = {
    **{make.name: Driver(partial(_of_talk, make), (f"polishd/drivers/{make.driver}",)) for make in TALKS},
    **{name: Driver(partial(_of_variables, make), ("polishd/drivers/plc_robot",)) for name, make in MAKERS.items()},
}


class Kept:
    """The file."""

    def __init__(self, path: Path = LINES) -> None:
        self._path = path

    def rows(self) -> list[Row]:
        """In the order of the page; of a driver that of other sources, where there is one, and then that of these."""
        rows = [row for row in beside.read(self._path) if row["driver"] in DRIVERS]
        return sorted(rows, key=lambda row: list(DRIVERS).index(row["driver"]))

    def row(self, name: str) -> Row:
        """The driver's line of these sources; an empty one where there is none."""
        of = DRIVERS[name].of
        mine = (row for row in self.rows() if (row["driver"], row["of"]) == (name, of))
        return next(mine, {"driver": name, "seeds": 0, **dict.fromkeys(TOLD), "date": "", "of": of})

    def add(self, name: str, told: Row) -> None:
        """What one more seed came to. A line of other sources goes once it is of no more replies."""
        row = self.row(name)
        sums = {key: _sum(row[key], told[key]) for key in TOLD}
        row = {**row, "seeds": row["seeds"] + 1, **sums, "date": beside.today()}
        others = [one for one in self.rows() if one["driver"] != name or bad(one) > bad(row)]
        beside.keep(self._path, sorted([*others, row], key=lambda one: list(DRIVERS).index(one["driver"])))


def bad(row: Row) -> int:
    """Malformed and late replies."""
    return sum(row[kind] or 0 for kind in KINDS)


def _sum(*parts: int | None) -> int | None:
    known = [part for part in parts if part is not None]
    return sum(known) if known else None


def text(kept: Kept) -> str:
    """The page's table."""
    return HEADER + "".join(map(_line, kept.rows()))


def _line(row: Row) -> str:
    counts = ["" if row[key] is None else f"{row[key]:,}" for key in TOLD]
    if row["taken"]:
        counts[TOLD.index("taken")] = f"**{row['taken']:,}**"
    return f"| {row['driver']} | {' | '.join(counts)} | {row['seeds']} | {beside.when(row)} |\n"
