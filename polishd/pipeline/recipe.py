"""The recipe of a job: all that the computing steps need, picklable, made once from the config and the plugins."""

from __future__ import annotations

from dataclasses import dataclass
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
from polishd.process.metrology.system_map import SystemMap

DEFAULT = FindingLimits()


@dataclass(frozen=True, slots=True)
class ToolStep:
    """A tool's turn among several."""

    tool: str
    passes: int
    change_s: float
    """Machine time that it takes to change to it."""


@dataclass(frozen=True, slots=True)
class Recipe:
    """One part, one process, one robot, one way of solving: sections of the config, and what is made of the others."""

    part: PartSection
    outline: Outline
    """Of the part, about its centre."""
    program: ProgramSection
    dwell: DwellSection
    job: JobSection
    instrument: Instrument | None
    """The profile of the instrument that the maps come from; None: maps must say everything themselves."""
    spike_mads: float
    nominal: SurfaceMap | None
    """The form wanted, in the part's frame; None: a flat, or what the interferometer's null makes one."""
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
    tolerance: tuple[ToleranceLine, ...] = ()
    """The drawing's lines, where the job has no short form."""
    remembers: bool = False
    """A job begins with the estimates of the last job of its series."""
    touch_off: TouchOff | None = None
    """Proof of the part's seat; None: no proof."""
    between: BetweenPasses = NOTHING
    turn: ToolStep | None = None
    """Of the tool that it is for; None where the cell has one tool."""
    system: SystemMap | None = None
    """The instrument's own error, subtracted from each map; None: unknown."""

    @property
    def accept(self) -> Accept:
        """By what an RMS is accepted. Without a word of the job by the bound only where something is known for it."""
        if self.job.accept is not None:
            return self.job.accept
        known = self.system is not None and self.part.alignment != "piston"
        return "bound" if known else "figure"

    @property
    def lines(self) -> tuple[ToleranceLine, ...]:
        """What the part is judged by: it is accepted when all of them hold."""
        return lines_of(self.job, self.tolerance)

    def facts(self) -> dict[str, Any]:
        """What a summary says of it."""
        job = self.job.model_dump(include={"tolerance_nm", "tolerance_period_mm", "lsf_period_mm"})
        lines = [{"what": line.what, "limit": line.limit, "unit": line.unit} for line in self.lines]
        return {
            "part_id": self.part.id,
            "outline": str(self.outline),
            "correction": self.correction,
            **job,
            "tolerance": lines,
            "accept": self.accept,
        }


# How long a computing step may take.


class CpuLimit(NamedTuple):
    """So many CPU seconds, and which key of the config gives more."""

    within_s: float
    key: str = ""
