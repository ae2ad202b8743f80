"""The process behind ``apart``: parses one file after another within bounds, until the line to it closes.

Run as ``python -m polishd.plugins.interferometer.formats.sandbox_worker FD``, FD being its end of a socket pair.
"""

from __future__ import annotations

import importlib
import json
import math
import resource
import signal
import sys
from collections.abc import Mapping
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import h5py  # type: ignore[import-untyped,unused-ignore]  # noqa: F401  what it takes is not counted as a file's
import numpy as np

from polishd.api import MapError, SurfaceMap
from polishd.plugins.interferometer.formats.sandbox import MOST_HEAD_BYTES, MapHead, ResourceLimits, limit
from polishd.util.serialization import plain


def serve(line: Connection) -> None:
    """Say that it runs, then answer each [module, path, bounds].

    An answer is [reason or "", the number of the operating system's error behind it or 0, the map's head or null], and
    then the heights as bytes, where there are any.
    """
    line.send_bytes(b"ready")
    while True:
        try:
            module, name, values = json.loads(line.recv_bytes())
        except EOFError:
            return
        path, bounds = Path(name), ResourceLimits(*values)
        head, heights, reason, number = None, np.empty(0), "", 0
        try:
            _bound(path, bounds)
            head, heights = _parts(importlib.import_module(module).parse(path))
        except MapError as error:
            reason, number = str(error), _number(error.__cause__)
        except MemoryError:
            reason = f"{path}: would take more memory than {bounds.memory_per_byte} times its length: it is broken"
        except Exception as error:  # noqa: BLE001  somebody else's parser may raise anything
            reason, number = f"{path}: cannot be read: {type(error).__name__}: {str(error)[:300]}", _number(error)
        answer = json.dumps([reason, number, head], default=plain).encode()
        if len(answer) > MOST_HEAD_BYTES:
            reason, heights = f"{path}: has {len(answer)} bytes of metadata, more than {MOST_HEAD_BYTES}", np.empty(0)
            answer = json.dumps([reason, 0, None]).encode()
        line.send_bytes(answer)
        if heights.size:
            line.send_bytes(heights.reshape(-1).view(np.uint8).data)
        signal.alarm(0)


def _parts(surface: SurfaceMap) -> tuple[dict[str, Any], np.ndarray[Any, Any]]:
    """Return a map's head, as values of JSON, and its heights."""
    heights = np.ascontiguousarray(surface.height_nm, dtype=np.float64)
    own = {name: getattr(surface, name) for name in MapHead.__slots__ if hasattr(surface, name)}
    own["taken_at"] = None if surface.taken_at is None else surface.taken_at.isoformat()
    own["unsaid"] = sorted(surface.unsaid)
    own["history"] = None if surface.history is None else json.loads(surface.history.to_json())
    head = {**own, "shape": heights.shape, "has_path": surface.path is not None}
    return {key: _unicode(value) for key, value in head.items()}, heights


def _unicode(value: Any) -> Any:
    """Return the same with each half character of its text (a lone surrogate) as its escape."""
    if isinstance(value, str):
        return value.encode(errors="backslashreplace").decode()
    if isinstance(value, Mapping):
        return {_unicode(str(key)): _unicode(one) for key, one in value.items()}
    return [_unicode(one) for one in value] if isinstance(value, list | tuple) else value


def _number(error: BaseException | None) -> int:
    return (error.errno or 0) if isinstance(error, OSError) else 0


def _bound(path: Path, bounds: ResourceLimits) -> None:
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
