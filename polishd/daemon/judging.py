"""Whether a job is over, by what was measured and what is expected."""

from __future__ import annotations

from dataclasses import dataclass

from polishd.daemon.journal import Journal
from polishd.model.cycle import Outcome
from polishd.model.dwell import AS_PROGRAMMED
from polishd.model.finding import Finding
from polishd.model.tolerance import holds
from polishd.process.findings import diverged, worthless
from polishd.process.forecast import Forecast
from polishd.recipe.recipe import Recipe
from polishd.recipe.records import Measured, tolerated_nm


@dataclass(frozen=True, slots=True)
class Judging:
    """A job's. What is polished as programmed, to teach, is over when its passes are made, and not before."""

    recipe: Recipe
    journal: Journal

    @property
    def corrects(self) -> bool:
        """Whether its passes are to correct the surface."""
        return self.recipe.dwell.choose != AS_PROGRAMMED

    @property
    def used_up(self) -> Outcome:
        """How it ends when all its passes are used."""
        return Outcome.CYCLES_USED if self.corrects else Outcome.AS_PROGRAMMED

    def accepts(self, surface: Measured) -> bool:
        """Whether all lines of the tolerance hold."""
        return self.corrects and holds(surface.judged)

    def diverges(self, surface: Measured) -> bool:
        """Whether the surface is clearly worse than it has been."""
        torn = [record.cycle for record in self.journal.passes if record.how != "done"]
        since = max(torn, default=-1)  # a pass that was torn off leaves a step, which is nobody's divergence
        earlier = [tolerated_nm(record.stats) for record in self.journal.history[:-1] if record.cycle > since]
        return self.corrects and diverged(earlier, surface.figure_nm)

    def worthless(self, expected: Forecast | None) -> Finding | None:
        """Why a pass will hardly leave the surface better than it is; nobody makes it then."""
        if expected is None or not self.corrects:
            return None
        return worthless(expected, self.recipe.finding)
