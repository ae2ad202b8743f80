"""How long a computing step may take."""

from __future__ import annotations

from typing import NamedTuple


class CpuLimit(NamedTuple):
    """So many CPU seconds, and which key of the config gives more."""

    within_s: float
    key: str = ""
