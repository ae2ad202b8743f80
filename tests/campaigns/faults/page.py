"""docs/fault-matrix.md, of what was measured and saved."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tests.campaigns.faults.links import LINKS
from tests.system.sim_rig import ROOT

PAGE = ROOT / "docs" / "fault-matrix.md"
SAVED = ROOT / "build" / "faults"
BEGIN, END = "<!-- written by make faults -->\n", "<!-- end of what make faults writes -->"
HEADER = """\
| link | fault | noticed as | s to that | limit, s | force off after, s | load | outcome |
|---|---|---|---|---|---|---|---|
"""
LONGEST = 110
LOSSES = """\
| link | losses | s to detection: 50 %, 95 %, most | limit, s | s from that to force off: 50 %, 95 %, most |
|---|---|---|---|---|
"""


def load(folder: Path) -> list[dict[str, Any]]:
    """What was saved, in the order of ``LINKS`` and of the faults of each."""
    order = [(name, fault) for name, link in LINKS.items() for fault in link.faults]
    found = [json.loads(path.read_text()) for path in folder.glob("*.json")]
    known = [one for one in found if (one["link"], one["fault"]) in order]
    return sorted(known, key=lambda one: order.index((one["link"], one["fault"])))


def table(findings: Sequence[dict[str, Any]]) -> str:
    """A row a case."""
    rows = []
    for one in findings:
        noticed = " ".join(one["noticed"].split()).replace("|", "/")
        noticed = _without_paths(noticed)[:LONGEST] or "not at all"
        times = f"{_s(one['detection_s'])} | {one['limit_s']:g} | {_s(one['force_off_s'])} | {_load(one)}"
        wrong = "; **wrong: " + "; ".join(one["wrong"]) + "**" if one["wrong"] else ""
        rows.append(f"| {one['link']} | {one['fault']} | {noticed} | {times} | {one['outcome']}{wrong} |\n")
    cases = sum(len(link.faults) for link in LINKS.values())
    return f"{len(findings)} of {cases} cases were measured.\n\n{HEADER}{''.join(rows)}"


def losses(folder: Path) -> str:
    """The distributions, a row a link; nothing where none were counted."""
    rows = []
    for path in sorted(folder.glob("*.losses")):
        told = json.loads(path.read_text())
        times = [one for one in told if one["detection_s"] is not None and one["force_off_s"] is not None]
        if times:
            spread = [_spread([one[key] for one in times]) for key in ("detection_s", "force_off_s")]
            rows.append(f"| {told[0]['link']} | {len(times)} | {spread[0]} | {told[0]['limit_s']:g} | {spread[1]} |\n")
    return f"\n{LOSSES}{''.join(rows)}" if rows else ""


def write(folder: Path = SAVED, page: Path = PAGE) -> None:
    """Put both tables into the page."""
    before, _, rest = page.read_text().partition(BEGIN)
    page.write_text(before + BEGIN + table(load(folder)) + losses(folder) + END + rest.partition(END)[2])


def _s(seconds: float | None) -> str:
    return "" if seconds is None else f"{seconds:.2f}"


def _load(one: dict[str, Any]) -> str:
    return "not noted" if one.get("load") is None else f"{one['load']:.1f}"


def _spread(values: Sequence[float]) -> str:
    return ", ".join(f"{value:.2f}" for value in np.percentile(values, [50.0, 95.0, 100.0]))


def _without_paths(text: str) -> str:
    """A case's folder says nothing to a reader."""
    return " ".join(f"...{word.rpartition('/sim/')[2]}" if "/sim/" in word else word for word in text.split())
