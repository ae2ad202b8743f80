"""Notification of an event for an operator who is not at the cell."""

from __future__ import annotations

import re
from dataclasses import asdict, dataclass, replace
from typing import Any

from polishd.model.states import Severity
from polishd.model.text import printable

TITLE_LETTERS = 140
_WITH_A_DIGIT = re.compile(r"\S*\d\S*")


@dataclass(frozen=True, slots=True, kw_only=True)
class Notification:
    """An event that needs an operator, with all that a remote reader needs. ``facts`` has it for programs."""

    id: str
    """Identifier, also when sent again; a receiver may drop duplicates."""
    event: str
    severity: Severity
    what: str
    """The event."""
    now: str
    """The cell's reaction."""
    todo: str
    """Actions for the operator."""
    cell: str
    job: str
    part: str
    cycle: int | None
    run_dir: str
    at: str
    """When it happened: ISO 8601, UTC."""
    times: int = 1
    """Number of occurrences since ``since``; this is the last one."""
    since: str = ""
    """When it happened first, of several times."""

    @property
    def thing(self) -> str:
        """Key of repeated events; words with a digit do not count."""
        words = _WITH_A_DIGIT.sub("#", self.what)
        return f"{self.severity} {self.event} {self.job} {self.part} {words}"

    @property
    def title(self) -> str:
        """One short line."""
        line = " ".join(printable(f"{self.cell}: {self.severity}: {self.what}").split())
        return line if len(line) <= TITLE_LETTERS else f"{line[: TITLE_LETTERS - 3]}..."

    @property
    def text(self) -> str:
        """All of it, for people; control characters in text from outside are escaped, as in the title."""
        of = [("cell", self.cell), ("job", self.job), ("part", self.part), ("cycle", self.cycle)]
        often = f" ({self.times} times since {self.since})" if self.times > 1 else ""
        lines = [
            f"what happened: {self.what}",
            f"the cell now: {self.now}",
            f"what to do: {self.todo}",
            "",
            ", ".join(f"{name} {value}" for name, value in of if value not in {None, ""}),
            f"at {self.at}{often}",
            *([f"run folder: {self.run_dir}"] if self.run_dir else []),
        ]
        return printable("\n".join(lines) + "\n")

    def again(self, earlier: Notification | None) -> Notification:
        """Return this notification, counted with the earlier ones that were not sent."""
        if earlier is None:
            return self
        return replace(self, times=earlier.times + self.times, since=earlier.since or earlier.at)

    def facts(self) -> dict[str, Any]:
        """JSON-ready, with ``title`` and ``text``."""
        return {**asdict(self), "title": self.title, "text": self.text}
