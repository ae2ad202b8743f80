"""The two files as text: SIM.toml with the origin behind each value, and the cell's own file with few of its values."""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping
from typing import Any

import tomlkit

from polishd.config.cell import FILES, overlay
from polishd.console.rehearsal.draft import RehearsalDraft
from polishd.plain import toml

COLUMN = 45
"""In which comments begin, where a value leaves room."""


def sim_text(draft: RehearsalDraft) -> str:
    """SIM.toml."""
    lines = [
        f"# Made by polishd sim --from {draft.config.path}: the simulated cell of {draft.config.cell.name}.",
        "# Behind each value: the key of the cell that it comes from. All keys: docs/reference/simulator.md",
        *(f"# {note}" for note in draft.notes),
    ]
    for section, values in draft.sim.items():
        lines += ["", f"[{section}]"]
        lines += [f"{f'{key} = {toml(value)}':<{COLUMN}} # {origin}" for key, (value, origin) in values.items()]
    return "\n".join(lines) + "\n"


def cell_text(draft: RehearsalDraft) -> str:
    """The rehearsal's cell: the cell with its fragments laid over it, its files by absolute paths, and its changes."""
    config = draft.config
    document = tomlkit.parse(config.source.text)
    if document.pop("include", None):  # what fragments say would replace what is changed here
        overlay(document, {key: value for key, value in config.raw.items() if key != "include"})
    for key, value in {**_files(draft), **draft.laid}.items():
        _set(document, key.split("."), value)
    head = (
        f"# Made by polishd sim --from {config.path}: the same cell, with simulated devices and folders of its own.\n"
    )
    return head + "".join(f"# {note}\n" for note in draft.notes) + tomlkit.dumps(document)


def _files(draft: RehearsalDraft) -> dict[str, Any]:
    """Keys of the cell that name files, with absolute paths: the rehearsal's cell lies in another folder."""
    found: dict[str, Any] = {}
    for key in FILES:
        section, name = key.split(".")
        given = draft.config.raw.get(section, {}).get(name)
        if isinstance(given, str):
            found[key] = str(draft.config.resolve(given).absolute())
        elif given:
            found[key] = [str(draft.config.resolve(one).absolute()) for one in given]
    return found


def _set(table: MutableMapping[str, Any], path: list[str], value: Any) -> None:
    """Set, or with None take out, what a dotted key names; tables on the way are made."""
    *way, last = path
    for name in way:
        if name not in table:
            if value is None:
                return
            table[name] = tomlkit.table()
        table = table[name]
    if value is None:
        table.pop(last, None)
    elif isinstance(value, Mapping):
        made = tomlkit.table()
        for key, one in value.items():
            made[key] = one
        table[last] = made
    else:
        table[last] = value
