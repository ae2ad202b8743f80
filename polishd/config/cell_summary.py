"""Who a cell is and where its daemon is found, at a glance: without the models of all that a cell may say.

Whoever asks a daemon how it is, or wants it to stop, waits for no more than that; and a file that was broken under a
running daemon keeps nobody from holding it.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from polishd.model.errors import ConfigError
from polishd.util.files import toml_text


@dataclass(frozen=True, slots=True)
class CellSummary:
    """Of one cell."""

    name: str
    """As ``cell.name``."""
    state_dir: Path
    """As ``CellConfig.state_dir``, absolute."""


def cell_summary(path: Path) -> CellSummary:
    """Of a cell's file; where that cannot be said, the ConfigError is the one of ``load_config``."""
    try:
        name, state_dir = (_said(path, key) for key in ("name", "state_dir"))
    except (ConfigError, ValueError, LookupError):
        from polishd.config.cell import load_config  # it says what is wrong, and where

        config = load_config(path)
        return CellSummary(config.cell.name, config.state_dir)
    return CellSummary(name, path.absolute().parent / Path(state_dir).expanduser())


def _said(path: Path, key: str) -> str:
    """The last word on that key of ``[cell]``: that of the file, or of the fragments which are laid over it."""
    raw = _read(path)
    fragments = [_read(path.parent / Path(name).expanduser()) for name in _included_files(raw)]
    said = [part["cell"][key] for part in (raw, *fragments) if key in part.get("cell", {})]
    if not said or not isinstance(said[-1], str) or not said[-1]:
        raise LookupError(key)
    return said[-1]


def _read(path: Path) -> Mapping[str, Any]:
    found = tomllib.loads(toml_text(path))
    if not isinstance(found.get("cell", {}), dict):
        raise LookupError("cell")
    return found


def _included_files(raw: Mapping[str, Any]) -> list[str]:
    names = raw.get("include", [])
    if not (isinstance(names, list) and all(isinstance(name, str) for name in names)):
        raise LookupError("include")
    return names
