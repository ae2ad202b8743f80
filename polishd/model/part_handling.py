"""Handling of part and tool beside polishing: check of the seat, and steps between passes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from polishd.model.surface import FloatArray


@dataclass(frozen=True, slots=True)
class TouchOff:
    """Check of the seat: the tool touches the part at three points with its spindle at rest."""

    force_n: float
    position_mm: float | None
    """Stroke of the actuator at which the tool's tip is at the programmed point; None: half of the stroke."""
    max_offset_mm: float
    """Farthest that any point of the part may sit from where it should."""
    each_pass: bool
    """Before each pass, not only before the first."""
    points_mm: FloatArray
    """(3, 3) on the nominal surface, part frame."""
    normal: FloatArray
    """(3, 3) unit normals of the surface there."""
    axis: FloatArray
    """(3, 3) unit tool axes there, from the tip into the spindle."""
    rim_mm: float
    """Radius of the circle about the part's centre that holds the part."""
    force_max_n: float = 2.0
    """Largest force that any device may read meanwhile."""

    @property
    def reach_mm(self) -> FloatArray:
        """(3,) way of the actuator beyond which nothing is touched that sits where it may."""
        return self.max_offset_mm / self.lean

    @property
    def lean(self) -> FloatArray:
        """(3,) cosine between tool axis and normal: what of the actuator's way is along the normal."""
        return np.asarray(np.einsum("ni,ni->n", self.axis, self.normal), dtype=np.float64)


LEAST_MM, LEAST_DEG = 0.0005, 0.0005
"""Least height and tilt of a seat that are printed: an actuator's position is not known better."""


@dataclass(frozen=True, slots=True)
class PartSeat:
    """Measured seat of a part against the cell file."""

    height_mm: float
    """Height error of the center along z; negative: too low."""
    tilt_deg: tuple[float, float]
    """Tilt error about x and y."""
    off_mm: tuple[float, ...]
    """Height error at each point, along the normal."""
    worst_mm: float
    """Most that any point of it is off."""

    @property
    def is_level(self) -> bool:
        """Return whether height and tilt are below the printed resolution."""
        return max(abs(self.height_mm) / LEAST_MM, *(abs(angle) / LEAST_DEG for angle in self.tilt_deg)) < 1

    def __str__(self) -> str:
        """Description of the seat."""
        way = "high" if self.height_mm >= 0 else "low"
        x, y = (round(angle, 3) + 0.0 for angle in self.tilt_deg)
        return f"{abs(self.height_mm):.3f} mm too {way}, tilted by {x:+.3f} deg about x and {y:+.3f} deg about y"


@dataclass(frozen=True, slots=True)
class HandlingStep:
    """Something that a person or a program does while the tool is up and nothing moves."""

    operator: str = ""
    """Instruction for the operator; empty: the command does the step."""
    command: tuple[str, ...] = ()
    folder: Path = Path()
    """Working folder of the command."""
    timeout_s: float = 600.0


@dataclass(frozen=True, slots=True)
class SettleRule:
    """When a part counts as settled: two maps in a row agree."""

    limit_nm: float
    """RMS of their difference in the clear aperture, levelled."""
    max_maps: int
    """Most that are taken for it."""
    wait_s: float
    """Between two of them."""


@dataclass(frozen=True, slots=True)
class BetweenPasses:
    """Steps between passes; None: none."""

    clean: HandlingStep | None = None
    settle: SettleRule | None = None
    condition: HandlingStep | None = None
    change: HandlingStep = HandlingStep()
    """Steps by tool, where there are several; a tool without steps is mounted by the operator."""


NOTHING = BetweenPasses()
