"""Several tools over the same part as one effect, and the fastest float32 products for its size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from polishd.model.errors import ComputeError
from polishd.model.surface import FloatArray, Grid
from polishd.process.removal.effect import Effect, SparseEffect
from polishd.process.removal.spread_effect import SpreadEffect
from polishd.util.jit import has_compiler

COMPILED_BLOCKS = 10_000
"""Blocks from which compiled code, loaded in half a second, is faster."""


def to_fast_float32(effect: SpreadEffect) -> Effect:
    """Return the effect with float32 products, accurate to about 1e-6 of the peak."""
    if not is_compiled(effect):
        return effect.single()
    from polishd.process.removal.spread_effect_compiled import compiled_spread

    return compiled_spread(effect)


def is_compiled(effect: SpreadEffect) -> bool:
    """Return whether compiled code computes the float32 products: it is installed, and the effect is large."""
    return effect.n >= COMPILED_BLOCKS and has_compiler()


@dataclass(frozen=True, slots=True)
class CombinedEffect:
    """The sum of effects on the same samples (paper eq. 47 with ``R = [R_1, R_2, ...]``); made by `combine_effects`."""

    parts: tuple[Effect, ...]

    @property
    def grid(self) -> Grid:
        """The process grid of the rows, which all have."""
        return self.parts[0].grid

    @property
    def n(self) -> int:
        """Number of timed points, of all together."""
        return sum(part.n for part in self.parts)

    def removal_nm(self, time_s: FloatArray) -> FloatArray:
        """(n,) s -> (ny, nx) nm."""
        own = zip(self.parts, split_by_tool(time_s, [part.n for part in self.parts]), strict=True)
        return np.asarray(sum(part.removal_nm(times) for part, times in own), dtype=np.float64)

    def adjoint(self, weight: FloatArray) -> FloatArray:
        """(ny, nx) -> (n,)."""
        return np.concatenate([part.adjoint(weight) for part in self.parts])


def combine_effects(effects: Sequence[Effect]) -> Effect:
    """Combine effects into one; a matrix where each has one.

    Raises:
        ComputeError: there is none, or they are not on the same samples.
    """
    if not effects:
        raise ComputeError("there is no tool")
    first = effects[0]
    for number, effect in enumerate(effects[1:], 2):
        if effect.grid != first.grid:
            raise ComputeError(f"tool {number} acts on {effect.grid}, the first on {first.grid}: give one grid to all")
    if len(effects) == 1:
        return first
    matrices = [effect.matrix for effect in effects if isinstance(effect, SparseEffect)]
    if len(matrices) == len(effects):
        return SparseEffect(first.grid, sparse.csr_array(sparse.hstack(matrices, format="csr")))
    return CombinedEffect(tuple(effects))


def split_by_tool(values: FloatArray, lengths: Sequence[int]) -> list[FloatArray]:
    """Split (n,) values of all points by tool; ``lengths`` are the numbers of points."""
    return np.split(values, np.cumsum(lengths)[:-1])


def to_float32(effect: Effect) -> Effect:
    """Return the effect with float32 products where those are faster, else the effect itself."""
    if isinstance(effect, CombinedEffect):
        return CombinedEffect(tuple(to_float32(part) for part in effect.parts))
    return to_fast_float32(effect) if isinstance(effect, SpreadEffect) else effect


def effect_note(effect: Effect) -> str | None:
    """Return the certificate's note on the error of an effect without a matrix; None of a matrix."""
    if isinstance(effect, CombinedEffect):
        return "; ".join(note for part in effect.parts if (note := effect_note(part)) is not None) or None
    return effect.note if isinstance(effect, SpreadEffect) else None


def effect_error(effect: Effect) -> float:
    """Return the largest error of the removal over its peak, at samples, without a matrix; 0 of a matrix."""
    if isinstance(effect, CombinedEffect):
        return max(effect_error(part) for part in effect.parts)
    return effect.error if isinstance(effect, SpreadEffect) else 0.0
