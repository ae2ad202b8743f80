"""Published figures of several tools over one part, and what one solve for all of them comes to, free of noise.

Their maps are not to be had: a disc of the same size and RMS takes their place, whose amplitude falls with the square
of the frequency. All bonnets have the same rate at their middle, as theirs are not stated. So a row says what the
dwell can leave at best of such a map, and theirs, measured on glass, what it was with all that a machine adds.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from benchmarks.dwell_cases import spot
from benchmarks.harness import Progress, Row
from polishd.model.surface import BoolArray, FloatArray, Grid
from polishd.process.dwell.arrays import DwellCase
from polishd.process.dwell.tools import ArrayTool, ToolsDwell, dwell_of_tools
from polishd.process.metrics.slopes import slope

DIAMETER_MM, EDGE_MM, PITCH_MM, RMS_NM = 60.0, 2.0, 1.0, 45.42
LONGEST_MM, SHORTEST_MM = 60.0, 3.0
RADII_MM = (12.0, 8.0, 5.0)
MEASURED_NM = 11.18
"""Three bonnets in one solve, Optics Express 30(10) 16957: from 45.42 nm, in 13.28 min, on glass."""
LEFT = {"rms": {"published": 2.0, "published, one after another": 12.0}, "slope": {"published": 11.0}}
"""%, non-sequential optimisation of several tools, Optics Express 17(24): 98 % of the RMS and 89 % of the slope go."""
STEP_MM = 2.0
SEED = 1


def part() -> tuple[Grid, BoolArray, BoolArray, FloatArray]:
    """Grid, the disc, its clear aperture, and (ny, nx) nm of a figure with that RMS in it."""
    n = int(DIAMETER_MM / PITCH_MM) + 1
    grid = Grid(n, n, PITCH_MM)
    disc, clear = (grid.radius_mm() <= DIAMETER_MM / 2 - edge for edge in (0.0, EDGE_MM))
    f = np.hypot(*np.meshgrid(np.fft.rfftfreq(2 * n, PITCH_MM), np.fft.fftfreq(2 * n, PITCH_MM)))
    within = (f > 1 / LONGEST_MM) & (f < 1 / SHORTEST_MM)
    size = np.where(within, np.maximum(f, 1 / LONGEST_MM) ** -2.0, 0.0)
    phase = np.exp(2j * np.pi * np.random.default_rng(SEED).random(f.shape))
    height = np.fft.irfft2(size * phase, (2 * n, 2 * n))[:n, :n]
    height = (height - height[clear].mean()) * RMS_NM / height[clear].std()
    return grid, disc, clear, height


def rows(progress: Progress) -> Iterator[Row]:
    """One row a published figure."""
    grid, disc, clear, height = part()
    tif = {radius: spot(1.0, radius, int(np.ceil(radius))) for radius in RADII_MM}
    case = DwellCase(
        grid.x_mm, grid.y_mm, height, tif[RADII_MM[0]], 1.0, mask=disc, clear=clear, piston_nm=None, rho=1e-4
    )
    bonnets = [ArrayTool(f"R{radius:g}", tif[radius], 1.0, step_mm=STEP_MM) for radius in RADII_MM]
    area_mm2 = disc.sum() * PITCH_MM**2

    def over_volume(found: ToolsDwell) -> float:
        """Dwell over what the largest alone would take for the same volume."""
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
    before = slope(np.where(clear, height, 0.0), clear, PITCH_MM).rms_urad
    after = slope(np.where(clear, np.nan_to_num(least.residual_nm), 0.0), clear, PITCH_MM).rms_urad
    left = 100 * least.certificate.predicted_rms_nm / RMS_NM
    yield Row(f"{name}, periods to 3 mm: RMS that is left", left, LEFT["rms"], "%")
    yield Row(f"{name}, periods to 3 mm: slope that is left", 100 * after / before, LEFT["slope"], "%")
