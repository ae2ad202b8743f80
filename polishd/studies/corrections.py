"""Every correction against two plants: the paper's simulation (section IV-D, Table IV), and effects that it omits.

A correction is the solver's model of the spot. The plant is the true spot: "eq49" is eq. 49 alone,
``R0 diag(gamma)``; "depth" has at each point the spot of that point's own depth.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from polishd.config.study import CorrectionsStudy
from polishd.model.dwell import OptimalityCertificate
from polishd.model.process import Correction
from polishd.model.surface import FloatArray
from polishd.process.dwell import newton_cg
from polishd.process.dwell.problem import DwellProblem
from polishd.process.dwell.quadratic import choose_piston_nm
from polishd.process.metrology.conditioning import ConditionedMap
from polishd.process.metrology.spectra import band_rms
from polishd.process.removal.convolution import ConvolutionEffect
from polishd.process.removal.dynamic_tif import CorrectedSpot, tif_at_point
from polishd.process.removal.effect import Effect
from polishd.studies.scene import ReadMap, Scene, make_scene, start_surface

PLANTS = ("eq49", "depth")
TIE = 2e-3
"""Two residuals tie if they differ by less than this share of the uncorrected one."""

ProgressReport = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class CorrectionRow:
    """One correction against one plant; figures over the clear aperture."""

    plant: str
    correction: str
    pv_nm: float
    rms_nm: float
    """About zero: the piston, a removal error common to all samples, counts."""
    rms_piston_removed_nm: float
    band_rms_nm: float
    """Of the periods above the study's ``lsf_period_mm``."""
    dwell_s: float
    wall_s: float
    """CPU time to make the solver's model and to solve."""
    residual_nm: FloatArray = field(repr=False)
    """(ny, nx) residual, NaN outside the aperture."""


@dataclass(frozen=True, slots=True)
class CorrectionComparison:
    """All rows of a study, and the data of its tables and pictures."""

    scene: Scene
    start: ConditionedMap
    rows: tuple[CorrectionRow, ...]
    time_s: Mapping[str, FloatArray]
    """(n,) dwell by correction."""
    notes: tuple[str, ...]

    def row(self, plant: str, correction: str) -> CorrectionRow:
        """Return that row."""
        return next(row for row in self.rows if (row.plant, row.correction) == (plant, correction))

    def ratio(self, plant: str, correction: str) -> float:
        """Return its RMS, piston kept, over the uncorrected one's."""
        return self.row(plant, correction).rms_nm / self.row(plant, "none").rms_nm


def compare_corrections(
    study: CorrectionsStudy, read: ReadMap, report_progress: ProgressReport
) -> CorrectionComparison:
    """Solve each correction once, and let both plants remove with its dwell. ConfigError for invalid input."""
    report_progress("compliance along the path")
    scene, start = make_scene(study), start_surface(study, read)
    target = removal_wanted(start, study.solve.unreachable)
    notes = [*scene.notes, f"mean target removal: {target[start.metric_mask].mean():.2f} nm"]
    spots = believed_spots(scene, study.process.depth_exponent)
    dwell, wall = {}, {}
    for correction, spot in spots.items():
        report_progress(f"solving: {correction}")
        begin = time.perf_counter()
        effect = solver_model(scene, correction, spot)
        with study.blame("solve"):
            solution = newton_cg.solve(
                dwell_problem(study, effect, start, target), study.solve.cpu_limit_s, study.solve.kkt_tolerance
            )
        dwell[correction] = solution.time_s if spot.divide_by is None else solution.time_s / spot.divide_by
        wall[correction] = time.perf_counter() - begin
        notes += [f"{correction}: {words}" for words in solver_notes(effect, solution.certificate)]
    report_progress("removing with both plants")
    plants = {"eq49": scene.effect(spots["linear"]), "depth": scene.effect(spots["exact"])}
    rows = [
        make_row(
            target - effect.removal_nm(time_s),
            start,
            study.lsf_period_mm,
            plant=plant,
            correction=name,
            dwell_s=float(time_s.sum()),
            wall_s=wall[name],
        )
        for plant, effect in plants.items()
        for name, time_s in dwell.items()
    ]
    return CorrectionComparison(scene, start, tuple(rows), dwell, tuple(notes))


def believed_spots(scene: Scene, exponent: float) -> dict[str, CorrectedSpot]:
    """Return each correction's model of the spot; "calibrated" takes the spot at the mean pose for all points."""
    gamma = scene.gamma
    calibrated = tif_at_point("none", gamma, reference=float(gamma.mean()))
    corrected: list[Correction] = ["pointwise", "linear", "power", "exact"]
    spots: dict[str, CorrectedSpot] = {name: tif_at_point(name, gamma, exponent) for name in corrected}
    return {"none": tif_at_point("none", gamma), "calibrated": calibrated, **spots}


def solver_model(scene: Scene, correction: str, spot: CorrectedSpot) -> Effect:
    """Return the solver's effect; "exact" is a sum of convolutions where points are nodes, not the plant's matrix."""
    if correction == "exact" and scene.on_nodes:
        return scene.convolutions(scene.grid, scene.on_part(spot)[0])
    return scene.effect(spot)


def removal_wanted(start: ConditionedMap, unreachable: float) -> FloatArray:
    """(ny, nx) nm: the surface, raised until no material is missing; 0 outside the aperture."""
    piston = choose_piston_nm(start.height_nm, start.solve_mask, np.zeros(start.grid.shape), unreachable)
    return np.where(start.solve_mask, start.height_nm + piston, 0.0)


def dwell_problem(
    study: CorrectionsStudy, effect: Effect, start: ConditionedMap, target_nm: FloatArray
) -> DwellProblem:
    """Eq. 50 with ``t >= 0`` and no upper bound."""
    return DwellProblem(
        effect=effect,
        target_nm=target_nm,
        solve_mask=start.solve_mask,
        metric_mask=start.metric_mask,
        lower_s=np.zeros(effect.n),
        upper_s=np.full(effect.n, np.inf),
        regularisation=study.solve.regularisation_nm2_s2,
    )


def solver_notes(effect: Effect, certificate: OptimalityCertificate) -> list[str]:
    """Return facts about a solution for the notes of the table."""
    found = []
    if isinstance(effect, ConvolutionEffect):
        found.append(
            f"the solver's model is a sum of {effect.rank} convolutions, truncated to {effect.truncation:.1e} of a "
            "spot; the plant is the direct matrix"
        )
    if certificate.stopped != "converged":
        found.append(f"stopped at the {certificate.stopped}, KKT residual {certificate.kkt_residual:.1e}: no minimum")
    return found


def make_row(residual_nm: FloatArray, start: ConditionedMap, lsf_period_mm: float, **named: Any) -> CorrectionRow:
    """Return the figures of a (ny, nx) residual; ``named`` are the row's other fields."""
    inside = residual_nm[start.metric_mask]
    return CorrectionRow(
        **named,
        pv_nm=float(np.ptp(inside)),
        rms_nm=float(np.sqrt(np.mean(inside**2))),
        rms_piston_removed_nm=float(inside.std()),
        band_rms_nm=band_rms(residual_nm, start.metric_mask, start.grid.pitch_mm, lsf_period_mm),
        residual_nm=np.where(start.solve_mask, residual_nm, np.nan),
    )


def tie_words(compared: CorrectionComparison) -> list[str]:
    """Say where pointwise and linear tie, and why, one sentence for each plant."""
    words = []
    for plant in PLANTS:
        pointwise, linear = compared.row(plant, "pointwise").rms_nm, compared.row(plant, "linear").rms_nm
        tied = abs(pointwise - linear) <= TIE * compared.row(plant, "none").rms_nm
        figures = f"{pointwise:.3g} and {linear:.3g} nm RMS"
        if plant == "eq49":
            says = "tie, as they must" if tied else "do not tie, although they must: the solver stopped early"
            words.append(f"plant eq49: pointwise and linear {says} ({figures}): R0 diag(gamma) (t/gamma) = R0 t")
        else:
            says = "tie here too" if tied else "differ"
            words.append(f"plant depth: pointwise and linear {says} ({figures}): both take the removal to go as gamma")
    return words


# Figures printed in the paper, for the tables: Li, Cheng, Fan, Pang.

TABLE_IV: dict[str, tuple[float, float]] = {"none": (16.81, 5.62), "pointwise": (8.91, 4.95), "linear": (6.57, 1.93)}
"""Reconstruction error by correction, PV and RMS in nm: without compensation, with ref. 17, with its own method."""

TABLE_IV_RATIO = 0.343
"""Its own RMS over that without compensation."""

DIVERGENCE_BASE = 2.0
"""Base of the logarithm in our Jensen-Shannon divergences; the paper states none."""
