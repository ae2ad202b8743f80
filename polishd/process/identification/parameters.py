"""Parameters of the identification, and their knowledge from pass to pass."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import scipy

from polishd.model.errors import ComputeError
from polishd.model.estimates import MapPixels
from polishd.model.process import ToolProcess
from polishd.model.surface import BoolArray, FloatArray, Grid
from polishd.process.checks import refuse_where, require_number
from polishd.process.metrology.resampling import Registration, averaging_matrix
from polishd.process.removal.contact import relative_removal

Scope = Literal["map", "mount", "tool", "cell"]
"""Scope of a parameter, with which it starts anew: a map, a mounted part, a tool, or never."""
FIELD_ORDER = 3
"""Largest radial order of the rate's field."""
INSTRUMENT = ("piston", "tilt_x", "tilt_y", "power")
"""Differences of two maps without removal, in Noll's order; ``astigmatism_45``, ``astigmatism_0`` may follow."""
ABERRATIONS = (*INSTRUMENT, "astigmatism_45", "astigmatism_0")
LARGE_NM = 300.0
"""Prior of piston and tilt: above any map's, small enough for float64."""
DRIFT_NM = 3.0
"""Prior RMS of power and astigmatism by which two maps of one part differ."""


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter of the process; 0 is the configured process."""

    name: str
    unit: str
    sigma: float
    """Prior standard deviation."""
    scope: Scope
    use: float = 0.0
    """Random walk in an hour of contact; in n hours sqrt(n) times this."""
    rest: float = 0.0
    """Likewise in a day."""
    extension: str | None = None
    """Extension of the model that contains it; None: always fitted."""
    words: str = ""
    """Description for messages."""


@dataclass(frozen=True, slots=True)
class PriorKnowledge:
    """Normal distribution of k parameters."""

    parameters: tuple[Parameter, ...]
    mean: FloatArray
    """(k,) in the parameters' units."""
    covariance: FloatArray
    """(k, k)"""
    odds: Mapping[str, float] = field(default_factory=dict)
    """By projection of the compliance (or another choice): natural logarithm of its odds, up to a constant."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters."""
        return tuple(p.name for p in self.parameters)

    @property
    def sigma(self) -> FloatArray:
        """(k,) standard errors."""
        return np.sqrt(np.diag(self.covariance))

    def at(self, name: str) -> int:
        """Index of a parameter; KeyError where it is not among them."""
        try:
            return self.names.index(name)
        except ValueError:
            raise KeyError(f"no parameter {name!r}; there are {', '.join(self.names)}") from None


def usual_parameters(instrument: Iterable[str] = INSTRUMENT, *, turns: bool = True) -> tuple[Parameter, ...]:
    """Return all parameters with the priors of docs/explanation/identification.md.

    Args:
        instrument: what maps may differ by.
        turns: whether the spot has a shape that turns. A sphere's contact is round: its turn is an offset of what it
            removes, and all else of it smaller than what laying it on samples costs.
    """
    turn = Parameter("turn", "deg", 5.0, "tool", 0.1, 0.1, "turn", "spot's turn about the normal")
    return (
        Parameter("rate", "1", 0.3, "tool", 0.02, 0.03, None, "removal rate, natural logarithm"),
        *_field(),
        Parameter("wear", "1/h", 0.5, "tool", 0.05, 0.0, "wear", "loss of rate an hour of contact"),
        Parameter("offset_x", "mm", 1.0, "tool", 0.01, 0.01, "offset", "spot's offset across the lean"),
        Parameter("offset_y", "mm", 1.0, "tool", 0.01, 0.01, "offset", "spot's offset along the lean"),
        *((turn,) if turns else ()),
        Parameter("width", "1", 0.1, "tool", 0.01, 0.0, "width", "spot's width, natural logarithm"),
        Parameter("compliance", "1", 0.3, "cell", 0.005, 0.005, "compliance", "scale of the compliance, natural log."),
        Parameter("exponent", "1", 0.5, "cell", 0.0, 0.005, "exponent", "gamma's exponent, beside the spot's own"),
        Parameter("shift_x", "mm", 0.3, "mount", 0.0, 0.0, "shift", "seat or registration, along x"),
        Parameter("shift_y", "mm", 0.3, "mount", 0.0, 0.0, "shift", "seat or registration, along y"),
        Parameter("rotation", "deg", 0.3, "mount", 0.0, 0.0, "rotation", "seat or registration, turned"),
        *(_aberration(name) for name in instrument),
    )


def initial_knowledge(parameters: Sequence[Parameter]) -> PriorKnowledge:
    """Return the knowledge before any measurement: all 0, each with its prior."""
    prior = np.array([p.sigma for p in parameters])
    return PriorKnowledge(tuple(parameters), np.zeros(len(prior)), np.diag(prior**2))


def knowledge_before_pass(
    known: PriorKnowledge, contact_h: float, days: float = 0.0, anew: Iterable[Scope] = ("map",)
) -> PriorKnowledge:
    """Return the knowledge at the begin of the next pass.

    A tool that wears loses its rate (``rate -= contact_h * wear``, exactly, with the covariance). Each parameter walks
    at random by its own use and rest, up to its prior; those of the scopes ``anew`` begin again.

    Args:
        known: after a pass.
        contact_h: h that the tool was in contact in it.
        days: since.
        anew: scopes of what was changed; "map" always is.
    """
    step = np.eye(len(known.mean))
    if {"rate", "wear"} <= set(known.names):
        step[known.at("rate"), known.at("wear")] = -contact_h
    mean, covariance = step @ known.mean, step @ known.covariance @ step.T
    prior = np.array([p.sigma**2 for p in known.parameters])
    walk = np.array([p.use**2 * contact_h + p.rest**2 * days for p in known.parameters])
    covariance = covariance + np.diag(np.clip(prior - np.diag(covariance), 0.0, walk))
    new = np.array([p.scope in {"map", *anew} for p in known.parameters])
    mean[new], covariance[new, :], covariance[:, new] = 0.0, 0.0, 0.0
    covariance[new, new] = prior[new]
    return replace(known, mean=mean, covariance=covariance)


def _field() -> Iterable[Parameter]:
    """Zernike terms 2 ... of Noll's order over the unit circle, RMS 1 there: the relative rate's own RMS."""
    term = 2
    for order in range(1, FIELD_ORDER + 1):
        for _ in range(order + 1):
            words = f"rate over the part, Zernike term {term}"
            yield Parameter(f"field_{term}", "1", 0.1 / order, "cell", 0.01, 0.005, f"field {order}", words)
            term += 1


def _aberration(name: str) -> Parameter:
    sigma = LARGE_NM if name in INSTRUMENT[:3] else DRIFT_NM
    return Parameter(name, "nm", sigma, "map", words=f"{name.replace('_', ' ')} between the maps, RMS")


# Input of the identification: executed blocks, and the removal from two maps.

FEWEST = 50
"""Least number of samples with data."""


@dataclass(frozen=True, slots=True)
class ExecutedBlocks:
    """n executed blocks in time order, in the part's frame."""

    start_mm: FloatArray
    """(n, 2) x and y of each start."""
    end_mm: FloatArray
    """(n, 2)"""
    time_s: FloatArray
    """(n,) s executed in contact."""
    azimuth_rad: FloatArray
    """(n,) direction of the spindle's lean, counterclockwise from x."""
    depth_ratio: Mapping[str, FloatArray]
    """By projection of the compliance, (n,) gamma of each block."""
    factor: FloatArray | None = None
    """(n,) on the removal, as of `dynamic_tif.tif_at_point`; None: 1."""
    force_n: FloatArray | None = None
    """(n,) measured N, NaN where unknown; None: the process's force."""
    rpm: FloatArray | None = None
    """(n,) measured 1/min, likewise."""
    wider: FloatArray | None = None
    """(n,) factor of the part's curvature on each spot's width; None: on a flat."""

    @property
    def contact_h(self) -> FloatArray:
        """(n,) h of contact in the pass up to the middle of each block."""
        return np.asarray((np.cumsum(self.time_s) - self.time_s / 2) / 3600, dtype=np.float64)

    def weight_s(self, process: ToolProcess) -> FloatArray:
        """(n,) s weighted by measured over configured force and speed."""
        unknown = np.full(self.time_s.shape, np.nan)
        force = unknown if self.force_n is None else self.force_n
        rpm = unknown if self.rpm is None else self.rpm
        own = 1.0 if self.factor is None else self.factor
        return np.asarray(self.time_s * own * relative_removal(process, force, rpm), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class RemovalNoise:
    """Noise of a removal map: its size at a sample, and its correlation area."""

    sigma_nm: float
    """Noise of a sample of the difference: sqrt(2) times a map's."""
    area_mm2: float = 0.0
    """Integral of its autocorrelation; at least a sample's cell. White noise: 0."""

    def cells(self, pitch_mm: float) -> float:
        """Return the correlation area in samples, at least 1."""
        return max(1.0, self.area_mm2 / pitch_mm**2)

    def with_another(self, other: RemovalNoise, pitch_mm: float) -> RemovalNoise:
        """Return the sum of two independent noises: their variances add, over each one's area."""
        square = np.array([self.sigma_nm, other.sigma_nm]) ** 2
        cells = np.array([self.cells(pitch_mm), other.cells(pitch_mm)])
        both = float(square.sum())
        return RemovalNoise(float(np.sqrt(both)), float(square @ cells) / both * pitch_mm**2)


@dataclass(frozen=True, slots=True)
class MapPixelData:
    """Pixels of the maps, and the averaging to the removal's samples."""

    at: MapPixels
    means: scipy.sparse.csr_array
    """(ny * nx, pixels) of each sample of the removal, `resampling.averaging_matrix`."""

    def laid(self, place_mm: FloatArray) -> FloatArray:
        """(n, 2) mm from the map's center, of points (n, 2) on the part."""
        turn = self.turn_rad
        rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])  # of rows
        return np.asarray(place_mm @ rotation + self.at.shift_mm, dtype=np.float64)

    @property
    def turn_rad(self) -> float:
        """Turn of the part in the map, counterclockwise."""
        return float(np.radians(self.at.rotation_deg))


@dataclass(frozen=True, slots=True)
class RemovalMap:
    """Removal as two maps show it."""

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
            means = averaging_matrix(grid, coarse, Registration()) @ pixels.means
            pixels = replace(pixels, means=scipy.sparse.csr_array(means))
        return RemovalMap(coarse, np.where(mask, total / np.maximum(count, 1), 0.0), mask, noise, pixels)


def check_pass(blocks: ExecutedBlocks, removed: RemovalMap, projection: str) -> None:
    """Raise ComputeError for an inconsistent pass."""
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
