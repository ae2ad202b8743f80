"""The true part: its surface with the waster ring around it, drawn from the seed or taken from a measured map."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy import ndimage, optimize

from polishd.config.simulator import SimConfig
from polishd.config.simulator_physics import Plant
from polishd.model.outline import Circle
from polishd.model.surface import BoolArray, FloatArray, Grid
from polishd.sim_backends.common import metropro
from polishd.sim_backends.common.runtime import replace_file

FIGURE_MM = (30.0, 160.0)
MIDDLE_MM = (9.5, 30.0)
MIDDLE_SHARE = 0.15
"""RMS of the middle periods relative to the figure."""
BUMP_SIGMA_MM = 4.5
BEYOND_MM = 2.0
"""The map continues this far beyond straight sides: an edge of the map is not taken for an edge of the part."""


@dataclass(slots=True)
class FinePatch:
    """A square of the part on finer samples, which show the lines of a path."""

    grid: Grid
    """About its own center."""
    centre_mm: FloatArray
    """(2,) in the part's x and y."""
    height_nm: FloatArray
    start_nm: FloatArray

    def write_map(self, path: Path, part_id: str) -> None:
        """Write its map by a perfect instrument as a MetroPro file, replaced whole."""
        comment = f"patch about {self.centre_mm[0]:g}, {self.centre_mm[1]:g} mm"
        content = metropro.pack(metropro.DatMap(self.height_nm, self.grid.pitch_mm, part=part_id, comment=comment))
        replace_file(path, content)


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
    patch: FinePatch | None = None

    def __post_init__(self) -> None:
        """Keep the initial surface."""
        self.start_nm = self.height_nm.copy()

    def map_nm(self) -> FloatArray:
        """Return the map of a perfect instrument."""
        frame = self.height_nm[self.pad : -self.pad, self.pad : -self.pad]
        return np.where(self.valid, frame, np.nan)

    def write(self, path: Path) -> None:
        """Save as an .npz file, replaced whole."""
        fine = self.patch
        patch = {} if fine is None else {f"patch_{name}": getattr(fine, name) for name in PATCH_ARRAYS}
        patch |= {} if fine is None else {"patch_pitch_mm": np.float64(fine.grid.pitch_mm)}
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
                **patch,
            )
        beside.replace(path)

    def stats(self) -> tuple[float, float]:
        """True RMS and PV in the clear aperture, nm, without the plane: tilt is no figure error."""
        seen = _seen(self, _level(self, self.height_nm))
        return float(seen.std()), float(np.ptp(seen))


def make(config: Plant, seed: int) -> TruePart:
    """Draw a part with figure and middle-frequency errors, RMS and PV as configured, flush with its ring."""
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
    part.patch = _patch(part, config)
    return part


PATCH_ARRAYS = ("centre_mm", "height_nm", "start_nm")


def _patch(part: TruePart, config: Plant) -> FinePatch | None:
    """Return the square on finer samples, with the surface between the part's samples."""
    if config.patch_mm is None:
        return None
    x, y, side = config.patch_mm
    count = max(round(side / config.patch_pitch_mm), 1)
    grid, whole = Grid(count, count, config.patch_pitch_mm), part.grid
    rows = (whole.y_mm[0] - (grid.y_mm + y)) / whole.pitch_mm
    columns = (grid.x_mm + x - whole.x_mm[0]) / whole.pitch_mm
    height = ndimage.map_coordinates(part.height_nm, np.meshgrid(rows, columns, indexing="ij"), order=3, mode="nearest")
    return FinePatch(grid, np.array([x, y]), height, height.copy())


def from_map(path: Path, config: Plant) -> TruePart:
    """Make a part from a measured map. Holes are filled smoothly and stay holes for the instrument."""
    data = metropro.read(path)
    rows, columns = data.height_nm.shape
    pad = math.ceil(config.ring_mm / data.pitch_mm)
    grid = Grid(rows + 2 * pad, columns + 2 * pad, data.pitch_mm)
    valid = np.isfinite(data.height_nm)
    outline = ndimage.binary_fill_holes(valid)
    inside = ndimage.distance_transform_edt(np.pad(outline, 1))[1:-1, 1:-1] * data.pitch_mm
    height = fill(np.pad(data.height_nm, pad, constant_values=np.nan))
    part = TruePart(grid, height, pad, valid, valid & (inside > config.edge_mm), data.origin_px)
    part.patch = _patch(part, config)
    return part


def swelling_nm(part: TruePart, config: SimConfig, since_s: float) -> FloatArray:
    """(map rows, map columns) thermal height so long after a pass (simulated clock)."""
    rows, columns = part.valid.shape
    radius = Grid(rows, columns, part.grid.pitch_mm).radius_mm() / config.plant.outline.radius_mm
    return np.asarray(config.hidden_truth.thermal_nm * math.exp(-since_s / config.hidden_truth.thermal_s) * radius**2)


def fill(height_nm: FloatArray) -> FloatArray:
    """Replace NaN by weighted means of neighbors, from fine scales to coarse ones."""
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
    """Remove the plane fitted in the clear aperture."""
    x, y = np.meshgrid(part.grid.x_mm, part.grid.y_mm)
    columns = np.stack([np.ones(part.clear.sum()), _seen(part, x), _seen(part, y)], axis=1)
    c, sx, sy = np.linalg.lstsq(columns, _seen(part, height), rcond=None)[0]
    return np.asarray(height - (c + sx * x + sy * y))


# The nominal surface by the plant's own methods: heights by iteration, normals and curvature by differences.

STEP_MM = 0.1
"""Distance between the nine heights that give slope and curvature."""
MOST_STEPS = 1000
SETTLED_MM = 1e-13
_NINE = STEP_MM * np.array([[i, j] for j in (-1, 0, 1) for i in (-1, 0, 1)], dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Local:
    """The surface under n points of the part's x and y."""

    height_mm: FloatArray
    """(n,)."""
    normal: FloatArray
    """(n, 3) unit, out of the part."""
    curvature_per_mm: FloatArray
    """(n,) mean of the two principal ones, positive where it is concave."""

    def levelled(self, axis: FloatArray) -> FloatArray:
        """Turn (n, 3) directions of the part's frame into a frame whose z is the normal, the short way."""
        along = np.einsum("ni,ni->n", axis, self.normal)
        share = (along + axis[:, 2]) / (1.0 + self.normal[:, 2])
        return np.column_stack([axis[:, :2] - share[:, None] * self.normal[:, :2], along])

    def raised(self, along: FloatArray) -> FloatArray:
        """(n, 3) directions of the part's frame from (n, 2) along the surface: the inverse of `levelled`."""
        share = np.einsum("ni,ni->n", along, self.normal[:, :2]) / (1.0 + self.normal[:, 2])
        flat = np.column_stack([along, np.zeros(len(along))])
        return np.asarray(flat - share[:, None] * (self.normal + np.array([0.0, 0.0, 1.0])))

    @property
    def stretch(self) -> FloatArray:
        """(n, 2, 2) from offsets in the part's x and y to offsets along the surface, in that turned frame."""
        lean, up = self.normal[:, :2], self.normal[:, 2]
        size = 1.0 / (up * (1.0 + up))
        return np.asarray(np.eye(2) + size[:, None, None] * lean[:, :, None] * lean[:, None, :])


@dataclass(frozen=True, slots=True)
class Shape:
    """The optic of a part."""

    plant: Plant
    _centre: FloatArray = field(init=False)
    """(3,) the part's center in the parent's frame."""
    _axes: FloatArray = field(init=False)
    """(3, 3) the part's axes there, as columns."""

    def __post_init__(self) -> None:
        """Find the frame of a part that lies off the parent's axis."""
        centre = np.array([self.plant.off_axis_mm])
        height, slope, _ = _looked_at(self._parent_mm(centre + _NINE))
        a, b, c = np.array([-slope[0, 0], -slope[0, 1], 1.0]) / math.sqrt(1.0 + float((slope**2).sum()))
        turn = [[1 - a * a / (1 + c), -a * b / (1 + c), a], [-a * b / (1 + c), 1 - b * b / (1 + c), b], [-a, -b, c]]
        object.__setattr__(self, "_centre", np.append(centre[0], height))
        object.__setattr__(self, "_axes", np.array(turn))

    @property
    def flat(self) -> bool:
        """True for a plane."""
        return self.plant.curvature_radius_mm is None and not any(self.plant.even)

    def under(self, place: FloatArray) -> Local:
        """Return the surface under points whose x and y are the first two columns of (n, 2 or more), part's frame.

        Beyond the ring around the part it continues as at the edge of the ring.
        """
        n = len(place)
        if self.flat:
            return Local(np.zeros(n), np.tile([0.0, 0.0, 1.0], (n, 1)), np.zeros(n))
        plane = place[:, :2]
        end_mm = self.plant.outline.radius_mm + self.plant.ring_mm - 2 * STEP_MM
        plane = plane * np.minimum(1.0, end_mm / np.maximum(np.hypot(plane[:, 0], plane[:, 1]), 1e-9))[:, None]
        nine = self._part_mm((plane[:, None] + _NINE).reshape(-1, 2)).reshape(n, 9)
        height, slope, bend = _looked_at(nine)
        size = np.sqrt(1.0 + np.einsum("ni,ni->n", slope, slope))
        normal = np.column_stack([-slope, np.ones(n)]) / size[:, None]
        (zx, zy), (zxx, zxy, zyy) = slope.T, bend.T
        mean = ((1 + zy**2) * zxx - 2 * zx * zy * zxy + (1 + zx**2) * zyy) / (2 * size**3)
        return Local(height, normal, mean)

    def _part_mm(self, plane: FloatArray) -> FloatArray:
        """(n,) heights over (n, 2) of the part's frame: down its z until the parent is met."""
        height = np.zeros(len(plane))
        begin = self._centre + plane @ self._axes[:, :2].T
        for _ in range(MOST_STEPS):
            at = begin + height[:, None] * self._axes[:, 2]
            step = (at[:, 2] - self._parent_mm(at[:, :2])) * self._axes[2, 2]
            height = height - step
            if np.abs(step).max(initial=0.0) < SETTLED_MM:
                break
        return height

    def _parent_mm(self, plane: FloatArray) -> FloatArray:
        """Heights (...,) over (..., 2) of the parent's frame: ``2 R z = r^2 + (1 + k) z^2``, and the even terms."""
        plant, square = self.plant, (plane**2).sum(axis=-1)
        even = np.zeros_like(square)
        for power, factor in enumerate(plant.even, start=2):
            even += factor * square**power
        height = np.zeros_like(square)
        if plant.curvature_radius_mm is None:
            return np.asarray(even)
        for _ in range(MOST_STEPS):
            before = height
            height = (square + (1.0 + plant.conic) * before**2) / (2.0 * plant.curvature_radius_mm)
            if np.abs(height - before).max(initial=0.0) < SETTLED_MM:
                break
        return np.asarray(height + even)


def _looked_at(nine: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Height (n,), slopes (n, 2) and second derivatives xx, xy, yy (n, 3) of (n, 9) heights on `_NINE`."""
    z = nine.reshape(-1, 3, 3)  # row: y, column: x
    slope = np.stack([z[:, 1, 2] - z[:, 1, 0], z[:, 2, 1] - z[:, 0, 1]], axis=1) / (2.0 * STEP_MM)
    along = z[:, 1, 2] - 2.0 * z[:, 1, 1] + z[:, 1, 0]
    across = z[:, 2, 1] - 2.0 * z[:, 1, 1] + z[:, 0, 1]
    twist = (z[:, 2, 2] - z[:, 2, 0] - z[:, 0, 2] + z[:, 0, 0]) / 4.0
    return z[:, 1, 1], slope, np.stack([along, twist, across], axis=1) / STEP_MM**2
