"""The recipe of a job: the complete, picklable input of the computing steps, made once from config and plugins."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

from polishd.config.cell_sections import DwellSection, JobSection, PartSection, ProgramSection
from polishd.config.tolerance import lines_of
from polishd.hookspecs import DwellSolver, ProgramFormat, RemovalModel
from polishd.model.estimates import FindingLimits
from polishd.model.instrument import Instrument
from polishd.model.outline import Outline
from polishd.model.part_handling import NOTHING, BetweenPasses, TouchOff
from polishd.model.process import ComplianceOptions, Correction, MeasuredTif, Optic, Placement, RobotModel, ToolProcess
from polishd.model.program import Envelope
from polishd.model.surface import SurfaceMap
from polishd.model.tolerance import Accept, ToleranceLine
from polishd.process.metrology.absolute_test import SystemMap
from polishd.process.removal.ripple import MODELLED, PathErrors

DEFAULT = FindingLimits()


@dataclass(frozen=True, slots=True)
class ToolStep:
    """The position of a tool in the sequence."""

    tool: str
    passes: int
    change_s: float
    """Machine time of the change to this tool."""


@dataclass(frozen=True, slots=True)
class Recipe:
    """One part, process, robot and solver: sections of the config, and objects made from them."""

    part: PartSection
    outline: Outline
    """Outline of the part, about its center."""
    program: ProgramSection
    dwell: DwellSection
    job: JobSection
    instrument: Instrument | None
    """Profile of the instrument of the maps; None: the maps must state everything."""
    spike_threshold_mad: float
    nominal: SurfaceMap | None
    """Nominal form in the part's frame; None: flat, or the form of the interferometer's null."""
    grid_mm: float
    process: ToolProcess
    robot: RobotModel
    placement: Placement
    options: ComplianceOptions
    optic: Optic
    tif: MeasuredTif | None
    correction: Correction
    envelope: Envelope
    max_rate_change: float
    format: ProgramFormat
    model: RemovalModel
    solver: DwellSolver
    cross_check: DwellSolver | None
    finding: FindingLimits = DEFAULT
    ripple_errors: PathErrors = MODELLED
    """Errors that the forecast of ripple counts with."""
    tolerance: tuple[ToleranceLine, ...] = ()
    """Lines of the drawing, where the job has no short form."""
    remembers: bool = False
    """A job begins with the estimates of the last job of its series."""
    touch_off: TouchOff | None = None
    """Proof of the part's seat; None: no proof."""
    part_handling: BetweenPasses = NOTHING
    turn: ToolStep | None = None
    """Tool of the recipe; None where the cell has one tool."""
    system: SystemMap | None = None
    """The instrument's own error, subtracted from each map; None: unknown."""

    @property
    def accept(self) -> Accept:
        """Acceptance rule of an RMS. The default is the bound where the instrument's error is known."""
        if self.job.accept_by is not None:
            return self.job.accept_by
        known = self.system is not None and self.part.alignment != "piston"
        return "bound" if known else "figure"

    @property
    def lines(self) -> tuple[ToleranceLine, ...]:
        """Lines of the tolerance: a part is accepted when all of them hold."""
        return lines_of(self.job, self.tolerance)

    def facts(self) -> dict[str, Any]:
        """Facts for a summary."""
        job = self.job.model_dump(include={"tolerance_nm", "tolerance_period_mm", "lsf_period_mm"})
        lines = [{"what": line.what, "unit": line.unit, **asdict(line)} for line in self.lines]
        return {
            "part_id": self.part.id,
            "outline": str(self.outline),
            "correction": self.correction,
            **job,
            "tolerance": lines,
            "accept": self.accept,
        }


# Time limit of a computing step.


class CpuLimit(NamedTuple):
    """CPU seconds, and the config key that raises the limit."""

    within_s: float
    key: str = ""
