"""Cost of a dwell for a moving tool as the part grows: effect, regularization, solve and certificate, no matrix.

Each size runs in a separate process; its memory is the kernel's peak (VmHWM). By name only: hours.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator

import numpy as np

from benchmarks.bench_dwell import FEED_MM_S, path, surface
from benchmarks.bench_effect import Case
from benchmarks.harness import Progress, Row, memory_bytes
from polishd.model.outline import Polygon
from polishd.model.process import FLAT, Optic
from polishd.model.surface import Grid
from polishd.process.dwell import alternating_directions
from polishd.process.dwell.problem import DwellProblem
from polishd.process.dwell.quadratic import choose_piston_nm, regularisation_from_rho
from polishd.process.removal.contact import contact_on_curved_part
from polishd.process.removal.spread_effect import spread_effect
from polishd.process.toolpath.apertures import circle, over_outline
from polishd.process.toolpath.paths import raster

DISCS = tuple(Case(diameter_mm, 1.0, 1.0, 10.0, 1e-3) for diameter_mm in (110.0, 200.0, 360.0, 640.0, 1130.0, 2200.0))
"""10^4 to 4 * 10^6 blocks."""
SEGMENT = Case(1400.0, 1.0, 0.8, 30.0, 1e-3)
"""Of an extremely large telescope, over the corners of its hexagon; two million blocks."""
OFF_AXIS = Optic(69_000.0, -1.0, (), (15_000.0, 6_000.0))
"""Position of that segment on its paraboloid."""


def rows(progress: Progress) -> Iterator[Row]:
    """CPU seconds and memory of flat discs of a spot of 10 mm, and of an off-axis hexagon of one of 30 mm."""
    for case in (*DISCS, SEGMENT):
        shape = "hexagon" if case is SEGMENT else "phi"
        progress(f"size: {shape} {case.diameter_mm:g} mm")
        command = [sys.executable, "-m", __name__, shape, str(case.diameter_mm)]
        found = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
        name = f"size: {shape} {case.diameter_mm:g} mm, {found['blocks']} blocks, spot {case.radius_mm:g} mm"
        yield Row(f"{name}, gap {found['gap']:.0e}", found["cpu_s"], {}, "s")
        yield Row(f"{name}, memory", found["mb"], {}, "MB")


def measured(case: Case, *, hexagon: bool) -> dict[str, float]:
    """One size."""
    turns = [k * np.pi / 3 for k in range(6)]
    outline = Polygon(
        tuple((case.diameter_mm / 2 * np.cos(turn), case.diameter_mm / 2 * np.sin(turn)) for turn in turns)
    )
    points = raster(over_outline(outline) if hexagon else circle(case.diameter_mm), case.step_mm, case.step_mm)
    program = path(points)
    side = int((case.diameter_mm + 2 * case.radius_mm) / case.pitch_mm) + 1
    grid = Grid(side, side, case.pitch_mm)
    gamma = np.asarray(0.875 + 0.035 * np.sin(program.end_mm[:, 0] / 30))
    begun_s = time.process_time()
    factor, bent = np.ones(program.n), None
    curved = contact_on_curved_part(case.process, OFF_AXIS if hexagon else FLAT, program.end_mm)
    if curved is not None:
        gamma, factor, bent = gamma * curved.deeper, curved.seen, np.column_stack([curved.wider, curved.askew])
    effect = spread_effect(grid, case.spot, program, gamma, factor, tolerance=case.tolerance, bent=bent)
    solve = outline.contains(*grid.axes_mm) if hexagon else grid.radius_mm() <= case.diameter_mm / 2
    height, lower = surface(grid, solve), program.length_mm / FEED_MM_S
    target = height + choose_piston_nm(height, solve, effect.removal_nm(lower))
    p = regularisation_from_rho(effect, solve, 1e-4)
    problem = DwellProblem(effect, target, solve, solve, lower, np.full(lower.size, np.inf), p)
    certificate = alternating_directions.solve(problem, 36_000.0).certificate
    assert certificate.stopped == "converged"
    assert certificate.gap is not None
    seconds = time.process_time() - begun_s
    return {"blocks": program.n, "cpu_s": seconds, "mb": memory_bytes("VmHWM") / 1e6, "gap": certificate.gap}


if __name__ == "__main__":
    asked = next(case for case in (*DISCS, SEGMENT) if case.diameter_mm == float(sys.argv[2]))
    print(json.dumps(measured(asked, hexagon=sys.argv[1] == "hexagon")))
