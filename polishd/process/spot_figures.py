"""Figures of a removal spot: depth, radius, pressure, peak, volume, and its profiles through the centre."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy

from polishd.model.errors import ComputeError
from polishd.model.process import MeasuredTif, ToolProcess
from polishd.model.surface import FloatArray
from polishd.process import contact, measured_tif
from polishd.process.robot.refusal import require_number

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
        volume_mm3_min=measured_tif.volume_mm3_min(tif),
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
    """Whether somewhere between two shoulders the profile lies below both."""
    left, right = np.maximum.accumulate(profile), np.maximum.accumulate(profile[::-1])[::-1]
    return bool((profile < np.minimum(left, right) - M_DEPTH * profile.max()).any())
