"""A job's file: part, program, tolerance and other recipe values, laid over the cell's file.

A job's values replace those of the cell. A job cannot change the cell's identity and devices.
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
from polishd.util.files import named_path, toml_text

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
"""Sections that a job cannot have."""
OWN = (("job", "id"), ("part", "id"))
"""Keys that each job must have: its name, and the part that its maps must show."""


@dataclass(frozen=True, slots=True)
class JobFile:
    """A job's file as read. Relative paths in it start from its folder."""

    path: Path
    """Absolute."""
    text: str = field(repr=False)

    @classmethod
    def read(cls, path: Path) -> JobFile:
        """Read a job's file; raise ConfigError if that fails."""
        return cls(path.absolute(), toml_text(path))

    def laid_over(self, cell: CellConfig) -> CellConfig:
        """Return the cell with this job.

        Raises ConfigError, one line per problem: ``FILE:LINE: section.key: what is wrong; what to do``.
        """
        fragment, source = self.fragment()
        for key, value in self.named(fragment):
            *tables, name = key.split(".")
            _inner(fragment, tables)[name] = value
        raw = copy.deepcopy(dict(cell.raw))
        _drop_other_tolerance(raw, fragment)
        _drop_other_outline(raw, fragment)
        if "tools" in fragment:  # all of them: a job with one tool uses no other
            raw.pop("tools", None)
        overlay(raw, fragment)
        return consistent(CellConfig.of(raw, replace(cell.source, included=(*cell.source.included, source))))

    def fragment(self) -> tuple[dict[str, Any], TomlSource]:
        """Return the values, checked as far as possible without a cell, and their source; raise ConfigError."""
        fragment, source = loads_toml(self.text, self.path)
        wrong = [
            source.error((name,), f"belongs into the cell's file; a job has sections {join_words(_sections())}")
            for name in fragment
            if name in OF_THE_CELL
        ]
        wrong += [
            source.error(key, f"is missing; add it: {key[-1]} = ...") for key in OWN if _value(fragment, key) is None
        ]
        if wrong:
            raise ConfigError("\n".join(wrong))
        return fragment, source

    def names(self) -> list[str]:
        """Return the keys with which the job names files."""
        fragment, _ = loads_toml(self.text, self.path)
        return [key for key, _ in self.named(fragment)]

    def named(self, fragment: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        """Yield (dotted key, absolute path or paths) of files. Values of another type fail in the section's check."""
        tools = fragment.get("tools")
        for key in (*FILES, *tool_files(tools if isinstance(tools, dict) else {})):
            match _value(fragment, tuple(key.split("."))):
                case str() as name:
                    yield key, self._absolute(name)
                case [*names] if all(isinstance(name, str) for name in names):
                    yield key, [self._absolute(name) for name in names]

    def _absolute(self, name: str) -> str:
        return str(named_path(self.path.parent, name)) if name else name


def _drop_other_tolerance(raw: dict[str, Any], fragment: Mapping[str, Any]) -> None:
    """Remove the cell's tolerance, in its long or short form, if the job has one."""
    if "tolerance" in fragment:
        for key in ("tolerance_nm", "tolerance_period_mm"):
            raw["job"].pop(key, None)
    elif _value(fragment, ("job", "tolerance_nm")) is not None:
        raw.pop("tolerance", None)


def _drop_other_outline(raw: dict[str, Any], fragment: Mapping[str, Any]) -> None:
    """Remove the cell's part outline if the job has one."""
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
