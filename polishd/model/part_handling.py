"""What is done with part and tool beside polishing: the seat is proved, and between passes the part is made ready."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from polishd.model.surface import FloatArray


@dataclass(frozen=True, slots=True)
class TouchOff:
    """How the seat is proved: the tool rests on the part at three places, its spindle at rest."""

    force_n: float
    position_mm: float | None
    """Of the actuator, where the tool's tip is where the program says; None: half of its stroke."""
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
    """How a part sits, against what the cell's file says."""

    height_mm: float
    """How much too high its centre is, along its z; negative: too low."""
    tilt_deg: tuple[float, float]
    """How it is turned, about its x and y."""
    off_mm: tuple[float, ...]
    """How much too high it is at each place, along the normal."""
    worst_mm: float
    """Most that any point of it is off."""

    @property
    def is_level(self) -> bool:
        """Whether height and tilt are below what is printed of them."""
        return max(abs(self.height_mm) / LEAST_MM, *(abs(angle) / LEAST_DEG for angle in self.tilt_deg)) < 1

    def __str__(self) -> str:
        """In words."""
        way = "high" if self.height_mm >= 0 else "low"
        x, y = (round(angle, 3) + 0.0 for angle in self.tilt_deg)
        return f"{abs(self.height_mm):.3f} mm too {way}, tilted by {x:+.3f} deg about x and {y:+.3f} deg about y"


@dataclass(frozen=True, slots=True)
class HandlingStep:
    """Something that a person or a program does while the tool is up and nothing moves."""

    person: str = ""
    """What the person is asked to do; empty: the command does it."""
    command: tuple[str, ...] = ()
    folder: Path = Path()
    """Where the command runs."""
    within_s: float = 600.0


@dataclass(frozen=True, slots=True)
class SettleRule:
    """When a part counts as settled: two maps in a row agree."""

    limit_nm: float
    """RMS of their difference in the clear aperture, levelled."""
    maps: int
    """Most that are taken for it."""
    wait_s: float
    """Between two of them."""


@dataclass(frozen=True, slots=True)
class BetweenPasses:
    """What happens between passes; None: nothing."""

    clean: HandlingStep | None = None
    settle: SettleRule | None = None
    condition: HandlingStep | None = None
    change: HandlingStep = HandlingStep()
    """Of the tool, where there are several; one that says nothing: a person mounts it."""


NOTHING = BetweenPasses()
