"""An effect may be as large as a gigabyte: it stays in the process that made it, and others are sent its name."""

from __future__ import annotations

import uuid
from typing import ClassVar

from polishd.model.errors import ComputeError
from polishd.model.surface import FloatArray, Grid
from polishd.process.dwell.problem import negligible_share
from polishd.process.removal.effect import Effect


class CachedEffect:
    """An Effect that pickles as its name; the process that made it finds it again by that name, once."""

    _left: ClassVar[dict[str, Effect]] = {}
    """The last one whose name was sent: of the plan that is being made."""

    def __init__(self, effect: Effect | None, grid: Grid, name: str = "") -> None:
        self._effect = effect
        self.grid = grid
        self._name = name or uuid.uuid4().hex

    @property
    def here(self) -> bool:
        """Whether this process has it."""
        return self._effect is not None

    @property
    def n(self) -> int:
        """Number of timed points."""
        return self._own().n

    @property
    def negligible(self) -> float:
        """Share of the strongest removal up to which it is taken for none."""
        return negligible_share(self._own())

    def removal_nm(self, time_s: FloatArray) -> FloatArray:
        """(n,) s -> (ny, nx) nm."""
        return self._own().removal_nm(time_s)

    def adjoint(self, weight: FloatArray) -> FloatArray:
        """(ny, nx) -> (n,)."""
        return self._own().adjoint(weight)

    def __reduce__(self) -> tuple[object, ...]:
        if self._effect is not None:
            CachedEffect._left = {self._name: self._effect}
        return _by_name, (self._name, self.grid)

    def _own(self) -> Effect:
        if self._effect is None:
            raise ComputeError("the effect is in the process that solved with it, and this is another one")
        return self._effect


def _by_name(name: str, grid: Grid) -> CachedEffect:
    return CachedEffect(CachedEffect._left.pop(name, None), grid, name)
