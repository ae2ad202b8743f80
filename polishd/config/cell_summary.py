"""Read a cell's name and state folder quickly, without the models of its other sections.

Commands such as `status` and `hold` need no more. They work even if the file was damaged while the daemon runs.
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
    """Name and state folder of a cell."""

    name: str
    """As ``cell.name``."""
    state_dir: Path
    """As ``CellConfig.state_dir``, absolute."""


def cell_summary(path: Path) -> CellSummary:
    """Read the summary from a cell's file; raise the ConfigError of ``load_config`` if that fails."""
    try:
        name, state_dir = (_cell_value(path, key) for key in ("name", "state_dir"))
    except (ConfigError, ValueError, LookupError):
        from polishd.config.cell import load_config  # its error names the fault and its line

        config = load_config(path)
        return CellSummary(config.cell.name, config.state_dir)
    return CellSummary(name, path.absolute().parent / Path(state_dir).expanduser())


def _cell_value(path: Path, key: str) -> str:
    """Return the value of that key of ``[cell]``: that of the last fragment which has it, or of the file."""
    raw = _read(path)
    fragments = [_read(path.parent / Path(name).expanduser()) for name in _included_files(raw)]
    values = [part["cell"][key] for part in (raw, *fragments) if key in part.get("cell", {})]
    if not values or not isinstance(values[-1], str) or not values[-1]:
        raise LookupError(key)
    return values[-1]


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
