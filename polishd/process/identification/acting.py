"""What the parameters make of blocks: where they lie, how deep they go, and how fast they remove. 0 changes nothing."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping

import numpy as np

from polishd.model.surface import FloatArray
from polishd.process.metrics import zernike_terms
from polishd.process.spot import Spot, WiderSpot, rotate_spot

FIELD = "field_"
"""What the rate's terms over the part begin with; Noll's number follows."""
MOVING = ("offset_x", "offset_y", "shift_x", "shift_y", "turn", "rotation")
LEAST_RATIO = 0.01
"""Depth ratio below which no compliance sinks a block."""


class ParameterAction:
    """Values of parameters, by name (`parameters.usual_parameters`); one that is not named is 0."""

    def __init__(self, values: Mapping[str, float]) -> None:
        """The values, in the parameters' units."""
        self.at: Mapping[str, float] = defaultdict(float, values)

    @property
    def moves(self) -> bool:
        """Whether any point lies elsewhere than where it was programmed, or any lean."""
        return any(self.at[name] for name in MOVING)

    def laid(self, place_mm: FloatArray, azimuth_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n, 2) mm where programmed points really are, and (n,) rad where the spindle leans there."""
        at = self.at
        lean = azimuth_rad + np.radians(at["turn"] + at["rotation"])
        angle = np.radians(at["rotation"])
        rotation = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])  # of rows
        off = rotate_spot(at["offset_x"], at["offset_y"], lean)
        return place_mm @ rotation + off + [at["shift_x"], at["shift_y"]], lean

    def sunk(self, depth_ratio: FloatArray) -> FloatArray:
        """(n,) depth ratios: ``1 - exp(compliance) (1 - gamma)``."""
        return np.asarray(np.maximum(1 - np.exp(self.at["compliance"]) * (1 - depth_ratio), LEAST_RATIO))

    def spot(self, spot: Spot) -> Spot:
        """As wide as it is."""
        return WiderSpot(spot, float(np.exp(self.at["width"]))) if self.at["width"] else spot

    def log_rate(self, depth_ratio: FloatArray, contact_h: FloatArray) -> FloatArray:
        """(n,) natural logarithm of each block's rate over the configured one, but for its place: at these ratios."""
        at = self.at
        return np.asarray(at["rate"] - at["wear"] * contact_h + at["exponent"] * np.log(depth_ratio))

    def log_field(self, place_mm: FloatArray, radius_mm: float) -> FloatArray:
        """(n,) what the place adds to that: Zernike terms over the circle of that radius about the part's origin."""
        names = [name for name, value in self.at.items() if name.startswith(FIELD) and value]
        values = np.array([self.at[name] for name in names])
        return values @ zernike_field([int(name.removeprefix(FIELD)) for name in names], place_mm / radius_mm)


def zernike_field(terms: list[int], place: FloatArray) -> FloatArray:
    """(t, n) terms of Noll's order at (n, 2) places over the radius: RMS 1 over the circle, and on beyond it."""
    if not terms:
        return np.zeros((0, len(place)))
    pairs = zernike_terms.order("noll", max(terms))
    return zernike_terms.values([pairs[k - 1] for k in terms], "rms", place[:, 0], place[:, 1])
