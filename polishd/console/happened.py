"""``polishd events``: what happened in a cell, from its journal, and as it happens."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import Any

from polishd.config.cell import load_config
from polishd.daemon import client
from polishd.daemon.history import read_events
from polishd.show.terminal import say

SAID = ("reason", "error", "what", "notes", "outcome", "tool", "state", "by", "part")
"""Data that a line tells, in this order, where there is any."""
MOST_CHARACTERS = 160


def events_verb(cell: Path, count: int, *, follow: bool, as_json: bool) -> None:
    """The last ones of the journal, the newest last; then, if asked, those to come, until the daemon ends."""
    config = load_config(cell)
    for event in read_events(config.state_dir, count):
        _tell(event, as_json=as_json)
    if not follow:
        return
    with suppress(KeyboardInterrupt):  # so whoever follows ends it
        for event in client.subscribe(config.state_dir):
            _tell({"at_s": time.time(), **event}, as_json=as_json)


def _tell(event: Mapping[str, Any], *, as_json: bool) -> None:
    say(json.dumps(event) if as_json else line_of(event))


def line_of(event: Mapping[str, Any]) -> str:
    """One line: when, in which cycle, what, and the most telling of its data."""
    data = event["data"]
    said = [_words(data[key]) for key in SAID if data.get(key)]
    cycle = "" if event.get("cycle") is None else f"cycle {event['cycle']}"
    when = datetime.fromtimestamp(event["at_s"]).astimezone().strftime("%Y-%m-%d %H:%M:%S")
    text = f"{when}  {cycle:<9} {event['name']:<18} {'; '.join(said)}"
    return text.rstrip() if len(text) <= MOST_CHARACTERS else text[: MOST_CHARACTERS - 3] + "..."


def _words(value: Any) -> str:
    words = "; ".join(map(str, value)) if isinstance(value, list) else str(value)
    return " ".join(words.split())
