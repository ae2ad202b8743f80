"""``polishd history``: what became of a cell's parts, as a table, as JSON, and as a picture."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rich.console import Group
from rich.table import Table

from polishd.config.cell import load_config
from polishd.daemon.history import JobHistory, read_history
from polishd.show.tables import emit, figure_table, record_table

HISTORY_COLUMNS = ("job", "part", "began, UTC", "took", "passes", "RMS nm", "worst line", "rate", "faults", "outcome")


def history_verb(cell: Path, out: Path | None, *, as_json: bool) -> None:
    """Read the journal, and show it; no daemon is needed, and none is disturbed."""
    config = load_config(cell)
    jobs = read_history(config.state_dir)
    if out is not None:
        from polishd.console.history_picture import draw
        from polishd.show.style import save_picture

        save_picture(out, draw(config.cell.name, jobs))
    emit(
        {"cell": config.cell.name, "jobs": [_facts(job) for job in jobs]},
        as_json=as_json,
        table=lambda: Group(history_table(config.cell.name, jobs), *fault_tables(jobs)),
        lines=[] if out is None else [f"written to {out}"],
    )


def history_table(name: str, jobs: Sequence[JobHistory]) -> Table:
    """A row a job, and how many parts came into tolerance."""
    ended = Counter(job.outcome or "under way, or given up" for job in jobs)
    words = ", ".join(f"{count} {outcome.replace('_', ' ')}" for outcome, count in ended.most_common())
    told = [one.as_forecast for job in jobs for one in job.measured if one.as_forecast is not None]
    held = f"; {sum(told)} of {len(told)} passes as forecast, and 9 of 10 are to be" if told else ""
    return figure_table(f"{name}: {len(jobs)} jobs ({words}){held}", HISTORY_COLUMNS, map(_history_row, jobs))


def fault_tables(jobs: Sequence[JobHistory]) -> list[Table]:
    """What somebody had to see to, by kind, the most frequent first; no table where there was nothing."""
    faults = [(fault, job) for job in jobs for fault in job.faults]
    last = {fault.kind: (fault, job) for fault, job in faults}
    rows = [
        (kind, count, _when(last[kind][0].at_s), last[kind][1].job, last[kind][0].what)
        for kind, count in Counter(fault.kind for fault, _ in faults).most_common()
    ]
    return [record_table("faults", ("kind", "times", "last, UTC", "in", "what"), rows)] if rows else []


def _history_row(job: JobHistory) -> Sequence[str]:
    figures = [one.rms_nm for one in job.measured]
    rms = f"{figures[0]:.2f} -> {figures[-1]:.2f}" if len(figures) > 1 else "".join(f"{one:.2f}" for one in figures)
    torn = f" + {job.interrupted} torn" if job.interrupted else ""
    return (
        job.job,
        job.part_id,
        _when(job.began_s),
        "" if job.ended_s is None else _took(job.ended_s - job.began_s),
        f"{job.passes}{torn}",
        rms,
        "" if job.worst is None else f"{job.worst.what} {job.worst.value:.3g} of {job.worst.limit:g} {job.worst.unit}",
        "" if job.rate is None else f"{job.rate:.3f}",
        str(len(job.faults) or ""),
        job.outcome.replace("_", " "),
    )


def _facts(job: JobHistory) -> Mapping[str, Any]:
    """For programs: times as ISO 8601."""
    facts = asdict(job)
    measured = [
        {**asdict(one), "judged": [line.facts() for line in one.judged], "at": _iso(one.at_s)} for one in job.measured
    ]
    faults = [{**asdict(fault), "at": _iso(fault.at_s)} for fault in job.faults]
    times = {"began": _iso(job.began_s), "ended": None if job.ended_s is None else _iso(job.ended_s)}
    return {**facts, **times, "rate": job.rate, "measured": measured, "faults": faults}


def _took(seconds: float) -> str:
    """Hours and minutes."""
    hours, minutes = divmod(round(seconds / 60), 60)
    return f"{hours} h {minutes:02d} min"


def _when(at_s: float) -> str:
    return f"{datetime.fromtimestamp(at_s, UTC):%Y-%m-%d %H:%M}"


def _iso(at_s: float) -> str:
    return datetime.fromtimestamp(at_s, UTC).isoformat(timespec="seconds")
