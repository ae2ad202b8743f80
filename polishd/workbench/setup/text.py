"""A new cell as text: each key with its meaning behind it, and above it what has to be looked at."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping
from typing import Any

from pydantic import BaseModel

from polishd.config.cell import PORTS, CellConfig
from polishd.config.meanings import in_words, meanings
from polishd.config.places import section_of, toml_type
from polishd.config.process import HybridSection, MeasuredSection, SerialSection
from polishd.plain import toml
from polishd.workbench.setup.arms import ARMS
from polishd.workbench.setup.draft import ORDER, CellDraft

FILL_IN = "to be filled in, from the arm's data sheet; here that of another arm"
WIDTH = 120
COLUMN = 36
"""In which meanings begin, where a value leaves room."""
LOOK = "# LOOK: "
KINDS: Mapping[str, type[BaseModel]] = {"hybrid": HybridSection, "serial": SerialSection, "measured": MeasuredSection}
ROW = "a_mm, alpha_deg, d_mm, theta_deg with joint {} at 0"


def cell_text(draft: CellDraft) -> str:
    """The cell's file."""
    lines = [
        "# A polishd cell, made by polishd init. Relative paths start from this file's folder. LOOK: the next key was",
        "# assumed; mend it, and take that line away. All keys, with unit, default and range: docs/reference/cell.md",
        *(f"{name} = {toml(value)}" for name, value in draft.raw.items() if not _is_section(value)),
    ]
    places = {name: place for place, name in enumerate(ORDER)}
    for name, section in sorted(draft.raw.items(), key=lambda item: places.get(item[0], len(places))):
        if isinstance(section, Mapping):
            if section:
                lines += ["", f"[{name}]", *_keys(draft, name, section)]
        elif _is_section(section):
            for one in section:
                lines += ["", f"[[{name}]]", *(f"{key} = {toml(value)}" for key, value in one.items())]
    return "\n".join(lines) + "\n"


def _is_section(value: Any) -> bool:
    return isinstance(value, Mapping) or (
        isinstance(value, list) and bool(value) and all(isinstance(one, Mapping) for one in value)
    )


def _keys(draft: CellDraft, name: str, section: Mapping[str, Any]) -> Iterator[str]:
    told = _meanings(draft, name, section)
    if (arm := draft.answers.own.kinematics.arm) and name == "kinematics":
        yield f"# {ARMS[arm].title}. Rows: {ARMS[arm].source}"
    for key, value in sorted(section.items(), key=lambda item: item[0] != "type"):
        blank = f"{name}.{key}" in draft.blank
        why = FILL_IN if blank else draft.assumed.get(f"{name}.{key}")
        if why:
            yield f"{LOOK}{why}"
        lines = _written(key, value, in_words(told.get(key, "")))
        yield from (f"# {line}" if blank and not line.startswith("#") else line for line in lines)


def _written(key: str, value: Any, meaning: str) -> Iterator[str]:
    """A key's lines: what it means behind it, or above it where there is no room."""
    if key == "dh" and isinstance(value, list | tuple):
        yield from textwrap.wrap(meaning, WIDTH - 2, initial_indent="# ", subsequent_indent="# ")
        yield "dh = ["
        for joint, row in enumerate(value, 1):
            yield f"{f'  {toml(row)},':<{COLUMN}} # {ROW.format(joint)}"
        yield "]"
        return
    line = f"{key} = {toml(value)}"
    beside = f"{line:<{COLUMN}} # {meaning}" if meaning else line
    if len(beside) > WIDTH:
        yield from textwrap.wrap(meaning, WIDTH - 2, initial_indent="# ", subsequent_indent="# ")
        yield line
    else:
        yield beside


def _meanings(draft: CellDraft, name: str, section: Mapping[str, Any]) -> Mapping[str, str]:
    return {} if (model := _model(draft, name, section)) is None else meanings(model)


def _model(draft: CellDraft, name: str, section: Mapping[str, Any]) -> type[BaseModel] | None:
    """Who judges a section; None for a table of several by name."""
    if name in PORTS:
        kind = draft.hooks.device_types().get(section.get("type", ""))
        return None if kind is None else kind.options
    if name == "kinematics":
        return KINDS[section.get("type", "hybrid")]
    return section_of(toml_type(CellConfig.model_fields[name].annotation))
