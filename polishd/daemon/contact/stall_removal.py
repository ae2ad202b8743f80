"""Cost of late reports of the robot: removal where it stands, and uncertainty of the end of a block."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from polishd.config.cell import CellConfig
from polishd.daemon.cell.cell import Cell
from polishd.daemon.cell.time_limits import ActionTimeLimit, TimeLimits, late_s
from polishd.daemon.contact.progress import MOST_OVERHEAD_S
from polishd.model.dwell import AS_PROGRAMMED
from polishd.model.program import Plan, Program
from polishd.pipeline.recipe import Recipe
from polishd.pipeline.steps import envelope_of, in_part_frame
from polishd.process.removal.excess import ExcessMap
from polishd.process.removal.measured_tif import SpotFigures, measured_figures, spot_figures
from polishd.process.robot.motion import delivered_time_s, least_time_s

NO_TOLERANCE_NM = 10.0
"""Tolerance to assume where no line of the tolerance is in nm."""
TENTH = 0.1
"""Default limit of excess removal, as a share of the removal planned at the point."""


@dataclass(frozen=True, slots=True)
class StallRemoval:
    """Removal by a robot that stands in contact while it reports that it runs."""

    notice_s: float
    """Longest from the standstill until contact is left: a block's expected time, the report's age, two looks, and
    ``first_s``."""
    first_s: float
    """Part of it for the overhead of a point, which a first pass does not know yet."""
    release_s: float
    """Longest from then until the force is off."""
    rate_nm_s: float
    """Removal rate at the peak of the spot."""

    @property
    def removal_nm(self) -> float:
        """Depth of the pit, at most."""
        return self.rate_nm_s * (self.notice_s + self.release_s)

    def facts(self) -> dict[str, float]:
        """JSON-ready."""
        return {**asdict(self), "removal_nm": self.removal_nm}

    def row(self) -> dict[str, Any]:
        """Row of the time-limit table."""
        off_s = self.notice_s + self.release_s
        what = f"standstill of the robot detected{self._first()}; force off after {off_s:.2f} s, "
        return ActionTimeLimit("", f"{what}removal {self.removal_nm:.0f} nm at most", round(self.notice_s, 3)).row()

    def warning(self, tolerance_nm: float | None) -> str:
        """Return the warning of a pit deeper than half of the tolerance; empty if it is not deeper."""
        if tolerance_nm is None or self.removal_nm <= tolerance_nm / 2:
            return ""
        return (
            f"A robot that stands in contact removes up to {self.removal_nm:.0f} nm before the force is off, more than "
            f"half of the tolerance of {tolerance_nm:g} nm: detection takes {self.notice_s:.2f} s{self._first()}, "
            f"force off {self.release_s:g} s more, at {self.rate_nm_s:.0f} nm/s. Use shorter blocks, less force, a "
            "controller that reports faster or an actuator that releases faster."
        )

    def _first(self) -> str:
        return f" ({self.first_s:g} s of it only in a first pass, for the overhead of a point)"


def stall_removal(
    limits: TimeLimits, recipe: Recipe, program: Program, no_progress_s: float | None = None
) -> StallRemoval:
    """Return the bound for the program with its own times; ``no_progress_s`` replaces the derived one.

    The dwell time at a point does not count as standstill: the tool has to stand there.
    """
    expected_s = delivered_time_s(program, program.time_s, envelope_of(recipe, program))
    moving_s = expected_s - program.time_s if program.encoding == "dwell" else expected_s
    block_s = float(moving_s.max(initial=0.0))
    extra_s = limits.no_progress_s if no_progress_s is None else no_progress_s
    first_s = MOST_OVERHEAD_S
    notice_s = block_s + first_s + late_s(block_s + first_s) + extra_s
    return StallRemoval(notice_s, first_s, limits.actuator.release_s, peak_nm_s(recipe))


def tolerance_nm(recipe: Recipe) -> float | None:
    """Return the tightest limit in nm of the tolerance, or None where no line is in nm."""
    return min((line.limit for line in recipe.lines if line.unit == "nm"), default=None)


def require_stall_depth(config: CellConfig, cell: Cell, recipe: Recipe) -> str:
    """Return the depth of the pit in words; empty if the robot reports at once.

    ConfigError beyond ``limits.max_stall_removal_nm``.
    """
    robot, actuator = cell.limits.robot, cell.limits.actuator
    if not robot.unseen_stop_s:
        return ""
    stands_s = robot.unseen_stop_s + actuator.release_s
    rate_nm_s = peak_nm_s(recipe)
    depth = (
        f"{rate_nm_s * stands_s:.1f} nm at most: {1e3 * robot.unseen_stop_s:.0f} ms until the robot reports it, "
        f"{1e3 * actuator.release_s:.0f} ms until the force is off, at {rate_nm_s:.0f} nm/s"
    )
    if rate_nm_s * stands_s > config.limits.max_stall_removal_nm:
        raise config.error(
            "limits.max_stall_removal_nm",
            f"a feed hold at the controller would dig {depth}; the limit is {config.limits.max_stall_removal_nm:g} nm. "
            "Make the controller report faster, set actuator.release_s to the measured time, or connect the "
            "controller's signal 'in motion' to the actuator (in_motion_wired in its profile)",
        )
    return depth


def require_held_motion(config: CellConfig, cell: Cell, recipe: Recipe, program: Program) -> str:
    """Return the motion that a robot with few instructions holds, in words; empty for any other robot.

    ConfigError if a plan of this program could hold less than the lift of the tool takes.
    """
    envelope, as_programmed = envelope_of(recipe, program), recipe.dwell.objective == AS_PROGRAMMED
    least_s = np.maximum(least_time_s(program, envelope), recipe.envelope.least_point_s)
    if as_programmed:
        least_s = delivered_time_s(program, program.time_s, envelope)
    limit = cell.limits.held_motion(program.encoding, least_s)
    if limit is None:
        return ""
    if not limit.holds:
        needed_s = round_up(limit.least_s / cell.limits.held_points(program.encoding))
        remedy = (
            f"Have it posted with points of {needed_s:g} s or more (a first touch: set machine.least_point_s to that)"
            if as_programmed
            else f"Set machine.least_point_s to {needed_s:g} or more"
        )
        raise config.error(
            limit.key,
            f"{limit.what} of {program.name} may take only {limit.seconds:.3f} s; {limit.least_s:.3f} s are needed to "
            f"lift the tool if the actuator stops answering. {remedy}, or reduce the actuator's watchdog or its "
            "retract_s.",
        )
    return f"at least {limit.seconds:.2f} s in {cell.limits.robot.held_instructions} instructions; {limit.because}"


def round_up(seconds: float) -> float:
    """Return the time in whole ms, not below it."""
    return math.ceil(1e3 * seconds - 1e-6) / 1e3


def timing_uncertainty_s(cell: Cell, recipe: Recipe) -> str:
    """Return the uncertainty of the end of a block, in time and removal; empty if the robot reports it exactly."""
    end_s = cell.limits.robot.block_end_s
    return f"{1e3 * end_s:.0f} ms rms, {peak_nm_s(recipe) * end_s:.1f} nm; it does not add up" if end_s else ""


def peak_nm_s(recipe: Recipe) -> float:
    """Return the removal rate of a standing tool at the peak of its spot, nm/s."""
    return _spot(recipe).peak_nm_s


def _spot(recipe: Recipe) -> SpotFigures:
    tif, process = recipe.tif, recipe.process
    return spot_figures(process) if tif is None else measured_figures(tif, process)


def excess_map(recipe: Recipe, plan: Plan, most_nm: float | None) -> ExcessMap:
    """Return the limits of excess removal for that plan: ``most_nm``, or from tolerance and plan."""
    share = TENTH if most_nm is None else 0.0
    return ExcessMap(
        in_part_frame(recipe, plan.program),
        plan.expected_time_s,
        _spot(recipe),
        floor_nm=(tolerance_nm(recipe) or NO_TOLERANCE_NM) / 2 if most_nm is None else most_nm,
        share=share,
        on_part=recipe.outline.contains,
    )
