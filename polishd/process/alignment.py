"""What of a map is alignment: said where it is large, or where it is polished."""

from __future__ import annotations

from polishd.model.surface import BoolArray, FloatArray
from polishd.process import metrics

LARGE_NM = 50.0
"""PV of a tilt that a person should know of where the figure is smaller than it: a sixth of a fringe."""


def alignment_notes(
    height_nm: FloatArray, mask: BoolArray, removal: metrics.Removal, tolerance_nm: float
) -> tuple[str, ...]:
    """What a person should know of a map's tilt: that much was taken off, or that it was left in and is polished.

    Args:
        height_nm: (ny, nx) the map as measured, finite inside ``mask``.
        mask: (ny, nx) clear aperture.
        removal: what is taken off as alignment.
        tolerance_nm: RMS of the figure that is wanted: less tilt than this is not worth a word.
    """
    figure_nm = float(metrics.without(height_nm, mask, removal)[mask].std())
    tilt = metrics.fitted(height_nm, mask, "tilt" if removal == "piston" else removal)
    pv, rms = metrics.pv_rms(tilt, mask)
    if removal == "piston" and rms > tolerance_nm:
        note = (
            f"of the figure's {figure_nm:.3g} nm RMS a tilt makes {rms:.3g} ({pv:.3g} nm PV), and it is polished away: "
            'part.alignment = "piston" says so, "tilt" takes it for alignment'
        )
        return (note,)
    if removal != "piston" and pv > LARGE_NM and rms > figure_nm:
        terms = "tilt" if removal == "tilt" else "tilt and power"
        note = (
            f"{terms} of {pv:.4g} nm PV in the clear aperture taken off as alignment (part.alignment), "
            f"which leaves {figure_nm:.3g} nm RMS of figure"
        )
        return (note,)
    return ()
