"""The recipe of a job: all that the computing steps need, picklable, made once from the config and the plugins."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from polishd.hookspecs import DwellSolver, ProgramFormat, RemovalModel
from polishd.model.dwell import Choice
from polishd.model.instrument import Instrument
from polishd.model.limits import Envelope
from polishd.model.process import ComplianceOptions, Correction, MeasuredTif, Optic, Placement, ToolProcess
from polishd.model.robot import RobotModel
from polishd.model.surface import SurfaceMap
from polishd.process.edge.extension import Extension
from polishd.process.metrics import Removal


@dataclass(frozen=True, slots=True)
class Recipe:
    """One part, one process, one robot, one way of solving."""

    part_id: str
    instrument: Instrument | None
    """The profile of the instrument that the maps come from; None: maps must say everything themselves."""
    aperture_mm: float
    edge_mm: float
    free_rim: bool
    extension: Extension | Literal["none"]
    alignment: Removal
    """What of a map is alignment, and not figure."""
    nominal: SurfaceMap | None
    """The form wanted, in the part's frame; None: a flat, or what the interferometer's null makes one."""
    spike_mads: float
    """How far off the surface a sample is a spike; 0: none is looked for."""
    grid_mm: float
    program_offset_mm: tuple[float, float, float]
    program_rotation_deg: float
    process: ToolProcess
    robot: RobotModel
    placement: Placement
    options: ComplianceOptions
    optic: Optic
    tif: MeasuredTif | None
    correction: Correction
    envelope: Envelope
    format: ProgramFormat
    model: RemovalModel
    solver: DwellSolver
    cross_check: DwellSolver | None
    cross_check_gap: float
    regularisation: float
    """rho = P N_r / sigma_max^2."""
    solve_s: float
    choose: Choice
    """The least residual, or a point of the residual-against-time curve: `model.dwell.Choice`."""
    budget_s: float
    """Most time in contact, where that is chosen."""
    target_nm: float
    """Predicted RMS to reach, where that is chosen."""
    curve: bool
    """Whether each plan comes with its curve of residual against time."""
    kkt_tolerance: float
    tolerance_nm: float
    tolerance_period_mm: float
    lsf_period_mm: float
    max_rate_change: float

    def facts(self) -> dict[str, Any]:
        """What a summary says of it."""
        names = ("part_id", "correction", "tolerance_nm", "tolerance_period_mm", "lsf_period_mm")
        return {name: getattr(self, name) for name in names}
