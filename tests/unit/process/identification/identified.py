"""Small independent process model for the tests of identification: sums elliptic Gaussian spots one by one.

It shares no code with polishd.process: the effect of each parameter is written here once more.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy import ndimage

from polishd.model.process import MeasuredTif, ToolProcess
from polishd.model.surface import BoolArray, FloatArray, Grid
from polishd.process.identification.identify import IdentificationResult, identify
from polishd.process.identification.parameters import (
    ExecutedBlocks,
    Parameter,
    PriorKnowledge,
    RemovalMap,
    RemovalNoise,
    initial_knowledge,
    usual_parameters,
)
from polishd.process.removal.tif import MeasuredSpot, measured_spot

SIZES_MM = (1.2, 2.0)
"""Standard deviations of the spot along its own x and y (y where the spindle leans)."""
PEAK_NM_S = 20.0
RADIUS_MM = 16.0
BEYOND_MM = 23.0
"""Half width of the raster: beyond it no spot reaches the disc."""
PITCH_MM = 1.0
NODE = np.array([-1.0, 1.0]) / np.sqrt(12) * PITCH_MM
"""Two Gauss points a cell and way: a sample is the mean over its cell."""
PROCESS = ToolProcess()


@dataclass(frozen=True)
class Polished:
    """Dwells at n points of a disc, with their removal."""

    place: FloatArray
    time: FloatArray
    azimuth: FloatArray
    gamma: FloatArray
    noise: float = 0.3

    def removed(self, truth: Mapping[str, float], seed: int | None = 0) -> RemovalMap:
        """Return the removal as an instrument measures it; without noise where the seed is None."""
        return seen(removal(self, truth), self.noise, seed)

    def blocks(self, **other: FloatArray) -> ExecutedBlocks:
        """Return the blocks as the controller models them: ``other`` gammas by projection."""
        return ExecutedBlocks(self.place, self.place, self.time, self.azimuth, {"linear": self.gamma, **other})

    def identified(
        self, truth: Mapping[str, float], names: str = "", seed: int = 0, prior: PriorKnowledge | None = None
    ) -> IdentificationResult:
        """What is found where this is true, with the rate, piston, tilt and the parameters or extensions named."""
        return found(self.removed(truth, seed), self.blocks(), prior or knowing(names))


def found(removed: RemovalMap, blocks: ExecutedBlocks, prior: PriorKnowledge) -> IdentificationResult:
    """What is found; the dwell did not follow any map's noise."""
    return identify(removed, blocks, spot(), PROCESS, prior, projection="linear", radius_mm=RADIUS_MM, followed=False)


def knowing(names: str = "") -> PriorKnowledge:
    """Nothing but the priors of the rate, piston, tilt and of the parameters or extensions named."""
    wanted = {"rate", "piston", "tilt_x", "tilt_y", *names.split()}
    return initial_knowledge([p for p in all_parameters() if {p.name, (p.extension or "").split(" ")[0]} & wanted])


def all_parameters() -> tuple[Parameter, ...]:
    return usual_parameters()


EVERYTHING = "field wear offset turn width compliance exponent shift rotation power"


@cache
def polished(
    seed: int = 1, *, lean: str = "turning", gamma_span: float = 0.2, time: str = "varied", smooth: bool = False
) -> Polished:
    """A raster of 1 mm over the disc and beyond.

    lean: the azimuth is "fixed", or "turning" by 100 degrees over the part.
    gamma_span: of the depth ratio about 0.85.
    smooth: it falls evenly along x, as on a small part; else it is wavy.
    time: "varied" with the place, "even", or "stripes" along x.
    """
    rng = np.random.default_rng(seed)
    axis = np.arange(-BEYOND_MM, BEYOND_MM + 0.5)
    x, y = np.meshgrid(axis, axis[::-1])
    place = np.column_stack([x.ravel(), y.ravel()])
    place = place[np.hypot(*place.T) <= BEYOND_MM]
    wavy = ndimage.gaussian_filter(rng.standard_normal((len(axis), len(axis))), 2.0, mode="wrap")
    at = (BEYOND_MM - place[:, 1]).astype(int), (place[:, 0] + BEYOND_MM).astype(int)
    even = np.full(len(place), 0.6)
    waves = {"varied": wavy[at] / wavy.std(), "even": 0 * even, "stripes": np.sin(place[:, 1])}[time]
    dwell = even * (1 + 0.25 * waves).clip(0.1)
    azimuth = np.full(len(place), 0.6) + (np.radians(100) * place[:, 0] / 40 if lean == "turning" else 0.0)
    wave = place[:, 0] / BEYOND_MM if smooth else np.sin(place[:, 0] / 5) * np.cos(place[:, 1] / 7)
    gamma = 0.85 + gamma_span / 2 * wave
    return Polished(place, dwell, azimuth, gamma)


@cache
def spot() -> MeasuredSpot:
    """The spot as the controller was given it: a map of it at gamma 1, leaning along y.

    Each sample covers a square, which widens the spot; the sampled spot is narrower by that.
    """
    pitch = 0.3
    fine = (np.arange(61) - 30) * pitch
    x_size, y_size = (np.sqrt(size**2 - pitch**2 / 12) for size in SIZES_MM)
    peak = PEAK_NM_S * SIZES_MM[0] * SIZES_MM[1] / x_size / y_size
    rate = peak * np.exp(-(fine[None, :] ** 2) / 2 / x_size**2 - fine[:, None] ** 2 / 2 / y_size**2)
    return measured_spot(MeasuredTif(np.where(rate > 1e-4 * peak, rate, 0.0), pitch, azimuth_deg=90.0), PROCESS)


@cache
def disc() -> tuple[Grid, BoolArray]:
    grid = Grid(33, 33, PITCH_MM)
    return grid, grid.radius_mm() <= RADIUS_MM


def removal(one: Polished, truth: Mapping[str, float]) -> FloatArray:
    """(33, 33) nm: the sum of all spots, and what the instrument adds."""
    true = dict.fromkeys((p.name for p in all_parameters()), 0.0) | dict(truth)
    grid, mask = disc()
    compliance = np.exp(true["compliance"])
    gamma = 1 - compliance * (1 - one.gamma)
    hours = (np.cumsum(one.time) - one.time / 2) / 3600
    x, y = one.place.T / RADIUS_MM
    square = x**2 + y**2
    terms = [2 * x, 2 * y, np.sqrt(3) * (2 * square - 1), np.sqrt(6) * 2 * x * y, np.sqrt(6) * (x**2 - y**2)]
    terms += [np.sqrt(8) * (3 * square - 2) * y, np.sqrt(8) * (3 * square - 2) * x]
    terms += [np.sqrt(8) * (3 * x**2 * y - y**3), np.sqrt(8) * (x**3 - 3 * x * y**2)]
    field = sum(true[f"field_{k}"] * term for k, term in enumerate(terms, 2))
    rate = PEAK_NM_S * np.exp(true["rate"] + field - true["wear"] * hours) * gamma ** (0.5 + true["exponent"])
    # the volume goes as gamma^1.5, the spot's area as gamma: so the peak as gamma^0.5
    turn, rotation = np.radians(true["turn"]), np.radians(true["rotation"])
    lean = one.azimuth + turn + rotation
    middle = one.place @ np.array([[np.cos(rotation), np.sin(rotation)], [-np.sin(rotation), np.cos(rotation)]])
    along = np.column_stack([np.cos(lean), np.sin(lean)])
    across = np.column_stack([np.sin(lean), -np.cos(lean)])
    middle = middle + true["offset_x"] * across + true["offset_y"] * along + [true["shift_x"], true["shift_y"]]
    wide = np.sqrt(gamma) * np.exp(true["width"])
    rows, columns = np.nonzero(mask)
    total = np.zeros(rows.size)
    for dx in NODE:
        for dy in NODE:
            to = np.stack([grid.x_mm[columns] + dx, grid.y_mm[rows] + dy], axis=1)[:, None, :] - middle[None, :, :]
            u, v = (
                np.einsum("mnk,nk->mn", to, way) / wide / size
                for way, size in zip((across, along), SIZES_MM, strict=True)
            )
            total += np.exp(-(u**2 + v**2) / 2) @ (rate * one.time * np.exp(-2 * true["width"])) / 4
    u, v = grid.x_mm[columns] / RADIUS_MM, grid.y_mm[rows] / RADIUS_MM
    total += true["piston"] + 2 * true["tilt_x"] * u + 2 * true["tilt_y"] * v
    total += true["power"] * np.sqrt(3) * (2 * (u**2 + v**2) - 1)
    whole = np.full(mask.shape, np.nan)
    whole[mask] = total
    return whole


def seen(removal_nm: FloatArray, sigma_nm: float, seed: int | None) -> RemovalMap:
    """The removal with white noise, as two maps show it."""
    grid, mask = disc()
    noise = 0.0 if seed is None else np.random.default_rng(seed).normal(0.0, sigma_nm, mask.shape)
    return RemovalMap(grid, removal_nm + noise, mask, RemovalNoise(sigma_nm))


def slower(one: Polished, factor: float) -> Polished:
    """Return the pass with all times and hours of contact multiplied, and map noise in proportion to the removal."""
    return replace(one, time=one.time * factor, noise=one.noise * max(1.0, factor))
