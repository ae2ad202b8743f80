"""What the verbs on a cell do: load, ask the daemon's rooms, print for people or for programs."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import typer

from polishd.console.progress import progress
from polishd.console.tables import cycle_table, key_table, record_table, stderr, stdout
from polishd.daemon import client
from polishd.daemon.config import CellConfig, load_config
from polishd.daemon.plugin_checks import DECLARATIONS
from polishd.daemon.plugins import Hooks, load_own, load_plugins
from polishd.model.cycle import EXIT_CODES, Outcome


def run_verb(cell: Path, correction: str | None, *, as_json: bool) -> int:
    """Run the daemon; its exit code."""
    from polishd.daemon.app import run_cell

    config, hooks = load_cell(cell, correction)
    with progress() as show:
        summary = asyncio.run(run_cell(config, hooks, lambda event: show(event.name, event.cycle, event.data)))
    emit(summary, as_json=as_json, table=lambda: cycle_table(summary))
    return EXIT_CODES[Outcome(summary["outcome"])]


def plan_verb(cell: Path, surface: Path, program: Path, out: Path, correction: str | None, *, as_json: bool) -> None:
    """Plan a part by hand."""
    from polishd.daemon.planning import plan_part

    config, hooks = load_cell(cell, correction)
    with stderr.status("solving the dwell"):
        summary = plan_part(config, hooks, surface, program, out)
    emit(summary, as_json=as_json, table=lambda: cycle_table(summary))
    if not as_json:
        for note in summary["notes"]:
            stdout.print(f"note: {note}", markup=False)
        stdout.print(f"written to {out} (report.html)", markup=False)


def check_verb(cell: Path, *, as_json: bool) -> None:
    """Config, plugins, program and reach; opens nothing."""
    from polishd.daemon.checking import check_cell

    config, hooks = load_cell(cell)
    facts = check_cell(config, hooks)
    emit(
        facts,
        as_json=as_json,
        table=lambda: key_table(f"{config.cell.name}: checked, nothing was opened", facts.items()),
    )


def probe_verb(cell: Path, *, as_json: bool) -> None:
    """Connect, identify, leave safe."""
    from polishd.daemon.checking import probe_cell

    config, hooks = load_cell(cell)
    found = asyncio.run(probe_cell(config, hooks))
    devices = {name: asdict(identity) for name, identity in found.items()}
    columns = ("device", "vendor", "model", "serial", "firmware")
    rows = [(name, *(facts[column] for column in columns[1:])) for name, facts in devices.items()]
    emit(devices, as_json=as_json, table=lambda: record_table(f"{config.cell.name}: all safe", columns, rows))


def status_verb(cell: Path, *, as_json: bool) -> None:
    """Ask the running daemon."""
    config = load_config(cell)
    answer = client.request(config.state_dir, "status")
    rows = [(key, value) for key, value in answer.items() if key not in ("ok", "cycles") and value]
    rows += [(f"measurement {i}", f"RMS {c['rms_nm']:.2f} nm") for i, c in enumerate(answer.get("cycles", []))]
    emit(answer, as_json=as_json, table=lambda: key_table(config.cell.name, rows))


def order_verb(cell: Path, verb: str, *, as_json: bool) -> None:
    """Give the running daemon an order; returns when it is obeyed."""
    config = load_config(cell)
    answer = client.request(config.state_dir, verb)
    emit(answer, as_json=as_json, table=lambda: key_table(f"{config.cell.name}: {verb}", answer.items()))


def plugins_verb(cell: Path | None, *, as_json: bool) -> None:
    """What is loaded, what each plugin brings, and what is refused and why."""
    hooks = load_own() if cell is None else _plugins_of(load_config(cell))
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


def _plugins_of(config: CellConfig) -> Hooks:
    return load_plugins(config.plugins.load, config.dialect_paths)


def load_cell(cell: Path, correction: str | None = None) -> tuple[CellConfig, Hooks]:
    """Config and plugins; ConfigError or PluginError where anything that the config names is missing or broken."""
    config = load_config(cell, {"process.correction": correction} if correction else None)
    hooks = _plugins_of(config)
    hooks.report.require()
    return config, hooks


def emit(answer: Mapping[str, Any], *, as_json: bool, table: Any) -> None:
    """JSON on stdout for programs, a table for people."""
    if as_json:
        typer.echo(json.dumps(answer, default=str))
    else:
        stdout.print(table())


def _brings(plugin: Mapping[str, Any]) -> str:
    return ", ".join(name for names in plugin["brings"].values() for name in names) or "checks and events"
