"""The contact of a rigid robot's bonnet: Hertz pressure, sliding speed and Preston's rate (paper eq. 16-33).

The tool's frame: origin at the contact's centre, z out of the part, y where the spindle leans, x = y cross z. The tool
turns counterclockwise about the axis from the tip into the spindle for a positive speed.
Depths (mm) may be a number or any array that broadcasts with x and y.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import scipy

from polishd.model.errors import ComputeError
from polishd.model.process import Optic, ToolProcess
from polishd.model.surface import FloatArray
from polishd.process import optic_surface
from polishd.process.checks import refuse_where, require_number

CM2_PER_N = 100.0
"""mm^2/N in one cm^2/N."""
NM_PER_MM = 1e6

Depth = float | FloatArray


def check_process(process: ToolProcess) -> None:
    """Raise ComputeError that names the first number of the process which cannot be."""
    moduli = {"tool_modulus_mpa": "MPa", "part_modulus_mpa": "MPa", "lame_mpa": "MPa"}
    units = {"tool_radius_mm": "mm", "force_n": "N", "rpm": "1/min", "preston_cm2_per_n": "cm2/N", **moduli}
    units |= {"depth_exponent": ""}
    for name, unit in units.items():
        require_number(f"the process's {name}", getattr(process, name), unit, above=0.0)
    require_number("the process's dip_deg", process.dip_deg, "deg", above=-1e-12, below=90.0)
    for name in ("tool_poisson", "part_poisson"):
        require_number(f"the process's {name}", getattr(process, name), "", above=-1.0, below=0.5 + 1e-12)
    for name in ("viscosity_mpa_s", "second_viscosity_mpa_s"):
        require_number(f"the process's {name}", getattr(process, name), "MPa s", above=-1e-12)
    for value in process.spot_offset_mm:
        require_number(
            "the process's spot_offset_mm", value, "mm", above=-process.tool_radius_mm, below=process.tool_radius_mm
        )
    if process.normal_force not in ("axial", "resolved"):
        raise ComputeError(f"the process's normal_force is {process.normal_force!r}, it must be axial or resolved")


def reduced_modulus_mpa(process: ToolProcess) -> float:
    """E* of bonnet and part (paper eq. 28), MPa."""
    tool = (1 - process.tool_poisson**2) / process.tool_modulus_mpa
    return float(1 / (tool + (1 - process.part_poisson**2) / process.part_modulus_mpa))


def normal_force_n(process: ToolProcess) -> float:
    """Force that Hertz is given, N: the actuator's ("axial"), or ``force / cos(dip)`` as eq. 44 has it ("resolved")."""
    if process.normal_force == "axial":
        return process.force_n
    return float(process.force_n / np.cos(np.radians(process.dip_deg)))


def hertz_depth_mm(process: ToolProcess) -> float:
    """Depth d at which Hertz gives the normal force (eq. 28 solved for d), mm.

    Raises ComputeError for an impossible process, or where the bonnet would be pressed in by a quarter of its radius.
    """
    check_process(process)
    radius, force = process.tool_radius_mm, normal_force_n(process)
    depth = float((0.75 * force / (reduced_modulus_mpa(process) * np.sqrt(radius))) ** (2 / 3))
    if depth > radius / 4:
        raise ComputeError(
            f"the contact's depth is {depth:.5g} mm at {force:.4g} N: too deep for Hertz on a bonnet of radius "
            f"{radius:g} mm"
        )
    return depth


def contact_radius_mm(process: ToolProcess, depth_mm: Depth) -> FloatArray:
    """``a = sqrt(R d)``, mm (eq. 27)."""
    return np.sqrt(process.tool_radius_mm * np.asarray(depth_mm))


def peak_pressure_mpa(process: ToolProcess, depth_mm: Depth) -> FloatArray:
    """Pressure at the contact's centre, ``3 F / (2 pi a^2)``, MPa (eq. 27 and 28)."""
    return 2 * reduced_modulus_mpa(process) / np.pi * np.sqrt(np.asarray(depth_mm) / process.tool_radius_mm)


def sliding_speed_mm_s(process: ToolProcess, depth_mm: Depth, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
    """Speed of the bonnet along the surface at (x, y) of the tool's frame (eq. 17-18, rigid spin), mm/s."""
    dip, spin = np.radians(process.dip_deg), process.rpm * np.pi / 30
    height = process.tool_radius_mm - np.asarray(depth_mm)
    across, along = np.sin(dip) * height + np.cos(dip) * y_mm, np.cos(dip) * x_mm
    return np.asarray(spin * np.sqrt(across * across + along * along))  # hypot takes four times as long


def dissipative_shift_mm(process: ToolProcess, depth_mm: Depth) -> FloatArray:
    """Shift of the pressure along +x, towards the side where the bonnet enters the contact, mm (eq. 29 and 32).

    ``alpha omega sin(dip) (R - d)``: the bounded reading of the dissipative stress, about 1 um at 1000 rpm. The force
    stays what it was; the moment is shift x force (eq. 33). It lies along x because the dip lies in y-z (eq. 30).
    """
    viscosity = 2 * process.second_viscosity_mpa_s + process.viscosity_mpa_s / 3
    alpha_s = viscosity * process.tool_poisson / process.lame_mpa
    entering = process.rpm * np.pi / 30 * np.sin(np.radians(process.dip_deg))
    return np.asarray(alpha_s * entering * (process.tool_radius_mm - np.asarray(depth_mm)), dtype=np.float64)


def dissipative_fraction(process: ToolProcess, depth_mm: Depth) -> FloatArray:
    """Size of the dissipative stress: the shift that has its moment, over the contact's radius (eq. 29-33).

    It is the moment of the dissipative stress over force x contact radius. At ``rho`` contact radii along x eq. 29 and
    32 print ``fraction * rho / (1 - rho^2)`` for dissipative over elastic stress: infinite at the rim, which is why the
    pressure is shifted instead. Eq. 32's last term, fifty times smaller at the paper's numbers, is left out.
    """
    return np.asarray(dissipative_shift_mm(process, depth_mm) / contact_radius_mm(process, depth_mm), dtype=np.float64)


def pressure_mpa(process: ToolProcess, depth_mm: Depth, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
    """Pressure at (x, y) of the tool's frame, 0 outside the contact, dissipative shift included, MPa (eq. 27-32)."""
    shifted = np.hypot(x_mm - dissipative_shift_mm(process, depth_mm), y_mm)
    rho = shifted / contact_radius_mm(process, depth_mm)
    return np.asarray(peak_pressure_mpa(process, depth_mm) * np.sqrt(np.clip(1 - rho**2, 0.0, None)))


def preston_nm_s(process: ToolProcess) -> float:
    """Removal rate in nm/s per MPa of pressure and mm/s of speed (eq. 16; the paper prints no unit, cm2/N is taken)."""
    return process.preston_cm2_per_n * CM2_PER_N * NM_PER_MM


def removal_rate_nm_s(process: ToolProcess, depth_mm: Depth, x_mm: FloatArray, y_mm: FloatArray) -> FloatArray:
    """Removal rate at (x, y) of the tool's frame, nm/s, 0 outside the contact: ``k p v`` (eq. 16)."""
    pressure = pressure_mpa(process, depth_mm, x_mm, y_mm)
    return np.asarray(preston_nm_s(process) * pressure * sliding_speed_mm_s(process, depth_mm, x_mm, y_mm))


def volume_rate_nm_mm2_s(process: ToolProcess, depth_mm: Depth) -> FloatArray:
    """(n,) volume removed per second at (n,) depths, nm mm^2/s (1e-6 mm^3/s): the integral of `removal_rate_nm_s`."""
    depth = np.atleast_1d(depth_mm)
    radius = contact_radius_mm(process, depth)
    scale = radius**2 * peak_pressure_mpa(process, depth)
    dip, spin = np.radians(process.dip_deg), process.rpm * np.pi / 30
    shift = np.cos(dip) * dissipative_shift_mm(process, depth)
    middle = np.hypot(np.sin(dip) * (process.tool_radius_mm - depth), shift)
    rho, weight = _disc()
    speed = spin * _mean_sum(middle[:, None], np.cos(dip) * radius[:, None] * rho)
    return np.asarray(preston_nm_s(process) * scale * (speed * weight).sum(axis=1), dtype=np.float64)


def relative_removal(process: ToolProcess, force_n: FloatArray, rpm: FloatArray) -> FloatArray:
    """(n,) volume removed a second at (n,) forces and speeds, over that at the process's own.

    Depth goes as ``force^(2/3)`` (eq. 28), volume as ``depth^depth_exponent`` and as the speed (eq. 16); the spot's
    size, which goes as ``force^(1/3)``, is left as it is. NaN: the process's own.
    """
    force = np.where(np.isnan(force_n), 1.0, np.clip(force_n / process.force_n, 0.0, None))
    speed = np.where(np.isnan(rpm), 1.0, np.abs(rpm) / process.rpm)
    return np.asarray(force ** (2 / 3 * process.depth_exponent) * speed, dtype=np.float64)


def _mean_sum(one: FloatArray, other: FloatArray) -> FloatArray:
    """Mean length of the sum of two vectors of these lengths, over all angles between them."""
    both = one + other
    return np.asarray(2 / np.pi * both * scipy.special.ellipe(4 * one * other / both**2))


@cache
def _disc() -> tuple[FloatArray, FloatArray]:
    """Nodes of the unit disc: (16,) radii and weights, of what goes as ``sqrt(1 - rho^2)``.

    Gauss-Legendre in psi with ``rho = sin(psi)``, where pressure and speed are smooth.
    """
    node, weight = np.polynomial.legendre.leggauss(16)
    psi = (node + 1) * np.pi / 4
    return np.sin(psi), np.asarray(weight * np.pi**2 / 2 * np.sin(psi) * np.cos(psi) ** 2)


# What a part's own curvature makes of a contact: Hertz's ellipse on the surface, and how a map sees it from above.

STEP_MM = 0.05
"""On either side of a point: what the normals' differences tell of curvature; they are exact but for rounding."""
CLOSEST = 0.9
"""Part of the bonnet's curvature that a concave part may have: closer, and it is touched all round."""
SLIMMEST = 0.05
"""Ratio of an ellipse's axes down to which it is tabulated."""


@dataclass(frozen=True, slots=True)
class CurvedContact:
    """Contacts at n points of a part, beside the same bonnet's on a flat."""

    deeper: FloatArray
    """(n,) depth under the same force, over that on a flat."""
    wider: FloatArray
    """(n, 2) half its width along the part's x and y, seen along z, over the radius on a flat."""
    seen: FloatArray
    """(n,) share of the removed volume that a map shows: the cosine of the slope."""
    askew: FloatArray
    """(n,) correlation of x and y over the ellipse: 0 where its axes lie along them."""

    @property
    def note(self) -> str:
        """Note for an answer."""
        wide = f"contacts {self.wider.min():.3f} to {self.wider.max():.3f} times as wide as on a flat"
        return f"curved part: {wide}, the slope takes up to {1 - self.seen.min():.2%} of what a map shows"


def contact_on_curved_part(
    process: ToolProcess, optic: Optic, place_mm: FloatArray, *, contact: bool = True
) -> CurvedContact | None:
    """The contacts over points (n, 2 or more) of the part's frame; None on a flat.

    Without ``contact`` only the slope counts: a spot that was measured is as wide as it was measured.
    Raises ComputeError as `optics.unit_normals`, and where the bonnet does not fit into the part.
    """
    if optic_surface.is_flat(optic) or not len(place_mm):
        return None
    normal, curvature, level = _shape(optic, np.asarray(place_mm[:, :2], dtype=np.float64))
    deeper, axes = np.ones(len(normal)), np.tile(np.eye(2), (len(normal), 1, 1))
    if contact:
        deeper, axes = _ellipse(process, curvature)
    above = np.linalg.solve(level, axes)
    square = above @ above.transpose(0, 2, 1)
    wider = np.sqrt(np.einsum("nii->ni", square))
    return CurvedContact(deeper, wider, normal[:, 2], square[:, 0, 1] / wider.prod(axis=1))


def _shape(optic: Optic, plane: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Unit normals (n, 3); curvatures (n, 2, 2), 1/mm, concave positive; and offsets in x and y to those along it.

    All but the normals in the frame that is turned with the normal, the short way to z.
    """
    normal = optic_surface.unit_normals(optic, plane)
    lean, up = normal[:, :2], normal[:, 2]
    level = np.eye(2) + lean[:, :, None] * lean[:, None, :] / (up * (1 + up))[:, None, None]
    ways = STEP_MM * np.eye(2)
    turns = [
        (optic_surface.unit_normals(optic, plane + way) - optic_surface.unit_normals(optic, plane - way))
        for way in ways
    ]
    turn = np.stack(turns, axis=2) / (2 * STEP_MM)  # (n, 3, 2): of the normal, by x and y
    along = turn[:, :2] - (lean / (1 + up)[:, None])[:, :, None] * turn[:, 2:]
    bend = -along @ np.linalg.inv(level)
    return normal, (bend + bend.transpose(0, 2, 1)) / 2, level


def _ellipse(process: ToolProcess, curvature: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n,) depth and (n, 2, 2) the unit disc's map to the contact, both over the flat's; curvatures (n, 2, 2), 1/mm."""
    own = 1 / process.tool_radius_mm
    value, vector = np.linalg.eigh(own * np.eye(2) - curvature)
    part_mm = 1 / np.maximum(own - value[:, 0], 1e-12)
    refuse_where(
        value[:, 0] < (1 - CLOSEST) * own, part_mm, "the part's radius of curvature", "mm",
        f"the bonnet of {process.tool_radius_mm:g} mm does not lie in it with a spot",
    )  # fmt: skip
    ratio, slim, size, depth = _table()
    k, by = (np.interp(value[:, 0] / value[:, 1], ratio, of) for of in (slim, size))
    mean_mm = 1 / np.sqrt(value.prod(axis=1))
    across = (mean_mm * own) ** (1 / 3) * by
    half = np.stack([across / np.sqrt(k), across * np.sqrt(k)], axis=1)
    deeper = (mean_mm * own) ** (-1 / 3) * np.interp(value[:, 0] / value[:, 1], ratio, depth)
    return deeper, vector * half[:, None, :] @ vector.transpose(0, 2, 1)


@cache
def _table() -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Ratio of the principal relative curvatures, ascending; of the ellipse's axes; and Johnson's F1 and F2."""
    k = np.append(np.linspace(SLIMMEST, 1 - 1e-3, 400), 1.0)
    m = 1 - k[:-1] ** 2
    first, second = scipy.special.ellipk(m), scipy.special.ellipe(m)
    high, low = second / k[:-1] ** 2 - first, first - second
    f_1 = (4 / (np.pi * m)) ** (1 / 3) * np.sqrt(k[:-1]) * (high * low) ** (1 / 6)
    f_2 = 2 / np.pi * np.sqrt(k[:-1]) / f_1 * first
    return np.append(low / high, 1.0), k, np.append(f_1, 1.0), np.append(f_2, 1.0)
