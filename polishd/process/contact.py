"""The contact of a rigid robot's bonnet: Hertz pressure, sliding speed and Preston's rate (paper eq. 16-33).

The tool's frame: origin at the contact's centre, z out of the part, y where the spindle leans, x = y cross z. The tool
turns counterclockwise about the axis from the tip into the spindle for a positive speed.
Depths (mm) may be a number or any array that broadcasts with x and y.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import scipy

from polishd.model.errors import ComputeError
from polishd.model.process import ToolProcess
from polishd.model.surface import FloatArray
from polishd.process.robot.refusal import require_number

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
