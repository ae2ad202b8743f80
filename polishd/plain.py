"""What json cannot hold by itself, as something that it can."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, is_dataclass

import numpy as np


def plain(value: object) -> object:
    """For ``json.dumps(..., default=plain)``: numbers stay numbers, records become objects, the rest its text."""
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        return value.tolist()
    if is_dataclass(value) and not isinstance(value, type):
        return asdict(value)
    if isinstance(value, Mapping):
        return dict(value)
    return str(value)
