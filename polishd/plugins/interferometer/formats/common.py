"""What all readers share: the whole content of a file, within bounds, and its hash."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np

from polishd.api import BadMap
from polishd.model.surface import FloatArray

MOST_BYTES = 2**30
"""No map of a camera is larger."""
MOST_SAMPLES = 64_000_000


def content_of(path: Path) -> bytes:
    """All bytes of a file; BadMap where it cannot be read, is empty, or is larger than any map."""
    try:
        with path.open("rb") as file:
            content = file.read(MOST_BYTES + 1)
    except OSError as error:
        raise BadMap(f"{path}: cannot be read: {error.strerror}") from error
    if not content:
        raise BadMap(f"{path}: the file is empty")
    if len(content) > MOST_BYTES:
        raise BadMap(f"{path}: is larger than {MOST_BYTES} bytes: no map of a camera")
    return content


def sha256_of(content: bytes) -> str:
    """Hash under which a map is known."""
    return hashlib.sha256(content).hexdigest()


def require_data(path: Path, height_nm: FloatArray) -> FloatArray:
    """The heights, where at least one is a number and none is infinite; BadMap otherwise."""
    if height_nm.ndim != 2 or not height_nm.size:
        raise BadMap(f"{path}: holds an array of shape {height_nm.shape}, not rows and columns")
    if np.isinf(height_nm).any():
        raise BadMap(f"{path}: {np.count_nonzero(np.isinf(height_nm))} samples are infinite")
    if np.isnan(height_nm).all():
        raise BadMap(f"{path}: no sample holds data")
    return height_nm
