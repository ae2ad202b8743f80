"""What a job begins with: what the last pass of its series has taught. The journal's passes are the only memory.

A series is what a removal rate belongs to: process, compliance, robot, instrument and tool; of a learner that reads
more than the rate from its maps, the part's form, too.
"""

from __future__ import annotations

import hashlib
import json
import logging
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from polishd.config.process_sections import LIMITS_OF_PROCESS
from polishd.daemon.journal.journal import JOURNAL_NAME, NO_JOB, Journal
from polishd.daemon.journal.store import Row, Store
from polishd.daemon.runtime.exit_record import locked
from polishd.model.errors import PolishdError
from polishd.model.estimates import Estimate
from polishd.model.events import ShopRateReceived
from polishd.model.text import with_error
from polishd.pipeline.recipe import Recipe
from polishd.pipeline.records import EstimatesInUse
from polishd.pipeline.steps import initial_estimates

# What other cells of a shop have learned of a recipe, as the shop offered it to this one: events of the journal.

RECIPE = ("process.",)
TOOL = "estimates.tool"
FORGOTTEN = "forgotten"
"""The event behind which nothing is remembered; its data has the last pass before it, ``job`` and ``cycle``."""
UNKNOWN_SHARE, ANOTHER_SHARE = 3.0, 6.0
"""``limits.max_rate_change`` by these: the rate's standard error before any pass, and from one machine to another."""


@dataclass(frozen=True, slots=True)
class ShopRate:
    """Another cell's removal rate."""

    cell: str
    job: str
    of_cycle: int
    at_s: float
    """Unix time at which its pass ended."""
    rate: float
    sigma: float
    """Its standard error on that cell's machine."""

    def on_another_machine(self, max_rate_change: float) -> Estimate:
        """What it says of this one's rate: less sure, and never less than of a machine of which nothing is known."""
        sigma = math.hypot(self.sigma, max_rate_change / ANOTHER_SHARE)
        return Estimate(self.rate, min(sigma, max_rate_change / UNKNOWN_SHARE))

    def told(self) -> str:
        """Whose it is, for people."""
        day = datetime.fromtimestamp(self.at_s, UTC)
        words = f"pass {self.of_cycle + 1} of job {self.job!r} of the cell {self.cell!r}"
        return f"{words} ({day:%Y-%m-%d %H:%M} UTC; another machine, offered by the shop)"


def recipe_of(terms: Mapping[str, Any]) -> str:
    """What identifies the recipe of a job that was begun with those terms, on whatever machine: process and tool.

    Empty where ``process.estimates`` is not ``rate``: the estimates then hold for this machine alone.
    """
    if terms.get("process.estimates", "rate") != "rate":
        return ""
    keys = {key for key in terms if key.startswith(RECIPE) or key == TOOL} - {*LIMITS_OF_PROCESS}
    known = {key: _content(terms[key]) for key in keys}
    return hashlib.sha256(json.dumps(known, sort_keys=True).encode()).hexdigest()[:16]


def latest_offer(read: Callable[[str, Sequence[Any]], list[tuple[Any, ...]]], recipe: str) -> ShopRate | None:
    """The last one of that recipe since anything was forgotten; ``read`` gives all rows of a query of the journal."""
    sql = (
        "SELECT data FROM event WHERE name = ? AND json_extract(data, '$.recipe') = ? "
        "AND id > ifnull((SELECT max(id) FROM event WHERE name = ?), 0) ORDER BY id DESC LIMIT 1"
    )
    found = read(sql, (ShopRateReceived.name, recipe, FORGOTTEN)) if recipe else []
    if not found:
        return None
    said = json.loads(found[0][0])
    return ShopRate(**{key: said[key] for key in ShopRate.__slots__})


def _content(value: Any) -> Any:
    """Of a file what stands in it, wherever it lies."""
    if isinstance(value, Mapping):
        return value.get("sha256")
    return [_content(one) for one in value] if isinstance(value, list) else value


SERIES = ("process.", "compliance.", "kinematics.", "roles.", "instrument.", "estimates.tool")
"""Sections and keys of a job's terms."""
FORM = "part."
MACHINE = ("machine.accel_mm_s2", "machine.corner_deg", "machine.block_overhead_s")
"""What the time that a block takes beyond its motion is learned beside."""
FAR_BACK = 500
"""Passes among which one of the series is looked for."""
DAY_S = 86400.0

Read = Callable[[str, Sequence[Any]], list[tuple[Any, ...]]]
"""(SQL, its values) -> all rows of the journal."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class JournalledEstimates:
    """What a whole pass has taught, as its row keeps it."""

    job: str
    cycle: int
    at_s: float
    """Unix time at which the pass ended."""
    series: str
    machine: str
    tool: str
    believed: Mapping[str, Any]
    """As of ``EstimatesInUse.facts``."""
    anew: bool
    """The pass showed a tool that a person had to see to: what it taught is of the tool before."""
    recipe: str = ""
    """Of process and tool, whatever the machine (``offers.recipe_of``); empty of a pass of an earlier polishd."""


@dataclass(frozen=True, slots=True)
class InitialEstimates:
    """What a job begins with, and why, in words."""

    believed: EstimatesInUse
    note: str


def facts(terms: Mapping[str, Any] | None, believed: EstimatesInUse) -> dict[str, Any]:
    """What a pass's row keeps of what it has taught a job that was begun with those terms."""
    own = terms or {}
    return {
        "taught": {
            "series": series_of(own),
            "machine": _hash({key: own.get(key) for key in MACHINE}),
            "tool": own.get("estimates.tool") or "",
            "recipe": recipe_of(own),
            "believed": believed.facts(),
        }
    }


def initial_estimates_of(
    journal: Journal, recipe: Recipe, terms: Mapping[str, Any] | None = None
) -> InitialEstimates | None:
    """What this job begins with, if the cell's journal has a lesson of its series. Reads the file: call in a thread.

    Where it has none, what another cell of the shop has learned of the recipe, if that was offered.
    ``terms``: of one of several tools; None: the job's own.
    """
    if not recipe.remembers:
        return None
    terms = terms or journal.terms or {}
    series = series_of(terms)
    found = journalled_estimates(journal.store.read, before=journal.number)
    lesson = next((one for one in found if one.series == series), None)
    if lesson is None and (offer := latest_offer(journal.store.read, recipe_of(terms))) is not None:
        return _of_another_cell(offer, recipe)
    if lesson is None or lesson.anew:
        return None
    first = initial_estimates(recipe)
    days = _days_since(lesson.at_s)
    try:
        taught = EstimatesInUse.load(lesson.believed, recipe.model.beliefs)
        removal = recipe.model.later(taught.removal, days)
    except PolishdError as error:
        log.warning("what the pass %d of the job %r taught is of no use: %s", lesson.cycle, lesson.job, error)
        return None
    if abs(removal.rate.value - 1) > recipe.max_rate_change:  # which was narrowed since
        return None
    same = lesson.machine == _hash({key: terms.get(key) for key in MACHINE})
    overhead_s = taught.block_overhead_s if same else first.block_overhead_s
    believed = replace(taught, removal=removal, block_overhead_s=overhead_s)
    return InitialEstimates(believed, f"begins with what {_told(lesson)} has taught: {describe(believed)}")


def _of_another_cell(offer: ShopRate, recipe: Recipe) -> InitialEstimates | None:
    """Its rate, less certain: by the days since, and as this is another machine."""
    first = initial_estimates(recipe)
    rate = offer.on_another_machine(recipe.max_rate_change)
    removal = recipe.model.later(replace(first.removal, rate=rate), _days_since(offer.at_s))
    if abs(rate.value - 1) > recipe.max_rate_change:
        return None
    believed = replace(first, removal=removal)
    return InitialEstimates(believed, f"begins with what {offer.told()} has taught: {describe(believed)}")


def _days_since(at_s: float) -> float:
    """None of a clock that was put back."""
    return max(time.time() - at_s, 0.0) / DAY_S


def series_of(terms: Mapping[str, Any]) -> str:
    """What identifies the series of a job that was begun with those terms."""
    prefixes = SERIES if terms.get("process.estimates", "rate") == "rate" else (*SERIES, FORM)
    other = {"part.id", *LIMITS_OF_PROCESS}
    return _hash({key: one for key, one in terms.items() if key.startswith(prefixes) and key not in other})


def journalled_estimates(read: Read, before: int | None = None) -> Iterator[JournalledEstimates]:
    """The last ones of a cell, the latest first; ``before``: of jobs with a lower number. None that are forgotten."""
    gone = read("SELECT data FROM event WHERE name = ? ORDER BY id DESC LIMIT 1", (FORGOTTEN,))
    behind = json.loads(gone[0][0]) if gone else {"job": NO_JOB, "cycle": -1}
    sql = (
        "SELECT job.name, pass.cycle, pass.ended, pass.facts FROM pass JOIN job ON job.id = pass.job "
        "WHERE pass.how = 'done' AND (pass.job, pass.cycle) > (?, ?) AND pass.job < ifnull(?, pass.job + 1) "
        "ORDER BY pass.job DESC, pass.cycle DESC LIMIT ?"
    )
    for job, cycle, ended, text in read(sql, (behind["job"], behind["cycle"], before, FAR_BACK)):
        found = json.loads(text)
        if taught := found.get("taught"):
            anew = any(one["stops"] == "cell" for one in found.get("findings", ()))
            yield JournalledEstimates(job=job, cycle=cycle, at_s=ended, anew=anew, **taught)


def forget_estimates(state_dir: Path, reason: str) -> None:
    """From now on nothing is remembered of what passes have taught so far; their rows stay as they are.

    ConfigError where a daemon runs the cell: its job goes on with what it knows.
    """
    with locked(state_dir), closing(Store.open(state_dir / JOURNAL_NAME)) as store:
        last = store.read("SELECT job, cycle FROM pass ORDER BY job DESC, cycle DESC LIMIT 1")
        job, cycle = last[0] if last else (NO_JOB, -1)
        data = json.dumps({"job": job, "cycle": cycle, "reason": reason})
        row: Row = (
            "INSERT INTO event (job, at, cycle, name, data) VALUES (?,?,?,?,?)",
            (NO_JOB, time.time(), None, FORGOTTEN, data),
        )
        store.write(row)


def describe(believed: EstimatesInUse) -> str:
    """For people."""
    rate = believed.removal.rate
    value = f"{rate.value:.3f}" if rate.sigma is None else with_error(rate.value, rate.sigma)
    more = len(getattr(believed.removal, "applied", ()))
    others = f", {more} more parameters" if more else ""
    return f"rate {value}, {1e3 * believed.block_overhead_s:.1f} ms a block{others}"


def _told(lesson: JournalledEstimates) -> str:
    day = datetime.fromtimestamp(lesson.at_s, UTC)
    return f"pass {lesson.cycle + 1} of job {lesson.job!r} ({day:%Y-%m-%d %H:%M} UTC)"


def _hash(values: Mapping[str, Any]) -> str:
    text = json.dumps(values, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]
