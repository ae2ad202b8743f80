"""``polishd beliefs``: what a cell has learned and the next job begins with; and how it is forgotten."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from rich.console import Group
from rich.table import Table

from polishd.config.cell import load_config
from polishd.daemon.history import read_only
from polishd.daemon.remembering import JournalledEstimates, forget_estimates, journalled_estimates
from polishd.show.tables import emit, figure_table

ESTIMATE_COLUMNS = ("tool", "job", "pass", "taught, UTC", "rate", "+-", "ms a block", "more")
PARAMETERS = ("parameter", "value", "+-", "plans count with")


def beliefs_verb(cell: Path, *, as_json: bool) -> None:
    """The last lesson of each series, read beside a daemon that may be running. ConfigError."""
    config = load_config(cell)
    with read_only(config.state_dir) as journal:
        last = list(_last(journalled_estimates(lambda sql, values: journal.execute(sql, values).fetchall())))
    emit(
        {"cell": config.cell.name, "remember": config.memory.remember, "beliefs": [asdict(one) for one in last]},
        as_json=as_json,
        table=lambda: Group(_table(config.cell.name, last), *(_parameters(one) for one in last if _means(one))),
        lines=_words(remember=config.memory.remember, found=bool(last)),
    )


def forget_verb(cell: Path, reason: str, *, as_json: bool) -> None:
    """Begin anew: nothing that was taught so far is remembered. ConfigError where a daemon runs the cell."""
    config = load_config(cell)
    forget_estimates(config.state_dir, reason)
    emit(
        {"cell": config.cell.name, "forgotten": True, "reason": reason},
        as_json=as_json,
        lines=[f"{config.cell.name}: the next job begins with nothing learned; the journal keeps what was"],
    )


def _last(found: Iterable[JournalledEstimates]) -> Iterator[JournalledEstimates]:
    """Of each series; none where a person had to see to the tool since."""
    seen: set[str] = set()
    for one in found:
        if one.series not in seen and not one.anew:
            yield one
        seen.add(one.series)


def _words(*, remember: bool, found: bool) -> Iterator[str]:
    if not remember:
        yield "memory.remember is false: a job begins with nothing learned"
    elif not found:
        yield "nothing is remembered: the next job begins with the rate as it is configured"
    else:
        yield "a job of the same tool, process, robot and instrument begins with it (docs/beliefs.md)"


def _table(name: str, found: Iterable[JournalledEstimates]) -> Table:
    return figure_table(f"{name}: what was learned", ESTIMATE_COLUMNS, map(_row, found))


def _row(one: JournalledEstimates) -> tuple[str, ...]:
    rate, means = _rate(one), _means(one)
    return (
        one.tool or "-",
        one.job,
        str(one.cycle + 1),
        f"{datetime.fromtimestamp(one.at_s, UTC):%Y-%m-%d %H:%M}",
        f"{rate['value']:.3f}",
        "" if rate["sigma"] is None else f"{rate['sigma']:.3f}",
        f"{1e3 * one.believed['block_overhead_s']:.1f}",
        f"{len(means)} parameters" if means else "",
    )


def _parameters(one: JournalledEstimates) -> Table:
    """What identification believes, as of its pass (docs/identification.md)."""
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
