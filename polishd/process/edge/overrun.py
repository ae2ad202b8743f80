"""How far dwell points must go beyond the rim, and what of the removal that costs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polishd.model.errors import ComputeError
from polishd.model.program import Program
from polishd.model.surface import BoolArray, FloatArray
from polishd.process.dynamic_tif import lean_azimuth_rad
from polishd.process.edge.rim import Rim
from polishd.process.effect import Effect
from polishd.process.robot.refusal import refuse_where
from polishd.process.spot import Spot

RATIOS = 65
"""Depth ratios at which a spot's volume is taken; between them it is interpolated."""


@dataclass(frozen=True, slots=True)
class Overrun:
    """Dwell beyond a part's rim."""

    wanted_mm: float
    """How far beyond the rim points still touch the part: half the spot's width, and its offset."""
    reached_mm: float
    """How far beyond it the program's farthest timed point lies; negative: on the part."""
    off_part: float
    """Share of all the removal that falls beside the part."""
    idle_s: float
    """Time spent where the spot does not touch the part at all."""
    total_s: float


def wanted_overrun_mm(spot: Spot, depth_ratio: FloatArray, azimuth_rad: FloatArray) -> float:
    """How far beyond the rim dwell points are of use, at most; farther out they do not touch the part.

    With less the rim is worked from one side only. ``depth_ratio`` and ``azimuth_rad`` (n,) of the points.
    """
    offset = np.linalg.norm(spot.offset_mm(depth_ratio, azimuth_rad), axis=1)
    return float((spot.half_width_mm(depth_ratio) + offset).max(initial=0.0))


def overrun(
    effect: Effect,
    part: BoolArray,
    time_s: FloatArray,
    *,
    program: Program,
    spot: Spot,
    depth_ratio: FloatArray,
    factor: FloatArray,
    rim: Rim,
) -> Overrun:
    """Figures of the dwell beyond the rim.

    Args:
        effect: as built from program, spot, depth ratio and factor.
        part: (ny, nx) samples of its grid that are part; the share off the part is right as far as their cells are.
        time_s: (n,) dwell.
        program: the path in the part's frame.
        spot: the spot.
        depth_ratio: (n,) as of `corrected_spot` (at a free rim: of `rim_contact`).
        factor: (n,) on the removal.
        rim: the part's.

    Raises:
        ComputeError: times that are negative, not finite or all 0, or masks and times of another shape.
    """
    if part.shape != effect.grid.shape or time_s.shape != (effect.n,) or program.n != effect.n:
        raise ComputeError(
            f"the part's mask is {part.shape} and the dwell {time_s.shape}: the effect is of {effect.grid.shape} "
            f"samples and {effect.n} points, the program of {program.n}"
        )
    refuse_where(~((time_s >= 0) & np.isfinite(time_s)), time_s, "the dwell", "s", "it must be finite and not negative")
    on_part = effect.adjoint(part.astype(np.float64)) * effect.grid.pitch_mm**2
    whole = _volume(spot, depth_ratio) * factor
    total = float(whole @ time_s)
    if not total > 0:
        raise ComputeError("the dwell removes nothing: there is no overrun to state")
    return Overrun(
        wanted_mm=wanted_overrun_mm(spot, depth_ratio, lean_azimuth_rad(program)),
        reached_mm=float(-min(rim.inside_mm(at[:, :2]).min() for at in (program.start_mm, program.end_mm))),
        off_part=max(0.0, 1 - float(on_part @ time_s) / total),
        idle_s=float(time_s[on_part <= 0].sum()),
        total_s=float(time_s.sum()),
    )


def _volume(spot: Spot, depth_ratio: FloatArray) -> FloatArray:
    """(n,) whole volume rate, nm mm^2/s: it goes with the depth, and not with the azimuth."""
    mesh = np.linspace(depth_ratio.min(), depth_ratio.max(), RATIOS)
    volume = spot.patch(mesh, np.zeros(RATIOS)).sum(axis=(1, 2))
    return np.asarray(np.interp(depth_ratio, mesh, volume), dtype=np.float64)
