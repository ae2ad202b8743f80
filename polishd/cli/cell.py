"""Commands on a cell: load it, call the daemon's packages, print for people or for programs."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer
from rich.console import Group
from rich.table import Table

from polishd.cli.command_group import yield_to_daemon
from polishd.config.cell import load_config
from polishd.daemon.assembly import build_notifiers
from polishd.daemon.notifications.notifications import try_out
from polishd.model.errors import ConfigError, DeviceFault, LinkError
from polishd.plugin_loader import DECLARATIONS, load_cell, load_own, plugins_of
from polishd.rendering.terminal import emit, key_table, outcome_tables, record_table, say, stderr, stdout
from polishd.util.extras import require_extra
from polishd.util.threads import run_loop

if TYPE_CHECKING:
    from polishd.web.http.users import Role


def plan_verb(
    cell: Path,
    surface: Path,
    program: Path | None,
    out: Path,
    correction: str | None,
    *,
    of_pass: int | None = None,
    as_json: bool,
) -> None:
    """Plan a pass of a part; ``program`` None: the cell's, of that pass (None: of the first)."""
    from polishd.programs.plan import plan_part

    if program is not None and of_pass is not None:
        raise ConfigError("--pass: --program names the program already. Leave out one of them")
    config, hooks = load_cell(cell, correction)
    with stderr.status("solving the dwell"):
        summary = plan_part(config, hooks, surface, program, out, of_pass=of_pass or 1)
    emit(summary, as_json=as_json, table=lambda: outcome_tables(summary))
    if not as_json:
        for note in summary["notes"]:
            stdout.print(f"note: {note}", markup=False)
        mb = summary["writes"]
        sizes = f"{mb['state_mb']:.1f} MB of journal, {mb['run_mb']:.1f} MB into the run folder"
        stdout.print(f"a pass of {summary['blocks']} blocks writes {sizes}", markup=False)
        stdout.print(f"written to {out} (report.html)", markup=False)


def check_verb(cell: Path, *, as_json: bool) -> None:
    """Check config, plugins, program and reach; open nothing."""
    with stderr.status("checking: plugins") as shown:
        from polishd.daemon.checks import check_cell  # this import is slow

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
    """Return the table of time limits, in the order in which they act."""
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
    """Connect, identify, leave safe; after the table raise DeviceFault if a device does not answer."""
    from polishd.daemon.checks import probe_cell

    config, hooks = load_cell(cell)
    # The table shows devices that do not answer; without a handler Python would print their warnings.
    logging.getLogger().addHandler(logging.NullHandler())
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
            f"{len(found.problems)} of {len(only or devices)} devices failed: {names}. See the table above"
        )


def _probed_tables(cell: str, devices: Mapping[str, Mapping[str, Any]], *, all_: bool) -> list[Table]:
    """Return the table of devices that answered."""
    columns = ("device", "vendor", "model", "serial", "firmware")
    answered = [(name, *(facts[key] for key in columns[1:])) for name, facts in devices.items() if "model" in facts]
    wrong = any("error" in facts for facts in devices.values())
    safe = "all safe" if all_ and not wrong else "not made safe" if not all_ else "these answered"
    return [record_table(f"{cell}: {safe}", columns, answered)] if answered else []


def plugins_verb(cell: Path | None, *, as_json: bool) -> None:
    """Show the loaded plugins with their functions, and the refused ones with the reason."""
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


# ``polishd web``: serves a cell's page and HTTP API, and keeps its users.


def web_verb(cell: Path, add_user: str | None, role: Role, remove_user: str | None) -> None:
    """Add or remove a user, or serve."""
    from polishd.web.http.users import UserFile, users_path
    from polishd.web.routes import serve

    config = load_config(cell)
    users = UserFile(users_path(config))
    if add_user is not None:
        token = users.add(add_user, role)
        say(f"{add_user} has the role {role.value}; the token, which is not shown again:", err=True)
        say(token)
    elif remove_user is not None:
        users.remove(remove_user)
        say(f"user {remove_user} was removed", err=True)
    else:
        if not users:
            say("there are no users; run: polishd web CELL.toml --add-user NAME --role operate", err=True)
        serve(config)


# ``polishd opcua``: the cell's OPC UA server.


def opcua_verb(path: Path) -> None:
    """Serve until Ctrl-C or SIGTERM. Raise ConfigError if [opcua] or the library is missing."""
    config = load_config(path)
    if config.opcua is None:
        raise config.error("opcua", "is missing: OPC UA clients need this machine's identity; add [opcua]: "
                           "docs/how-to/plant-systems.md")  # fmt: skip
    require_extra("polishd opcua", "opcua")
    from polishd.opcua.server import ADDRESS, serve

    yield_to_daemon()
    try:
        asyncio.run(serve(config.cell.name, config.state_dir, config.opcua))
    except OSError as error:
        problem = f"the server cannot listen at {ADDRESS}:{config.opcua.port}: {error.strerror}; set another port"
        raise config.error("opcua.port", problem) from error


# ``polishd notify``: a test of each notifier.


def notify_verb(cell: Path, *, as_json: bool) -> None:
    """Send a test through each notifier, of any severity; exit code 5 if one failed."""
    config, hooks = load_cell(cell)
    notifiers = build_notifiers(config, hooks)
    if not notifiers:
        raise config.error("notify", "there is no notifier; add a section [notify.NAME]: docs/how-to/notifications.md")
    found = try_out(config, notifiers)
    columns = ("notifier", "type", "severity", "test", "waiting")
    rows = [
        (one["notifier"], one["type"], one["severity"], one["error"] or "sent", one["waiting"] or "") for one in found
    ]
    emit({"notifiers": found}, as_json=as_json, table=lambda: record_table(config.cell.name, columns, rows))
    if any(one["error"] for one in found):
        raise typer.Exit(LinkError.exit_code)
