"""The process behind ``apart``: parses one file after another within bounds, until the line to it closes.

Run as ``python -m polishd.plugins.interferometer.formats.apart_worker FD``, FD being its end of a socket pair.
"""

from __future__ import annotations

import importlib
import math
import pickle
import resource
import sys
from multiprocessing.connection import Connection
from pathlib import Path

import h5py  # type: ignore[import-untyped,unused-ignore]  # noqa: F401  what it takes is not counted as a file's

from polishd.api import BadMap

MEMORY_PER_BYTE = 4
MEMORY_BYTES = 64 * 2**20
"""Beside that: the library's own tables, and small files."""
CPU_S = 2
BYTES_PER_CPU_S = 16 * 2**20


def serve(line: Connection) -> None:
    """Answer each (module, path) with (reason or "", the map without its arrays, their sizes) and the arrays."""
    while True:
        try:
            module, path = line.recv()
        except EOFError:
            return
        buffers: list[pickle.PickleBuffer] = []
        head, reason = b"", ""
        try:
            _bound(path)
            head = pickle.dumps(importlib.import_module(module).parse(path), protocol=5, buffer_callback=buffers.append)
        except BadMap as error:
            reason = str(error)
        except MemoryError:
            reason = f"{path}: would take more memory than {MEMORY_PER_BYTE} times its length: it is broken"
        except Exception as error:  # noqa: BLE001  somebody else's parser may raise anything
            reason = f"{path}: cannot be read: {type(error).__name__}: {str(error)[:300]}"
        arrays = [buffer.raw() for buffer in buffers]
        line.send((reason, head, [array.nbytes for array in arrays]))
        for array in arrays:
            line.send_bytes(array)


def _bound(path: Path) -> None:
    length = path.stat().st_size
    held = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    _lower(resource.RLIMIT_AS, held + MEMORY_BYTES + MEMORY_PER_BYTE * length)
    used_s = sum(resource.getrusage(resource.RUSAGE_SELF)[:2])
    _lower(resource.RLIMIT_CPU, math.ceil(used_s + CPU_S + length / BYTES_PER_CPU_S))


def _lower(what: int, most: int) -> None:
    """The soft limit: each file has its own."""
    resource.setrlimit(what, (most, resource.getrlimit(what)[1]))


if __name__ == "__main__":
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    serve(Connection(int(sys.argv[1])))
