"""The true part: its surface with the waster ring around it, drawn from the seed or taken from a measured map."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy import ndimage, optimize

from polishd.config.simulator import Plant, SimConfig
from polishd.model.outline import Circle
from polishd.model.surface import BoolArray, FloatArray, Grid
from polishd.sim_backends import metropro

FIGURE_MM = (30.0, 160.0)
MIDDLE_MM = (9.5, 30.0)
MIDDLE_SHARE = 0.15
"""RMS of the middle periods relative to the figure."""
BUMP_SIGMA_MM = 4.5
BEYOND_MM = 2.0
"""So far beyond straight sides the map goes on: a side that the map ends with is not seen as the part's."""


@dataclass(slots=True)
class TruePart:
    """Heights in nm on a grid that is ``pad`` cells wider than the part's map on each side."""

    grid: Grid
    height_nm: FloatArray
    pad: int
    valid: BoolArray
    """(map rows, map columns): where the instrument sees the part."""
    clear: BoolArray
    """The clear aperture, same shape."""
    origin_px: tuple[int, int] = (0, 0)
    start_nm: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))

    def __post_init__(self) -> None:
        """Keep the start."""
        self.start_nm = self.height_nm.copy()

    def map_nm(self) -> FloatArray:
        """What a perfect instrument would show."""
        frame = self.height_nm[self.pad : -self.pad, self.pad : -self.pad]
        return np.where(self.valid, frame, np.nan)

    def write(self, path: Path) -> None:
        """As an .npz file, replaced whole."""
        beside = path.with_name(f".{path.name}")
        with beside.open("wb") as file:
            np.savez(
                file,
                height_nm=self.height_nm,
                start_nm=self.start_nm,
                valid=self.valid,
                clear=self.clear,
                pad=self.pad,
                pitch_mm=self.grid.pitch_mm,
            )
        beside.replace(path)

    def stats(self) -> tuple[float, float]:
        """True RMS and PV in the clear aperture, nm, less its plane: how a part lies is nobody's error."""
        seen = _seen(self, _level(self, self.height_nm))
        return float(seen.std()), float(np.ptp(seen))


def make(config: Plant, seed: int) -> TruePart:
    """A part with figure and middle-frequency errors, RMS and PV as configured, flush with its ring."""
    pitch = config.pitch_mm
    beyond = 0.0 if isinstance(config.outline, Circle) else BEYOND_MM
    nx, ny = (2 * math.ceil((half + beyond) / pitch) + 1 for half in config.outline.half_mm)
    pad = math.ceil(config.ring_mm / pitch)
    grid, frame = Grid(ny + 2 * pad, nx + 2 * pad, pitch), Grid(ny, nx, pitch)
    valid = config.outline.contains(*frame.axes_mm, -1e-9)
    clear = config.outline.contains(*frame.axes_mm, config.edge_mm - 1e-9)
    part = TruePart(grid, np.zeros(grid.shape), pad, valid, clear)
    part.height_nm = _errors(part, config, np.random.default_rng([seed, 2]))
    part.start_nm = part.height_nm.copy()
    return part


def from_map(path: Path, config: Plant) -> TruePart:
    """A part that starts as a measured map shows it; holes are filled smoothly and stay unseen by the instrument."""
    data = metropro.read(path)
    rows, columns = data.height_nm.shape
    pad = math.ceil(config.ring_mm / data.pitch_mm)
    grid = Grid(rows + 2 * pad, columns + 2 * pad, data.pitch_mm)
    valid = np.isfinite(data.height_nm)
    outline = ndimage.binary_fill_holes(valid)
    inside = ndimage.distance_transform_edt(np.pad(outline, 1))[1:-1, 1:-1] * data.pitch_mm
    height = fill(np.pad(data.height_nm, pad, constant_values=np.nan))
    return TruePart(grid, height, pad, valid, valid & (inside > config.edge_mm), data.origin_px)


def swelling_nm(part: TruePart, config: SimConfig, since_s: float) -> FloatArray:
    """(map rows, map columns) by which the part stands higher so long after a pass (simulated clock): it is warm."""
    rows, columns = part.valid.shape
    radius = Grid(rows, columns, part.grid.pitch_mm).radius_mm() / config.plant.outline.radius_mm
    return np.asarray(config.truth.warm_nm * math.exp(-since_s / config.truth.warm_s) * radius**2)


def fill(height_nm: FloatArray) -> FloatArray:
    """Replace NaN by weighted means of what is near, from fine scales to coarse ones."""
    known = np.isfinite(height_nm)
    filled = np.where(known, height_nm, 0.0)
    missing = ~known
    sigma = 1.5
    while missing.any():
        weight = ndimage.gaussian_filter(known.astype(np.float64), sigma, truncate=3.0)
        mean = ndimage.gaussian_filter(np.where(known, height_nm, 0.0), sigma, truncate=3.0)
        take = missing & (weight > 1e-2)
        filled[take] = mean[take] / weight[take]
        missing &= ~take
        sigma *= 2.0
    return filled


def _errors(part: TruePart, config: Plant, rng: np.random.Generator) -> FloatArray:
    grid = part.grid
    figure = _level(part, _band(grid, FIGURE_MM, rng))
    middle = _level(part, _band(grid, MIDDLE_MM, rng))
    base = figure / _rms(part, figure) + MIDDLE_SHARE * middle / _rms(part, middle)
    base /= _rms(part, base)
    if config.rms_nm == 0.0:
        return np.zeros(grid.shape)
    angle, radius = rng.uniform(0.0, math.tau), rng.uniform(0.2, 0.6) * min(config.outline.half_mm)
    centre = radius * math.cos(angle), radius * math.sin(angle)
    distance = np.hypot(grid.x_mm[None, :] - centre[0], grid.y_mm[:, None] - centre[1])
    bump = _level(part, np.exp(-0.5 * (distance / BUMP_SIGMA_MM) ** 2))
    target = config.pv_nm / config.rms_nm

    def excess(amount: float) -> float:
        seen = _seen(part, base + amount * bump)
        return float(np.ptp(seen) / seen.std()) - target

    amounts = np.linspace(0.0, 20.0, 81)
    values = [excess(float(amount)) for amount in amounts]
    above = next((k for k, value in enumerate(values) if value >= 0.0), None)
    amount = float(amounts[int(np.argmax(values))]) if above is None else float(amounts[above])
    if above:
        amount = float(optimize.brentq(excess, amounts[above - 1], amounts[above]))
    shape = base + amount * bump
    return np.asarray(shape * (config.rms_nm / _rms(part, shape)))


def _band(grid: Grid, period_mm: tuple[float, float], rng: np.random.Generator) -> FloatArray:
    """Noise with periods in the band, amplitude falling as the square of the frequency."""
    ny, nx = 2 * grid.ny, 2 * grid.nx
    fy = np.fft.fftfreq(ny, grid.pitch_mm)[:, None]
    fx = np.fft.rfftfreq(nx, grid.pitch_mm)[None, :]
    frequency = np.hypot(fx, fy)
    inside = (frequency >= 1.0 / period_mm[1]) & (frequency <= 1.0 / period_mm[0])
    weight = np.where(inside, 1.0 / np.maximum(frequency, 1e-9) ** 2, 0.0)
    spectrum = np.fft.rfft2(rng.standard_normal((ny, nx))) * weight
    return np.asarray(np.fft.irfft2(spectrum, s=(ny, nx))[: grid.ny, : grid.nx])


def _seen(part: TruePart, height: FloatArray) -> FloatArray:
    return np.asarray(height[part.pad : -part.pad, part.pad : -part.pad][part.clear])


def _rms(part: TruePart, height: FloatArray) -> float:
    return float(_seen(part, height).std())


def _level(part: TruePart, height: FloatArray) -> FloatArray:
    """Remove the plane that the clear aperture sees."""
    x, y = np.meshgrid(part.grid.x_mm, part.grid.y_mm)
    columns = np.stack([np.ones(part.clear.sum()), _seen(part, x), _seen(part, y)], axis=1)
    c, sx, sy = np.linalg.lstsq(columns, _seen(part, height), rcond=None)[0]
    return np.asarray(height - (c + sx * x + sy * y))
