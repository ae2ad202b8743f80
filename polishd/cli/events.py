"""``polishd events``: events of a cell, from its journal and live."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from contextlib import suppress
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

from rich.console import Group

from polishd.config.cell import load_config
from polishd.daemon.journal.history import read_events
from polishd.daemon.socket import client
from polishd.rendering.terminal import emit, key_table, record_table, say
from polishd.util.wire_recording import Recording, WireMessage, read_recording

SHOWN = ("reason", "error", "what", "notes", "outcome", "tool", "state", "by", "part")
"""Data of an event shown in its line, in this order."""
MOST_CHARACTERS = 160


def events_verb(cell: Path, count: int, *, follow: bool, as_json: bool) -> None:
    """Print the last events of the journal, the newest last; with ``follow`` then new events until the daemon ends."""
    config = load_config(cell)
    for event in read_events(config.state_dir, count):
        _print_event(event, as_json=as_json)
    if not follow:
        return
    with suppress(KeyboardInterrupt):  # Ctrl-C ends --follow
        for event in client.subscribe(config.state_dir):
            _print_event({"at_s": time.time(), **event}, as_json=as_json)


def _print_event(event: Mapping[str, Any], *, as_json: bool) -> None:
    say(json.dumps(event) if as_json else line_of(event))


def line_of(event: Mapping[str, Any]) -> str:
    """Return one line: time, cycle, name, and the most important data."""
    data = event["data"]
    shown = [_text(data[key]) for key in SHOWN if data.get(key)]
    cycle = "" if event.get("cycle") is None else f"cycle {event['cycle']}"
    when = datetime.fromtimestamp(event["at_s"]).astimezone().strftime("%Y-%m-%d %H:%M:%S")
    text = f"{when}  {cycle:<9} {event['name']:<18} {'; '.join(shown)}"
    return text.rstrip() if len(text) <= MOST_CHARACTERS else text[: MOST_CHARACTERS - 3] + "..."


def _text(value: Any) -> str:
    text = "; ".join(map(str, value)) if isinstance(value, list) else str(value)
    return " ".join(text.split())


# ``polishd recording``: content of a recording of a cell's links.

COLUMNS = ("device", "link", "opened", "out", "in", "from s", "to s", "longest silence s")


def show_verb(file: Path, *, as_json: bool) -> None:
    """Print a table of the recording's links; raise ConfigError for another file."""
    found = read_recording(file)
    links = _links(found)
    header = {key: value for key, value in found.header.items() if key not in ("polishd_wire", "devices")}
    facts = [*header.items(), *(("missing", note) for note in found.notes)]
    emit(
        {**header, "devices": found.header.get("devices", {}), "links": links, "missing": list(found.notes)},
        as_json=as_json,
        table=lambda: Group(key_table(file.name, facts), record_table("links", COLUMNS, map(_row, links))),
    )


def _links(found: Recording) -> list[dict[str, Any]]:
    by_link: dict[tuple[str, str], list[WireMessage]] = {}
    for one in found.passed:
        by_link.setdefault((one.role, one.link), []).append(one)
    return [{"device": role, "link": link, **_counts(passed)} for (role, link), passed in by_link.items()]


def _row(link: dict[str, Any]) -> tuple[object, ...]:
    """Return the cells of COLUMNS."""
    ways = (f"{link[way]} ({link[f'bytes_{way}']} B)" for way in ("out", "in"))
    times = (link[key] for key in ("first_s", "last_s", "longest_silence_s"))
    return (link["device"], link["link"], link["opened"], *ways, *times)


def _counts(passed: list[WireMessage]) -> dict[str, Any]:
    """Count messages and bytes; ``longest_silence_s`` is between incoming messages while the link was open."""
    out, came = ([one for one in passed if one.way == way] for way in ("out", "in"))
    incoming = [one for one in passed if one.way != "out"]
    gaps = [b.at_s - a.at_s for a, b in pairwise(incoming) if b.way == "in" and a.way != "end"]
    return {
        "opened": sum(one.way == "open" for one in passed),
        "out": len(out),
        "bytes_out": sum(len(one.data) for one in out),
        "in": len(came),
        "bytes_in": sum(len(one.data) for one in came),
        "first_s": round(passed[0].at_s, 3),
        "last_s": round(passed[-1].at_s, 3),
        "longest_silence_s": round(max(gaps, default=0.0), 3),
    }
