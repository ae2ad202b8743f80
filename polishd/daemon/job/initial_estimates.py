"""Initial estimates of a job: those after the last pass of its series, which the journal holds.

A series is all that a removal rate depends on: process, compliance, robot, instrument and tool. Where
``process.estimates`` reads more than the rate from the maps, the form of the part belongs to it too.
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

# Removal rates of other cells of a shop for the same recipe: events of the journal.

RECIPE = ("process.",)
TOOL = "estimates.tool"
FORGOTTEN = "forgotten"
"""Event that makes all earlier estimates void. Its data names the last pass before it: ``job`` and ``cycle``."""
UNKNOWN_SHARE, ANOTHER_SHARE = 3.0, 6.0
"""``limits.max_rate_change`` divided by these: standard error of the rate before any pass, and between machines."""


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
        """Return the estimate for this machine: less certain, but no less than for an unknown machine."""
        sigma = math.hypot(self.sigma, max_rate_change / ANOTHER_SHARE)
        return Estimate(self.rate, min(sigma, max_rate_change / UNKNOWN_SHARE))

    def source(self) -> str:
        """Return the description of its pass and cell."""
        day = datetime.fromtimestamp(self.at_s, UTC)
        source = f"pass {self.of_cycle + 1} of job {self.job!r} of the cell {self.cell!r}"
        return f"{source} ({day:%Y-%m-%d %H:%M} UTC; another machine, offered by the shop)"


def recipe_of(terms: Mapping[str, Any]) -> str:
    """Return the id of the recipe, process and tool, of a job with these terms. It is the same on any machine.

    Empty where ``process.estimates`` is not ``rate``: the estimates then hold for this machine alone.
    """
    if terms.get("process.estimates", "rate") != "rate":
        return ""
    keys = {key for key in terms if key.startswith(RECIPE) or key == TOOL} - {*LIMITS_OF_PROCESS}
    known = {key: _content(terms[key]) for key in keys}
    return hashlib.sha256(json.dumps(known, sort_keys=True).encode()).hexdigest()[:16]


def latest_offer(read: Callable[[str, Sequence[Any]], list[tuple[Any, ...]]], recipe: str) -> ShopRate | None:
    """Return the last offered rate of that recipe that is not void. ``read`` returns all rows of a journal query."""
    sql = (
        "SELECT data FROM event WHERE name = ? AND json_extract(data, '$.recipe') = ? "
        "AND id > ifnull((SELECT max(id) FROM event WHERE name = ?), 0) ORDER BY id DESC LIMIT 1"
    )
    found = read(sql, (ShopRateReceived.name, recipe, FORGOTTEN)) if recipe else []
    if not found:
        return None
    offer = json.loads(found[0][0])
    return ShopRate(**{key: offer[key] for key in ShopRate.__slots__})


def _content(value: Any) -> Any:
    """Return the hash of a file's content in place of its path."""
    if isinstance(value, Mapping):
        return value.get("sha256")
    return [_content(one) for one in value] if isinstance(value, list) else value


SERIES = ("process.", "compliance.", "kinematics.", "roles.", "instrument.", "estimates.tool")
"""Sections and keys of a job's terms."""
FORM = "part."
MACHINE = ("machine.accel_mm_s2", "machine.corner_deg", "machine.block_overhead_s")
"""Keys on which the estimated overhead of a block depends."""
FAR_BACK = 500
"""Number of passes that are searched for one of the series."""
DAY_S = 86400.0

Read = Callable[[str, Sequence[Any]], list[tuple[Any, ...]]]
"""(SQL, values) -> all rows of the journal."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class JournalledEstimates:
    """Estimates after a complete pass, from its row."""

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
    """The pass showed a tool that an operator had to check: the estimates belong to the earlier state of the tool."""
    recipe: str = ""
    """Id from ``recipe_of``; empty for a pass of an earlier polishd."""


@dataclass(frozen=True, slots=True)
class InitialEstimates:
    """Estimates at the begin of a job, and a note on their source."""

    estimates: EstimatesInUse
    note: str


def facts(terms: Mapping[str, Any] | None, believed: EstimatesInUse) -> dict[str, Any]:
    """Return the facts for a pass's row: the estimates after it, and the series and recipe of its job's terms."""
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
    """Return the estimates of the last pass of the job's series in this cell's journal.

    Where there is none, return the rate that the shop offers from another cell. None: the job starts without. It reads
    the file: call it in a thread. ``terms``: of one of several tools; None: the job's.
    """
    if not recipe.remembers:
        return None
    terms = terms or journal.terms or {}
    series = series_of(terms)
    found = journalled_estimates(journal.store.read, before=journal.number)
    last = next((one for one in found if one.series == series), None)
    if last is None and (offer := latest_offer(journal.store.read, recipe_of(terms))) is not None:
        return _of_another_cell(offer, recipe)
    if last is None or last.anew:
        return None
    first = initial_estimates(recipe)
    days = _days_since(last.at_s)
    try:
        taught = EstimatesInUse.load(last.believed, recipe.model.beliefs)
        removal = recipe.model.later(taught.removal, days)
    except PolishdError as error:
        log.warning("the estimates after pass %d of the job %r are not used: %s", last.cycle + 1, last.job, error)
        return None
    if abs(removal.rate.value - 1) > recipe.max_rate_change:  # the limit was reduced since
        return None
    same = last.machine == _hash({key: terms.get(key) for key in MACHINE})
    overhead_s = taught.block_overhead_s if same else first.block_overhead_s
    believed = replace(taught, removal=removal, block_overhead_s=overhead_s)
    day = datetime.fromtimestamp(last.at_s, UTC)
    source = f"pass {last.cycle + 1} of job {last.job!r} ({day:%Y-%m-%d %H:%M} UTC)"
    return InitialEstimates(believed, f"starts with the estimates after {source}: {describe(believed)}")


def _of_another_cell(offer: ShopRate, recipe: Recipe) -> InitialEstimates | None:
    """Return its rate, less certain: by the days since, and because this is another machine."""
    first = initial_estimates(recipe)
    rate = offer.on_another_machine(recipe.max_rate_change)
    removal = recipe.model.later(replace(first.removal, rate=rate), _days_since(offer.at_s))
    if abs(rate.value - 1) > recipe.max_rate_change:
        return None
    believed = replace(first, removal=removal)
    return InitialEstimates(believed, f"starts with the estimates after {offer.source()}: {describe(believed)}")


def _days_since(at_s: float) -> float:
    """Return the days since then; 0 where the clock was set back."""
    return max(time.time() - at_s, 0.0) / DAY_S


def series_of(terms: Mapping[str, Any]) -> str:
    """Return the id of the series of a job with these terms."""
    prefixes = SERIES if terms.get("process.estimates", "rate") == "rate" else (*SERIES, FORM)
    other = {"part.id", *LIMITS_OF_PROCESS}
    return _hash({key: one for key, one in terms.items() if key.startswith(prefixes) and key not in other})


def journalled_estimates(read: Read, before: int | None = None) -> Iterator[JournalledEstimates]:
    """Yield the last estimates of a cell that are not void, the latest first.

    ``before``: only of jobs with a lower number.
    """
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
    """Make all estimates of earlier passes void; their rows do not change.

    ConfigError where a daemon runs the cell: its job uses its estimates further.
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
    """Return the description of the estimates."""
    rate = believed.removal.rate
    value = f"{rate.value:.3f}" if rate.sigma is None else with_error(rate.value, rate.sigma)
    more = len(getattr(believed.removal, "applied", ()))
    others = f", {more} more parameters" if more else ""
    return f"rate {value}, {1e3 * believed.block_overhead_s:.1f} ms a block{others}"


def _hash(values: Mapping[str, Any]) -> str:
    text = json.dumps(values, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]
