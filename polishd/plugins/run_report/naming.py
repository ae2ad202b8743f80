"""What people call passes and measurements: one that was interrupted is no pass like the others, and has no number."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

Rows = Sequence[Mapping[str, Any]]


def interrupted(row: Mapping[str, Any]) -> bool:
    """Whether the pass after a measurement did not come to its end."""
    return row.get("how") not in (None, "done")


def share(row: Mapping[str, Any]) -> str:
    """How much of an interrupted pass was executed; empty for any other."""
    if not interrupted(row):
        return ""
    match row.get("executed_s"), row.get("dwell_s"):
        case (int() | float()) as executed, (int() | float()) as planned if planned > 0:
            return f"interrupted at {executed / planned:.0%}"
        case _:
            return "interrupted"


def passes(rows: Rows) -> str:
    """How many came to their end, and how many did not."""
    torn = sum(map(interrupted, rows))
    whole = len(rows) - 1 - sum(map(interrupted, rows[:-1]))
    return f"{whole}, and {torn} interrupted" if torn else str(whole)


def measurement(rows: Rows, index: int) -> str:
    """``start``, or after which pass it was taken."""
    if index == 0:
        return "start"
    if index <= len(rows) and interrupted(rows[index - 1]):
        return "after an interrupted pass"
    return f"after pass {index - sum(map(interrupted, rows[:index]))}"


def pass_after(rows: Rows, index: int) -> str:
    """The pass that followed a measurement."""
    if index < len(rows) and interrupted(rows[index]):
        return f"Pass that was {share(rows[index])}"
    return f"Pass {index + 1 - sum(map(interrupted, rows[:index]))}"
