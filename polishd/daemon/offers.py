"""What other cells of a shop have learned of a recipe, as the shop offered it to this one: events of the journal."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from polishd.config.process import LIMITS_OF_PROCESS
from polishd.model.beliefs import Estimate
from polishd.model.events import ShopRateReceived

RECIPE = ("process.",)
TOOL = "memory.tool"
FORGOTTEN = "forgotten"
"""The event behind which nothing is remembered; its data has the last pass before it, ``job`` and ``cycle``."""
UNKNOWN_SHARE, ANOTHER_SHARE = 3.0, 6.0
"""``limits.max_rate_change`` by these: the rate's standard error before any pass, and from one machine to another."""


@dataclass(frozen=True, slots=True)
class ShopRate:
    """Another cell's removal rate."""

    cell: str
    job: str
    of_cycle: int
    at_s: float
    """Unix time at which its pass ended."""
    rate: float
    sigma: float
    """Its standard error on that cell's machine."""

    def on_another_machine(self, max_rate_change: float) -> Estimate:
        """What it says of this one's rate: less sure, and never less than of a machine of which nothing is known."""
        sigma = math.hypot(self.sigma, max_rate_change / ANOTHER_SHARE)
        return Estimate(self.rate, min(sigma, max_rate_change / UNKNOWN_SHARE))

    def told(self) -> str:
        """Whose it is, for people."""
        day = datetime.fromtimestamp(self.at_s, UTC)
        words = f"pass {self.of_cycle + 1} of job {self.job!r} of the cell {self.cell!r}"
        return f"{words} ({day:%Y-%m-%d %H:%M} UTC; another machine, offered by the shop)"


def recipe_of(terms: Mapping[str, Any]) -> str:
    """What identifies the recipe of a job that was begun with those terms, on whatever machine: process and tool.

    Empty where what it learns is of its own machine (``process.learns`` other than ``rate``): nothing is offered then.
    """
    if terms.get("process.learns", "rate") != "rate":
        return ""
    keys = {key for key in terms if key.startswith(RECIPE) or key == TOOL} - {*LIMITS_OF_PROCESS}
    known = {key: _content(terms[key]) for key in keys}
    return hashlib.sha256(json.dumps(known, sort_keys=True).encode()).hexdigest()[:16]


def latest_offer(read: Callable[[str, Sequence[Any]], list[tuple[Any, ...]]], recipe: str) -> ShopRate | None:
    """The last one of that recipe since anything was forgotten; ``read`` gives all rows of a query of the journal."""
    sql = (
        "SELECT data FROM event WHERE name = ? AND json_extract(data, '$.recipe') = ? "
        "AND id > ifnull((SELECT max(id) FROM event WHERE name = ?), 0) ORDER BY id DESC LIMIT 1"
    )
    found = read(sql, (ShopRateReceived.name, recipe, FORGOTTEN)) if recipe else []
    if not found:
        return None
    said = json.loads(found[0][0])
    return ShopRate(**{key: said[key] for key in ShopRate.__slots__})


def _content(value: Any) -> Any:
    """Of a file what stands in it, wherever it lies."""
    if isinstance(value, Mapping):
        return value.get("sha256")
    return [_content(one) for one in value] if isinstance(value, list) else value
