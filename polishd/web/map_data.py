"""Maps of a pass as arrays for the page: heights on the process grid, and dwell and gamma along the path."""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from polishd.model.errors import ConfigError, NoSuchResource
from polishd.model.surface import BoolArray, FloatArray
from polishd.rendering.scales import PERCENTILE, height_limit, value_limits

Arrays = Mapping[str, NDArray[Any]]
Encoding = Literal["rows", "float32"]
ENCODINGS: Mapping[Encoding, int] = {"rows": 128, "float32": 768}
"""Greatest number of samples along a side: as numbers of the JSON, and as base64 of an array."""
LEAST_PX = 8


@dataclass(frozen=True, slots=True)
class MapKind:
    """Kind of a map."""

    key: str
    """Key of its values in the answer, with their unit."""
    unit: str
    signed: bool
    """Heights about 0, which have a diverging scale, as in the reports."""
    of_path: bool = False
    """Values at the points of the path, and no array of the grid."""


MAP_KINDS: Mapping[str, MapKind] = {
    "measured": MapKind("height_nm", "nm", signed=True),
    "predicted": MapKind("height_nm", "nm", signed=True),
    "residual": MapKind("height_nm", "nm", signed=True),
    "removal": MapKind("height_nm", "nm", signed=False),
    "dwell": MapKind("dwell_s", "s", signed=False, of_path=True),
    "gamma": MapKind("gamma", "", signed=False, of_path=True),
}
"""``residual``: the measurement after the pass less what the plan predicted, each less its mean."""


@dataclass(frozen=True, slots=True)
class MapQuery:
    """Which map, and how it is answered."""

    kind: str
    px: int = 0
    """Greatest number of samples along a side; 0: that of the encoding."""
    encoding: Encoding = "rows"

    @classmethod
    def of(cls, kind: str, query: Mapping[str, str]) -> MapQuery:
        """Return the request of a path and its query; ConfigError where a value cannot be."""
        if kind not in MAP_KINDS:
            raise NoSuchResource(f"there is no such map: {', '.join(MAP_KINDS)}")
        encoding = next((one for one in ENCODINGS if one == query.get("encoding", "rows")), None)
        if encoding is None:
            raise ConfigError(f"encoding must be one of {', '.join(ENCODINGS)}")
        px = query_number(query, "px", ENCODINGS[encoding], LEAST_PX, max(ENCODINGS.values()))
        return cls(kind, min(px, ENCODINGS[encoding]), encoding)


Default = TypeVar("Default", int, None)


def query_number(query: Mapping[str, str], key: str, default: Default, least: int, most: int) -> int | Default:
    """Return a whole number of a query; ConfigError where it is none, or outside its limits."""
    text = query.get(key)
    if text is None:
        return default
    digits = text.lstrip("0") or text[-1:]  # int() takes at most 4300 digits
    if not (text.isascii() and text.isdecimal() and len(digits) <= len(str(most)) and least <= int(digits) <= most):
        raise ConfigError(f"{key} must be a whole number from {least} to {most}")
    return int(digits)


@dataclass(frozen=True, slots=True)
class _Sampled:
    """Values on a lattice: row 0 is the top."""

    values: FloatArray
    """(ny, nx); NaN: no data."""
    aperture: BoolArray
    """(ny, nx) samples of the clear aperture."""
    corner_mm: tuple[float, float]
    """x and y of the first sample of row 0."""
    pitch_mm: float


def picture(request: MapQuery, surface: Arrays, plan: Arrays | None, after: Arrays | None) -> dict[str, Any]:
    """Return the answer for a map.

    Args:
        request: the kind, and how it is answered.
        surface: arrays of the measurement before the pass.
        plan: arrays of the plan; None: the kind needs none.
        after: arrays of the measurement after the pass; None: as ``plan``.

    Raises:
        ConfigError: arrays are missing or do not fit: they are of an earlier polishd, or of another pass.
    """
    kind = MAP_KINDS[request.kind]
    try:
        if kind.of_path:
            sampled = _of_path(surface, _given(plan), "time_s" if request.kind == "dwell" else "gamma", request.px)
        else:
            sampled = _of_grid(surface, _heights(request.kind, surface, plan, after))
    except (KeyError, ValueError, IndexError, TypeError) as error:
        raise ConfigError(f"the arrays of this map are not those of a pass ({error!r}); it cannot be shown") from error
    inside = sampled.values[sampled.aperture & np.isfinite(sampled.values)]
    limit = height_limit(inside)
    return {
        "kind": request.kind,
        "unit": kind.unit,
        "signed": kind.signed,
        **_spread(inside),
        "scale": [-limit, limit] if kind.signed else list(value_limits(inside, PERCENTILE)),
        **_encoded(_thinned(sampled, request.px), kind.key, request.encoding),
    }


def _given(plan: Arrays | None) -> Arrays:
    if plan is None:
        raise ValueError("no plan")
    return plan


def _heights(kind: str, surface: Arrays, plan: Arrays | None, after: Arrays | None) -> FloatArray:
    height = np.asarray(surface["height_nm"], dtype=np.float64)
    if kind == "measured":
        return height
    planned = np.asarray(_given(plan)["predicted_removal_nm" if kind == "removal" else "residual_nm"], dtype=np.float64)
    if planned.shape != height.shape:
        raise ValueError(f"grids {planned.shape} and {height.shape}")
    expected = np.where(np.isfinite(height), planned, np.nan)
    if kind != "residual":
        return expected
    last, mask = np.asarray(_given(after)["height_nm"], dtype=np.float64), surface["metric_mask"]
    return _about_mean(last, mask) - _about_mean(expected, mask)


def _about_mean(height_nm: FloatArray, mask: BoolArray) -> FloatArray:
    inside = height_nm[mask & np.isfinite(height_nm)]
    return height_nm - (inside.mean() if inside.size else 0.0)


def _of_grid(surface: Arrays, values: FloatArray) -> _Sampled:
    mask = np.asarray(surface["metric_mask"], dtype=np.bool_)
    if values.ndim != 2 or mask.shape != values.shape:
        raise ValueError(f"grids {values.shape} and {mask.shape}")
    return _Sampled(values, mask, _corner_mm(mask.shape, _pitch_mm(surface)), _pitch_mm(surface))


def _pitch_mm(surface: Arrays) -> float:
    pitch = float(surface["pitch_mm"])
    if not (math.isfinite(pitch) and pitch > 0):
        raise ValueError(f"pitch {pitch}")
    return pitch


def _corner_mm(shape: tuple[int, ...], pitch_mm: float) -> tuple[float, float]:
    return -(shape[1] - 1) / 2 * pitch_mm, (shape[0] - 1) / 2 * pitch_mm


def _of_path(surface: Arrays, plan: Arrays, key: str, px: int) -> _Sampled:
    """Each sample has the value of the nearest point of the path, as far from it as the aperture's samples are."""
    import scipy.spatial

    points = (np.asarray(plan["start_mm"])[:, :2] + np.asarray(plan["end_mm"])[:, :2]) / 2
    values, mask = np.asarray(plan[key], dtype=np.float64), np.asarray(surface["metric_mask"], dtype=np.bool_)
    if not values.size or values.shape != points.shape[:1] or not np.isfinite(points).all():
        raise ValueError(f"{values.shape} values at {points.shape} points")
    (left, top), pitch = _corner_mm(mask.shape, _pitch_mm(surface)), _pitch_mm(surface)
    low, high = points.min(axis=0), points.max(axis=0)
    step = pitch * max(1.0, math.ceil((max(high - low) / pitch + 1) / px))
    x = np.arange(low[0], high[0] + step, step)
    y = np.arange(high[1], low[1] - step, -step)
    # not rint: it takes every other half to the same even number
    column = np.floor((x - left) / pitch + 0.5).astype(np.intp)
    row = np.floor((top - y) / pitch + 0.5).astype(np.intp)
    on_grid = ((row >= 0) & (row < mask.shape[0]))[:, None] & ((column >= 0) & (column < mask.shape[1]))
    aperture = on_grid & mask[np.clip(row, 0, mask.shape[0] - 1)][:, np.clip(column, 0, mask.shape[1] - 1)]
    distance, nearest = scipy.spatial.cKDTree(points).query(np.stack(np.meshgrid(x, y), axis=2))
    reach = 1.5 * float(np.percentile(distance[aperture], PERCENTILE)) if aperture.any() else 0.0
    covered = distance <= max(reach, step)
    return _Sampled(np.where(covered, values[nearest], np.nan), aperture, (float(x[0]), float(y[0])), step)


def _spread(inside: FloatArray) -> dict[str, float]:
    """Figures of the clear aperture; the RMS is about the mean."""
    if not inside.size:
        return {"low": 0.0, "high": 0.0, "mean": 0.0, "rms": 0.0}
    return {
        "low": float(inside.min()),
        "high": float(inside.max()),
        "mean": float(inside.mean()),
        "rms": float(inside.std()),
    }


def _thinned(sampled: _Sampled, px: int) -> _Sampled:
    """Not smoothed: a spike stays a spike, or is not shown."""
    step = max(1, -(-max(sampled.values.shape) // px))
    chosen = np.s_[::step, ::step]
    return _Sampled(sampled.values[chosen], sampled.aperture[chosen], sampled.corner_mm, sampled.pitch_mm * step)


def _encoded(sampled: _Sampled, key: str, encoding: Encoding) -> dict[str, Any]:
    """``rows``: the clear aperture, null where there are no data. ``float32``: all data, NaN where there are none."""
    facts = {
        "pitch_mm": sampled.pitch_mm,
        "x0_mm": sampled.corner_mm[0],
        "y0_mm": sampled.corner_mm[1],
        "ny": sampled.values.shape[0],
        "nx": sampled.values.shape[1],
        "encoding": encoding,
        "key": key,
    }
    if encoding == "float32":
        values = base64.b64encode(sampled.values.astype("<f4").tobytes()).decode("ascii")
        mask = base64.b64encode(np.packbits(sampled.aperture).tobytes()).decode("ascii")
        return {**facts, key: values, "aperture": mask}
    shown = np.where(sampled.aperture, sampled.values, np.nan)
    digits = 3 if key == "height_nm" else 5
    return {**facts, key: [[round(float(one), digits) if np.isfinite(one) else None for one in row] for row in shown]}
