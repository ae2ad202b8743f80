"""A surface judged by its drawing: each line's figure on the map's own pixels in the clear aperture."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from polishd.model.errors import MapError
from polishd.model.surface import BoolArray, FloatArray
from polishd.model.tolerance import NORMS, Judged, ToleranceLine
from polishd.process import metrics

SLOPE_LENGTHS = 1.5
"""Most by which the shortest length that a map has, two pitches, may be longer than a slope's integration length."""


@dataclass(frozen=True)
class _Surface:
    """A surface, and what its lines have in common."""

    height_nm: FloatArray
    mask: BoolArray
    pitch_mm: float

    @cached_property
    def iso(self) -> metrics.iso10110.Iso10110Figures:
        """Figures of ISO 10110-5."""
        return metrics.iso10110.irregularity(self.height_nm, self.mask)

    def band(self, line: ToleranceLine) -> FloatArray:
        """(ny, nx) what has the line's periods."""
        edges = [edge for edge in (line.below_mm, line.above_mm) if edge]
        if not edges:
            return self.height_nm
        return metrics.split_bands(self.height_nm, self.mask, self.pitch_mm, edges)[0 if line.below_mm is None else 1]


def judge(
    lines: Iterable[ToleranceLine],
    height_nm: FloatArray,
    mask: BoolArray,
    pitch_mm: float,
    repeatability_nm: float | None = None,
) -> tuple[Judged, ...]:
    """What was measured of each line.

    Args:
        lines: of the drawing.
        height_nm: (ny, nx) the figure on the map's own pixels, without what is alignment; finite inside ``mask``.
        mask: (ny, nx) the clear aperture.
        pitch_mm: distance of samples.
        repeatability_nm: RMS of the instrument's noise in one map; None: not known.

    Raises:
        BadMap: a line counts what a map of this pitch cannot show, or the mask is empty.
    """
    surface = _Surface(height_nm, mask, pitch_mm)
    found = []
    for line in lines:
        _require_seen(line, pitch_mm)
        uncertainty = repeatability_nm if line.figure in NORMS else None
        found.append(Judged(line.what, _figure(line, surface), line.limit, line.unit, uncertainty))
    return tuple(found)


def seen(line: ToleranceLine, height_nm: FloatArray, mask: BoolArray, pitch_mm: float) -> FloatArray:
    """(ny, nx) what of a surface has the line's periods; arguments as for `judge`."""
    return _Surface(height_nm, mask, pitch_mm).band(line)


def notes_of(judged: Iterable[Judged]) -> tuple[str, ...]:
    """What a person should know of figures that are nearer to their limits than the instrument repeats."""
    return tuple(
        f"{one}: it {'holds' if one.holds else 'does not hold'}, and the instrument's repeatability could have it "
        "the other way"
        for one in judged
        if one.unsure
    )


def out_of_reach(
    lines: Sequence[ToleranceLine], height_nm: FloatArray, mask: BoolArray, pitch_mm: float, cutoff_period_mm: float
) -> tuple[Judged, ...]:
    """The lines that a spot cannot make hold: they do not of what is left where all periods above its cut-off are gone.

    Arguments as for `judge`. On a grid that averages over the map's pixels less is left than on the map: a line that is
    named here is out of reach, one that is not may be. Those that the grid cannot show are left out.
    """
    if cutoff_period_mm <= 2 * pitch_mm:
        return ()
    beyond = metrics.split_bands(height_nm, mask, pitch_mm, (cutoff_period_mm,))[1]
    some = [line for line in lines if _unseen(line, pitch_mm) is None and line.above_mm < cutoff_period_mm]
    return tuple(one for one in judge(some, beyond, mask, pitch_mm) if not one.holds)


def only_beyond(lines: Iterable[ToleranceLine], cutoff_period_mm: float) -> tuple[ToleranceLine, ...]:
    """Lines that count no period above a spot's cut-off: it changes nothing of them for the better."""
    return tuple(line for line in lines if line.below_mm is not None and line.below_mm <= cutoff_period_mm)


def _figure(line: ToleranceLine, surface: _Surface) -> float:
    match line.figure:
        case "rms":
            return metrics.pv_rms(surface.band(line), surface.mask)[1]
        case "pv":
            return metrics.pv_rms(surface.band(line), surface.mask)[0]
        case "slope_rms" | "slope_max":
            found = metrics.slope(surface.band(line), surface.mask, surface.pitch_mm, line.integration_mm)
            return found.rms_urad if line.figure == "slope_rms" else found.max_urad
        case "psd":
            return _above_line(line, metrics.radial_psd(surface.height_nm, surface.mask, surface.pitch_mm))
        case "A" | "B" | "C":
            return float(getattr(surface.iso, f"{line.figure.lower()}_nm"))
        case _:
            return float(getattr(surface.iso, f"rms_{line.figure[-1]}_nm"))


def _above_line(line: ToleranceLine, psd: metrics.RadialPsd) -> float:
    """The factor A of the lowest line ``A / f**exponent`` that no ring of the periods is above."""
    frequency = psd.frequency_per_mm
    counted = (frequency >= 1 / (line.below_mm or np.inf)) & (frequency <= 1 / line.above_mm)
    if not counted.any():
        raise MapError(
            f"the map has no frequency in {line.what}: it is too small, or the periods too near to each other"
        )
    return float((psd.density_nm2_mm2 * frequency**line.exponent)[counted].max())


def _require_seen(line: ToleranceLine, pitch_mm: float) -> None:
    problem = _unseen(line, pitch_mm)
    if problem is not None:
        raise MapError(
            f"{line.what} cannot be judged on this map: {problem}; measure with a finer pitch, or mend the line"
        )


def _unseen(line: ToleranceLine, pitch_mm: float) -> str | None:
    """Why a map of this pitch does not show what a line counts; None where it does.

    A band without a lower end counts what the map shows; one with an end must be shown to that.
    """
    shortest = 2 * pitch_mm
    if line.above_mm and line.above_mm < shortest:
        return f"it shows periods above {shortest:.3g} mm only"
    if line.below_mm is not None and line.below_mm <= shortest:
        return f"it shows periods above {shortest:.3g} mm only"
    if line.integration_mm is not None and shortest > SLOPE_LENGTHS * line.integration_mm:
        return f"its shortest slope is over {shortest:.3g} mm"
    return None
