"""A job's file: part, program, tolerance and what else of the recipe is its own, laid over the cell's file.

What a job says replaces what the cell says; what it leaves out is the cell's. Who the cell is, and what it consists of,
no job may change.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from polishd.config.cell import FILES, PORTS, CellConfig, consistent, overlay, tool_files
from polishd.config.fields import OUTLINES
from polishd.config.toml_loader import TomlSource, join_words, loads_toml
from polishd.model.errors import ConfigError
from polishd.util.files import toml_text

OF_THE_CELL = (
    "include",
    "cell",
    "plugins",
    *PORTS,
    "roles",
    "signals",
    "machine",
    "kinematics",
    "notify",
    "certificate",
    "shop",
    "opcua",
    "web",
)
"""What a job cannot say."""
OWN = (("job", "id"), ("part", "id"))
"""What each job says for itself: its name, and the part that its maps must show."""


@dataclass(frozen=True, slots=True)
class JobFile:
    """A job's file as it was read; paths in it start from its own folder."""

    path: Path
    """Absolute."""
    text: str = field(repr=False)

    @classmethod
    def read(cls, path: Path) -> JobFile:
        """ConfigError where it cannot be read."""
        return cls(path.absolute(), toml_text(path))

    def laid_over(self, cell: CellConfig) -> CellConfig:
        """The cell with this job; ConfigError, a line each: ``FILE:LINE: section.key: what is wrong; what to do``."""
        fragment, source = self.fragment()
        for key, value in self.named(fragment):
            *tables, name = key.split(".")
            _inner(fragment, tables)[name] = value
        raw = copy.deepcopy(dict(cell.raw))
        _drop_other_tolerance(raw, fragment)
        _drop_other_outline(raw, fragment)
        if "tools" in fragment:  # all of them: a job with one tool has no other's turn
            raw.pop("tools", None)
        overlay(raw, fragment)
        return consistent(CellConfig.of(raw, replace(cell.source, included=(*cell.source.included, source))))

    def fragment(self) -> tuple[dict[str, Any], TomlSource]:
        """Its values, judged as far as that can be done without a cell, and where they stand; ConfigError."""
        fragment, source = loads_toml(self.text, self.path)
        wrong = [
            source.error((name,), f"is the cell's, and no job's; a job has sections {join_words(_sections())}")
            for name in fragment
            if name in OF_THE_CELL
        ]
        wrong += [
            source.error(key, f"is missing; add it: {key[-1]} = ... (each job says its own)")
            for key in OWN
            if _value(fragment, key) is None
        ]
        if wrong:
            raise ConfigError("\n".join(wrong))
        return fragment, source

    def names(self) -> list[str]:
        """The keys by which it names files itself."""
        fragment, _ = loads_toml(self.text, self.path)
        return [key for key, _ in self.named(fragment)]

    def named(self, fragment: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        """(dotted key, absolute path or paths) of files; what is no text is left to the section's own check."""
        tools = fragment.get("tools")
        for key in (*FILES, *tool_files(tools if isinstance(tools, dict) else {})):
            match _value(fragment, tuple(key.split("."))):
                case str() as name:
                    yield key, self._absolute(name)
                case [*names] if all(isinstance(name, str) for name in names):
                    yield key, [self._absolute(name) for name in names]

    def _absolute(self, name: str) -> str:
        return str(self.path.parent / Path(name).expanduser()) if name else name


def _drop_other_tolerance(raw: dict[str, Any], fragment: Mapping[str, Any]) -> None:
    """A tolerance has a long form and a short one: the job's takes the place of the cell's, whichever that is."""
    if "tolerance" in fragment:
        for key in ("tolerance_nm", "tolerance_period_mm"):
            raw["job"].pop(key, None)
    elif _value(fragment, ("job", "tolerance_nm")) is not None:
        raw.pop("tolerance", None)


def _drop_other_outline(raw: dict[str, Any], fragment: Mapping[str, Any]) -> None:
    """So has the part's outline: of a job's part that has one the cell's says nothing."""
    if any(_value(fragment, ("part", key)) is not None for key in OUTLINES):
        for key in (*OUTLINES, "hole_mm"):
            raw["part"].pop(key, None)


def _sections() -> list[str]:
    return [name for name in CellConfig.model_fields if name not in OF_THE_CELL]


def _inner(values: dict[str, Any], tables: Sequence[str]) -> dict[str, Any]:
    for table in tables:
        values = values[table]
    return values


def _value(values: Any, key: tuple[str, ...]) -> Any:
    for name in key:
        values = values.get(name) if isinstance(values, dict) else None
    return values
