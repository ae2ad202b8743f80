"""Published figures beside a noise-free solve: two mirrors, and several tools over one part.

The mirrors' maps are available. Those of the tools are not: a disc of the same size and RMS replaces them, whose
amplitude falls with the square of the frequency. All bonnets have the same rate at their center, as the papers do not
state it. A row gives the best possible result of the dwell for such a map; the published figure was measured on glass
and contains all errors of the machine.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.dwell_cases import spot
from benchmarks.harness import Progress, Row, race
from polishd.model.surface import BoolArray, FloatArray, Grid
from polishd.process.dwell import interior_point
from polishd.process.dwell.from_arrays import ArrayTool, DwellCase, ToolsDwell, array_problem, dwell_of_tools
from polishd.process.metrology.statistics import slope

DIAMETER_MM, EDGE_MM, PITCH_MM, RMS_NM = 60.0, 2.0, 1.0, 45.42
LONGEST_MM, SHORTEST_MM = 60.0, 3.0
REACHED_MM, REACHED_STEP_MM = 10.0, 1.0
"""Diameter of the smallest spot: these tools can correct all longer periods. And distance of points."""
RADII_MM = (12.0, 8.0, 5.0)
MEASURED_NM = 11.18
"""Three bonnets in one solve, Optics Express 30(10) 16957: from 45.42 nm, in 13.28 min, on glass."""
LEFT = {"rms": {"published": 2.0, "published, one after another": 12.0}, "slope": {"published": 11.0}}
"""%, non-sequential optimisation of several tools, Optics Express 17(24): 98 % of the RMS and 89 % of the slope go."""
STEP_MM = 2.0
SEED = 1


def part(shortest_mm: float) -> tuple[Grid, BoolArray, BoolArray, FloatArray]:
    """Grid, the disc, its clear aperture, and (ny, nx) nm of a figure with that RMS in it, of periods down to that."""
    n = int(DIAMETER_MM / PITCH_MM) + 1
    grid = Grid(n, n, PITCH_MM)
    disc, clear = (grid.radius_mm() <= DIAMETER_MM / 2 - edge for edge in (0.0, EDGE_MM))
    f = np.hypot(*np.meshgrid(np.fft.rfftfreq(2 * n, PITCH_MM), np.fft.fftfreq(2 * n, PITCH_MM)))
    within = (f > 1 / LONGEST_MM) & (f < 1 / shortest_mm)
    size = np.where(within, np.maximum(f, 1 / LONGEST_MM) ** -2.0, 0.0)
    phase = np.exp(2j * np.pi * np.random.default_rng(SEED).random(f.shape))
    height = np.fft.irfft2(size * phase, (2 * n, 2 * n))[:n, :n]
    height = (height - height[clear].mean()) * RMS_NM / height[clear].std()
    return grid, disc, clear, height


MIRRORS = Path(__file__).parents[2] / "shared" / "data"
"""Folder beside the repository for the data; docs/how-to/dwell.md describes the two mirrors."""
MIRROR = {
    # rows, columns, peak nm/s, sigma mm, least RMS nm and its dwell in min (an exact solution: tests/unit/process)
    "xray": (slice(19, 62), slice(26, 553), 10.0, 1.0, 0.0599, 545.2),
    "elongated": (slice(103, 145), slice(82, 498), 0.4, 2.7752 / np.sqrt(8 * np.log(2)), 0.3573, 200.0),
}
PUBLISHED_NM = {"xray": 0.620, "elongated": 0.385}
"""FISTA, 200 iterations, as re-implemented."""
TIF_PITCH_MM, TIF_REACH_MM = 0.25, 5.0


def mirror(name: str) -> DwellCase:
    """The case exactly as the data's README defines it."""
    across, along, peak, sigma, *_ = MIRROR[name]
    with np.load(MIRRORS / f"{name}_mirror_map.npz") as file:
        x, y, z = (file[key][across, along] * factor for key, factor in (("X", 1e3), ("Y", 1e3), ("Z", 1e9)))
    plane = np.stack([np.ones(z.size), x.ravel(), y.ravel()], axis=1)
    z = z - (plane @ np.linalg.lstsq(plane, z.ravel())[0]).reshape(z.shape)
    u = np.arange(-TIF_REACH_MM, TIF_REACH_MM + 1e-9, TIF_PITCH_MM)
    r = np.hypot(u[None, :], u[:, None])
    tif = np.where(r <= TIF_REACH_MM, peak * np.exp(-(r**2) / (2 * sigma**2)), 0.0)
    return DwellCase(x, y, z - z.min(), tif, TIF_PITCH_MM)


def of_mirrors(progress: Progress) -> Iterator[Row]:
    """Residual, machine time and CPU of both, beside their proven optimum."""
    for name, (*_, least_nm, least_min) in MIRROR.items():
        if not (MIRRORS / f"{name}_mirror_map.npz").exists():
            progress(f"{name} mirror: its map is not in {MIRRORS}")
            continue
        problem, _ = array_problem(mirror(name))
        found = interior_point.solve(problem, 60.0).certificate
        peers = {"least, exact": least_nm, "FISTA, 200 iterations": PUBLISHED_NM[name]}
        yield Row(f"{name} mirror: residual", found.predicted_rms_nm, peers, "nm")
        yield Row(f"{name} mirror: dwell", found.dwell_total_s / 60, {"least, exact": least_min}, "min")
        if found.gap is not None:
            yield Row(f"{name} mirror: objective, none is less by more than", found.gap, {}, "of it")
        yield race(f"{name} mirror: solve", partial(interior_point.solve, problem, 60.0), {}, progress=progress)


def rows(progress: Progress) -> Iterator[Row]:
    """One row a published figure."""
    yield from of_mirrors(progress)
    tif = {radius: spot(1.0, radius, int(np.ceil(radius))) for radius in RADII_MM}
    case, disc = case_of(SHORTEST_MM, tif)
    bonnets = bonnets_of(STEP_MM, tif)
    area_mm2 = disc.sum() * PITCH_MM**2

    def over_volume(found: ToolsDwell) -> float:
        """Dwell over the time of the largest tool alone for the same volume."""
        removed = sum(float(one.removal_nm[disc].mean()) for one in found.passes) * area_mm2
        return float(found.total_s * tif[RADII_MM[0]].sum() / removed)

    name = f"three bonnets ({', '.join(f'{radius:g}' for radius in RADII_MM)} mm), phi 60 mm, {RMS_NM:g} nm"
    progress(f"{name}: all at once")
    least = dwell_of_tools(case, bonnets)
    yield Row(f"{name}: residual", least.certificate.predicted_rms_nm, {"published, on glass": MEASURED_NM}, "nm")
    alone = {}
    for bonnet in bonnets:
        progress(f"{name}: {bonnet.name} alone")
        alone[bonnet.name] = dwell_of_tools(case, [bonnet])
    peers = {f"{one} alone": found.certificate.predicted_rms_nm for one, found in alone.items()}
    yield Row(f"{name}: residual, each alone", least.certificate.predicted_rms_nm, peers, "nm")
    progress(f"{name}: to {MEASURED_NM:g} nm")
    goal = dwell_of_tools(case, bonnets, target_rms_nm=MEASURED_NM)
    yield Row(
        f"{name}: dwell to {MEASURED_NM:g} nm, over volume over the volume rate of the largest",
        over_volume(goal),
        {"least residual": over_volume(least)},
        "times",
    )
    yield from left(f"{name}, periods to {SHORTEST_MM:g} mm", case, least)
    progress(f"{name}: periods to {REACHED_MM:g} mm")
    case, _ = case_of(REACHED_MM, tif)
    yield from left(
        f"{name}, periods to {REACHED_MM:g} mm", case, dwell_of_tools(case, bonnets_of(REACHED_STEP_MM, tif))
    )


def case_of(shortest_mm: float, tif: Mapping[float, FloatArray]) -> tuple[DwellCase, BoolArray]:
    """Return the figure with the largest tool, and the disc."""
    grid, disc, clear, height = part(shortest_mm)
    largest = tif[RADII_MM[0]]
    case = DwellCase(grid.x_mm, grid.y_mm, height, largest, 1.0, mask=disc, clear=clear, piston_nm=None, rho=1e-4)
    return case, disc


def bonnets_of(step_mm: float, tif: Mapping[float, FloatArray]) -> list[ArrayTool]:
    return [ArrayTool(f"R{radius:g}", tif[radius], 1.0, step_mm=step_mm) for radius in RADII_MM]


def left(name: str, case: DwellCase, found: ToolsDwell) -> Iterator[Row]:
    """Of RMS and slope."""
    clear = np.asarray(case.clear)
    before, after = (
        slope(np.where(clear, np.nan_to_num(height), 0.0), clear, PITCH_MM).rms_urad
        for height in (np.asarray(case.height_nm), found.residual_nm)
    )
    share = 100 * found.certificate.predicted_rms_nm / RMS_NM
    yield Row(f"{name}: RMS that is left", share, LEFT["rms"], "%")
    yield Row(f"{name}: slope that is left", 100 * after / before, LEFT["slope"], "%")
