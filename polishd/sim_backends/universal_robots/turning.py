"""Orientations: rotation vectors as URScript writes them, quaternions between, A and C for the plant."""

from __future__ import annotations

import math
from collections.abc import Sequence

Quaternion = tuple[float, float, float, float]
Triple = tuple[float, float, float]


def from_vector(vector: Sequence[float]) -> Quaternion:
    """The quaternion (w, x, y, z) of a rotation vector, rad."""
    x, y, z = vector
    angle = math.sqrt(x * x + y * y + z * z)
    share = math.sin(angle / 2.0) / angle if angle > 1e-12 else 0.5
    return math.cos(angle / 2.0), x * share, y * share, z * share


def to_vector(quaternion: Quaternion) -> Triple:
    """The rotation vector, rad, of at most pi."""
    w, x, y, z = quaternion if quaternion[0] >= 0.0 else tuple(-part for part in quaternion)
    length = math.sqrt(x * x + y * y + z * z)
    share = 2.0 * math.atan2(length, w) / length if length > 1e-12 else 2.0
    return x * share, y * share, z * share


def turned(quaternion: Quaternion, vector: Sequence[float]) -> Triple:
    """A vector, turned."""
    w, x, y, z = quaternion
    vx, vy, vz = vector
    tx, ty, tz = 2.0 * (y * vz - z * vy), 2.0 * (z * vx - x * vz), 2.0 * (x * vy - y * vx)
    return (
        vx + w * tx + y * tz - z * ty,
        vy + w * ty + z * tx - x * tz,
        vz + w * tz + x * ty - y * tx,
    )


def after(first: Quaternion, second: Quaternion) -> Quaternion:
    """``first`` times ``second``: turned by the second, then by the first."""
    a, b, c, d = first
    e, f, g, h = second
    return (
        a * e - b * f - c * g - d * h,
        a * f + b * e + c * h - d * g,
        a * g - b * h + c * e + d * f,
        a * h + b * g - c * f + d * e,
    )


def between(begin: Quaternion, end: Quaternion, share: float) -> Quaternion:
    """On the way from one to the other, at constant angular speed."""
    dot = sum(a * b for a, b in zip(begin, end, strict=True))
    sign = 1.0 if dot >= 0.0 else -1.0
    angle = math.acos(min(abs(dot), 1.0))
    if angle < 1e-9:
        return end
    low, high = math.sin((1.0 - share) * angle) / math.sin(angle), sign * math.sin(share * angle) / math.sin(angle)
    w, x, y, z = (low * a + high * b for a, b in zip(begin, end, strict=True))
    return w, x, y, z


def angle(begin: Quaternion, end: Quaternion) -> float:
    """Between two orientations, rad."""
    return 2.0 * math.acos(min(abs(sum(a * b for a, b in zip(begin, end, strict=True))), 1.0))


def wrist_deg(quaternion: Quaternion) -> tuple[float, float]:
    """A and C of the plant, deg: the tool axis points from the tip into the spindle, against the tool frame's z."""
    x, y, z = (-part for part in turned(quaternion, (0.0, 0.0, 1.0)))
    a = math.acos(max(-1.0, min(z, 1.0)))
    return math.degrees(a), math.degrees(math.atan2(x, -y)) if a > 1e-9 else 0.0


def from_wrist(a_deg: float, c_deg: float) -> Quaternion:
    """An orientation that has these A and C."""
    half_a, half_c = math.radians(a_deg) / 2.0, math.radians(c_deg) / 2.0
    dip = after((math.cos(half_c), 0.0, 0.0, math.sin(half_c)), (math.cos(half_a), math.sin(half_a), 0.0, 0.0))
    return after(dip, (0.0, 1.0, 0.0, 0.0))
