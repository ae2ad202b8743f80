"""What two maps differ by: a removal that is scaled and moved, and low orders that none explains.

Temperature and set-up bend a part between two maps: power and astigmatism. Three points of a mount print through as a
trefoil (J. E. Nelson, J. Lubliner, T. S. Mast, "Telescope mirror supports: plate deflections on point supports",
Proc. SPIE 332, 212, 1982). Left out of a fit they read as rate and shift: 4 nm of power as up to 1 mm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from polishd.model.beliefs import Estimate
from polishd.model.surface import BoolArray, FloatArray, Grid
from polishd.process.metrics import Removal
from polishd.process.metrics.zernike_terms import order, values
from polishd.process.removal_fit import FEWEST, levelled, regressed

NOLL = (4, 5, 6, 9, 10)
"""Power, astigmatism at 45 and 0 degrees, trefoil as sine and cosine: their indices, after Noll."""
CHANCE = (7, 8, 11, 12, 13, 14, 15)
"""Their neighbours, which neither temperature nor mount makes: what these come to, is chance's and the tool's."""


@dataclass(frozen=True, slots=True)
class ResidualFit:
    """Each with its standard error. Sizes are RMS over the circle of the mask.

    Of low orders it is the scatter over the map's tiles or, where that is more, what the fit leaves of their
    neighbours, RMS: of what is as long as the part tiles know nothing.
    """

    rate: Estimate | None
    """Measured over predicted removal; None between two maps with no pass between."""
    shift_mm: Estimate
    """Length of the way by which the removal lies off its prediction."""
    power_nm: Estimate
    """Positive: the rim lost more than the removal explains; negative: it stands higher in the map after."""
    astigmatism_nm: Estimate
    trefoil_nm: Estimate


def leftover(
    changed_nm: FloatArray,
    mask: BoolArray,
    pitch_mm: float,
    predicted_nm: FloatArray | None = None,
    *,
    removal: Removal = "tilt",
) -> ResidualFit | None:
    """All of them in one least-squares fit, beside piston and tilt; None where the samples are too few.

    Args:
        changed_nm: (ny, nx) map before less map after, positive = removed.
        mask: (ny, nx) samples to compare.
        pitch_mm: of the grid.
        predicted_nm: (ny, nx) removal predicted of the pass between, positive = removed; None: there was none.
        removal: what nobody knows of a change: with "power" none is told of it, and 0 stands for it.
    """
    if np.count_nonzero(mask) < FEWEST:
        return None
    fitted = [] if predicted_nm is None else [predicted_nm, *_slopes(predicted_nm, pitch_mm)]
    modes, first = _modes(mask), len(fitted)
    if removal == "power":
        modes[0] = np.zeros(mask.shape)
    signals = [levelled(signal, mask, removal) for signal in (*fitted, *modes[: len(NOLL)])]
    measured = levelled(changed_nm, mask, removal)
    found = regressed(signals, measured, mask, lambda factors: factors, with_drift=False)
    size, left = found.factors, measured[mask] - found.terms @ found.factors
    error = np.concatenate(
        [found.scatter[:first], np.maximum(found.scatter[first:], _chance_nm(left, modes[len(NOLL) :], mask))]
    )
    power, astigmatism, trefoil = (slice(first + a, first + b) for a, b in ((0, 1), (1, 3), (3, 5)))
    rate = float(size[0]) if fitted else 1.0
    moved = (size[1:3] / (rate or 1.0), error[1:3] / (rate or 1.0)) if fitted else (np.zeros(2), np.zeros(2))
    return ResidualFit(
        rate=Estimate(rate, float(error[0])) if fitted else None,
        shift_mm=_length(*moved),
        power_nm=Estimate(float(size[power][0]), float(error[power][0])),
        astigmatism_nm=_length(size[astigmatism], error[astigmatism]),
        trefoil_nm=_length(size[trefoil], error[trefoil]),
    )


def _chance_nm(left_nm: FloatArray, neighbours: Sequence[FloatArray], mask: BoolArray) -> float:
    """RMS of the neighbours in what the fit leaves: as terms of it they would take the rate's place on a small part."""
    terms = np.column_stack([neighbour[mask] for neighbour in neighbours])
    return float(np.sqrt(np.mean(np.linalg.lstsq(terms, left_nm, rcond=None)[0] ** 2)))


def _length(vector: FloatArray, errors: FloatArray) -> Estimate:
    """With the larger of the components' errors."""
    return Estimate(float(np.linalg.norm(vector)), float(np.abs(errors).max()))


def _slopes(height_nm: FloatArray, pitch_mm: float) -> list[FloatArray]:
    """What a removal that is moved by 1 mm along x, along y has more: y goes up, rows go down."""
    down, right = (np.asarray(np.gradient(height_nm, pitch_mm, axis=axis), dtype=np.float64) for axis in (0, 1))
    return [-right, down]


def _modes(mask: BoolArray) -> list[FloatArray]:
    """(ny, nx) each: of RMS 1 over the circle that the mask fills, zero outside it."""
    grid = Grid(mask.shape[0], mask.shape[1], 1.0)
    rows, columns = np.nonzero(mask)
    x, y = grid.x_mm[columns], grid.y_mm[rows]
    x, y = x - (x.max() + x.min()) / 2, y - (y.max() + y.min()) / 2
    circle = float(np.hypot(x, y).max())
    indices = (*NOLL, *CHANCE)
    pairs = order("noll", max(indices))
    made = []
    for term in values([pairs[index - 1] for index in indices], "rms", x / circle, y / circle):
        mode = np.zeros(mask.shape)
        mode[mask] = term
        made.append(mode)
    return made
