"""Estimate how a figure grows with the parts: slope of a straight line, and its standard error."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

WARM = 40
"""Number of parts omitted at the start of each process, which loads modules and fills pools."""
LEAST = 4
"""Number of parts of a process from which its growth is estimated."""
BOUNDS: Mapping[str, float] = {
    "daemon_rss_mb": 0.1,
    "worker_rss_mb": 0.1,
    "descriptors": 0.02,
    "threads": 0.02,
    "tasks": 0.02,
    "written_mb": 0.01,
}
"""Permitted growth per part by figure; for ``written_mb`` that of the size written for each part."""


@dataclass(frozen=True, slots=True)
class Slope:
    """Growth of one figure per part; NaN where it is unknown."""

    per_part: float
    sigma: float
    mean: float
    lives: int
    parts: int

    def grows(self, bound: float) -> bool:
        """Return whether the growth exceeds the bound by two standard errors."""
        return bool(self.per_part - 2 * self.sigma > bound)

    def flat(self, bound: float) -> bool:
        """Return whether the growth is below the bound by two standard errors."""
        return bool(self.per_part + 2 * self.sigma < bound)


def slope(lives: Iterable[list[tuple[float, float]]]) -> Slope:
    """Return one slope for all processes with separate levels; ``lives``: (parts since the start, value)."""
    xs, ys, counted = [], [], 0
    mean = 0.0
    for life in lives:
        points = np.array([point for point in life if point[0] >= WARM]).reshape(-1, 2)
        if len(points) >= LEAST:
            xs.append(points[:, 0] - points[:, 0].mean())
            ys.append(points[:, 1] - points[:, 1].mean())
            counted, mean = counted + 1, mean + points[:, 1].sum()
    if not xs:
        return Slope(math.nan, math.nan, math.nan, 0, 0)
    x, y = np.concatenate(xs), np.concatenate(ys)
    per_part = float(x @ y / (x @ x))
    free = max(len(x) - counted - 1, 1)
    sigma = math.sqrt(float(((y - per_part * x) ** 2).sum()) / free / float(x @ x))
    return Slope(per_part, sigma, float(mean / len(x)), counted, len(x))


def slopes(records: Iterable[Mapping[str, Any]]) -> dict[str, Slope]:
    """Return the slope of each figure over the processes that have it."""
    lives: dict[tuple[Any, str], list[tuple[float, float]]] = {}
    for record in records:
        for name in BOUNDS:
            if record["held"].get(name) is not None:
                lives.setdefault((record["life"], name), []).append((record["age"], record["held"][name]))
    return {name: slope([life for (_, of), life in lives.items() if of == name]) for name in BOUNDS}
