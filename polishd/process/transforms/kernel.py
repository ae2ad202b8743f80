"""Functions over lanes, compiled and kept."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from polishd.compiled import compiled
from polishd.process.transforms import butterflies, lanes, plane


@cache
def kernel(function: Callable[..., Any], *others: str) -> Callable[..., Any]:
    """The function by numba; ``others``: files of what it calls, but for this package and its own."""
    own = (function.__code__.co_filename, butterflies.__file__, lanes.__file__, plane.__file__)
    return compiled(function, map(Path, (*own, *others)), error_model="numpy")
