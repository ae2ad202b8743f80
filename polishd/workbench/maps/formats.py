"""``polishd map formats``: what can be read and written here."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any

from polishd.hookspecs import SurfaceReader
from polishd.show.tables import emit, record_table
from polishd.workbench.maps.files import readers_for

EXTRAS = {
    "fits": ("fits", "astropy"),
    "gwy": ("gwy", "gwyfile"),
    "tiff": ("tiff", "tifffile"),
    "tail": ("tail", "SurfaceTopography"),
}
"""Readers that need more than the base install: the extra, and the module that it brings."""


def formats_verb(cell: Path | None = None, *, as_json: bool) -> None:
    """All readers, in the order in which they are asked."""
    asked = readers_for(cell)
    own = asked.keys() if cell is None else readers_for().keys()
    answers = [{**format_answer(reader), "own": reader.name in own} for reader in asked.values()]
    columns = ("format", "endings", "reads", "writes", "dated by", "installed by")
    emit(
        {"formats": answers}, as_json=as_json, table=lambda: record_table("formats", columns, map(_format_row, answers))
    )


def format_answer(reader: SurfaceReader) -> dict[str, Any]:
    """What a reader can do here."""
    extra, module = EXTRAS.get(reader.name, (None, None))
    installed = module is None or find_spec(module) is not None
    return {
        "name": reader.name,
        "suffixes": list(reader.suffixes),
        "reads": installed,
        "writes": installed and reader.write is not None,
        "dates": reader.dates,
        "extra": extra,
        "installed": installed,
    }


def _format_row(answer: dict[str, Any]) -> tuple[str, ...]:
    extra = answer["extra"]
    by = "polishd" if answer["own"] else "a plugin of the cell"
    return (
        answer["name"],
        " ".join(answer["suffixes"]) or "any",
        "yes" if answer["reads"] else "no",
        "yes" if answer["writes"] else "no",
        "header" if answer["dates"] else "file system",
        f"pip install 'polishd[{extra}]'" + (": is there" if answer["installed"] else "") if extra else by,
    )
