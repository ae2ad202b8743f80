"""What an interferometer makes of true heights: what its reference, its imaging and its mount add. Pure of I/O."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from polishd.config.simulator import InstrumentErrors, MapFaults, SimConfig
from polishd.model.surface import FloatArray
from polishd.sim_backends.truth import stream


def add_instrument_errors(
    true_nm: FloatArray,
    config: SimConfig,
    pitch_mm: float,
    rng: np.random.Generator,
    *,
    quarters: int = 0,
    shift_px: tuple[int, int] = (0, 0),
) -> FloatArray:
    """A map of the part in the instrument, (rows, columns), NaN where there are no data.

    The part is turned by so many quarters, counter-clockwise, then moved by columns to the right and rows up; what
    belongs to it goes with it.
    """
    errors = config.interferometer.errors
    height = _imaged(_shifted(np.rot90(add_mount_errors(true_nm, config), quarters), shift_px), errors)
    x, y = _places(height)
    noise = config.truth.map_noise_nm * rng.standard_normal(height.shape)
    if errors.retrace_nm_per_urad or errors.slope_noise_nm_per_urad:
        down, across = np.gradient(_whole(height), pitch_mm)  # nm/mm: microradians
        noise += errors.slope_noise_nm_per_urad * np.hypot(across, down) * rng.standard_normal(height.shape)
        height = height + errors.retrace_nm_per_urad * across
    if errors.tilt_nm:
        along_x, along_y = rng.uniform(-errors.tilt_nm, errors.tilt_nm, 2)
        height = height + 2.0 * (along_x * x + along_y * y)
    height = height + noise + _reference(x, y, errors)
    if errors.mount_anew:
        below, beside = rng.normal(0.0, errors.mount_nm / np.sqrt(2.0), 2)
        height = height + _trefoil(height, below) + _trefoil(height.T, beside).T
    elif not errors.mount_turns:
        height = height + _trefoil(height, errors.mount_nm)
    if errors.dead_pixels:
        dead = stream(0, "dead pixels").random(height.shape) < errors.dead_pixels  # of the camera: always the same
        height = np.where(dead, np.nan, height)
    return add_imaging_errors(height, config.interferometer.faults)


def add_mount_errors(true_nm: FloatArray, config: SimConfig) -> FloatArray:
    """True heights with the print of a mount that turns with the part: no map of it, however turned, is without."""
    errors = config.interferometer.errors
    held = errors.mount_turns and not errors.mount_anew
    return true_nm + _trefoil(true_nm, errors.mount_nm) if held else true_nm


def add_imaging_errors(height_nm: FloatArray, faults: MapFaults) -> FloatArray:
    """What an instrument with these faults gives for true heights, (rows, columns)."""
    lying = np.rot90(height_nm[:, ::-1] if faults.mirror else height_nm, faults.rotation_deg // 90)
    return np.asarray(lying * (faults.sign * faults.factor))


def _places(height_nm: FloatArray) -> tuple[FloatArray, FloatArray]:
    """X (right) and y (up) of the samples over the radius of the circle about them."""
    rows, columns = height_nm.shape
    half = max(rows, columns) / 2.0
    x = (np.arange(columns) - (columns - 1) / 2.0) / half
    y = ((rows - 1) / 2.0 - np.arange(rows)) / half
    return np.broadcast_to(x[None, :], height_nm.shape), np.broadcast_to(y[:, None], height_nm.shape)


def _reference(x: FloatArray, y: FloatArray, errors: InstrumentErrors) -> FloatArray:
    """Power, astigmatism and coma; each of RMS 1 over the circle, times its size."""
    square = x**2 + y**2
    power = np.sqrt(3.0) * (2.0 * square - 1.0)
    twice = 2.0 * np.radians(errors.astigmatism_deg)
    astigmatism = np.sqrt(6.0) * ((x**2 - y**2) * np.cos(twice) + 2.0 * x * y * np.sin(twice))
    coma = np.sqrt(8.0) * (3.0 * square - 2.0) * x
    added = errors.power_nm * power + errors.astigmatism_nm * astigmatism + errors.coma_nm * coma
    return np.asarray(added, dtype=np.float64)


def _trefoil(height_nm: FloatArray, size_nm: float) -> FloatArray:
    """Three points of a mount, the first below."""
    x, y = _places(height_nm)
    return np.asarray(size_nm * np.sqrt(8.0) * (3.0 * x**2 * y - y**3), dtype=np.float64)


def _imaged(height_nm: FloatArray, errors: InstrumentErrors) -> FloatArray:
    """As it lies on the camera: each sample shows what is nearer to the middle, where it is magnified."""
    if not errors.magnification and not errors.distortion:
        return height_nm
    x, y = _places(height_nm)
    rows, columns = height_nm.shape
    larger = 1.0 + errors.magnification + errors.distortion * (x**2 + y**2)
    from_row = (np.arange(rows)[:, None] - (rows - 1) / 2.0) / larger + (rows - 1) / 2.0
    from_column = (np.arange(columns)[None, :] - (columns - 1) / 2.0) / larger + (columns - 1) / 2.0
    seen = ndimage.map_coordinates(_whole(height_nm), [from_row, from_column], order=3, mode="nearest")
    missing = ndimage.map_coordinates(np.isnan(height_nm).astype(float), [from_row, from_column], order=1, cval=1.0)
    return np.asarray(np.where(missing > 0.5, np.nan, seen), dtype=np.float64)


def _whole(height_nm: FloatArray) -> FloatArray:
    """Without holes: each of them is as the nearest sample that has data."""
    holes = np.isnan(height_nm)
    nearest = ndimage.distance_transform_edt(holes, return_distances=False, return_indices=True)
    return np.asarray(height_nm[tuple(nearest)])


def _shifted(height_nm: FloatArray, by_px: tuple[int, int]) -> FloatArray:
    """Moved by columns to the right and rows up; NaN comes in."""
    right, up = by_px
    rows, columns = height_nm.shape
    moved = np.full_like(height_nm, np.nan)
    to_rows, from_rows = slice(max(-up, 0), rows - max(up, 0)), slice(max(up, 0), rows - max(-up, 0))
    to_cols, from_cols = slice(max(right, 0), columns - max(-right, 0)), slice(max(-right, 0), columns - max(right, 0))
    moved[to_rows, to_cols] = height_nm[from_rows, from_cols]
    return moved
