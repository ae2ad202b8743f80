"""Memory that a call takes, beside threads of other tests in the same process."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable

READINGS = 3


def peak_bytes(run: Callable[[], object], most: float, readings: int = READINGS) -> int:
    """Highest memory of Python and NumPy during a call, beside what was held before.

    The trace counts what every thread of the process allocates, so a peak above the most that a test allows is
    taken again: the call's own comes back, that of another thread does not. The result is the least of the readings;
    one reading is for what cannot be called twice.
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
