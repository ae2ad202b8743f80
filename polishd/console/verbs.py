"""What the verbs on a cell do: load, ask the daemon's rooms, print for people or for programs."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import typer
from rich.console import Group
from rich.table import Table

from polishd.config.cell import load_config
from polishd.hooks.cell import load_cell, plugins_of
from polishd.hooks.checks import DECLARATIONS
from polishd.hooks.loader import load_own
from polishd.model.errors import DeviceFault
from polishd.show.tables import emit, key_table, outcome_tables, record_table, stderr, stdout
from polishd.threads import run_loop


def plan_verb(
    cell: Path, surface: Path, program: Path | None, out: Path, correction: str | None, *, as_json: bool
) -> None:
    """Plan a part by hand; without ``program`` by the cell's."""
    from polishd.workbench.plan import plan_part

    config, hooks = load_cell(cell, correction)
    with stderr.status("solving the dwell"):
        summary = plan_part(config, hooks, surface, program, out)
    emit(summary, as_json=as_json, table=lambda: outcome_tables(summary))
    if not as_json:
        for note in summary["notes"]:
            stdout.print(f"note: {note}", markup=False)
        mb = summary["writes"]
        sizes = f"{mb['state_mb']:.1f} MB of journal, {mb['run_mb']:.1f} MB into the run folder"
        stdout.print(f"a pass of its {summary['blocks']} blocks writes {sizes}", markup=False)
        stdout.print(f"written to {out} (report.html)", markup=False)


def check_verb(cell: Path, *, as_json: bool) -> None:
    """Config, plugins, program and reach; opens nothing."""
    with stderr.status("checking: plugins") as shown:
        from polishd.daemon.checking import check_cell  # it takes a while by itself

        config, hooks = load_cell(cell)
        facts = check_cell(config, hooks, lambda what: shown.update(f"checking: {what}"))
    plain = [(key, value) for key, value in facts.items() if key not in {"time limits", "pit", "warnings"}]
    emit(
        facts,
        as_json=as_json,
        table=lambda: Group(
            key_table(f"{config.cell.name}: checked, nothing was opened", plain), _limit_table(facts["time limits"])
        ),
    )
    if not as_json:
        for warning in facts["warnings"]:
            stdout.print(f"warning: {warning}", markup=False)


def _limit_table(limits: Sequence[Mapping[str, Any]]) -> Table:
    """The chain of time limits, in the order in which they act."""
    rows = [
        (
            limit["what"],
            "never" if limit["seconds"] is None else f"{limit['seconds']:g} s",
            f">= {limit['least_s']:g} s {limit['because']}" if limit["least_s"] else "",
            limit["key"],
        )
        for limit in limits
    ]
    return record_table("time limits", ("what", "time", "needed", "key"), rows)


def probe_verb(cell: Path, only: Sequence[str] = (), record: Path | None = None, *, as_json: bool) -> None:
    """Connect, identify, leave safe; DeviceFault, after the table, where one of them does not answer."""
    from polishd.daemon.checking import probe_cell

    config, hooks = load_cell(cell)
    logging.getLogger().addHandler(
        logging.NullHandler()
    )  # what it tells of a device that is silent stands in the table
    found = run_loop(probe_cell(config, hooks, only, record))
    devices: dict[str, dict[str, Any]] = {name: asdict(identity) for name, identity in found.identities.items()}
    for name, problem in found.problems.items():
        devices.setdefault(name, {})["error"] = problem
    answer = {**devices, **({"signals": dict(found.signals)} if found.signals else {})}
    tables = _probed_tables(config.cell.name, devices, all_=not only)
    if found.signals:
        tables.append(key_table("signals", list(found.signals.items())))
    wrong = [f"{name}: {problem}" for name, problem in found.problems.items()]
    emit(answer, as_json=as_json, table=(lambda: Group(*tables)) if tables else None, lines=wrong)
    if found.problems:
        names = ", ".join(found.problems)
        raise DeviceFault(
            f"{len(found.problems)} of {len(only or devices)} devices did not answer as they should: {names}"
        )


def _probed_tables(cell: str, devices: Mapping[str, Mapping[str, Any]], *, all_: bool) -> list[Table]:
    """Who answered."""
    columns = ("device", "vendor", "model", "serial", "firmware")
    answered = [(name, *(facts[key] for key in columns[1:])) for name, facts in devices.items() if "model" in facts]
    wrong = any("error" in facts for facts in devices.values())
    safe = "all safe" if all_ and not wrong else "not made safe" if not all_ else "these answered"
    return [record_table(f"{cell}: {safe}", columns, answered)] if answered else []


def plugins_verb(cell: Path | None, *, as_json: bool) -> None:
    """What is loaded, what each plugin brings, and what is refused and why."""
    hooks = load_own() if cell is None else plugins_of(load_config(cell))
    loaded = [
        {
            "name": plugin.name,
            "distribution": plugin.distribution,
            "version": plugin.version,
            "brings": {hook: [record.name for record in plugin.records[hook]] for hook in DECLARATIONS},
        }
        for plugin in hooks.report.loaded
    ]
    refused = [{"name": refused.name, "reason": refused.reason} for refused in hooks.report.refused]
    rows: list[tuple[object, ...]] = [(p["name"], p["distribution"], p["version"], _brings(p)) for p in loaded]
    rows += [(r["name"], "", "refused", r["reason"]) for r in refused]
    emit(
        {"loaded": loaded, "refused": refused},
        as_json=as_json,
        table=lambda: record_table("plugins", ("name", "distribution", "version", "brings"), rows),
    )
    if refused:
        raise typer.Exit(3)


def _brings(plugin: Mapping[str, Any]) -> str:
    return ", ".join(name for names in plugin["brings"].values() for name in names) or "checks and events"
