"""What is gathered of a cell before anything is written: SIM.toml's values with their origins, the cell's changes."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from polishd.config.cell import CellConfig, device_options
from polishd.hooks.loader import Hooks

LOOPBACK = "127.0.0.1"
SIM_STATE = "sim"
"""The simulator's state folder, beside SIM.toml."""


@dataclass(slots=True)
class RehearsalDraft:
    """A rehearsal that is being made of a cell."""

    config: CellConfig
    hooks: Hooks
    sim: dict[str, dict[str, tuple[Any, str]]] = field(default_factory=dict)
    """SIM.toml: by section and key a value, and where it comes from."""
    laid: dict[str, Any] = field(default_factory=dict)
    """What the rehearsal's cell has else than the cell, by dotted key; None: the key is taken out."""
    notes: list[str] = field(default_factory=list)
    """What the simulator cannot be, and what stands in for it."""
    files: dict[str, bytes] = field(default_factory=dict)
    """What both refer to, by name in the folder."""

    def put(self, section: str, key: str, value: Any, origin: str) -> None:
        """A value of SIM.toml; one that is None is left out."""
        table = self.sim.setdefault(section, {})
        if value is not None:
            table[key] = (value, origin)

    def take(self, section: str, keys: Sequence[str], given: str, values: Any) -> None:
        """Values of SIM.toml that the cell's section ``given`` has under the same names."""
        for key in keys:
            self.put(section, key, getattr(values, key), self.origin(f"{given}.{key}"))

    def origin(self, key: str) -> str:
        """Where the cell has a value: its key, and the fragment, or that it is a default."""
        inner: Any = self.config.raw
        for name in key.split("."):
            inner = inner.get(name) if isinstance(inner, Mapping) else None
        if inner is None:
            return f"{key}, its default"
        return f"{key} of {self.config.included[key]}" if key in self.config.included else key

    def options(self, device: str) -> dict[str, Any]:
        """A device's options with their defaults, as its type judges them; ConfigError as of the cell."""
        _, options = device_options(self.config, device, self.hooks.device_types())
        return dict(options)

    def replace_device(self, device: str, section: Mapping[str, Any], why: str) -> None:
        """Another type of device stands in for one that the simulator has not; keys of the port stay."""
        raw = self.config.devices[device]
        kept = {key: getattr(raw, key) for key in type(raw).model_fields if key != "type"}
        self.laid[device] = {**kept, **section}
        self.notes.append(f"{device}: {why}; {section['type']} stands in for it")

    def instead(self, key: str, value: Any, why: str) -> None:
        """The rehearsal's cell has another value than the cell, and says so; None: none."""
        self.laid[key] = value
        said = "is left out" if value is None else f"is {json.dumps(value)} in the rehearsal"
        self.notes.append(f"{key}: {why}; it {said}")

    def plugin(self, name: str) -> None:
        """A stand-in needs this plugin."""
        loaded = self.laid.get("plugins.load", list(self.config.plugins.load))
        if name not in loaded:
            self.laid["plugins.load"] = [*loaded, name]

    def copy(self, name: str, path: Path) -> str:
        """A file goes into the folder; its name there."""
        self.files[name] = path.read_bytes()
        return name
