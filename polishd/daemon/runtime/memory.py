"""Memory limit of this process, and a reserve for the case that memory runs out.

The daemon holds the reserve during contact and releases it at the first MemoryError, for the way out of contact.
"""

from __future__ import annotations

import resource
from pathlib import Path

from polishd.model.errors import HostFault
from polishd.pipeline.disk_space import MB

LEAST_MB = 48.0
"""Least memory below the process's limit: for leaving contact, its record and the stack of a thread."""
RESERVE_BYTES, PIECE_BYTES = 4 << 20, 1 << 15
"""In pieces of a size that the allocator keeps for the next allocation."""
LIMITS = {
    "VmSize": (resource.RLIMIT_AS, "LimitAS, ulimit -v"),
    "VmData": (resource.RLIMIT_DATA, "LimitDATA, ulimit -d"),
}
_NO_THREAD = "can't start new thread"


def process_memory_mb(status: Path = Path("/proc/self/status")) -> tuple[float, str] | None:
    """Return the least memory left below a limit of this process, MB, and the name of the limit; None without one."""
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
    """Memory reserve for the way out of contact."""

    def __init__(self) -> None:
        self._kept: list[bytearray] = []

    @property
    def kept_bytes(self) -> int:
        """Present size."""
        return sum(map(len, self._kept))

    def take(self) -> None:
        """Allocate the reserve before contact; HostFault where the memory is not sufficient. Idempotent."""
        try:
            while self.kept_bytes < RESERVE_BYTES:
                self._kept.append(bytearray(PIECE_BYTES))
        except MemoryError as error:
            self.release()
            raise out_of_memory(error) from error

    def release(self) -> None:
        """Release the reserve where memory has run out."""
        self._kept.clear()


RESERVE = Reserve()
"""Reserve of the process, shared by its cells."""


def is_out_of_memory(error: BaseException) -> bool:
    """Return whether the error or one of its causes is a lack of memory, for an object or the stack of a thread."""
    seen: set[int] = set()
    each: BaseException | None = error
    while each is not None and id(each) not in seen:
        if isinstance(each, MemoryError) or (isinstance(each, RuntimeError) and str(each) == _NO_THREAD):
            return True
        seen.add(id(each))
        each = each.__cause__
    return False


def out_of_memory(error: BaseException) -> HostFault:
    """Return the error with a message for the operator."""
    what = str(error) or "an object could not be created"
    return HostFault(
        f"the daemon has run out of memory ({what}). Increase its limit (MemoryMax or LimitAS of the service, "
        "ulimit -v) or end other programs, then start the daemon again"
    )


def named(error: Exception) -> Exception:
    """Return the error, or ``out_of_memory`` in its place after the release of the reserve."""
    if not is_out_of_memory(error):
        return error
    RESERVE.release()
    fault = out_of_memory(error)
    fault.__cause__ = error
    return fault
