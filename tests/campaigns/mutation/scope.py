"""Modules of the mutation campaign and their tests, from ``scope.toml``."""

from __future__ import annotations

import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
PARTS = ("state_machine", "journal", "recovery", "safety")
KEPT = ROOT / "build" / "mutation"
"""Folder of the results that are kept between sessions."""

_SCOPE = tomllib.loads(Path(__file__).with_name("scope.toml").read_text())

TESTS: tuple[str, ...] = tuple(_SCOPE["tests"])
CHOSEN = "not slow and not hil"
MODULES: tuple[str, ...] = tuple(f"polishd/{name}.py" for part in PARTS for name in _SCOPE[part])
"""Paths of the modules relative to the project's root."""
