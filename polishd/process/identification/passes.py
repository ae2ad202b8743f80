"""A pass as identification sees it: the blocks that were executed, and the removal that two maps show."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import scipy

from polishd.model.beliefs import MapPixels
from polishd.model.errors import ComputeError
from polishd.model.process import ToolProcess
from polishd.model.surface import BoolArray, FloatArray, Grid
from polishd.process.contact import relative_removal
from polishd.process.registration.record import Registration
from polishd.process.registration.resampling import averaging
from polishd.process.robot.refusal import refuse_where, require_number

FEWEST = 50
"""Samples with data below which nothing is identified."""


@dataclass(frozen=True, slots=True)
class ExecutedBlocks:
    """n executed blocks in time order, in the part's frame."""

    start_mm: FloatArray
    """(n, 2) x and y where each began."""
    end_mm: FloatArray
    """(n, 2)"""
    time_s: FloatArray
    """(n,) s executed in contact."""
    azimuth_rad: FloatArray
    """(n,) where the spindle leaned, counterclockwise from x."""
    depth_ratio: Mapping[str, FloatArray]
    """By projection of the compliance, (n,) gamma of each block: what is to be told apart."""
    factor: FloatArray | None = None
    """(n,) on the removal, as of `dynamic_tif.corrected_spot`; None: 1."""
    force_n: FloatArray | None = None
    """(n,) N measured, NaN where not; None: the process's own."""
    rpm: FloatArray | None = None
    """(n,) 1/min measured, likewise."""
    wider: FloatArray | None = None
    """(n,) by which the part's curvature makes each spot wider; None: on a flat."""

    @property
    def contact_h(self) -> FloatArray:
        """(n,) h of contact in the pass up to the middle of each block."""
        return np.asarray((np.cumsum(self.time_s) - self.time_s / 2) / 3600, dtype=np.float64)

    def weight_s(self, process: ToolProcess) -> FloatArray:
        """(n,) s that count: executed, by what force and speed really were."""
        unknown = np.full(self.time_s.shape, np.nan)
        force = unknown if self.force_n is None else self.force_n
        rpm = unknown if self.rpm is None else self.rpm
        own = 1.0 if self.factor is None else self.factor
        return np.asarray(self.time_s * own * relative_removal(process, force, rpm), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class RemovalNoise:
    """Noise of a removal map: its size at a sample, and the area over which it is one and the same."""

    sigma_nm: float
    """Of a sample of the difference: sqrt(2) times a map's."""
    area_mm2: float = 0.0
    """Integral of its autocorrelation; at least a sample's cell. White noise: 0."""

    def cells(self, pitch_mm: float) -> float:
        """Samples that count as one: the noise of a smooth mean over the map is so many times the white one's."""
        return max(1.0, self.area_mm2 / pitch_mm**2)

    def with_another(self, other: RemovalNoise, pitch_mm: float) -> RemovalNoise:
        """Both together, where one knows nothing of the other: their variances add, over each one's area."""
        square = np.array([self.sigma_nm, other.sigma_nm]) ** 2
        cells = np.array([self.cells(pitch_mm), other.cells(pitch_mm)])
        both = float(square.sum())
        return RemovalNoise(float(np.sqrt(both)), float(square @ cells) / both * pitch_mm**2)


@dataclass(frozen=True, slots=True)
class MapPixelData:
    """The maps' own samples, and what was made of them."""

    at: MapPixels
    means: scipy.sparse.csr_array
    """(ny * nx, pixels) of each sample of the removal, `registration.resampling.averaging`."""

    def laid(self, place_mm: FloatArray) -> FloatArray:
        """(n, 2) mm from the middle of the map, of places (n, 2) on the part."""
        turn = self.turn_rad
        rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])  # of rows
        return np.asarray(place_mm @ rotation + self.at.shift_mm, dtype=np.float64)

    @property
    def turn_rad(self) -> float:
        """Of the part in the map, counter-clockwise."""
        return float(np.radians(self.at.rotation_deg))


@dataclass(frozen=True, slots=True)
class RemovalMap:
    """What two maps say was removed."""

    grid: Grid
    removal_nm: FloatArray
    """(ny, nx) map before less map after, positive = removed; up to piston and tilt."""
    mask: BoolArray
    """(ny, nx) where it counts and has data."""
    noise: RemovalNoise
    pixels: MapPixelData | None = None
    """None: each sample is the mean over its own cell."""

    def coarser(self, odd: int) -> RemovalMap:
        """Means over squares of ``odd`` by ``odd`` samples, of which at least half have data; the middle stays."""
        if odd < 1 or odd % 2 == 0:
            raise ComputeError(f"a map is made coarser by an odd whole factor, not by {odd}")
        if odd == 1:
            return self
        grid = self.grid
        ny, nx = (n // odd + (n // odd + n) % 2 for n in grid.shape)  # as odd or even as the map: one middle
        pads = [((odd * m - n) // 2) for m, n in zip((ny, nx), grid.shape, strict=True)]

        def summed(values: FloatArray) -> FloatArray:
            for axis, pad in enumerate(pads):
                width = [(max(pad, 0),) * 2 if k == axis else (0, 0) for k in range(2)]
                values = np.pad(values, width)
                values = np.take(values, range(max(-pad, 0), values.shape[axis] - max(-pad, 0)), axis=axis)
            return np.asarray(values.reshape(ny, odd, nx, odd).sum(axis=(1, 3)), dtype=np.float64)

        count = summed(self.mask.astype(np.float64))
        total = summed(np.where(self.mask, self.removal_nm, 0.0))
        cells = self.noise.cells(grid.pitch_mm)
        noise = RemovalNoise(self.noise.sigma_nm * min(1.0, np.sqrt(cells) / odd), self.noise.area_mm2)
        mask = count >= odd**2 / 2
        coarse = Grid(ny, nx, grid.pitch_mm * odd)
        pixels = self.pixels
        if pixels is not None:
            means = averaging(grid, coarse, Registration()) @ pixels.means
            pixels = replace(pixels, means=scipy.sparse.csr_array(means))
        return RemovalMap(coarse, np.where(mask, total / np.maximum(count, 1), 0.0), mask, noise, pixels)


def check_pass(blocks: ExecutedBlocks, removed: RemovalMap, projection: str) -> None:
    """ComputeError that says what of a pass cannot be."""
    n = len(blocks.time_s)
    arrays = {"start_mm": blocks.start_mm, "end_mm": blocks.end_mm, "azimuth_rad": blocks.azimuth_rad}
    arrays |= {f"depth_ratio {name}": gamma for name, gamma in blocks.depth_ratio.items()}
    arrays |= {
        name: found
        for name, found in (("factor", blocks.factor), ("force_n", blocks.force_n), ("rpm", blocks.rpm))
        if found is not None
    }
    for name, array in arrays.items():
        if len(array) != n:
            raise ComputeError(f"the blocks have {n} times and {len(array)} of {name}: give one to each block")
    if projection not in blocks.depth_ratio:
        raise ComputeError(f"no gamma is given for the projection {projection!r}; there are {list(blocks.depth_ratio)}")
    refuse_where(
        ~((blocks.time_s >= 0) & np.isfinite(blocks.time_s)),
        blocks.time_s,
        "the executed time",
        "s",
        "it must be finite and not negative",
    )
    if not blocks.time_s.any():
        raise ComputeError("no block was executed: there is nothing to identify")
    require_number("the noise of the removal map", removed.noise.sigma_nm, "nm", above=0.0)
    for name, shape in (("removal_nm", removed.removal_nm.shape), ("mask", removed.mask.shape)):
        if shape != removed.grid.shape:
            raise ComputeError(f"the grid is {removed.grid.shape}, the removal's {name} {shape}: give the grid's own")
    if np.count_nonzero(removed.mask) < FEWEST:
        raise ComputeError(f"{np.count_nonzero(removed.mask)} samples have data: at least {FEWEST} are needed")
    if not np.isfinite(removed.removal_nm[removed.mask]).all():
        raise ComputeError("the removal is not finite everywhere in its mask: take drop-outs out of the mask")
