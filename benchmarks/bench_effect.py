"""The effect of a raster of moving blocks, without a matrix and with one: making it, and a product with it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from benchmarks.bench_dwell import path
from benchmarks.harness import Progress, Row, Runner, peak_mb, race
from polishd.model.process import ToolProcess
from polishd.model.surface import FloatArray, Grid
from polishd.process.removal import contact
from polishd.process.removal.dynamic_tif import effect_matrix
from polishd.process.removal.effect import Effect, SparseEffect
from polishd.process.removal.spread_effect import spread_effect
from polishd.process.removal.tif import HertzSpot, hertz_spot
from polishd.process.toolpath.apertures import circle
from polishd.process.toolpath.paths import raster

MOST_ENTRIES = 100_000_000
"""Most nonzeros of a matrix that is made here: 1.2 GB, and twice that while it is made."""
PRODUCTS = 10


@dataclass(frozen=True)
class Case:
    """A disc, and a raster on it."""

    diameter_mm: float
    pitch_mm: float
    step_mm: float
    radius_mm: float
    """Of the rigid robot's contact."""
    tolerance: float

    @property
    def process(self) -> ToolProcess:
        """The paper's, bonnet and force grown to this contact."""
        process = ToolProcess()
        grown = self.radius_mm / float(contact.contact_radius_mm(process, contact.hertz_depth_mm(process)))
        return replace(process, tool_radius_mm=grown * process.tool_radius_mm, force_n=grown**2 * process.force_n)

    @property
    def spot(self) -> HertzSpot:
        """Of that process, on a flat."""
        return hertz_spot(self.process, self.pitch_mm)


# the demo's spot is a few cells wide: an effect without a matrix has no advantage there, and is not near 1e-3
CASES = (
    Case(100.0, 1.0, 1.0, 1.7, 2e-2),
    Case(300.0, 1.0, 1.0, 1.7, 2e-2),
    Case(200.0, 0.5, 0.93, 10.0, 1e-3),
)


def rows(progress: Progress) -> Iterator[Row]:
    """CPU seconds to make each and for ten pairs of products, and the memory that making it takes."""
    for case in CASES:
        progress(f"effect: phi {case.diameter_mm:g} mm, spot of {case.radius_mm:g} mm")
        yield from compared(case, progress)


def compared(case: Case, progress: Progress) -> Iterator[Row]:
    """Rows of a case; a matrix that would be too large is listed as not finished."""
    program = path(raster(circle(case.diameter_mm), case.step_mm, case.step_mm))
    side, spot = int((case.diameter_mm + 2 * case.radius_mm) / case.pitch_mm) + 1, case.spot
    grid = Grid(side, side, case.pitch_mm)
    gamma, one = np.asarray(0.875 + 0.035 * np.sin(program.end_mm[:, 0] / 30)), np.ones(program.n)
    name = f"phi {case.diameter_mm:g} mm, {program.n} blocks, spot {case.radius_mm:g} mm, grid {case.pitch_mm:g} mm"

    def without() -> Effect:
        return spread_effect(grid, spot, program, gamma, one, tolerance=case.tolerance)

    def matrix() -> Effect:
        return SparseEffect(grid, effect_matrix(grid, spot, program, gamma, one))

    fits = program.n * np.pi * (case.radius_mm / case.pitch_mm) ** 2 < MOST_ENTRIES
    peers: Mapping[str, Callable[[], Effect]] = {"matrix": matrix} if fits else {}
    missing: dict[str, float | None] = {} if fits else {"matrix": None}
    made = race(f"effect made, {name}", without, peers, progress=progress)
    yield replace(made, peers={**made.peers, **missing})
    runs: dict[str, Runner] = {peer: partial(products, make(), one) for peer, make in peers.items()}
    product = race(f"{PRODUCTS} products and adjoints, {name}", partial(products, without(), one), runs)
    yield replace(product, peers={**product.peers, **missing})
    most = {peer: peak_mb(make) for peer, make in peers.items()}
    yield Row(f"effect made, memory, {name}", peak_mb(without), {**most, **missing}, "MB")


def products(effect: Effect, time_s: FloatArray) -> None:
    """The products of the solver's conjugate gradients."""
    for _ in range(PRODUCTS):
        effect.adjoint(effect.removal_nm(time_s))
