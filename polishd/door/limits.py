"""How much one may ask, and how often be wrong."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

PER_S, BURST = 50.0, 100.0
"""Requests of one user, or of one address that has not signed in."""
WRONG, LOCKED_S = 5, 60.0
"""Wrong tokens of one user at one address, and the time for which this user is then locked out there."""
BUDGET = 30
"""Wrong tokens of one address, whatever users they name, within ``LOCKED_S``."""
MOST_KEPT = 10_000
"""Addresses, and users at addresses, that are remembered."""


class RateLimiter:
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


class LoginLockout:
    """Counts wrong tokens, by user and address and by address alone.

    A user who has signed in from an address is not locked out there by the wrong tokens of others.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._wrong: dict[tuple[str, str], tuple[float, float]] = {}
        self._spent: dict[str, tuple[float, float]] = {}
        self._signed_in: dict[tuple[str, str], tuple[float, float]] = {}

    def knows(self, address: str, user: str) -> bool:
        """Return whether that user has brought a right token from that address."""
        return (address, user) in self._signed_in

    def locked(self, address: str, user: str) -> bool:
        """Return whether no token of that user is taken at that address now."""
        key = address, user
        count, at_s = self._wrong.get(key, (0, 0.0))
        if count and self._clock() - at_s > LOCKED_S:
            del self._wrong[key]
            count = 0
        return count >= WRONG or self._budget(address) < 1.0

    def wrong(self, address: str, user: str) -> None:
        """Count one more; what a locked user tries costs the address nothing."""
        key = address, user
        count, _ = self._wrong.pop(key, (0, 0.0))
        self._wrong[key] = (count + 1, self._clock())
        left = self._budget(address)
        if count < WRONG:
            self._spent.pop(address, None)
            self._spent[address] = (max(left - 1.0, 0.0), self._clock())
        _forget(self._wrong)
        _forget(self._spent)

    def right(self, address: str, user: str) -> None:
        """Note that this user has a token and is at that address."""
        key = address, user
        self._wrong.pop(key, None)
        self._signed_in.pop(key, None)
        self._signed_in[key] = (0.0, self._clock())
        _forget(self._signed_in)

    def _budget(self, address: str) -> float:
        left, at_s = self._spent.get(address, (float(BUDGET), 0.0))
        return min(float(BUDGET), left + BUDGET / LOCKED_S * (self._clock() - at_s))


class Shares:
    """Streams that each user holds open, at most ``most`` each and ``in_all`` together."""

    def __init__(self, most: int, in_all: int) -> None:
        self._most, self._in_all = most, in_all
        self._open: Counter[str] = Counter()

    def refusal(self, user: str) -> tuple[int, str] | None:
        """Return status and reason why one more does not fit; None where it fits."""
        if self._open[user] >= self._most:
            return 429, f"{user} holds {self._most} event streams open, the most for one user: close a page"
        if self._open.total() >= self._in_all:
            return 503, f"{self._in_all} event streams are open, the most for all users: close a page"
        return None

    @contextmanager
    def one(self, user: str) -> Iterator[None]:
        """Hold one of that user open inside this block."""
        self._open[user] += 1
        try:
            yield
        finally:
            self._open[user] -= 1
            self._open += Counter()  # those at zero are forgotten


def _forget(kept: dict[Any, tuple[float, float]]) -> None:
    while len(kept) > MOST_KEPT:
        del kept[next(iter(kept))]
