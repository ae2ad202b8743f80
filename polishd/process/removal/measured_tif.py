"""A measured tool influence function: from the maps before and after a spot to a rate that the process can use."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy

from polishd.model.errors import ComputeError
from polishd.model.process import MeasuredTif, ToolProcess
from polishd.model.surface import BoolArray, FloatArray
from polishd.process.checks import require_number
from polishd.process.removal import contact

FRAME = 0.1
"""Width of the map's outer ring, taken as untouched at first, over the map's smaller side."""
SMOOTH_PX = 2.0
"""Sigma of the smoothing with which the spot is found and the noise of means is judged."""
STANDS_OUT = 6.0
"""Least height of a spot's smoothed peak, in sigma of the smoothed outer ring."""
RIM_SIGMA = 3.0
RIM_SHARE = 0.005
"""The rim is where the mean round the centroid falls below 3 sigma of that mean, or below this share of its maximum."""
MARGIN = 1.25
"""The volume within this many rim radii is what is conserved; the plane of the untouched surface lies beyond."""
MIN_LEVEL_SAMPLES = 50


@dataclass(frozen=True, slots=True)
class TifReport:
    """Imported TIF, and the effect of cleaning."""

    volume_mm3_min: float
    peak_nm_s: float
    fwhm_mm: float
    """Diameter of the disc as large as the area above half of the peak."""
    rim_mm: float
    """Radius beyond which the rate is set to 0."""
    noise_nm_s: float
    """Standard deviation of a sample of the untouched surface (from its median absolute deviation)."""
    volume_change: float
    """Relative change of the volume by cleaning; the TIF is scaled back to the volume before."""
    centroid_mm: tuple[float, float]
    """Position of the spot's centroid from the map's center: x right, y up."""


def tif_from_maps(
    before_nm: FloatArray,
    after_nm: FloatArray,
    pitch_mm: float,
    seconds: float,
    *,
    radius_mm: float | None = None,
    azimuth_deg: float = 0.0,
    depth_ratio: float = 1.0,
    rotates: bool = True,
) -> tuple[MeasuredTif, TifReport]:
    """The removal rate of one spot: (before - after) / seconds, levelled, centred on its centroid, and cleaned.

    The plane of the untouched surface is taken off, the spot moved onto its centroid by cubic splines, what lies beyond
    the rim set to 0 and what is negative within it too, and the whole scaled to the volume before cleaning.

    Args:
        before_nm: (ny, nx) height, positive = high; NaN = no data, which the spot must not have.
        after_nm: (ny, nx) the same place after the spot.
        pitch_mm: of both.
        seconds: how long the tool stood there.
        radius_mm: the rim; None: found, see ``RIM_SIGMA``.
        azimuth_deg: where the spindle leaned, counterclockwise from the map's x.
        depth_ratio: gamma there.
        rotates: whether the spot turns with the direction in which the spindle leans.

    Raises:
        ComputeError: maps that do not fit each other, numbers that cannot be, no spot that stands out of the noise, a
            spot that reaches the map's border, or samples without data in it.
    """
    rate = _rate(before_nm, after_nm, pitch_mm, seconds)
    require_number("the spot's depth ratio gamma", depth_ratio, "", above=0.0)
    if radius_mm is not None:
        require_number("the TIF's radius", radius_mm, "mm", above=0.0)
    frame = _frame(rate.shape)
    rate = _levelled(rate, frame)
    peak = _find(rate, frame)
    centre, rim = _centroid(
        rate, peak, _sigma(_smooth(rate)[frame]), None if radius_mm is None else radius_mm / pitch_mm
    )
    away = _distance(rate.shape, centre) > MARGIN * rim
    if np.count_nonzero(away & np.isfinite(rate)) >= MIN_LEVEL_SAMPLES:
        rate, frame = _levelled(rate, away), away
    _require_whole(rate, centre, rim, pitch_mm)
    volume = float(np.nansum(rate[_distance(rate.shape, centre) <= MARGIN * rim]))
    clean = _cleaned(rate, centre, rim)
    tif = clean * (volume / clean.sum())
    report = TifReport(
        volume_mm3_min=volume * pitch_mm**2 * 60e-6,
        peak_nm_s=float(tif.max()),
        fwhm_mm=fwhm_mm(tif, pitch_mm),
        rim_mm=rim * pitch_mm,
        noise_nm_s=_sigma(rate[frame]),
        volume_change=float(clean.sum() / volume - 1),
        centroid_mm=_from_centre(rate.shape, centre, pitch_mm),
    )
    return MeasuredTif(tif, pitch_mm, azimuth_deg, depth_ratio, rotates), report


def fwhm_mm(rate_nm_s: FloatArray, pitch_mm: float) -> float:
    """Diameter of the disc as large as the area above half of the peak of a (ny, nx) rate, mm."""
    return float(2 * pitch_mm * np.sqrt(np.count_nonzero(rate_nm_s > rate_nm_s.max() / 2) / np.pi))


def volume_mm3_min(tif: MeasuredTif) -> float:
    """Volume rate of a measured TIF, mm^3/min."""
    return float(tif.rate_nm_s.sum()) * tif.pitch_mm**2 * 60e-6


def preston_from_tif(process: ToolProcess, depth_ratio: float, tif: MeasuredTif) -> float:
    """Preston constant, cm^2/N, at which the model of eq. 16-33 at that depth ratio removes the measured volume."""
    require_number("the spot's depth ratio gamma", depth_ratio, "", above=0.0)
    depth = depth_ratio * contact.hertz_depth_mm(process)
    modelled = float(contact.volume_rate_nm_mm2_s(process, depth)[0]) * 60e-6
    return process.preston_cm2_per_n * volume_mm3_min(tif) / modelled


def _rate(before_nm: FloatArray, after_nm: FloatArray, pitch_mm: float, seconds: float) -> FloatArray:
    require_number("the time on the spot", seconds, "s", above=0.0)
    require_number("the maps' pitch", pitch_mm, "mm", above=0.0)
    if before_nm.shape != after_nm.shape or before_nm.ndim != 2:
        raise ComputeError(f"the map before has the shape {before_nm.shape}, the map after {after_nm.shape}")
    if min(before_nm.shape) < 16:
        raise ComputeError(f"maps of {before_nm.shape[0]} x {before_nm.shape[1]} samples are too small for a spot")
    rate = np.asarray((before_nm - after_nm) / seconds, dtype=np.float64)
    return np.where(np.isfinite(rate), rate, np.nan)


def _frame(shape: tuple[int, ...]) -> BoolArray:
    """(ny, nx) the map's outer ring."""
    width = max(2, round(FRAME * min(shape)))
    frame = np.ones(shape, dtype=np.bool_)
    frame[width:-width, width:-width] = False
    return frame


def _levelled(rate: FloatArray, where: BoolArray) -> FloatArray:
    """The map less the plane through the samples of the mask, outliers of over 3 sigma left out."""
    row, column = np.indices(rate.shape)
    columns = np.stack([np.ones(rate.shape), row - row.mean(), column - column.mean()], axis=-1)
    use = where & np.isfinite(rate)
    if np.count_nonzero(use) < MIN_LEVEL_SAMPLES:
        raise ComputeError(
            f"{np.count_nonzero(use)} samples of untouched surface have data: too few to level the map by"
        )
    left = rate
    for _ in range(3):
        plane = np.linalg.lstsq(columns[use], rate[use], rcond=None)[0]
        left = rate - columns @ plane
        use = where & (np.abs(left) <= 3 * _sigma(left[where]) + 1e-12 * float(np.nanmax(np.abs(rate))))
    return np.asarray(left, dtype=np.float64)


def _sigma(values: FloatArray) -> float:
    """Standard deviation from the median absolute deviation, NaN left out."""
    values = values[np.isfinite(values)]
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))


def _smooth(rate: FloatArray) -> FloatArray:
    """Gaussian mean over ``SMOOTH_PX``, of the samples that have data."""
    valid = np.isfinite(rate)
    total = scipy.ndimage.gaussian_filter(np.where(valid, rate, 0.0), SMOOTH_PX)
    weight = scipy.ndimage.gaussian_filter(valid.astype(np.float64), SMOOTH_PX)
    return np.where(valid, total / np.maximum(weight, 1e-12), np.nan)


def _find(rate: FloatArray, frame: BoolArray) -> tuple[float, float]:
    """Row and column of the spot's peak."""
    smooth = _smooth(rate)
    noise, peak = _sigma(smooth[frame]), float(np.nanmax(smooth))
    if not peak > STANDS_OUT * noise or peak <= 1e-9 * float(np.nanmax(np.abs(rate))):
        raise ComputeError(
            f"no spot stands out: the largest removal is {peak:.3g} nm/s, the surroundings' noise {noise:.3g} nm/s"
        )
    row, column = np.unravel_index(np.nanargmax(smooth), smooth.shape)
    if frame[row, column]:
        raise ComputeError(
            f"the largest removal is at row {row}, column {column}, at the map's border: it must be inside"
        )
    return float(row), float(column)


def _distance(shape: tuple[int, ...], centre: tuple[float, float]) -> FloatArray:
    """(ny, nx) distance from (row, column), px."""
    row, column = np.indices(shape)
    return np.asarray(np.hypot(row - centre[0], column - centre[1]), dtype=np.float64)


def _centroid(
    rate: FloatArray, peak: tuple[float, float], noise: float, radius_px: float | None
) -> tuple[tuple[float, float], float]:
    """Row and column of the centroid of what lies within the rim round it, and the rim's radius, px."""
    centre, rim = peak, 0.0
    row, column = np.indices(rate.shape)
    for _ in range(20):
        rim = _rim(rate, centre, noise) if radius_px is None else radius_px
        inside = (_distance(rate.shape, centre) <= rim) & np.isfinite(rate)
        weight = np.where(inside, rate, 0.0)
        if not weight.sum() > 0:
            raise ComputeError("no spot stands out: the volume within its rim is not above 0")
        before, centre = (
            centre,
            (float((weight * row).sum() / weight.sum()), float((weight * column).sum() / weight.sum())),
        )
        if np.hypot(before[0] - centre[0], before[1] - centre[1]) < 1e-3:
            break
    return centre, rim


def _rim(rate: FloatArray, centre: tuple[float, float], noise: float) -> float:
    """Radius, px, from which on outwards of its maximum the mean round the centre is not above noise.

    ``noise`` is the standard deviation of the smoothed map; noise as wide as the smoothing is allowed for.
    """
    ring = np.round(_distance(rate.shape, centre)).astype(np.int64)
    valid = np.isfinite(rate)
    count = np.bincount(ring[valid])
    mean = np.bincount(ring[valid], rate[valid]) / np.maximum(count, 1)
    noise_of_mean = noise / np.sqrt(np.maximum(count / (4 * np.pi * SMOOTH_PX**2), 1.0))
    below = mean < np.maximum(RIM_SIGMA * noise_of_mean, RIM_SHARE * mean.max())
    below[: int(mean.argmax())] = False
    return float(below.argmax()) if below.any() else float(len(mean))


def _require_whole(rate: FloatArray, centre: tuple[float, float], rim: float, pitch_mm: float) -> None:
    """Refuse a spot whose rim leaves the map, or that has samples without data."""
    room = min(centre[0], centre[1], rate.shape[0] - 1 - centre[0], rate.shape[1] - 1 - centre[1]) + 0.5
    if rim > room:
        raise ComputeError(
            f"the spot's rim lies {rim * pitch_mm:.3g} mm from its centre, and reaches the map's border "
            f"{room * pitch_mm:.3g} mm away"
        )
    holes = int(np.count_nonzero(~np.isfinite(rate) & (_distance(rate.shape, centre) <= rim)))
    if holes:
        raise ComputeError(f"{holes} samples of the spot have no data: its volume is not known")


def _cleaned(rate: FloatArray, centre: tuple[float, float], rim: float) -> FloatArray:
    """Square map, odd, whose middle is the centroid; 0 beyond the rim and where the rate is negative."""
    reach = np.arange(-int(np.ceil(rim)), int(np.ceil(rim)) + 1)
    row, column = np.meshgrid(reach + centre[0], reach + centre[1], indexing="ij")
    moved = scipy.ndimage.map_coordinates(
        np.where(np.isfinite(rate), rate, 0.0), [row, column], order=3, mode="nearest"
    )
    inside = np.hypot(reach[:, None], reach[None, :]) <= rim
    return np.asarray(np.where(inside, np.clip(moved, 0.0, None), 0.0), dtype=np.float64)


def _from_centre(shape: tuple[int, ...], centre: tuple[float, float], pitch_mm: float) -> tuple[float, float]:
    """X and y of a (row, column) from the map's centre, mm."""
    return (centre[1] - (shape[1] - 1) / 2) * pitch_mm, ((shape[0] - 1) / 2 - centre[0]) * pitch_mm


# Figures of a removal spot: depth, radius, pressure, peak, volume, and its profiles through the centre.

PROFILE_POINTS = 201
PROFILE_REACH = 1.1
"""Profiles and maps reach this many contact radii from the centre."""
M_DEPTH = 0.05
"""A measured profile is M-shaped when it falls by this share of its maximum between two shoulders."""


@dataclass(frozen=True, slots=True)
class SpotFigures:
    """A spot in the tool's frame: y where the spindle leans, x = y cross the normal out of the part."""

    depth_mm: float
    contact_radius_mm: float
    peak_pressure_mpa: float
    peak_nm_s: float
    volume_mm3_min: float
    dissipative_fraction: float
    """Dissipative shift of the pressure over the contact's radius (`contact.dissipative_fraction`)."""
    x_mm: FloatArray
    """(m,) from the contact's centre, ascending."""
    profile_x_nm_s: FloatArray
    """(m,) at y = 0."""
    y_mm: FloatArray
    """(m,)."""
    profile_y_nm_s: FloatArray
    """(m,) at x = 0."""
    pole_mm: float
    """``(R - d) tan(dip)``: how far from the contact's centre the bonnet's axis, which stands still, meets the part."""
    m_shaped: bool
    """Whether the x profile has two maxima with a minimum between: of a Hertz spot where the pole lies within it."""


def spot_figures(process: ToolProcess, depth_ratio: float = 1.0) -> SpotFigures:
    """Figures of the modelled spot (paper eq. 16-33) at a depth ratio gamma. Raises ComputeError as the contact does.

    The x profile is M-shaped where ``(R - d) tan(dip) < a``; so in none of the paper's Table III, with size = radius.
    """
    depth = _depth_mm(process, depth_ratio)
    line = _line(process, depth)
    zero = np.zeros_like(line)
    pole = (process.tool_radius_mm - depth) * float(np.tan(np.radians(process.dip_deg)))
    radius = float(contact.contact_radius_mm(process, depth))
    return SpotFigures(
        depth_mm=depth,
        contact_radius_mm=radius,
        peak_pressure_mpa=float(contact.peak_pressure_mpa(process, depth)),
        peak_nm_s=_peak_nm_s(process, depth),
        volume_mm3_min=float(contact.volume_rate_nm_mm2_s(process, depth)[0]) * 60e-6,
        dissipative_fraction=float(contact.dissipative_fraction(process, depth)),
        x_mm=line,
        profile_x_nm_s=contact.removal_rate_nm_s(process, depth, line, zero),
        y_mm=line,
        profile_y_nm_s=contact.removal_rate_nm_s(process, depth, zero, line),
        pole_mm=pole,
        m_shaped=pole < radius,
    )


def measured_figures(tif: MeasuredTif, process: ToolProcess) -> SpotFigures:
    """The same of a measured TIF: rates, volume, profiles and shape are measured, the rest is the model's at its depth.

    The profiles go through the map's centre, as the tool lay when it was measured.
    """
    model = spot_figures(process, tif.depth_ratio)
    reach = (max(tif.rate_nm_s.shape) - 1) / 2 * tif.pitch_mm
    line = np.linspace(-reach, reach, PROFILE_POINTS)
    azimuth = np.radians(tif.azimuth_deg)
    x = _along(tif, line * np.sin(azimuth), -line * np.cos(azimuth))
    y = _along(tif, line * np.cos(azimuth), line * np.sin(azimuth))
    return replace(
        model,
        peak_nm_s=float(tif.rate_nm_s.max()),
        volume_mm3_min=volume_mm3_min(tif),
        x_mm=line,
        profile_x_nm_s=x,
        y_mm=line,
        profile_y_nm_s=y,
        m_shaped=_m_shaped(x),
    )


def map_nm_s(process: ToolProcess, depth_ratio: float, pitch_mm: float) -> tuple[FloatArray, FloatArray]:
    """The modelled spot for a picture, in the tool's frame: (m,) mm, ascending, and (m, m) nm/s at samples' centres.

    The first is x of the columns, and y of the rows from the last to the first: row 0 is the top.
    """
    require_number("the picture's pitch", pitch_mm, "mm", above=0.0)
    depth = _depth_mm(process, depth_ratio)
    count = int(np.ceil(PROFILE_REACH * float(contact.contact_radius_mm(process, depth)) / pitch_mm))
    if count > 2000:
        raise ComputeError(f"the picture's pitch is {pitch_mm:g} mm: {2 * count + 1} samples a side are too many")
    x = np.asarray(np.arange(-count, count + 1) * pitch_mm, dtype=np.float64)
    return x, contact.removal_rate_nm_s(process, depth, x[None, :], -x[:, None])


def profile_divergence(p: FloatArray, q: FloatArray, base: float = 2.0) -> float:
    """Jensen-Shannon divergence of two (m,) profiles, each normalised to a sum of 1, to the logarithm's base.

    0 for equal shapes; with base 2 at most 1. The paper's Table III states neither base nor whether it is the
    divergence or its root, the distance; this is the divergence.
    """
    require_number("the logarithm's base", base, "", above=1.0)
    for name, profile in (("first", p), ("second", q)):
        if profile.ndim != 1 or profile.shape != p.shape or not np.isfinite(profile).all():
            raise ComputeError(f"profiles of shapes {p.shape} and {q.shape}: they must be finite and of one length")
        if profile.size == 0 or profile.min() < 0 or not profile.sum() > 0:
            raise ComputeError(f"the {name} profile is not a distribution: it is negative somewhere, or zero all over")
    # scipy's distance comes out as nan where rounding makes its square a hair negative
    return float(np.nan_to_num(scipy.spatial.distance.jensenshannon(p, q, base=base))) ** 2


def _depth_mm(process: ToolProcess, depth_ratio: float) -> float:
    require_number("the depth ratio gamma", depth_ratio, "", above=0.0)
    return depth_ratio * contact.hertz_depth_mm(process)


def _line(process: ToolProcess, depth_mm: float) -> FloatArray:
    reach = PROFILE_REACH * float(contact.contact_radius_mm(process, depth_mm))
    return np.linspace(-reach, reach, PROFILE_POINTS)


def _peak_nm_s(process: ToolProcess, depth_mm: float) -> float:
    """The largest rate: of a grid over the contact, then of finer and finer ones about the largest of the last."""
    centre, reach = np.zeros(2), float(contact.contact_radius_mm(process, depth_mm))
    best = 0.0
    for _ in range(6):
        step = np.linspace(-reach, reach, 81)
        x, y = centre[0] + step[None, :], centre[1] + step[:, None]
        rate = contact.removal_rate_nm_s(process, depth_mm, x, y)
        row, column = np.unravel_index(rate.argmax(), rate.shape)
        best = float(rate[row, column])
        centre, reach = np.array([x[0, column], y[row, 0]]), reach / 16
    return best


def _along(tif: MeasuredTif, right_mm: FloatArray, up_mm: FloatArray) -> FloatArray:
    """Rate at places of the TIF's map, from its centre, nm/s; 0 beyond the map."""
    rows, columns = tif.rate_nm_s.shape
    row, column = (rows - 1) / 2 - up_mm / tif.pitch_mm, (columns - 1) / 2 + right_mm / tif.pitch_mm
    return np.asarray(scipy.ndimage.map_coordinates(tif.rate_nm_s, [row, column], order=1), dtype=np.float64)


def _m_shaped(profile: FloatArray) -> bool:
    """Return whether somewhere between two shoulders the profile lies below both."""
    left, right = np.maximum.accumulate(profile), np.maximum.accumulate(profile[::-1])[::-1]
    return bool((profile < np.minimum(left, right) - M_DEPTH * profile.max()).any())
