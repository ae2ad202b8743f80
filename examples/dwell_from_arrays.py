# ruff: noqa: T201
"""Dwell times for your arrays: a map, a TIF and dwell points."""

from dataclasses import replace
from functools import partial

import numpy as np

from polishd.process.dwell.from_arrays import DwellCase, array_problem, dwell_from_arrays
from polishd.process.dwell.interior_point import solve
from polishd.process.dwell.residual_curve import floor_cost, price_curve

# A map of 30 x 20 mm at 0.5 mm: x to the right, y up, heights in nm, the lowest at zero. NaN where there is no data.
x_mm, y_mm = np.arange(61) * 0.5, np.arange(41) * 0.5
X, Y = np.meshgrid(x_mm, y_mm)
height_nm = 20 * np.sin(X / 5) * np.cos(Y / 4) + 5 * np.cos(X / 2 + Y / 3)
height_nm -= height_nm.min()

# A TIF in nm/s: 25 x 25 samples at 0.2 mm, the dwell point in their center.
u = (np.arange(25) - 12) * 0.2
tif_nm_s = 5 * np.exp(-(u[None, :] ** 2 + u[:, None] ** 2) / 1.3)

# Dwell points anywhere: here a spiral over the part and a little beyond. Omit them for a square lattice.
angle = np.sqrt(np.arange(0, 2000) * 2.0)
spiral = np.stack([15 + 0.36 * angle * np.cos(angle * 2), 10 + 0.36 * angle * np.sin(angle * 2)], axis=1)
inside = (np.abs(spiral[:, 0] - 15) < 17) & (np.abs(spiral[:, 1] - 10) < 12)


def main() -> None:
    """The least residual, a time budget, a target, the curve, and what a dwell floor costs."""
    case = DwellCase(x_mm, y_mm, height_nm, tif_nm_s, 0.2, points_mm=spiral[inside])

    best = dwell_from_arrays(case)
    c = best.certificate
    print(f"{height_nm.std():.2f} nm RMS before, {len(best.time_s)} dwell points")
    print(f"least residual  {c.predicted_rms_nm:7.4f} nm in {c.dwell_total_s:7.1f} s, KKT {c.kkt_residual:.1e}")

    hurried = dwell_from_arrays(case, budget_s=0.9 * c.dwell_total_s).certificate
    print(f"a tenth quicker {hurried.predicted_rms_nm:7.4f} nm in {hurried.dwell_total_s:7.1f} s")
    enough = dwell_from_arrays(case, target_rms_nm=1.0).certificate
    print(f"1 nm is enough  {enough.predicted_rms_nm:7.4f} nm in {enough.dwell_total_s:7.1f} s")

    problem, _ = array_problem(case)
    quick = partial(solve, within_s=60.0)
    curve = price_curve(problem, quick)
    for row in curve.rows():
        print(f"  price {row['price_nm2_per_s']:.1e} nm^2/s: {row['rms_nm']:7.4f} nm in {row['total_s']:7.1f} s")
    knee = curve.knee()
    print(f"knee            {knee.rms_nm:7.4f} nm in {knee.total_s:7.1f} s")

    slow, _ = array_problem(replace(case, lower_s=0.02))
    cost = floor_cost(slow, quick).row()
    print(
        f"a floor of 20 ms {cost['rms_nm']:6.4f} nm in {cost['total_s']:7.1f} s, or with {cost['raised_by_nm']:.1f} nm"
    )
    print(f"more are removed{cost['raised_rms_nm']:7.4f} nm in {cost['raised_total_s']:7.1f} s")


if __name__ == "__main__":
    main()
