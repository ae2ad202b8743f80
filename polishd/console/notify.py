"""``polishd notify``: whether those whom a cell's config names are really reached."""

from __future__ import annotations

from pathlib import Path

import typer

from polishd.daemon.assembly import build_notifiers
from polishd.daemon.notifications import try_out
from polishd.hooks.cell import load_cell
from polishd.model.errors import LinkError
from polishd.show.tables import emit, record_table


def notify_verb(cell: Path, *, as_json: bool) -> None:
    """A test through each notifier, whatever its least severity; exit code 5 where one failed."""
    config, hooks = load_cell(cell)
    notifiers = build_notifiers(config, hooks)
    if not notifiers:
        raise config.error("notify", "nobody is told of anything; add a section [notify.NAME]: docs/notifications.md")
    found = try_out(config, notifiers)
    columns = ("notifier", "type", "told from", "test", "waiting")
    rows = [
        (one["notifier"], one["type"], one["severity"], one["error"] or "sent", one["waiting"] or "") for one in found
    ]
    emit({"notifiers": found}, as_json=as_json, table=lambda: record_table(config.cell.name, columns, rows))
    if any(one["error"] for one in found):
        raise typer.Exit(LinkError.exit_code)
