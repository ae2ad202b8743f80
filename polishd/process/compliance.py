"""From the robot's compliance matrix to one number a point, and to what is left of the contact's depth (eq. 42-48)."""

from __future__ import annotations

import numpy as np

from polishd.model.process import Projection, ToolProcess
from polishd.model.surface import BoolArray, FloatArray
from polishd.process.robot.parallel import cross, dot
from polishd.process.robot.refusal import refuse_where, require_number

JUMP = 0.05
"""Relative change between neighbours, beyond that of the compliance matrix itself, that counts as a jump."""
CHUNK = 4096
"""Points worked on at a time: what they need stays in the processor's cache."""
SEPARATE = 1e-3
"""Where an eigenvalue lies nearer to another than this (relative), closed forms lose digits and LAPACK takes over."""
ROUNDING = 1e-9
"""Relative size up to which an asymmetry, or an imaginary part, is rounding."""
EQUAL = 1e-6
"""Eigenvalues this near (relative) are one: so are points with such a pair given to LAPACK."""


def equivalent_compliance(
    matrix: FloatArray, axis: FloatArray, normal: FloatArray, projection: Projection = "linear"
) -> FloatArray:
    """(n,) linear equivalent compliance in the direction of the surface normal b (paper eq. 42-43), mm/N.

    ``matrix`` (n, 3, 3) mm/N, ``axis`` and ``normal`` (n, 3) unit, all in one frame. X_1 and X_2 are the eigenvectors
    other than the one nearest the tool axis. "linear" sums ``lambda_k |<X_k, b>|`` (eq. 43, with the eigenvectors' sign
    made harmless), "quadratic" sums ``lambda_k <X_k, b>^2``, "normal" is ``b' C b``, what a static loading test along b
    measures. Where lambda_1 and lambda_2 are close "linear" depends on the eigenvectors' rotation: see `jumps`.

    A matrix that is not symmetric (eq. 41 as printed) may have complex eigenvalues: ComputeError names the first such
    point, and says how many there are; `complex_eigenvalues` finds them.
    """
    if projection == "normal":
        return np.asarray(np.einsum("ni,nij,nj->n", normal, matrix, normal), dtype=np.float64)
    if not _is_symmetric(matrix):
        return _projected(*_real_eigen(matrix), axis, normal, projection)
    result = np.empty(len(matrix))
    for first in range(0, len(matrix), CHUNK):
        part = slice(first, first + CHUNK)
        result[part] = _symmetric(matrix[part], axis[part], normal[part], projection)
    return result


def complex_eigenvalues(matrix: FloatArray) -> BoolArray:
    """(n,) True where an (n, 3, 3) matrix has complex eigenvalues, and no equivalent compliance: eq. 41 as printed."""
    values = np.linalg.eigvals(matrix)
    return np.asarray((np.abs(values.imag) > ROUNDING * np.abs(values)).any(axis=1), dtype=np.bool_)


def jumps(compliance: FloatArray, matrix: FloatArray) -> BoolArray:
    """(n - 1,) True where the equivalent compliance changes by over 5 % more than its matrix does, point to point.

    ``compliance`` (n,) and ``matrix`` (n, 3, 3) in one unit. Such a change comes from the projection, not the robot.
    """
    size = np.linalg.norm(matrix, axis=(1, 2))
    matrix_change = np.linalg.norm(np.diff(matrix, axis=0), axis=(1, 2)) / np.minimum(size[1:], size[:-1])
    change = np.abs(np.diff(compliance)) / np.minimum(compliance[1:], compliance[:-1])
    return np.asarray(change > JUMP + matrix_change, dtype=np.bool_)


def depth_ratio(compliance_mm_per_n: FloatArray, process: ToolProcess, depth_mm: float | FloatArray) -> FloatArray:
    """(n,) gamma = 1 - dz/d (paper eq. 48) with dz = c F / cos(dip) (eq. 44) and d the rigid robot's depth, mm.

    ``depth_mm`` is a number, or (n,) where the part's curvature makes each its own.
    Raises ComputeError where nothing of the depth would be left.
    """
    require_number("the process's dip_deg", process.dip_deg, "deg", above=-90.0, below=90.0)
    offset_mm = compliance_mm_per_n * (process.force_n / np.cos(np.radians(process.dip_deg)))
    gamma = np.asarray(1.0 - offset_mm / depth_mm, dtype=np.float64)
    gone = ~(gamma > 0)
    if gone.any():
        first = int(np.argmax(gone))
        softest, deep = float(compliance_mm_per_n[first]) * 1e3, np.broadcast_to(depth_mm, gone.shape)[first]
        limit = (
            f"the contact is only {deep:.5g} mm deep (equivalent compliance {softest:.4g} um/N at "
            f"{process.force_n:g} N): gamma would not be above 0"
        )
        refuse_where(gone, offset_mm, "the way that the robot gives", "mm", limit)
    return gamma


def _is_symmetric(matrix: FloatArray) -> bool:
    across = [np.abs(matrix[:, i, j] - matrix[:, j, i]).max(initial=0.0) for i, j in ((0, 1), (0, 2), (1, 2))]
    return bool(max(across) <= ROUNDING * np.abs(matrix).max(initial=0.0))


def _symmetric(matrix: FloatArray, axis: FloatArray, normal: FloatArray, projection: Projection) -> FloatArray:
    """Eq. 43 in closed form: LAPACK's batched eigh alone costs as much as all of the robot's model.

    X_3, the eigenvector nearest the tool axis, is found from its eigenvalue; the other two lie in the plane across it,
    where a Jacobi rotation gives them. Where X_3's eigenvalue does not stand apart, LAPACK has the word.
    """
    c = np.ascontiguousarray(matrix.transpose(1, 2, 0))
    a, b = np.ascontiguousarray(axis.T), np.ascontiguousarray(normal.T)
    value, gap = _axial_eigenvalue(c, a)
    x = _null_vector(c, value)
    along = dot(x, b)
    across = b - along * x
    share = np.sqrt(dot(across, across))
    first = across / np.maximum(share, 1e-300)
    second = cross(x, first)
    pushed = _times(c, first)
    m_11, m_12, m_22 = dot(first, pushed), dot(second, pushed), dot(second, _times(c, second))
    mean, half = (m_11 + m_22) / 2, (m_11 - m_22) / 2
    spread = np.hypot(half, m_12)
    big = np.where(spread > 0, (spread + np.abs(half)) / np.maximum(2 * spread, 1e-300), 1.0)
    small = m_12**2 / np.maximum(4 * spread**2 * big, 1e-300)  # 1 - big, without its cancellation
    on_high = np.where(half >= 0, big, small)
    on_low = np.where(half >= 0, small, big)
    if projection == "linear":
        result = share * ((mean + spread) * np.sqrt(on_high) + (mean - spread) * np.sqrt(on_low))
    else:
        result = share**2 * ((mean + spread) * on_high + (mean - spread) * on_low)
    near = gap < SEPARATE
    if near.any():
        result[near] = _projected(*np.linalg.eigh(matrix[near]), axis[near], normal[near], projection)
    return np.asarray(result, dtype=np.float64)


def _axial_eigenvalue(c: FloatArray, a: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n,) eigenvalue of the (3, 3, n) symmetric matrices whose eigenvector is nearest a (3, n), and its relative gap.

    Eigenvalues by the trigonometric form; the squared cosine to each eigenvector is a' P_k a, P_k its projector.
    """
    mean = (c[0, 0] + c[1, 1] + c[2, 2]) / 3
    d_0, d_1, d_2 = c[0, 0] - mean, c[1, 1] - mean, c[2, 2] - mean
    off = c[0, 1] ** 2 + c[0, 2] ** 2 + c[1, 2] ** 2
    size = np.sqrt((d_0**2 + d_1**2 + d_2**2 + 2 * off) / 6)
    det = d_0 * (d_1 * d_2 - c[1, 2] ** 2) - c[0, 1] * (c[0, 1] * d_2 - c[1, 2] * c[0, 2])
    det += c[0, 2] * (c[0, 1] * c[1, 2] - d_1 * c[0, 2])
    angle = np.arccos(np.clip(det / np.maximum(2 * size**3, 1e-300), -1.0, 1.0)) / 3
    high, low = mean + 2 * size * np.cos(angle), mean + 2 * size * np.cos(angle + 2 * np.pi / 3)
    middle = 3 * mean - high - low
    pushed = _times(c, a)
    once, twice = dot(a, pushed), dot(pushed, pushed)
    tiny = np.maximum(np.abs(mean), 1e-300) ** 2 * 1e-30
    value = np.stack([high, middle, low])
    share = np.stack(
        [
            (twice - (q + r) * once + q * r) / np.maximum((p - q) * (p - r) * sign, tiny) * sign
            for p, q, r, sign in ((high, middle, low, 1.0), (middle, high, low, -1.0), (low, high, middle, 1.0))
        ]
    )
    nearest = share.argmax(axis=0)[None, :]
    own = np.take_along_axis(value, nearest, axis=0)[0]
    closest = np.minimum(high - middle, middle - low)
    gap = np.where(nearest[0] == 0, high - middle, np.where(nearest[0] == 2, middle - low, closest))
    gap = np.where(closest > EQUAL * np.abs(high), gap, 0.0)  # of a pair so close the squared cosines are noise
    return own, gap / np.maximum(np.abs(high), 1e-300)


def _null_vector(c: FloatArray, value: FloatArray) -> FloatArray:
    """(3, n) unit eigenvectors of the (3, 3, n) symmetric matrices for a simple eigenvalue (n,): a row cross a row."""
    rows = c.copy()
    for k in range(3):
        rows[k, k] -= value
    crosses = np.stack([cross(rows[0], rows[1]), cross(rows[1], rows[2]), cross(rows[2], rows[0])])
    size = crosses[:, 0] ** 2 + crosses[:, 1] ** 2 + crosses[:, 2] ** 2
    best = size.argmax(axis=0)
    vector = np.take_along_axis(crosses, best[None, None, :], axis=0)[0]
    return np.asarray(vector / np.sqrt(np.maximum(size.max(axis=0), 1e-300)), dtype=np.float64)


def _times(c: FloatArray, p: FloatArray) -> FloatArray:
    return np.stack([dot(c[0], p), dot(c[1], p), dot(c[2], p)])


def _real_eigen(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Eigenvalues (n, 3) and eigenvectors in columns (n, 3, 3) of matrices that need not be symmetric."""
    values, vectors = np.linalg.eig(matrix)
    refuse_where(
        complex_eigenvalues(matrix),
        np.abs(values.imag).max(axis=1, initial=0.0) * 1e3,
        'with moment = "paper" the compliance has complex eigenvalues, the imaginary part',
        "um/N",
        'no equivalent compliance is defined there; use moment = "full"',
    )
    return values.real, vectors.real


def _projected(
    values: FloatArray, vectors: FloatArray, axis: FloatArray, normal: FloatArray, projection: Projection
) -> FloatArray:
    """Eq. 43 from eigenvalues (n, 3) and unit eigenvectors in columns (n, 3, 3)."""
    along_axis = np.abs(np.einsum("nij,ni->nj", vectors, axis))
    across = np.arange(3) != along_axis.argmax(axis=1)[:, None]
    share = np.abs(np.einsum("nij,ni->nj", vectors, normal))
    return np.asarray((across * values * (share if projection == "linear" else share**2)).sum(axis=1))
