"""Several tools over one part: whose turn it is, and what passes have taught of each. The journal knows both."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from polishd.daemon.journal import Journal
from polishd.daemon.journal_records import PassRecord
from polishd.daemon.safety import ContactLimits
from polishd.model.events import ToolMounted
from polishd.model.program import Program
from polishd.recipe.recipe import Recipe
from polishd.recipe.records import Believed


@dataclass(frozen=True, slots=True)
class ToolTurn:
    """What a job does with one of its tools."""

    recipe: Recipe
    program: Program
    contact: ContactLimits
    terms: Mapping[str, Any] | None = None
    """Of a job with this tool alone: what it has learned belongs to them. None: the journal's own."""

    @property
    def tool(self) -> str:
        """Its name; empty where the cell has one tool."""
        return "" if self.recipe.turn is None else self.recipe.turn.tool


def turn_now(turns: Sequence[ToolTurn], passes: Sequence[PassRecord]) -> int:
    """Number of the turn that the next pass belongs to: a pass that was torn off is made again with its tool."""
    done, upto = sum(record.how == "done" for record in passes), 0
    for number, turn in enumerate(turns):
        upto += 1 if turn.recipe.turn is None else turn.recipe.turn.passes
        if done < upto:
            return number
    return len(turns) - 1


def turn_of(turns: Sequence[ToolTurn], record: PassRecord) -> int:
    """Number of the turn that a pass belonged to."""
    return next((number for number, turn in enumerate(turns) if turn.tool == tool_of(record.facts)), 0)


def tool_of(facts: Mapping[str, Any]) -> str:
    """The tool of a pass, by its facts; empty where the cell has one."""
    return str(facts.get("tool", ""))


def believed_of(turn: ToolTurn, passes: Sequence[PassRecord]) -> Believed | None:
    """What the job's passes with that tool have taught of it; None where there was none."""
    for record in reversed(passes):
        if tool_of(record.facts) == turn.tool:
            taught = record.facts.get("taught")
            return Believed.load(taught["believed"] if taught else record.facts, turn.recipe.model.beliefs)
    return None


def mounted(journal: Journal) -> str:
    """The tool that was mounted last in this cell, of whatever job; empty where nobody knows. Reads the file."""
    sql = "SELECT data FROM event WHERE name = ? ORDER BY id DESC LIMIT 1"
    found = journal.store.read(sql, (ToolMounted.name,))
    return str(json.loads(found[0][0])["tool"]) if found else ""
