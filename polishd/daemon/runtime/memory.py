"""What is left to this process by its own limits, and what it does where memory runs out all the same.

A reserve is kept through contact and let go at the first MemoryError, so that leaving contact finds memory.
"""

from __future__ import annotations

import resource
from pathlib import Path

from polishd.model.errors import HostFault
from polishd.pipeline.disk_space import MB

LEAST_MB = 48.0
"""Left below a process's own limit: what leaving contact, a record of it and a thread's stack may take."""
RESERVE_BYTES, PIECE_BYTES = 4 << 20, 1 << 15
"""In pieces that the allocator keeps and gives to whoever asks next."""
LIMITS = {
    "VmSize": (resource.RLIMIT_AS, "LimitAS, ulimit -v"),
    "VmData": (resource.RLIMIT_DATA, "LimitDATA, ulimit -d"),
}
_NO_THREAD = "can't start new thread"


def process_memory_mb(status: Path = Path("/proc/self/status")) -> tuple[float, str] | None:
    """What is left below this process's own limit, the one with the least, and what sets it; None: it has none."""
    limited = {key: resource.getrlimit(number)[0] for key, (number, _) in LIMITS.items()}
    limited = {key: limit for key, limit in limited.items() if limit != resource.RLIM_INFINITY}
    if not limited:
        return None
    try:
        lines = dict(line.split(":", 1) for line in status.read_text().splitlines())
    except OSError:
        return None
    left = {key: limit / MB - int(lines[key].split()[0]) * 1024 / MB for key, limit in limited.items()}
    key = min(left, key=lambda one: left[one])
    return max(left[key], 0.0), LIMITS[key][1]


class Reserve:
    """Memory that is kept for a way out of contact."""

    def __init__(self) -> None:
        self._kept: list[bytearray] = []

    @property
    def kept_bytes(self) -> int:
        """As of now."""
        return sum(map(len, self._kept))

    def take(self) -> None:
        """Before contact; HostFault where there is not that much. Idempotent."""
        try:
            while self.kept_bytes < RESERVE_BYTES:
                self._kept.append(bytearray(PIECE_BYTES))
        except MemoryError as error:
            self.release()
            raise out_of_memory(error) from error

    def release(self) -> None:
        """Memory is out: what comes next has this much."""
        self._kept.clear()


RESERVE = Reserve()
"""Of the process: its cells share its memory."""


def is_out_of_memory(error: BaseException) -> bool:
    """Whether memory was missing, for an object or for the stack of a thread: then, or in what led to the error."""
    seen: set[int] = set()
    each: BaseException | None = error
    while each is not None and id(each) not in seen:
        if isinstance(each, MemoryError) or (isinstance(each, RuntimeError) and str(each) == _NO_THREAD):
            return True
        seen.add(id(each))
        each = each.__cause__
    return False


def out_of_memory(error: BaseException) -> HostFault:
    """The error in a sentence that says what to do."""
    what = str(error) or "an object could not be made"
    return HostFault(
        f"the daemon has run out of memory ({what}). Raise its limit (MemoryMax or LimitAS of the service, ulimit -v), "
        "or end other programs on this computer, then start the daemon again"
    )


def named(error: Exception) -> Exception:
    """The error itself, or out of memory in words, with the reserve let go."""
    if not is_out_of_memory(error):
        return error
    RESERVE.release()
    told = out_of_memory(error)
    told.__cause__ = error
    return told
