"""Several tools over one part: whose turn it is, and what passes have taught of each. The journal knows both."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from polishd.daemon.contact.safety import ContactLimits
from polishd.daemon.job import initial_estimates as remembering
from polishd.daemon.journal.journal import Journal
from polishd.daemon.journal.records import PassRecord
from polishd.model.events import ToolMounted
from polishd.model.program import Program
from polishd.pipeline.dwell_step import ToolProblem
from polishd.pipeline.recipe import Recipe
from polishd.pipeline.records import EstimatesInUse
from polishd.pipeline.steps import initial_estimates


@dataclass(frozen=True, slots=True, eq=False)
class ToolStepState:
    """What a job does with one of its tools."""

    recipe: Recipe
    program: Program
    contact: ContactLimits
    terms: Mapping[str, Any] | None = None
    """Of a job with this tool alone: what it has learned belongs to them. None: the journal's own."""

    @property
    def tool(self) -> str:
        """Its name; empty where the cell has one."""
        return "" if self.recipe.turn is None else self.recipe.turn.tool


class ToolSequence:
    """A job's tools, one of which has its turn. Of a cell without ``[tools]`` the only one, without a name."""

    def __init__(self, turns: Sequence[ToolStepState], journal: Journal) -> None:
        self._turns = tuple(turns)
        self._journal = journal
        self.now = self._turns[0]
        """The tool whose turn it is."""
        self._believed = {turn.tool: initial_estimates(turn.recipe) for turn in turns}

    @property
    def believed(self) -> EstimatesInUse:
        """What the passes have taught of the tool whose turn it is."""
        return self._believed[self.now.tool]

    def believe(self, known: EstimatesInUse) -> None:
        """That from here on, of the tool whose turn it is."""
        self._believed[self.now.tool] = known

    @property
    def left(self) -> tuple[ToolStepState, ...]:
        """The turns after this one."""
        return self._turns[self._turns.index(self.now) + 1 :]

    @property
    def terms(self) -> Mapping[str, Any] | None:
        """What the lessons of the tool whose turn it is belong to."""
        return self.now.terms or self._journal.terms

    def to_solve(self) -> list[ToolProblem]:
        """This turn and those after it, each as its tool is believed to be."""
        left = (self.now, *self.left)
        return [ToolProblem(turn.recipe, turn.program, self._believed[turn.tool]) for turn in left]

    def of(self, record: PassRecord) -> ToolStepState:
        """The turn that a pass belonged to."""
        return next((turn for turn in self._turns if turn.tool == tool_of(record.facts)), self._turns[0])

    def take(self) -> None:
        """From here on it is the turn that the next pass belongs to: one that was torn off is made again."""
        self.now = self._turns[turn_now(self._turns, self._journal.passes)]

    def take_of(self, record: PassRecord) -> None:
        """The same of a pass that was made."""
        self.now = self.of(record)

    async def load(self) -> tuple[str, ...]:
        """Take up what has been taught of each tool: by the job's passes, or by its series; notes of the latter."""
        notes = []
        for turn in self._turns:
            known = taught_of(turn, self._journal.passes)
            if known is None:
                terms = turn.terms or self._journal.terms
                found = await asyncio.to_thread(remembering.initial_estimates_of, self._journal, turn.recipe, terms)
                known = None if found is None else found.believed
                notes += [] if found is None else [f"{turn.tool} {found.note}".lstrip()]
            if known is not None:
                self._believed[turn.tool] = known
        return tuple(notes)


def turn_now(turns: Sequence[ToolStepState], passes: Sequence[PassRecord]) -> int:
    """Number of the turn that the next pass belongs to: a pass that was torn off is made again with its tool."""
    done, upto = sum(record.how == "done" for record in passes), 0
    for number, turn in enumerate(turns):
        upto += 1 if turn.recipe.turn is None else turn.recipe.turn.passes
        if done < upto:
            return number
    return len(turns) - 1


def tool_of(facts: Mapping[str, Any]) -> str:
    """The tool of a pass, by its facts; empty where the cell has one."""
    return str(facts.get("tool", ""))


def taught_of(turn: ToolStepState, passes: Sequence[PassRecord]) -> EstimatesInUse | None:
    """What the job's passes with that tool have taught of it; None where there was none."""
    for record in reversed(passes):
        if tool_of(record.facts) == turn.tool:
            taught = record.facts.get("taught")
            return EstimatesInUse.load(taught["believed"] if taught else record.facts, turn.recipe.model.beliefs)
    return None


def mounted(journal: Journal) -> str:
    """The tool that was mounted last in this cell, of whatever job; empty where nobody knows. Reads the file."""
    sql = "SELECT data FROM event WHERE name = ? ORDER BY id DESC LIMIT 1"
    found = journal.store.read(sql, (ToolMounted.name,))
    return str(json.loads(found[0][0])["tool"]) if found else ""
