"""A case of a study: what is swept there, what decides it, and on which versions it was computed."""

from __future__ import annotations

import functools
import hashlib
import json
import platform
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from polishd import __version__

LIBRARIES = ("numpy", "scipy", "numba")
"""Of which another version may give other last bits."""


@dataclass(frozen=True, slots=True)
class Case:
    """One of them. It is small: what a worker can compute of it is not in it."""

    number: int
    """In the study's order, from 0."""
    point: int
    """Of the sweep, from 0: cases of one point differ in scenario, loop and seed only."""
    at: Mapping[str, Any]
    """By dotted key of the study, what is swept."""
    scenario: str | None
    loop: str | None
    seed: int | None
    of: str
    """Hash of all that decides it, files and versions too: the same hash, the same figures to the last bit."""


@functools.cache
def versions() -> Mapping[str, str]:
    """What must be the same where a case is computed as where it was made."""
    return {
        "polishd": __version__,
        "python": platform.python_version(),
        "machine": platform.machine(),
        **{name: version(name) for name in LIBRARIES},
    }


def made_of(*parts: tuple[Mapping[str, Any], Path]) -> str:
    """Hash of parts of a study, the files that they name beside their folders, and the versions."""
    told = hashlib.sha256(json.dumps(versions()).encode())
    for part, folder in parts:
        told.update(json.dumps(part, sort_keys=True, default=str).encode())
        for name in _texts(part):
            path = folder / name
            if len(name) < 256 and path.is_file():
                told.update(hashlib.sha256(path.read_bytes()).digest())
    return told.hexdigest()[:16]


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, Mapping):
        for one in value.values():
            yield from _texts(one)
    elif isinstance(value, list | tuple):
        for one in value:
            yield from _texts(one)
