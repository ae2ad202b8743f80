"""How much one may ask, and how often be wrong."""

from __future__ import annotations

import time
from collections.abc import Callable

PER_S, BURST = 50.0, 100.0
"""Requests of one user, or of one address that has not signed in."""
WRONG, LOCKED_S = 5, 60.0
"""So many wrong tokens from an address, and no more are looked at for so long."""
MOST_KEPT = 10_000
"""Addresses that are remembered."""


class Rate:
    """A bucket for each name, which fills by ``PER_S``."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._left: dict[str, tuple[float, float]] = {}

    def takes(self, name: str) -> bool:
        """Whether one more fits."""
        now_s = self._clock()
        left, at_s = self._left.pop(name, (BURST, now_s))
        left = min(BURST, left + PER_S * (now_s - at_s))
        self._left[name] = (left - 1.0 if left >= 1.0 else left, now_s)
        _forget(self._left)
        return left >= 1.0


class Lockout:
    """Addresses from which too many wrong tokens came."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._wrong: dict[str, tuple[int, float]] = {}

    def locked(self, address: str) -> bool:
        """No token from there is looked at."""
        count, at_s = self._wrong.get(address, (0, 0.0))
        if count and self._clock() - at_s > LOCKED_S:
            del self._wrong[address]
            return False
        return count >= WRONG

    def wrong(self, address: str) -> None:
        """One more."""
        count, _ = self._wrong.pop(address, (0, 0.0))
        self._wrong[address] = (count + 1, self._clock())
        _forget(self._wrong)

    def right(self, address: str) -> None:
        """Whoever is there has a token."""
        self._wrong.pop(address, None)


def _forget(kept: dict[str, tuple[int, float]] | dict[str, tuple[float, float]]) -> None:
    while len(kept) > MOST_KEPT:
        del kept[next(iter(kept))]
