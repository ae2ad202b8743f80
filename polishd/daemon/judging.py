"""What follows a measurement, by what the journal knows of the job (`polishd.recipe.decisions`)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from polishd.daemon.journal import Journal
from polishd.model.finding import Finding
from polishd.recipe.decisions import Decision, decide
from polishd.recipe.recipe import Recipe
from polishd.recipe.records import MeasureResult, tolerated_nm


@dataclass(frozen=True, slots=True)
class StopCriteria:
    """Decisions of one job."""

    recipe: Recipe
    journal: Journal

    def decide(self, surface: MeasureResult, findings: Sequence[Finding], passes_left: int) -> Decision:
        """Decide what follows the last measurement of the journal."""
        torn = [record.cycle for record in self.journal.passes if record.how != "done"]
        since = max(torn, default=-1)  # a pass that was torn off leaves a step, which is nobody's divergence
        earlier = [tolerated_nm(record.stats) for record in self.journal.history[:-1] if record.cycle > since]
        return decide(self.recipe, earlier, surface, findings, passes_left)
