"""Writes a raster program from points and tool axes: for tests, the demo, and users without a planner."""

from __future__ import annotations

import numpy as np

from polishd.api import ProgramError
from polishd.model.surface import FloatArray

SAFE_Z_MM = 20.0


def raster_program(points_mm: FloatArray, axis: FloatArray, feed_mm_min: FloatArray | float, name: str) -> bytes:
    """RNC text through these points.

    Args:
        points_mm: (n, 3) tool tip, mm, program frame; the first and the last are landing points outside the part.
        axis: (n, 3) unit tool axis at each point, from the tip into the spindle.
        feed_mm_min: Feed of the block that ends at each point but the first: one value, or (n - 1,).
        name: Goes into the header's comment.

    Returns:
        ASCII text: G0 above the first point and down to it, one G1 with its own F a block, G0 up, M2.
    """
    points = np.asarray(points_mm, dtype=np.float64)
    axes = np.asarray(axis, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 2 or axes.shape != points.shape:
        raise ProgramError(f"{name}: a raster needs at least two points (n, 3), and as many axes.")
    feeds = np.broadcast_to(np.asarray(feed_mm_min, dtype=np.float64), (len(points) - 1,))
    if not (np.isfinite(points).all() and np.isfinite(axes).all() and np.isfinite(feeds).all() and (feeds > 0).all()):
        raise ProgramError(f"{name}: points, axes and feeds must be finite, and feeds above zero.")
    angles = np.degrees(_wrist(axes))
    written = [_words(point, angle) for point, angle in zip(points, angles, strict=True)]
    first = written[0]
    safe = {**first, "Z": f"Z{max(SAFE_Z_MM, points[0, 2] + SAFE_Z_MM):.4f}"}
    lines = [
        f"({_comment(name)}: {len(points)} points)",
        "G21 G90 G94",
        "G0 " + " ".join(safe[letter] for letter in "ZXYAC"),
        "G0 " + first["Z"],
    ]
    before = first
    for words, feed in zip(written[1:], feeds, strict=True):
        changed = [word for letter, word in words.items() if word != before[letter]] or [words["X"]]
        lines.append(f"G1 {' '.join(changed)} F{feed:.3f}")
        before = words
    lines += [f"G0 Z{max(SAFE_Z_MM, points[-1, 2] + SAFE_Z_MM):.4f}", "M2", ""]
    return "\n".join(lines).encode("ascii")


def _words(point: FloatArray, angle: FloatArray) -> dict[str, str]:
    texts = [f"{value:.4f}" for value in point] + [f"{value:.5f}" for value in angle]
    # "-0.0000" and "0.0000" are one place
    texts = [text.removeprefix("-") if float(text) == 0 else text for text in texts]
    return {letter: letter + text for letter, text in zip("XYZAC", texts, strict=True)}


def _wrist(axes: FloatArray) -> FloatArray:
    """A and C (n, 2) in rad with axis = (sin C sin A, -cos C sin A, cos A), A >= 0; C is kept where A is 0."""
    a = np.arctan2(np.hypot(axes[:, 0], axes[:, 1]), axes[:, 2])
    c = np.arctan2(axes[:, 0], -axes[:, 1])
    upright = np.sin(a) < 1e-9
    last = np.maximum.accumulate(np.where(upright, -1, np.arange(len(a))))
    c = np.where(last >= 0, c[last], 0.0)
    return np.stack([np.where(upright, 0.0, a), np.unwrap(c)], axis=1)


def _comment(name: str) -> str:
    """The name as a comment can hold it."""
    return "".join(char if char.isascii() and char.isprintable() and char not in "()" else "_" for char in name)[:80]
