"""The last lines of ``polishd run``, for whoever finds the cell: is it safe, who did not confirm, what to do next."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from polishd.daemon.last_word import for_cell
from polishd.model.concern import CellSafety
from polishd.show.terminal import say


def last_words(facts: Mapping[str, Any], cell: Path) -> list[tuple[str, str]]:
    """Names and texts, of a summary, a state event or what ``status`` found; commands name that cell."""
    standing = CellSafety.of(facts)
    rows = [*standing.rows(), ("run folder", facts.get("run_dir", "")), ("next", standing.next)]
    return [(name, for_cell(text, cell)) for name, text in rows if text]


def tell(facts: Mapping[str, Any], cell: Path, prefix: str = "") -> None:
    """Print them on stderr; stdout stays free for programs."""
    for name, text in last_words(facts, cell):
        say(f"{prefix}{name}: {text}", err=True)
