"""``polishd history``: the history of a cell's parts as a table, JSON and a picture."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.dates import AutoDateLocator, ConciseDateFormatter
from matplotlib.ticker import MaxNLocator
from rich.console import Group
from rich.table import Table

from polishd.config.cell import load_config
from polishd.daemon.job.initial_estimates import JournalledEstimates, forget_estimates, journalled_estimates
from polishd.daemon.journal.history import JobHistory, read_history, read_only
from polishd.rendering.plots import BLUE, GREEN, MUTED, ORANGE, figure, png, polishd_style, ruled
from polishd.rendering.terminal import emit, figure_table, record_table, utc_minute
from polishd.web.part_history import week_of

HISTORY_COLUMNS = ("job", "part", "began", "took", "passes", "RMS nm", "worst line", "rate", "faults", "outcome")


def history_verb(cell: Path, out: Path | None, *, as_json: bool) -> None:
    """Read the journal, and show it. This needs no daemon, and does not disturb one."""
    config = load_config(cell)
    jobs = read_history(config.state_dir)
    if out is not None:
        from polishd.rendering.plots import save_picture

        save_picture(out, draw(config.cell.name, jobs))
    emit(
        {"cell": config.cell.name, "jobs": [_facts(job) for job in jobs]},
        as_json=as_json,
        table=lambda: Group(history_table(config.cell.name, jobs), *fault_tables(jobs)),
        lines=[] if out is None else [f"written to {out}"],
    )


def history_table(name: str, jobs: Sequence[JobHistory]) -> Table:
    """Return a table with a row for each job, and the number of parts by outcome."""
    ended = Counter(job.outcome or "under way, or given up" for job in jobs)
    words = ", ".join(f"{count} {outcome.replace('_', ' ')}" for outcome, count in ended.most_common())
    forecast = [one.as_forecast for job in jobs for one in job.measured if one.as_forecast is not None]
    held = f"; {sum(forecast)} of {len(forecast)} passes as forecast (expected: 9 of 10)" if forecast else ""
    return figure_table(f"{name}: {len(jobs)} jobs ({words}){held}", HISTORY_COLUMNS, map(_history_row, jobs))


def fault_tables(jobs: Sequence[JobHistory]) -> list[Table]:
    """Return the table of faults that needed an operator, by kind, the most frequent first; none without faults."""
    faults = [(fault, job) for job in jobs for fault in job.faults]
    last = {fault.kind: (fault, job) for fault, job in faults}
    rows = [
        (kind, count, utc_minute(last[kind][0].at_s), last[kind][1].job, last[kind][0].what)
        for kind, count in Counter(fault.kind for fault, _ in faults).most_common()
    ]
    return [record_table("faults", ("kind", "times", "last", "in", "what"), rows)] if rows else []


def _history_row(job: JobHistory) -> Sequence[str]:
    figures = [one.rms_nm for one in job.measured]
    rms = f"{figures[0]:.2f} -> {figures[-1]:.2f}" if len(figures) > 1 else "".join(f"{one:.2f}" for one in figures)
    torn = f" + {job.interrupted} torn" if job.interrupted else ""
    return (
        job.job,
        job.part_id,
        utc_minute(job.began_s),
        "" if job.ended_s is None else _took(job.ended_s - job.began_s),
        f"{job.passes}{torn}",
        rms,
        "" if job.worst is None else f"{job.worst.what} {job.worst.value:.3g} of {job.worst.limit:g} {job.worst.unit}",
        "" if job.rate is None else f"{job.rate:.3f}",
        str(len(job.faults) or ""),
        job.outcome.replace("_", " "),
    )


def _facts(job: JobHistory) -> Mapping[str, Any]:
    """Return a job's facts for programs, with times as ISO 8601."""
    facts = asdict(job)
    measured = [
        {**asdict(one), "judged": [line.facts() for line in one.judged], "at": _iso(one.at_s)} for one in job.measured
    ]
    faults = [{**asdict(fault), "at": _iso(fault.at_s)} for fault in job.faults]
    times = {"began": _iso(job.began_s), "ended": None if job.ended_s is None else _iso(job.ended_s)}
    return {**facts, **times, "rate": job.rate, "measured": measured, "faults": faults}


def _took(seconds: float) -> str:
    """Format as hours and minutes."""
    hours, minutes = divmod(round(seconds / 60), 60)
    return f"{hours} h {minutes:02d} min"


def _iso(at_s: float) -> str:
    return datetime.fromtimestamp(at_s, UTC).isoformat(timespec="seconds")


# The picture of ``polishd history``: how parts converged, the removal rate, and faults over the weeks.

KINDS, OTHERS = 6, "others"
"""Number of fault kinds with their own color, and the name of the rest."""
DAY_S = 86400.0
"""Dates are days since 1970, as matplotlib has them."""


def draw(name: str, jobs: Sequence[JobHistory]) -> bytes:
    """Return a PNG of three panels, one above the other."""
    with polishd_style():
        fig = figure(8.0, 9.0)
        converged, rates, faults = fig.subplots(3, 1)
        _converged(converged, jobs)
        _rates(rates, jobs)
        _faults(faults, jobs)
        fig.suptitle(f"{name}: {len(jobs)} jobs")
        return png(fig)


def _converged(ax: Axes, jobs: Sequence[JobHistory]) -> None:
    """Draw the RMS of each part over its measurements; older parts are pale."""
    shades = mpl.colormaps["Blues"](np.linspace(0.3, 0.95, len(jobs)))
    for job, shade in zip(jobs, shades, strict=True):
        good = job.outcome == "in_tolerance"
        figures = [one.rms_nm for one in job.measured]
        ax.plot(figures, color=shade, linewidth=1.0, marker="o", markersize=2.5)
        if figures and job.outcome:
            ax.plot(len(figures) - 1, figures[-1], "o", color=GREEN if good else ORANGE, markersize=5, zorder=3)
    for word, colour in (("in tolerance", GREEN), ("ended otherwise", ORANGE), ("each part, the latest dark", BLUE)):
        ax.plot([], [], "o" if colour != BLUE else "-", color=colour, label=word)
    ax.set(title="Convergence", xlabel="measurement (0 = start)", ylabel="RMS (nm)", yscale="log")
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.legend(loc="best")
    ruled(ax)


def _rates(ax: Axes, jobs: Sequence[JobHistory]) -> None:
    """Draw the removal rate of each pass with its standard error."""
    shown = [(one.at_s / DAY_S, one.rate, one.rate_sigma or 0.0) for job in jobs for one in job.measured if one.rate]
    ax.axhline(1.0, color=MUTED, linewidth=1.0)
    if shown:
        times, rates, errors = np.transpose(shown)
        ax.errorbar(times, rates, errors, fmt="o", color=BLUE, markersize=3, linewidth=1.0)
    ax.set(title="Removal rate", ylabel="relative to the model's own")
    _dated(ax, empty=not shown)
    ruled(ax)


def _faults(ax: Axes, jobs: Sequence[JobHistory]) -> None:
    """Draw faults that needed an operator, one bar a week, the most frequent kinds below."""
    faults = [(fault.kind, week_of(fault.at_s) / DAY_S) for job in jobs for fault in job.faults]
    named = [kind for kind, _ in Counter(kind for kind, _ in faults).most_common(KINDS)]
    counts = Counter((kind if kind in named else OTHERS, week) for kind, week in faults)
    weeks = sorted({week for _, week in counts})
    base = np.zeros(len(weeks))
    for place, kind in enumerate([*named, OTHERS]):
        own = np.array([counts[kind, week] for week in weeks])
        if own.any():
            ax.bar(weeks, own, 6.0, base, label=kind, color=f"C{place}", align="edge")
            base += own
    ax.set(title="Faults a week", ylabel="times")
    ax.yaxis.set_major_locator(MaxNLocator(integer=True))
    _dated(ax, empty=not weeks)
    if weeks:
        ax.legend(loc="best")
    ruled(ax)


def _dated(ax: Axes, *, empty: bool) -> None:
    if empty:
        ax.set_xticks([])
        ax.text(0.5, 0.5, "none", transform=ax.transAxes, ha="center", color=MUTED)
        return
    locator = AutoDateLocator(minticks=2, maxticks=8)  # type: ignore[no-untyped-call]
    ax.xaxis.set_major_locator(locator)
    ax.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]


# ``polishd estimates``: the estimates with which the next job starts, and their deletion.

ESTIMATE_COLUMNS = ("tool", "job", "pass", "at", "rate", "+-", "ms a block", "more")
PARAMETERS = ("parameter", "value", "+-", "used in plans")


def estimates_verb(cell: Path, *, as_json: bool) -> None:
    """Show the last estimates of each series; a daemon may run meanwhile. Raise ConfigError."""
    config = load_config(cell)
    with read_only(config.state_dir) as journal:
        last = list(_last(journalled_estimates(lambda sql, values: journal.execute(sql, values).fetchall())))
    emit(
        {"cell": config.cell.name, "remember": config.estimates.use_previous, "beliefs": [asdict(one) for one in last]},
        as_json=as_json,
        table=lambda: Group(_table(config.cell.name, last), *(_parameters(one) for one in last if _means(one))),
        lines=_notes(use_previous=config.estimates.use_previous, found=bool(last)),
    )


def forget_verb(cell: Path, reason: str, *, as_json: bool) -> None:
    """Start the next job without earlier estimates. Raise ConfigError if a daemon runs the cell."""
    config = load_config(cell)
    forget_estimates(config.state_dir, reason)
    emit(
        {"cell": config.cell.name, "forgotten": True, "reason": reason},
        as_json=as_json,
        lines=[f"{config.cell.name}: the next job starts without estimates; the journal keeps the earlier ones"],
    )


def _last(found: Iterable[JournalledEstimates]) -> Iterator[JournalledEstimates]:
    """Yield the last estimates of each series, unless the operator has changed the tool since."""
    seen: set[str] = set()
    for one in found:
        if one.series not in seen and not one.anew:
            yield one
        seen.add(one.series)


def _notes(*, use_previous: bool, found: bool) -> Iterator[str]:
    if not use_previous:
        yield "estimates.use_previous is false: a job starts without estimates"
    elif not found:
        yield "there are no estimates: the next job starts with the configured rate"
    else:
        yield "a job with the same tool, process, robot and instrument starts with them (docs/explanation/estimates.md)"


def _table(name: str, found: Iterable[JournalledEstimates]) -> Table:
    return figure_table(f"{name}: estimates", ESTIMATE_COLUMNS, map(_row, found))


def _row(one: JournalledEstimates) -> tuple[str, ...]:
    rate, means = _rate(one), _means(one)
    return (
        one.tool or "-",
        one.job,
        str(one.cycle + 1),
        utc_minute(one.at_s),
        f"{rate['value']:.3f}",
        "" if rate["sigma"] is None else f"{rate['sigma']:.3f}",
        f"{1e3 * one.believed['block_overhead_s']:.1f}",
        f"{len(means)} parameters" if means else "",
    )


def _parameters(one: JournalledEstimates) -> Table:
    """Return the table of parameters estimated by identification (docs/explanation/identification.md)."""
    removal = one.believed["removal"]
    sigmas = [row[k] ** 0.5 for k, row in enumerate(removal["covariance"])]
    rows = [
        (name, f"{value:.4g}", f"{sigma:.2g}", f"{removal['applied'][name]:.4g}" if name in removal["applied"] else "")
        for (name, value), sigma in zip(_means(one).items(), sigmas, strict=True)
    ]
    return figure_table(f"{one.tool or 'the tool'}, job {one.job}", PARAMETERS, rows)


def _rate(one: JournalledEstimates) -> Any:
    return one.believed["removal"]["rate"]


def _means(one: JournalledEstimates) -> dict[str, float]:
    found: dict[str, float] = one.believed["removal"].get("mean", {})
    return found
