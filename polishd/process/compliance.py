"""From the robot's compliance matrix to one number a point, and to what is left of the contact's depth (eq. 42-48)."""

from __future__ import annotations

from typing import Literal

import numpy as np

from polishd.model.process import ToolProcess
from polishd.model.surface import BoolArray, FloatArray
from polishd.process.robot.refusal import refuse_where

Projection = Literal["linear", "quadratic", "normal"]
"""How the compliance matrix is taken along the surface normal b; see `equivalent_compliance`."""

JUMP = 0.05
"""Relative change between neighbours, beyond that of the compliance matrix itself, that counts as a jump."""


def equivalent_compliance(
    matrix: FloatArray, axis: FloatArray, normal: FloatArray, projection: Projection = "linear"
) -> FloatArray:
    """(n,) linear equivalent compliance in the direction of the surface normal b (paper eq. 42-43), mm/N.

    ``matrix`` (n, 3, 3) mm/N symmetric positive definite, ``axis`` and ``normal`` (n, 3) unit, all in one frame.
    X_1 and X_2 are the eigenvectors other than the one nearest the tool axis. "linear" sums ``lambda_k |<X_k, b>|``
    (eq. 43, with the eigenvectors' sign made harmless), "quadratic" sums ``lambda_k <X_k, b>^2``, "normal" is
    ``b' C b``, what a static loading test along b measures. Where lambda_1 and lambda_2 are close "linear" depends on
    the eigenvectors' rotation: see `jumps`.
    """
    if projection == "normal":
        return np.asarray(np.einsum("ni,nij,nj->n", normal, matrix, normal), dtype=np.float64)
    values, vectors = np.linalg.eigh(matrix)
    along_axis = np.abs(np.einsum("nij,ni->nj", vectors, axis))
    across = np.arange(3) != along_axis.argmax(axis=1)[:, None]
    share = np.abs(np.einsum("nij,ni->nj", vectors, normal))
    return np.asarray((across * values * (share if projection == "linear" else share**2)).sum(axis=1))


def jumps(compliance: FloatArray, matrix: FloatArray) -> BoolArray:
    """(n - 1,) True where the equivalent compliance changes by over 5 % more than its matrix does, point to point.

    ``compliance`` (n,) and ``matrix`` (n, 3, 3) in one unit. Such a change comes from the projection, not the robot.
    """
    size = np.linalg.norm(matrix, axis=(1, 2))
    matrix_change = np.linalg.norm(np.diff(matrix, axis=0), axis=(1, 2)) / np.minimum(size[1:], size[:-1])
    change = np.abs(np.diff(compliance)) / np.minimum(compliance[1:], compliance[:-1])
    return np.asarray(change > JUMP + matrix_change, dtype=np.bool_)


def depth_ratio(compliance_mm_per_n: FloatArray, process: ToolProcess, depth_mm: float) -> FloatArray:
    """(n,) gamma = 1 - dz/d (paper eq. 48) with dz = c F / cos(dip) (eq. 44) and d the rigid robot's depth, mm.

    Raises ComputeError where nothing of the depth would be left.
    """
    offset_mm = compliance_mm_per_n * process.force_n / np.cos(np.radians(process.dip_deg))
    gamma = np.asarray(1.0 - offset_mm / depth_mm, dtype=np.float64)
    says = f"at {process.force_n:g} N takes all of the contact's depth ({depth_mm:.5g} mm): gamma would not be above 0"
    refuse_where(~(gamma > 0), compliance_mm_per_n * 1e3, "the equivalent compliance", "um/N", says)
    return gamma
