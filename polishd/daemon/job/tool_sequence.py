"""Tools of a job, and the programs of each that take turns: the current ones, and the estimates of each tool.

All come from the journal.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from polishd.daemon.contact.safety import ContactLimits
from polishd.daemon.job import initial_estimates as from_journal
from polishd.daemon.journal.journal import Journal
from polishd.daemon.journal.records import PassRecord
from polishd.model.events import ToolMounted
from polishd.model.program import Program
from polishd.pipeline.dwell_step import ToolProblem
from polishd.pipeline.recipe import Recipe
from polishd.pipeline.records import EstimatesInUse, ProgramTurn
from polishd.pipeline.steps import initial_estimates


@dataclass(frozen=True, slots=True, eq=False)
class ToolStepState:
    """Recipe, programs and limits of one tool of a job."""

    recipe: Recipe
    programs: tuple[Program, ...]
    """Its programs, which take turns from pass to pass."""
    contact: ContactLimits
    terms: Mapping[str, Any] | None = None
    """Terms of a job with this tool alone, to which its estimates belong. None: the journal's."""
    index: int = 0
    """Of the current program."""

    @property
    def program(self) -> Program:
        """The current program."""
        return self.programs[self.index]

    @property
    def turn(self) -> ProgramTurn | None:
        """The current program among several; None where the tool has one."""
        return ProgramTurn(self.index + 1, self.program.name) if len(self.programs) > 1 else None

    def of_pass(self, before: int) -> ToolStepState:
        """Return the step of the pass that follows so many complete passes of the tool."""
        return replace(self, index=before % len(self.programs))

    @property
    def tool(self) -> str:
        """Its name; empty where the cell has one tool."""
        return "" if self.recipe.turn is None else self.recipe.turn.tool


class ToolSequence:
    """Tools of a job in order, with a current one. A cell without ``[tools]`` has one tool without a name."""

    def __init__(self, turns: Sequence[ToolStepState], journal: Journal) -> None:
        self._turns = tuple(turns)
        self._journal = journal
        self.now = self._turns[0]
        """The current tool, with its current program."""
        self._estimates = {turn.tool: initial_estimates(turn.recipe) for turn in turns}

    @property
    def estimates(self) -> EstimatesInUse:
        """Estimates of the current tool."""
        return self._estimates[self.now.tool]

    def update_estimates(self, estimates: EstimatesInUse) -> None:
        """Replace the estimates of the current tool."""
        self._estimates[self.now.tool] = estimates

    @property
    def left(self) -> tuple[ToolStepState, ...]:
        """The tools after this one."""
        names = [turn.tool for turn in self._turns]
        return self._turns[names.index(self.tool) + 1 :]

    @property
    def tool(self) -> str:
        """Name of the current tool; empty where the cell has one tool."""
        return self.now.tool

    @property
    def terms(self) -> Mapping[str, Any] | None:
        """Terms to which the estimates of the current tool belong."""
        return self.now.terms or self._journal.terms

    def to_solve(self) -> list[ToolProblem]:
        """Return this tool and those after it, each with its next program and its estimates."""
        left = (self.now, *self.left)
        return [ToolProblem(turn.recipe, turn.program, self._estimates[turn.tool]) for turn in left]

    def of(self, record: PassRecord) -> ToolStepState:
        """Return the tool of a pass, with its program."""
        found = next((turn for turn in self._turns if turn.tool == tool_of(record.facts)), self._turns[0])
        turn = program_turn_of(record.facts)
        return found if turn is None else found.of_pass(turn.number - 1)

    def take(self) -> None:
        """Make tool and program of the next pass the current ones. An interrupted pass is repeated with the same."""
        passes = self._journal.passes
        step = self._turns[current_step(self._turns, passes)]
        self.now = step.of_pass(sum(one.how == "done" and tool_of(one.facts) == step.tool for one in passes))

    def take_of(self, record: PassRecord) -> None:
        """Make tool and program of that pass the current ones."""
        self.now = self.of(record)

    async def load(self) -> tuple[str, ...]:
        """Load the estimates of each tool from the job's passes or from its series; return notes on the latter."""
        notes = []
        for turn in self._turns:
            known = estimates_of(turn, self._journal.passes)
            if known is None:
                terms = turn.terms or self._journal.terms
                found = await asyncio.to_thread(from_journal.initial_estimates_of, self._journal, turn.recipe, terms)
                known = None if found is None else found.estimates
                notes += [] if found is None else [f"{turn.tool} {found.note}".lstrip()]
            if known is not None:
                self._estimates[turn.tool] = known
        return tuple(notes)


def current_step(turns: Sequence[ToolStepState], passes: Sequence[PassRecord]) -> int:
    """Return the number of the tool of the next pass. An interrupted pass is repeated with its tool."""
    done, upto = sum(record.how == "done" for record in passes), 0
    for number, turn in enumerate(turns):
        upto += 1 if turn.recipe.turn is None else turn.recipe.turn.passes
        if done < upto:
            return number
    return len(turns) - 1


def tool_of(facts: Mapping[str, Any]) -> str:
    """Return the tool in a pass's facts; empty where the cell has one tool."""
    return str(facts.get("tool", ""))


def program_turn_of(facts: Mapping[str, Any]) -> ProgramTurn | None:
    """Return the program in a pass's facts; None where its tool has one."""
    found = facts.get("program")
    return None if found is None else ProgramTurn(**found)


def estimates_of(turn: ToolStepState, passes: Sequence[PassRecord]) -> EstimatesInUse | None:
    """Return the estimates after the last pass of the job with that tool; None where there was none."""
    for record in reversed(passes):
        if tool_of(record.facts) == turn.tool:
            taught = record.facts.get("taught")
            return EstimatesInUse.load(taught["believed"] if taught else record.facts, turn.recipe.model.beliefs)
    return None


def mounted(journal: Journal) -> str:
    """Return the tool that was mounted last in this cell, by any job; empty where unknown. It reads the file."""
    sql = "SELECT data FROM event WHERE name = ? ORDER BY id DESC LIMIT 1"
    found = journal.store.read(sql, (ToolMounted.name,))
    return str(json.loads(found[0][0])["tool"]) if found else ""
