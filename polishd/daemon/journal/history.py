"""History of a cell over its parts, from the journal's rows. A daemon may run at the same time."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

from polishd.daemon.journal.journal import JOURNAL_NAME
from polishd.daemon.journal.store import SCHEMA_VERSION, require_sound, show_present_names
from polishd.model.errors import ConfigError, JournalDamage, ToolStop
from polishd.model.tolerance import LineResult, line_results, worst_line

FAULTS = ("cell_held", "daemon_failed", "finding_reported")
"""Events that needed an operator."""
WITH_FINDING = ToolStop.__name__
"""Error with the same cause as the event ``finding_reported``."""


@dataclass(frozen=True, slots=True)
class HistoryMeasurement:
    """One map of a part, and the pass before it."""

    at_s: float
    """Unix time."""
    rms_nm: float
    judged: tuple[LineResult, ...]
    rate: float | None
    """Removal rate from the pass before it, relative to the model's; None: unknown."""
    rate_sigma: float | None
    predicted_nm: float | None
    """RMS predicted by the plan of that pass."""
    as_forecast: bool | None
    """Whether the RMS after that pass is in the 90 % interval of its forecast; None: there is no forecast."""


@dataclass(frozen=True, slots=True)
class FaultEvent:
    """An event that needed an operator."""

    at_s: float
    kind: str
    """Class of the error, or kind of the finding."""
    what: str


@dataclass(frozen=True, slots=True)
class JobHistory:
    """One job, from its row and the rows that name it."""

    number: int
    """Its row in the journal."""
    job: str
    part_id: str
    began_s: float
    ended_s: float | None
    outcome: str
    """Empty: it is under way, or was abandoned."""
    passes: int
    """Number of complete passes."""
    interrupted: int
    contact_s: float
    measured: tuple[HistoryMeasurement, ...]
    faults: tuple[FaultEvent, ...]

    @property
    def rate(self) -> float | None:
        """Rate from the last pass that shows one."""
        return next((one.rate for one in reversed(self.measured) if one.rate is not None), None)

    @property
    def worst(self) -> LineResult | None:
        """Worst line of the tolerance in the last measurement."""
        return worst_line(self.measured[-1].judged) if self.measured else None


def read_history(state_dir: Path, after: int = 0) -> list[JobHistory]:
    """Return all jobs of a cell in order; ConfigError where there is no journal, or it cannot be read.

    The file is opened read-only and blocks no writer: a daemon may be in contact. ``after``: only jobs after that
    number.
    """
    with read_only(state_dir) as journal:
        return list(_jobs(journal, after))


def read_events(
    state_dir: Path, count: int, before: int | None = None, names: Sequence[str] = ()
) -> list[dict[str, Any]]:
    """Return the last events of all jobs, the newest last: ``number, at_s, cycle, name, data``.

    ``before``: only events before that number. ``names``: only these kinds; without it all but ``pass_progressed``.
    Empty where there is no journal; ConfigError where it cannot be read.
    """
    if not (state_dir / JOURNAL_NAME).exists():
        return []
    kinds = f"name IN ({', '.join('?' * len(names))})" if names else "name != 'pass_progressed'"
    sql = f"SELECT id, at, cycle, name, data FROM event WHERE {kinds} AND id < ? ORDER BY id DESC LIMIT ?"  # noqa: S608
    with read_only(state_dir) as journal:
        rows = journal.execute(sql, (*names, 1 << 60 if before is None else before, count)).fetchall()
        keys = ("number", "at_s", "cycle", "name")
        return [{**dict(zip(keys, row[:4], strict=True)), "data": dict(json.loads(row[4]))} for row in reversed(rows)]


@contextmanager
def read_only(state_dir: Path) -> Iterator[sqlite3.Connection]:
    """Open a snapshot of a cell's journal, which a daemon may write at the same time; ConfigError as `read_history`.

    Parse rows inside this block too: an error from a damaged row becomes JournalDamage, which names the row.
    """
    path = state_dir / JOURNAL_NAME
    if not path.exists():
        raise ConfigError(f"{path}: not found: this cell has begun no job yet. Run polishd run CELL.toml")
    with naming_damage(state_dir), closing(_opened(path)) as journal:
        journal.execute("BEGIN")  # one snapshot for all reads
        yield journal


@contextmanager
def naming_damage(state_dir: Path) -> Iterator[None]:
    """Where reading a cell's journal fails inside this block, find the damaged row: JournalDamage names it.

    ConfigError where SQLite or a parser fails and no damage is found. Other errors pass unchanged.
    """
    path = state_dir / JOURNAL_NAME
    try:
        yield
    except (sqlite3.Error, ValueError) as error:
        _require_sound(path, error)
        raise ConfigError(f"{path}: the history cannot be read: {error}. Run polishd run: it updates an old journal, "
                          "or names the damage") from error  # fmt: skip
    except (LookupError, TypeError, AttributeError) as error:  # damaged JSON that is still valid JSON
        _require_sound(path, error)
        raise


def _require_sound(path: Path, error: Exception) -> None:
    try:
        require_sound(path)
    except JournalDamage as damage:
        raise damage from error


def _opened(path: Path) -> sqlite3.Connection:
    """Return a read-only connection. A journal from before release 1.0 is read with the present names."""
    connection = sqlite3.connect(f"file:{quote(str(path.absolute()))}?mode=ro", uri=True)
    try:
        (version,) = connection.execute("PRAGMA user_version").fetchone()
        if 0 < version < SCHEMA_VERSION:
            show_present_names(connection)
    except BaseException:
        connection.close()
        raise
    return connection


def _jobs(journal: sqlite3.Connection, after: int) -> Iterator[JobHistory]:
    maps = _by_job(journal, "SELECT job, cycle, taken, stats FROM map WHERE job > ? ORDER BY id", (after,))
    passes = _by_job(journal, "SELECT job, cycle, how, facts FROM pass WHERE job > ? ORDER BY job, cycle", (after,))
    marks = ", ".join("?" * len(FAULTS))
    sql = f"SELECT job, at, name, data FROM event WHERE job > ? AND name IN ({marks}) ORDER BY id"  # noqa: S608
    events = _by_job(journal, sql, (after, *FAULTS))
    jobs = "SELECT id, name, part_id, started, ended, outcome FROM job WHERE id > ? ORDER BY id"
    for number, *row in journal.execute(jobs, (after,)):
        name, part_id, began_s, ended_s, outcome = row
        run = {cycle: (how, json.loads(facts)) for cycle, how, facts in passes.get(number, ())}
        last = {cycle: (taken, json.loads(stats)) for cycle, taken, stats in maps.get(number, ())}
        hows = [how for how, _ in run.values()]
        yield JobHistory(
            number=number,
            job=name,
            part_id=part_id,
            began_s=began_s,
            ended_s=ended_s,
            outcome=outcome or "",
            passes=hows.count("done"),
            interrupted=sum(how not in {None, "done"} for how in hows),
            contact_s=sum((facts.get("shown") or {}).get("contact_s", 0.0) for _, facts in run.values()),
            measured=tuple(_measurement(*found, run.get(cycle - 1, ("", {}))[1]) for cycle, found in last.items()),
            faults=tuple(_faults(events.get(number, ()))),
        )


def _by_job(journal: sqlite3.Connection, sql: str, values: Sequence[Any] = ()) -> dict[int, list[Any]]:
    """Return the other columns of the rows, by their first one."""
    found: dict[int, list[Any]] = {}
    for job, *row in journal.execute(sql, values):
        found.setdefault(job, []).append(tuple(row))
    return found


def _measurement(at_s: float, stats: Mapping[str, Any], before: Mapping[str, Any]) -> HistoryMeasurement:
    rate = (before.get("shown") or {}).get("rate") or {}
    judged = line_results(stats)
    predicted = before.get("predicted_rms_nm")
    rms, rates = stats["rms_nm"], (rate.get("value"), rate.get("sigma"))
    return HistoryMeasurement(at_s, rms, judged, *rates, predicted, _as_forecast(before.get("shown") or {}))


def _as_forecast(shown: Mapping[str, Any]) -> bool | None:
    expected = shown.get("expected_nm")
    seen_nm = shown.get("seen_nm")  # passes before 2026-11-25 have none
    return None if expected is None or seen_nm is None else bool(expected[0] <= seen_nm <= expected[1])


def _faults(events: Iterable[tuple[float, str, str]]) -> Iterator[FaultEvent]:
    """Yield each fault once: an error that held the cell and then ended its daemon is one fault."""
    last = ("", "")
    for at_s, name, data in events:
        values = json.loads(data)
        fault = FaultEvent(at_s, values["kind"], values["what" if name == "finding_reported" else "error"])
        again = name == "daemon_failed" and last == (fault.kind, fault.what)
        last = (fault.kind, fault.what)
        if fault.kind != WITH_FINDING and not again:
            yield fault
