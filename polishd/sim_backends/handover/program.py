"""A program file as the controller has it, and which of its lines are the program's own."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from polishd.model.surface import FloatArray

OURS = b"(polishd)"
"""Lines that polishd puts in end with it."""


@dataclass(frozen=True, slots=True)
class PlcProgram:
    """A file, and what the plant is to know of it."""

    lines: tuple[bytes, ...]
    sha256: str
    """Of the program without the lines that were put in."""
    blocks: int
    inserted: FloatArray
    """(m,) 0-based lines that were put in."""

    @classmethod
    def of(cls, text: bytes) -> PlcProgram:
        """Take the text apart."""
        lines = text.removesuffix(b"\n").split(b"\n")
        inserted = [at for at, line in enumerate(lines) if line.endswith(OURS)]
        own = [line for line in lines if not line.endswith(OURS)] if inserted else lines
        return cls(tuple(lines), hashlib.sha256(b"\n".join(own)).hexdigest(), len(own), np.array(inserted, dtype=float))

    def blocks_of(self, lines: FloatArray) -> FloatArray:
        """0-based blocks of the program (n,) of 0-based lines (n,)."""
        blocks = lines - np.searchsorted(self.inserted, lines)
        return np.asarray(np.minimum(blocks, max(self.blocks - 1, 0)), dtype=np.float64)


def sha256_of(lines: Sequence[bytes]) -> str:
    """What the intake hashes."""
    return hashlib.sha256(b"".join(line + b"\n" for line in lines)).hexdigest()
