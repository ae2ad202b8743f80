"""Results of a soak: a line of JSON for each part, and their table in docs/reference/results.md."""

from __future__ import annotations

import json
import os
import platform
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from statistics import median
from typing import Any

from polishd.util.files import write_atomic
from tests.campaigns import result_files
from tests.campaigns.soak.growth import BOUNDS, Slope, slopes
from tests.campaigns.soak.records import Record
from tests.campaigns.soak.scripts import ACCEPTED, BY_A_PERSON, CALM, RECOVERED, SCRIPTS, Script
from tests.system.sim_rig import ROOT

CPU_S = 20.0
"""Permitted CPU time for a part, of daemon, worker and simulators."""
RECOVERED_SHARE = 0.99
"""Required share of parts accepted without an operator, of those that can be."""
OUTSIDE_SHARE = 0.01
"""Permitted share of accepted parts whose true surface is out of tolerance."""
ENOUGH = 100
"""Number of parts from which the shares are checked."""
PAGE = ROOT / "docs" / "reference" / "results.md"
BEGIN, END = "<!-- written by make soak -->\n", "<!-- end of what make soak writes -->"
LIFE_BEGIN, LIFE_END = "<!-- written by make soak --life -->\n", "<!-- end of what make soak --life writes -->"
WITHOUT = {CALM.name, *(script.name for script in RECOVERED)}
UNITS = {
    "daemon_rss_mb": "memory of the daemon, MB",
    "worker_rss_mb": "memory of the worker, MB",
    "descriptors": "descriptors of the daemon",
    "threads": "threads of the daemon",
    "tasks": "tasks of the daemon",
    "written_mb": "written for a part, MB (journal, array store, log)",
}


def sources() -> str:
    """Return the hash of polishd and of the soak itself: when it changes, the figures start anew."""
    return result_files.sources(("polishd", "tests/campaigns/soak"))


class Figures:
    """Folder with ``SOURCES-SEED-SPEED.jsonl``, a line for each part, and ``evidence`` of failures.

    ``life``: separate records of parts that one daemon polishes.
    """

    def __init__(self, folder: Path, seed: int, speed: float, *, life: bool = False) -> None:
        self.folder, self.seed, self.speed, self.of = folder, seed, speed, sources()
        folder.mkdir(parents=True, exist_ok=True)
        self._path = folder / f"{self.of}-{seed}-{speed:g}{'-life' * life}.jsonl"
        text = self._path.read_text() if self._path.exists() else ""
        whole, _, cut_off = text.rpartition("\n")
        if cut_off:  # a power cut: that part is done again
            write_atomic(self._path, f"{whole}\n".encode() if whole else b"")
        self.records: list[dict[str, Any]] = [json.loads(line) for line in whole.splitlines()]

    @property
    def done(self) -> set[int]:
        """Numbers of the parts that are done."""
        return {record["number"] for record in self.records}

    def add(self, record: Record) -> None:
        """Save a record. It is durable when this returns."""
        facts = {**asdict(record), "too_slow": record.too_slow}
        with self._path.open("a") as file:
            file.write(json.dumps(facts) + "\n")
            file.flush()
            os.fsync(file.fileno())
        self.records.append(facts)

    def sums(self) -> Sums:
        """Return the figures of all records."""
        return Sums(self.records)

    def conditions(self) -> str:
        """Return the conditions of the measurement."""
        python, cores = platform.python_version(), os.cpu_count()
        at = datetime.now(UTC).strftime("%Y-%m-%d")
        return (
            f"Sources {self.of}, seed {self.seed}, simulated clock {self.speed:g} times as fast as the wall, "
            f"{platform.system()}, Python {python}, {cores} cores, {at}."
        )


@dataclass(frozen=True)
class Sums:
    """Figures of records in JSON form."""

    all: Sequence[Mapping[str, Any]]

    @cached_property
    def counted(self) -> list[Mapping[str, Any]]:
        """Records of parts for which the machine was fast enough."""
        return [record for record in self.all if not (record["too_slow"] or record["missed"])]

    @cached_property
    def without(self) -> list[Mapping[str, Any]]:
        """Records of parts that need no operator."""
        return [record for record in self.counted if record["script"] in WITHOUT or not record["struck"]]

    @cached_property
    def alone(self) -> int:
        """Number of these parts that were accepted without an operator."""
        return sum(r["verdict"] == ACCEPTED and not (r["visits"] or r["unexpected"]) for r in self.without)

    @cached_property
    def accepted(self) -> list[Mapping[str, Any]]:
        """Records of accepted parts, with any fault."""
        return [record for record in self.counted if record["verdict"] == ACCEPTED and record["measured"]]

    @cached_property
    def outside_nm(self) -> list[float]:
        """Excess over the tolerance of accepted parts whose true surface is out of tolerance, nm."""
        beyond = (record["true_rms_nm"] - record["measured"]["limit_nm"] for record in self.accepted)
        return sorted(round(by, 3) for by in beyond if by > 0)

    @cached_property
    def uncertain(self) -> int:
        """Number of these parts with an excess above the measurement's stated uncertainty."""
        return sum(
            r["true_rms_nm"] > r["measured"]["limit_nm"] + r["measured"]["uncertainty_nm"] for r in self.accepted
        )

    @cached_property
    def damaged(self) -> int:
        """Number of parts for which plant and journal disagree, a tool stood still, or removal exceeds the plan."""
        return sum(any(said.startswith("damage") for said in record["wrong"]) for record in self.counted)

    @cached_property
    def other_ends(self) -> int:
        """Number of parts that did not end as their script requires."""
        return sum(any(not said.startswith("damage") for said in record["wrong"]) for record in self.counted)

    @cached_property
    def slopes(self) -> dict[str, Slope]:
        """Growth per part by figure."""
        return slopes(self.counted)

    @cached_property
    def cpu_s(self) -> list[float]:
        """CPU time of each part, sorted; of daemon, worker and simulators."""
        return sorted(sum(s for of, s in record["cpu_s"].items() if of != "commands") for record in self.counted)

    def wrong(self) -> list[str]:
        """Return the failures of the campaign."""
        few = len(self.without) < ENOUGH
        missed = len(self.without) - self.alone
        mean_s = sum(self.cpu_s) / max(len(self.cpu_s), 1)
        said = {
            f"{missed} of {len(self.without)} parts were not accepted without a person": missed
            > (1 if few else (1 - RECOVERED_SHARE) * len(self.without)),
            f"{len(self.outside_nm)} accepted parts are out of tolerance": len(self.outside_nm)
            > (1 if few else OUTSIDE_SHARE * len(self.accepted)),
            f"{self.uncertain} of them by more than the stated uncertainty": self.uncertain > 0,
            f"{self.damaged} parts are damaged": self.damaged > 0,
            f"{self.by_person_wrong} faults that need a person did not lead to their end": self.by_person_wrong > 0,
            f"a part takes {mean_s:.1f} CPU seconds": mean_s > CPU_S,
            **{f"{name} grows by {slope.per_part:.3g} a part": slope.grows(BOUNDS[name])
               for name, slope in self.slopes.items()},
        }  # fmt: skip
        return [what for what, so in said.items() if so]

    @cached_property
    def by_person_wrong(self) -> int:
        """Number of parts whose script needs an operator and that ended otherwise."""
        names = {script.name for script in BY_A_PERSON}
        return sum(bool(r["wrong"]) and r["struck"] and r["script"] in names for r in self.counted)

    def summary(self) -> dict[str, Any]:
        """Return the summary for the last line."""
        return {
            "parts": len(self.all),
            "not_counted": len(self.all) - len(self.counted),
            "without_a_person": [self.alone, len(self.without)],
            "accepted": len(self.accepted),
            "outside_nm": self.outside_nm,
            "beyond_uncertainty": self.uncertain,
            "damaged": self.damaged,
            "other_ends": self.other_ends,
            "visits": sum(record["visits"] for record in self.counted),
            "unexpected_visits": sum(len(record["unexpected"]) for record in self.counted),
            "cpu_s": [round(value, 2) for value in (median(self.cpu_s), self.cpu_s[-1])] if self.cpu_s else [],
            "growth": {name: [slope.per_part, slope.sigma] for name, slope in self.slopes.items()},
            "wrong": self.wrong(),
        }


HEAD = """\
| fault | drawn | should end | parts | ended so | visits |
|---|---|---|---|---|---|
"""


def table(sums: Sums, conditions: str) -> str:
    """Return the section of the page."""
    rows = [*_counts(sums), *_uses(sums)]
    first = "| what | how many |\n|---|---|\n" + "".join(f"| {what} | {n} |\n" for what, n in rows)
    ends = "".join(f"| {' | '.join(_ends(script, sums))} |\n" for script in SCRIPTS)
    return f"{first}\n{HEAD}{ends}\n{conditions}\n"


def _ends(script: Script, sums: Sums) -> list[str]:
    """Return the table row of a script."""
    mine = [record for record in sums.counted if record["script"] == script.name and record["struck"]]
    visits = sum(record["visits"] + len(record["unexpected"]) for record in mine)
    end = script.end if script.end == ACCEPTED else f"{script.end}: {' or '.join(script.faults)}"
    if script.visits or script.after:
        end += ", with a person" if script.end == ACCEPTED else "; held for a person"
    share = f"{script.share / sum(one.share for one in SCRIPTS):.1%}"
    return [script.name, share, end, str(len(mine)), str(sum(not record["wrong"] for record in mine)), str(visits)]


def _counts(sums: Sums) -> list[tuple[str, object]]:
    alone = f"**{sums.alone}**" + (f" ({sums.alone / len(sums.without):.1%})" if sums.without else "")
    outside = f"{len(sums.outside_nm)} of {len(sums.accepted)}"
    outside += f", by {sums.outside_nm[-1]:.3f} nm at most" if sums.outside_nm else ""
    verdicts = Counter(record["verdict"] or "none" for record in sums.counted)
    sessions, lives = ({record[name] for record in sums.all} for name in ("session", "life"))
    visits = sum(record["visits"] for record in sums.counted)
    unexpected = sum(len(record["unexpected"]) for record in sums.counted)
    return [
        ("parts through the queue", f"{len(sums.all):,}"),
        ("... not counted: the machine was too slow, and a device seemed silent", sum(r["too_slow"] for r in sums.all)),
        ("... not counted: the fault came after contact", sum(r["missed"] for r in sums.all)),
        ("... how they ended", ", ".join(f"{how} {n}" for how, n in verdicts.most_common())),
        ("sessions, starts of the daemon", f"{len(sessions)}, {len(lives)}"),
        ("parts with nothing, or with faults that polishd can recover from", len(sums.without)),
        ("**... accepted without a person**", alone),
        ("accepted, and the true surface is out of tolerance", outside),
        ("**... by more than the stated uncertainty**", f"**{sums.uncertain}**"),
        ("**damaged**", f"**{sums.damaged}**"),
        ("**faults that need a person, and led to another end**", f"**{sums.by_person_wrong}**"),
        ("visits of a person: expected, not expected", f"{visits}, {unexpected}"),
    ]


def _uses(sums: Sums) -> list[tuple[str, object]]:
    if not sums.cpu_s:
        return []
    by_group: Counter[str] = Counter()
    for record in sums.counted:
        by_group.update(record["cpu_s"])
    each = ", ".join(f"{of} {seconds / len(sums.counted):.1f}" for of, seconds in by_group.most_common())
    return [
        ("CPU seconds a part: median, most", f"{median(sums.cpu_s):.1f}, {sums.cpu_s[-1]:.1f}"),
        ("... mean of each", each),
        ("wall seconds a part, median", f"{median(record['wall_s'] for record in sums.counted):.1f}"),
    ]


def life_table(sums: Sums, conditions: str) -> str:
    """Return the part of the page about growth."""
    ends = Counter(record["verdict"] or "none" for record in sums.counted)
    rows = [
        ("parts, starts of the daemon", f"{len(sums.all)}, {len({record['life'] for record in sums.all})}"),
        ("... how they ended", ", ".join(f"{how} {n}" for how, n in ends.most_common())),
        *((f"growth a part: {UNITS[name]}", _growth(slope, BOUNDS[name])) for name, slope in sums.slopes.items()),
    ]
    return "| what | how many |\n|---|---|\n" + "".join(f"| {what} | {n} |\n" for what, n in rows) + f"\n{conditions}\n"


def _growth(slope: Slope, bound: float) -> str:
    if not slope.parts:
        return "not known yet"
    so = "flat" if slope.flat(bound) else "**grows**" if slope.grows(bound) else "not shown either way"
    rate = f"{slope.per_part:+.4f} +- {slope.sigma:.4f}; at most {bound:g}: {so}"
    return f"{rate} ({slope.parts} parts, mean {slope.mean:.3g})"


def write_page(text: str, *, life: bool = False) -> None:
    """Write the section to docs/reference/results.md."""
    begin, end = (LIFE_BEGIN, LIFE_END) if life else (BEGIN, END)
    before, _, rest = PAGE.read_text().partition(begin)
    PAGE.write_text(before + begin + text + end + rest.partition(end)[2])
