"""``polishd queue``: the queue of a cell, through the running daemon, or in the journal if none runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from polishd.cli.json_error import refusal_of
from polishd.config.cell import CellConfig, load_config
from polishd.daemon.queue.queue import Queue
from polishd.daemon.queue.requests import QueueRequests
from polishd.daemon.socket import client
from polishd.model.errors import NoDaemon
from polishd.plugin_loader import load_cell, plugins_of
from polishd.rendering.terminal import emit, record_table, utc_minute
from polishd.util.command_line import terminal_user
from polishd.util.threads import run_loop

COLUMNS = ("job", "part", "state", "added", "why")


def add_verb(cell: Path, files: Sequence[Path], *, as_json: bool) -> None:
    """Check all jobs, then add them."""
    from polishd.daemon.checks import check_jobs

    config, hooks = load_cell(cell)
    jobs = check_jobs(config, hooks, files)
    texts = [{"path": str(job.file.path), "content": job.file.text} for job in jobs]
    _request(config, "queue_add", files=texts, by=terminal_user())
    list_verb(cell, as_json=as_json)


def list_verb(cell: Path, *, as_json: bool) -> None:
    """Show the queue."""
    config = load_config(cell)
    _show(config, _request(config, "queue_list"), as_json=as_json)


def move_verb(cell: Path, job: str, where: str, other: str, *, as_json: bool) -> None:
    """Change the order."""
    config = load_config(cell)
    _show(
        config, _request(config, "queue_move", job=job, where=where, other=other, by=terminal_user()), as_json=as_json
    )


def remove_verb(cell: Path, job: str, reason: str, *, as_json: bool) -> None:
    """Remove a job."""
    config = load_config(cell)
    _show(config, _request(config, "queue_remove", job=job, reason=reason, by=terminal_user()), as_json=as_json)


def _request(config: CellConfig, verb: str, **arguments: Any) -> Mapping[str, Any]:
    try:
        reply = client.request(config.state_dir, verb, args=arguments)
    except NoDaemon:
        with Queue.at_rest(config.state_dir) as queue:
            return run_loop(_handle_at_rest(QueueRequests(config, plugins_of(config), queue), verb, arguments))
    if not reply["ok"]:
        raise refusal_of(reply)
    return reply


async def _handle_at_rest(requests: QueueRequests, verb: str, arguments: Mapping[str, Any]) -> Mapping[str, Any]:
    return await requests.handlers[verb](**arguments)


def _show(config: CellConfig, reply: Mapping[str, Any], *, as_json: bool) -> None:
    found = {"jobs": reply["jobs"]}
    rows = [
        (job["name"], job["part_id"], job["state"], utc_minute(job["added_s"]), job["reason"]) for job in found["jobs"]
    ]
    emit(found, as_json=as_json, table=lambda: record_table(f"{config.cell.name}: queue", COLUMNS, rows))
