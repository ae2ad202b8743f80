"""The last lines of ``polishd run``, for whoever finds the cell: is it safe, who did not confirm, what to do next."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import typer

from polishd.config.cell import port_of

AT_THE_MACHINE: Mapping[str, str] = {  # by port
    "actuator": "the tool may press on the part: switch the actuator off, and see it lifted, before anything moves",
    "robot": "it may still move: stop it at its own controller, and keep out of its reach",
    "spindle": "it may still turn: switch its drive off before you reach in",
    "loader": "it may still move, or hold a part: stop it at its own controller, and keep out of its reach",
}


def last_words(facts: Mapping[str, Any], cell: Path) -> list[tuple[str, str]]:
    """Names and texts, of a summary, a state event or what ``status`` found; commands name that cell."""
    rows = [("tool off the part", facts["tool_off"]), ("robot at rest", facts["robot_at_rest"])]
    for entry in facts["unsafe"]:
        device, _, why = entry.partition(": ")
        rows.append((f"{device} did not confirm", f"{why}; {AT_THE_MACHINE.get(port_of(device), 'look at it')}"))
    rows += [("run folder", facts.get("run_dir", "")), ("next", facts["next"])]
    return [(name, for_cell(text, cell)) for name, text in rows if text]


def for_cell(text: str, cell: Path) -> str:
    """With commands that can be copied."""
    return text.replace("CELL.toml", shlex.quote(str(cell)))


def tell(facts: Mapping[str, Any], cell: Path, prefix: str = "") -> None:
    """Print them on stderr; stdout stays free for programs."""
    for name, text in last_words(facts, cell):
        typer.echo(f"{prefix}{name}: {text}", err=True)
