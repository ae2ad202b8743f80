"""The process behind ``apart``: parses one file after another within bounds, until the line to it closes.

Run as ``python -m polishd.plugins.interferometer.formats.apart_worker FD``, FD being its end of a socket pair.
"""

from __future__ import annotations

import importlib
import math
import pickle
import resource
import signal
import sys
from multiprocessing.connection import Connection
from pathlib import Path

import h5py  # type: ignore[import-untyped,unused-ignore]  # noqa: F401  what it takes is not counted as a file's

from polishd.api import BadMap
from polishd.plugins.interferometer.formats.apart import Bounds, limit


def serve(line: Connection) -> None:
    """Say that it runs, then answer each (module, path, bounds).

    An answer is (reason or "", the number of the operating system's error behind it or 0, the map without its arrays,
    their sizes), and then the arrays.
    """
    line.send_bytes(b"ready")
    while True:
        try:
            module, path, bounds = line.recv()
        except EOFError:
            return
        buffers: list[pickle.PickleBuffer] = []
        head, reason, number = b"", "", 0
        try:
            _bound(path, bounds)
            head = pickle.dumps(importlib.import_module(module).parse(path), protocol=5, buffer_callback=buffers.append)
        except BadMap as error:
            reason, number = str(error), _number(error.__cause__)
        except MemoryError:
            reason = f"{path}: would take more memory than {bounds.memory_per_byte} times its length: it is broken"
        except Exception as error:  # noqa: BLE001  somebody else's parser may raise anything
            reason, number = f"{path}: cannot be read: {type(error).__name__}: {str(error)[:300]}", _number(error)
        arrays = [buffer.raw() for buffer in buffers]
        line.send((reason, number, head, [array.nbytes for array in arrays]))
        for array in arrays:
            line.send_bytes(array)
        signal.alarm(0)


def _number(error: BaseException | None) -> int:
    return (error.errno or 0) if isinstance(error, OSError) else 0


def _bound(path: Path, bounds: Bounds) -> None:
    length = path.stat().st_size
    held = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    limit(resource.RLIMIT_AS, held + bounds.memory_bytes + bounds.memory_per_byte * length)
    used_s = sum(resource.getrusage(resource.RUSAGE_SELF)[:2])
    limit(resource.RLIMIT_CPU, math.ceil(used_s + bounds.cpu_s + length / bounds.bytes_per_cpu_s))
    signal.alarm(math.ceil(bounds.wall_s) + 1)  # where nobody is left to end it


if __name__ == "__main__":
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    for everybodys in (signal.SIGINT, signal.SIGTERM):  # the daemon gets them too, and ends this process when it ends
        signal.signal(everybodys, signal.SIG_IGN)
    serve(Connection(int(sys.argv[1])))
