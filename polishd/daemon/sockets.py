"""Addresses of Unix sockets: the kernel allows 107 bytes, folders may be deeper."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

SOCKET_NAME = "polishd.sock"
LINE_BYTES = 1 << 22
"""Longest line of a request: some thousands of jobs."""
_LONGEST = 100


@contextmanager
def address_of(path: Path) -> Iterator[str]:
    """A path that bind and connect accept: the path itself, or a short one through an open folder (Linux)."""
    if len(os.fsencode(path)) <= _LONGEST:
        yield str(path)
        return
    folder = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
    try:
        yield f"/proc/self/fd/{folder}/{path.name}"
    finally:
        os.close(folder)
