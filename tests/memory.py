"""Measure the memory that a call takes, while threads of other tests run in the same process."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable

READINGS = 3


def peak_bytes(run: Callable[[], object], most: float, readings: int = READINGS) -> int:
    """Return the highest memory of Python and NumPy during a call, in addition to what was allocated before.

    The trace counts what every thread of the process allocates, so that a peak above the permitted ``most`` is
    measured again: the peak of the call recurs, that of another thread does not. The result is the least of the
    readings. ``readings=1`` is for calls that cannot be repeated.
    """
    least: int | None = None
    for _ in range(readings):
        tracemalloc.start()
        try:
            run()
            peak = tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()
        least = peak if least is None else min(least, peak)
        if least <= most:
            break
    assert least is not None
    return least
