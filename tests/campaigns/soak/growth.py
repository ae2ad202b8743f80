"""Whether something grows with the parts: a straight line through what was seen, and its standard error."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

WARM = 40
"""Of each life of a process, so many parts are left out: modules are loaded then, pools filled."""
LEAST = 4
"""Fewer parts of a life than that say nothing of growth."""
BOUNDS: Mapping[str, float] = {
    "daemon_rss_mb": 0.1,
    "worker_rss_mb": 0.1,
    "descriptors": 0.02,
    "threads": 0.02,
    "tasks": 0.02,
    "written_mb": 0.01,
}
"""Most by which each may be more with every part; of what was written for a part, by how much more for the next."""


@dataclass(frozen=True, slots=True)
class Slope:
    """Of one figure, a part; ``nan`` where nothing is known."""

    per_part: float
    sigma: float
    mean: float
    lives: int
    parts: int

    def grows(self, bound: float) -> bool:
        """Surely more than the bound allows: by two standard errors."""
        return bool(self.per_part - 2 * self.sigma > bound)

    def flat(self, bound: float) -> bool:
        """Surely less."""
        return bool(self.per_part + 2 * self.sigma < bound)


def slope(lives: Iterable[list[tuple[float, float]]]) -> Slope:
    """One slope for all lives, each with a level of its own; ``lives``: (parts since its start, value)."""
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
    """Of each figure, over the lives of the daemons that had it."""
    lives: dict[tuple[Any, str], list[tuple[float, float]]] = {}
    for record in records:
        for name in BOUNDS:
            if record["held"].get(name) is not None:
                lives.setdefault((record["life"], name), []).append((record["age"], record["held"][name]))
    return {name: slope([life for (_, of), life in lives.items() if of == name]) for name in BOUNDS}
