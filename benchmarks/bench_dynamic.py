"""Residual of an exact dynamic plan from 200 nm RMS, and the loss by a machine: noise, motion, a wrong stiffness.

The plan knows each block's own depth ratio gamma, 0.70 to 0.95 over the part (paper eq. 44-49), and the plant has each
block's own contact, too. Beside it stand plans with one spot for all, and with the paper's eq. 49.

A row is the RMS of the residual in the clear aperture, its mean removed; where the mean is not small, it has a row.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from benchmarks.bench_dwell import path
from benchmarks.harness import Progress, Row
from polishd.model.dwell import WarmStart
from polishd.model.process import ToolProcess
from polishd.model.program import Envelope
from polishd.model.surface import BoolArray, FloatArray, Grid
from polishd.process.dwell import newton_cg
from polishd.process.dwell.problem import DwellProblem
from polishd.process.dwell.quadratic import choose_piston_nm, regularisation_from_rho
from polishd.process.removal.dynamic_tif import CorrectedSpot, effect_matrix, tif_at_point
from polishd.process.removal.effect import SparseEffect
from polishd.process.removal.tif import HertzSpot
from polishd.process.robot import motion
from polishd.process.toolpath.apertures import circle
from polishd.process.toolpath.paths import raster
from polishd.studies.scene import random_waves

DIAMETER_MM, EDGE_MM, OVER_MM, PITCH_MM = 100.0, 3.0, 3.0, 0.5
LINES_MM, BLOCK_MM = 0.5, 1.0
RMS_NM, PERIOD_MM, SEED = 200.0, (30.0, 120.0), 3
"""As the shipped study's (examples/table_iv.toml), eleven times as high."""
GAMMA = 0.70, 0.95
RHO = 1e-5
NOISE_NM = 0.3, 1.0
"""Noise of a sample of the measured map."""
CLASS_NM = {"ion beam, published": 0.6}
FINER = 2
ROUNDS = 2
"""Re-solves with the delay by acceleration as the lower bound, as in a cell."""
MEAN = 0.1
"""Means above this share of the RMS have a row."""
MACHINE = Envelope(
    x_mm=(-1e3, 1e3), y_mm=(-1e3, 1e3), z_mm=(-1e3, 1e3), max_feed_mm_s=50.0, min_feed_mm_s=0.5, accel_mm_s2=800.0,
    block_overhead_s=0.0, corner_deg=30.0, max_pass_s=1e9, max_removal_nm=1e9,
)  # fmt: skip
"""Motion of the shipped cell; its simulated machine takes 5 ms more for each block."""
OVERHEAD_S = 0.005


@dataclass(frozen=True)
class Plan:
    """A dwell, and its predicted removal."""

    time_s: FloatArray
    target_nm: FloatArray


class Part:
    """A disc, its raster, and the plant, whose blocks each have their own depth."""

    def __init__(self) -> None:
        n = int((DIAMETER_MM + 12.0) / PITCH_MM) + 1
        self.grid = Grid(n, n, PITCH_MM)
        self.solve, self.clear = (self.grid.radius_mm() <= DIAMETER_MM / 2 - edge for edge in (0.0, EDGE_MM))
        self.program = path(raster(circle(DIAMETER_MM + 2 * OVER_MM), LINES_MM, BLOCK_MM))
        x, y = ((self.program.start_mm + self.program.end_mm) / 2)[:, :2].T
        self.gamma = np.mean(GAMMA) + np.ptp(GAMMA) / 2 * np.sin(np.pi * (x + 0.6 * y) / 90)
        self.spot = HertzSpot(ToolProcess())
        drawn = random_waves(self.grid, PERIOD_MM, SEED)
        self._level = float(drawn[self.clear].mean()), RMS_NM / float(drawn[self.clear].std())

    def height_nm(self, grid: Grid) -> FloatArray:
        """(ny, nx) the surface, on any grid."""
        mean, scale = self._level
        return (random_waves(grid, PERIOD_MM, SEED) - mean) * scale

    def effect(self, spots: CorrectedSpot, grid: Grid | None = None) -> SparseEffect:
        grid = grid or self.grid
        return SparseEffect(grid, effect_matrix(grid, self.spot, self.program, spots.depth_ratio, spots.factor))

    def softer(self, stiffness: float) -> FloatArray:
        """(n,) gamma of the robot with that share of its stiffness: paper eq. 44 and 48, ``1 - gamma`` as 1 / it."""
        return np.asarray(1 - (1 - self.gamma) / stiffness, dtype=np.float64)

    def exact(self, gamma: FloatArray) -> SparseEffect:
        return self.effect(tif_at_point("exact", gamma))

    @cached_property
    def model(self) -> SparseEffect:
        return self.exact(self.gamma)

    @cached_property
    def lower_s(self) -> FloatArray:
        """Dwell at the largest feed, without acceleration."""
        return np.asarray(self.program.length_mm / MACHINE.max_feed_mm_s, dtype=np.float64)

    def plan(self, height_nm: FloatArray, effect: SparseEffect | None = None) -> Plan:
        """Return the plan of the least residual at no more than the largest feed."""
        return self._solved(height_nm, effect or self.model, self.lower_s, None)

    def plan_for_machine(self, height_nm: FloatArray) -> Plan:
        """Return the same plan; the delay by acceleration is the next round's lower bound, as in a cell."""
        lower = np.maximum(self.lower_s, motion.least_time_s(self.program, MACHINE))
        plan = self._solved(height_nm, self.model, lower, None)
        for _ in range(ROUNDS):
            late = delivered(self, plan.time_s, MACHINE)
            lower = np.maximum(lower, np.where(late > plan.time_s * 1.001 + 1e-4, late, 0.0))
            plan = self._solved(height_nm, self.model, lower, WarmStart(plan.time_s, {}))
        return plan

    def _solved(self, height_nm: FloatArray, effect: SparseEffect, lower_s: FloatArray, warm: WarmStart | None) -> Plan:
        target = height_nm + choose_piston_nm(height_nm, self.solve, effect.removal_nm(lower_s))
        p = regularisation_from_rho(effect, self.solve, RHO)
        none = np.full(lower_s.size, np.inf)
        problem = DwellProblem(effect, target, self.solve, self.clear, lower_s, none, p, warm=warm)
        found = newton_cg.solve(problem, 600.0, 1e-6)
        if found.certificate.stopped != "converged":
            raise RuntimeError(f"a plan stopped at the {found.certificate.stopped}")
        return Plan(found.time_s, target)


def delivered(part: Part, time_s: FloatArray, machine: Envelope) -> FloatArray:
    """(n,) s of a dwell as the machine executes it."""
    return motion.delivered_time_s(part.program, time_s, machine)


def rows(progress: Progress) -> Iterator[Row]:
    """Rows of an exact plan, of the errors that a machine adds, and of plans with another model of the spot."""
    part = Part()
    progress("dynamic: the exact plan")
    height = part.height_nm(part.grid)
    exact = part.plan(height)
    yield from rows_of("exact, as predicted", left(part.model, exact), part.clear)
    yield from rows_of("exact, seen twice as finely", *finely(part, exact))
    yield from of_machine(part, height, exact, progress)
    yield from of_belief(part, height, progress)


def of_machine(part: Part, height: FloatArray, exact: Plan, progress: Progress) -> Iterator[Row]:
    """Rows of one error at a time, then of all."""
    rng = np.random.default_rng(SEED)
    noise = rng.standard_normal(part.grid.shape)
    for sigma in NOISE_NM:
        progress(f"dynamic: {sigma:g} nm of noise")
        noisy = part.plan(height + sigma * noise)
        residual = left(part.model, noisy) - sigma * noise
        yield from rows_of(f"exact, map noise of {sigma:g} nm a sample", residual, part.clear)
    late = replace(exact, time_s=delivered(part, exact.time_s, MACHINE))
    yield from rows_of("exact, acceleration that it does not know", left(part.model, late), part.clear)
    late = replace(exact, time_s=delivered(part, exact.time_s, replace(MACHINE, block_overhead_s=OVERHEAD_S)))
    yield from rows_of("the same, and 5 ms more a block", left(part.model, late), part.clear)
    progress("dynamic: acceleration")
    moved = part.plan_for_machine(height)
    moved = replace(moved, time_s=delivered(part, moved.time_s, MACHINE))
    yield from rows_of("exact, acceleration in the plan", left(part.model, moved), part.clear)
    for stiffness in (0.9, 1.1):
        plant = part.exact(part.softer(stiffness))
        yield from rows_of(f"exact, stiffness {stiffness:g} times what it takes", left(plant, exact), part.clear)
    progress("dynamic: all of them")
    soft, true = part.exact(part.softer(0.9)), height
    for number in ("one", "two", "three"):
        sigma = NOISE_NM[0]
        measured = sigma * rng.standard_normal(part.grid.shape)
        plan = part.plan_for_machine(true + measured)
        plan = replace(plan, time_s=delivered(part, plan.time_s, MACHINE))
        true = left(soft, plan) - measured
        all_of = f"all: noise {sigma:g} nm, acceleration in the plan, stiffness 0.9 times"
        yield from rows_of(f"{all_of}, after pass {number}", true, part.clear)
        true = true - true[part.clear].mean()


def of_belief(part: Part, height: FloatArray, progress: Progress) -> Iterator[Row]:
    """Rows of other models of the spot on the same plant."""
    mean = float(part.gamma.mean())
    static = tif_at_point("none", part.gamma)
    for name, spots in (
        ("static TIF, the rigid robot's", static),
        ("static TIF, of the mean pose", tif_at_point("none", part.gamma, reference=mean)),
        ("eq. 49 (linear)", tif_at_point("linear", part.gamma)),
        ("power 1.5", tif_at_point("power", part.gamma)),
    ):
        progress(f"dynamic: {name}")
        plan = part.plan(height, part.effect(spots))
        yield from rows_of(name, left(part.model, plan), part.clear)
        if spots is static:
            quotient = replace(plan, time_s=plan.time_s / part.gamma)
            yield from rows_of("static TIF, its dwell over gamma (pointwise)", left(part.model, quotient), part.clear)


def left(plant: SparseEffect, plan: Plan) -> FloatArray:
    """(ny, nx) nm."""
    return np.asarray(plan.target_nm - plant.removal_nm(plan.time_s))


def finely(part: Part, plan: Plan) -> tuple[FloatArray, BoolArray]:
    """Residual of the same dwell on samples FINER times as fine, and the clear aperture: it shows ripple."""
    grid = Grid(FINER * part.grid.ny, FINER * part.grid.nx, part.grid.pitch_mm / FINER)
    removed = part.effect(tif_at_point("exact", part.gamma), grid).removal_nm(plan.time_s)
    return part.height_nm(grid) - removed, grid.radius_mm() <= DIAMETER_MM / 2 - EDGE_MM


def rows_of(name: str, residual_nm: FloatArray, clear: BoolArray) -> Iterator[Row]:
    """Yield its row, and one for its mean."""
    inside = residual_nm[clear]
    rms, mean = float(inside.std()), abs(float(inside.mean()))
    of = f"dynamic plan, phi {DIAMETER_MM:g} mm, {RMS_NM:g} nm RMS, gamma {GAMMA[0]:g} to {GAMMA[1]:g}"
    yield Row(f"{of}: {name}", rms, CLASS_NM, "nm")
    if mean > MEAN * rms and name != "exact, seen twice as finely":
        yield Row(f"{of}: {name}: its mean", mean, {}, "nm")
