"""``sim.log``: one JSON line for each thing that happened, in the order in which it happened."""

from __future__ import annotations

import heapq
import itertools
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

KEPT = 4000


@dataclass(slots=True)
class SimEventLog:
    """Holds events back until every device has vouched for their time, then writes them in order."""

    path: Path
    _heap: list[tuple[float, int, dict[str, Any]]] = field(default_factory=list)
    _number: itertools.count[int] = field(default_factory=itertools.count)
    _wall: list[float] = field(default_factory=list)
    _process: list[float] = field(default_factory=list)

    def add(self, device: str, name: str, at_s: float, **data: Any) -> None:
        """Something happened at that time (time.monotonic)."""
        heapq.heappush(self._heap, (at_s, next(self._number), {"device": device, "event": name, **data}))

    def clock(self, wall_s: float, process_s: float) -> None:
        """How the two clocks stand together."""
        self._wall.append(wall_s)
        self._process.append(process_s)
        if len(self._wall) > 2 * KEPT:
            del self._wall[:KEPT], self._process[:KEPT]

    def write(self, until_s: float) -> None:
        """Append all that happened up to then."""
        lines = []
        while self._heap and self._heap[0][0] <= until_s:
            at_s, _, event = heapq.heappop(self._heap)
            process = float(np.interp(at_s, self._wall, self._process)) if self._wall else 0.0
            lines.append(json.dumps({"mono_s": round(at_s, 6), "process_s": round(process, 6), **event}))
        if lines:
            with self.path.open("a") as file:
                file.write("\n".join(lines) + "\n")
