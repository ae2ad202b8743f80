"""Ripple that a path leaves: its harmonics, their errors, and the sum over several passes.

`ripple_forecast` makes it from a path and its dwell.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np

from polishd.process.removal.tif import Spot
from polishd.process.removal.tif_family import PathBlocks

RADIUS_ERROR = 0.03
"""Default of what 95 % of spots stay within, of their radius: a TIF that was measured once."""
LINE_ERROR_MM = 0.02
"""Default of what 95 % of lines lie within, across them: a robot that repeats to 0.02 mm."""
LAG_MM = 0.05
"""Default of the distance that the tool trails its path by, at most."""
SAME_PERIOD = 0.02
"""Lines of two passes whose periods differ by less, relative, are the same."""
EQUAL_PERIOD, EQUAL_DEG = 1e-3, 0.05
"""Lines of two passes whose periods and directions differ by less keep their phase over the part."""
ALIGNED = 0.94
"""Cosine of the angle to a line from which a block counts to another direction."""
SEAT_MM = 0.05
"""Distance across the lines that 95 % of passes lie within of their place on the part: its seat, and the frame."""
SIGMAS_OF_95 = 1.96
"""Standard deviations of a normal distribution within which 95 % lie."""

Direction = Literal["across", "along", "every"]
Cause = Literal["path", "line_error", "lag"]


@dataclass(frozen=True, slots=True)
class PathErrors:
    """Limits within which 95 % of spots, lines and passes are."""

    radius: float = RADIUS_ERROR
    """Of the spot's radius, relative."""
    line_mm: float = 0.0
    """Of each line's place across it, independent of the other lines'."""
    lag_mm: float = 0.0
    """Distance along the path that the tool trails the programmed point by: friction, backlash, a soft bonnet.

    A delay in time alone is none: the tool passes the same points as long. Lines that run to and fro are shifted
    against each other by twice the distance."""

    @property
    def words(self) -> str:
        """Return the limits as text."""
        found = [f"a radius that is off by {100 * self.radius:g} %"] if self.radius else []
        found += [f"lines out of place by {self.line_mm:g} mm"] if self.line_mm else []
        found += [f"a lag of {self.lag_mm:g} mm"] if self.lag_mm else []
        return " and ".join(found) or "no errors"


MODELLED = PathErrors()
"""Of a spot that was measured once, on a path without errors."""


@dataclass(frozen=True, slots=True)
class RippleLine:
    """A harmonic of the pattern that a path leaves."""

    direction: Direction
    """"across" the lines, "along" them (distance of points at rest), or "every" where lines have no common distance."""
    period_mm: float
    amplitude_nm: float
    """Zero to peak, as modelled: the RMS over the patches."""
    rms_nm: float
    """RMS over the clear aperture, as modelled; 0 of what errors alone leave."""
    rms_high_nm: float
    """95 % value: with the errors of `PathErrors`, the worse sign of the radius; at least ``rms_nm``."""
    on_grid: float
    """Share of its mean square that the process grid's cells keep."""
    cause: Cause = "path"
    """"path": lines and points as programmed; "line_error": lines out of place, a band about the period; "lag"."""
    azimuth_deg: float | None = None
    """Direction of straight lines on the part, counterclockwise from x, 0 to 180; None: they are not straight."""
    phase: float | None = None
    """Periods from the part's center to a crest, across straight lines to their left; None: unknown."""

    def is_same(self, other: RippleLine) -> bool:
        """Return whether another pass leaves the same line."""
        alike = abs(self.period_mm - other.period_mm) <= SAME_PERIOD * self.period_mm
        return alike and (self.direction, self.cause) == (other.direction, other.cause) and not self.crosses(other)

    def crosses(self, other: RippleLine) -> bool:
        """Return whether another line runs at an angle to this one: over the part, they meet in all phases."""
        if self.azimuth_deg is None or other.azimuth_deg is None:
            return False
        return bool(abs(np.cos(np.radians(self.azimuth_deg - other.azimuth_deg))) < ALIGNED)

    def is_aligned(self, other: RippleLine) -> bool:
        """Return whether another pass leaves the same line with a known phase to this one."""
        if self.azimuth_deg is None or other.azimuth_deg is None or self.phase is None or other.phase is None:
            return False
        parallel = abs(self.azimuth_deg - other.azimuth_deg) <= EQUAL_DEG
        return parallel and abs(self.period_mm - other.period_mm) <= EQUAL_PERIOD * self.period_mm

    def kept(self, sample_mm: float) -> float:
        """Return the share of its mean square that samples which average over their distance keep."""
        return float(np.sinc(sample_mm / self.period_mm)) ** 2


@dataclass(frozen=True, slots=True)
class Ripple:
    """Forecast of the ripple that one pass adds."""

    lines: tuple[RippleLine, ...] = ()
    errors: PathErrors = MODELLED

    @property
    def rms_nm(self) -> float:
        """RMS of all lines, as modelled."""
        return float(np.sqrt(sum(one.rms_nm**2 for one in self.lines)))

    @property
    def rms_high_nm(self) -> float:
        """RMS of all lines, 95 % value."""
        return float(np.sqrt(sum(one.rms_high_nm**2 for one in self.lines)))

    @property
    def finer_nm(self) -> float:
        """RMS of what the process grid averages away, as modelled."""
        return float(np.sqrt(sum(one.rms_nm**2 * (1 - one.on_grid) for one in self.lines)))

    def shown_nm(self, sample_mm: float | None, *, high: bool = False) -> float:
        """RMS that a map's samples show beyond the process grid; ``sample_mm`` None: all of it."""
        square = 0.0
        for one in self.lines:
            rms = one.rms_high_nm if high else one.rms_nm
            kept = 1.0 if sample_mm is None else one.kept(sample_mm)
            square += max(kept * rms**2 - one.on_grid * one.rms_nm**2, 0.0)
        return float(np.sqrt(square))

    def without_phase(self) -> Ripple:
        """Return the ripple whose lines add up with those of any other pass."""
        return replace(self, lines=tuple(replace(one, phase=None) for one in self.lines))

    @property
    def words(self) -> str:
        """Return the largest line as text."""
        if not self.lines:
            return "no lines"
        one = max(self.lines, key=lambda line: line.rms_high_nm)
        return f"{one.period_mm:.2f} mm {one.direction}, amplitude {one.amplitude_nm:.2f} nm"

    def facts(self) -> list[dict[str, Any]]:
        """Return the lines for JSON."""
        return [asdict(one) for one in self.lines]


NO_RIPPLE = Ripple()


def sum_ripples(passes: Sequence[Ripple]) -> Ripple:
    """Return the ripple of several passes of one tool.

    Straight parallel lines of one distance add with their phase: those of a pass between the lines of another cancel.
    The mean squares of straight lines that cross add up, the amplitudes of all other lines of one period, as those of
    one path that is made twice do.
    """
    same = list[list[RippleLine]]()
    for line in (line for one in passes for line in one.lines):
        known = next((lines for lines in same if lines[0].is_same(line)), None)
        if known is None:
            same.append([line])
        else:
            known.append(line)
    errors = next((one.errors for one in passes if one.lines), passes[-1].errors if passes else MODELLED)
    return Ripple(tuple(_sum_lines(lines) for lines in same), errors)


def _sum_lines(lines: Sequence[RippleLine]) -> RippleLine:
    """Sum of one line over passes."""
    first = lines[0]
    if len(lines) == 1:
        return first
    values = np.array([(one.amplitude_nm, one.rms_nm, one.rms_high_nm) for one in lines])
    if first.cause == "line_error":  # out of place anew in each pass
        total = np.linalg.norm(values, axis=0)
    elif all(first.is_aligned(one) for one in lines):
        turn = np.exp(2j * np.pi * np.array([one.phase for one in lines]))
        total = np.abs(turn @ values)
        off = 2 * np.pi * SEAT_MM / first.period_mm * float(np.linalg.norm(values[:, 2]))
        total[2] = min(max(total[2] + off, total[1]), float(values[:, 2].sum()))
    else:
        total = values.sum(axis=0)
    amplitude, rms, high = map(float, total)
    # a sum over more passes starts from their lines, not from this one, which has no phase
    return replace(first, amplitude_nm=amplitude, rms_nm=rms, rms_high_nm=high, azimuth_deg=None, phase=None)


@dataclass(frozen=True, slots=True)
class ActingSpots:
    """The spots of a program's n timed points as they act: all that a ripple follows from but the dwell."""

    spot: Spot
    blocks: PathBlocks
