"""Map files are parsed in a worker process: a broken file that crashes, hangs or fills it is refused as MapError.

HDF5 2.0 allocates the length that a text states before it looks, walks some broken heaps forever, and crashes on
others. Both ends are in this file: ``read`` in the daemon, ``start_worker`` in the worker. The worker answers in JSON
and plain arrays, so that a file that takes it over runs nothing in the daemon.
"""

from __future__ import annotations

import atexit
import errno
import importlib
import json
import os
import resource
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import TypeAdapter

from polishd.api import MapError, SurfaceMap
from polishd.model.errors import ComputeError, WorkerError
from polishd.model.surface import DateFrom, MapStep, MaskCount
from polishd.util.array_stream import Message
from polishd.util.worker_main import AnswerFunction
from polishd.util.worker_process import WorkerLimit, WorkerProcess

TARGET = "polishd.plugins.interferometer.formats.sandbox:start_worker"


class ResourceLimits(NamedTuple):
    """Limits of reading one file, beside what the worker has before it."""

    memory_bytes: int = 64 * 2**20
    """For the library's own tables, and small files."""
    memory_per_byte: int = 4
    cpu_s: float = 3.0
    bytes_per_cpu_s: int = 16 * 2**20
    wall_s: float = 60.0
    is_kept: bool = True
    """Whether the worker may read the next file, too. It takes half a second to start one."""

    def of(self, length: int) -> WorkerLimit:
        """Return the limit for a file of so many bytes."""
        cpu_s = self.cpu_s + length / self.bytes_per_cpu_s
        return WorkerLimit(self.wall_s, cpu_s, self.memory_bytes + self.memory_per_byte * length)


@dataclass(frozen=True, slots=True)
class MapHead:
    """A map without its heights, as the worker states it: fields of ``SurfaceMap``."""

    has_path: bool
    pitch_mm: float | None = None
    part_id: str = ""
    instrument: str = ""
    taken_at: datetime | None = None
    date_from: DateFrom = "header"
    sha256: str = ""
    format: str = ""
    factors: Mapping[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    unsaid: frozenset[str] = frozenset()
    doubts: Mapping[str, str] = field(default_factory=dict)
    orientation: str = ""
    fiducials_px: tuple[tuple[float, float], ...] = ()
    reader_version: int = 0
    pitches_mm: tuple[float, float] | None = None
    masks: tuple[MaskCount, ...] = ()
    history: MapStep | None = None


USUAL = ResourceLimits()
_idle: list[WorkerProcess] = []
"""Workers that wait for a file. Each reads for one caller at a time, so that no cell waits for another cell's file."""


def read(module: str, path: Path, bounds: ResourceLimits = USUAL) -> SurfaceMap:
    """Return the map that ``parse(path)`` of the module makes of a file, in a worker.

    MapError where it raises that, ends or exceeds a limit. An error that does not concern the file (the share is away,
    the worker cannot start) has an OSError with a number as its cause.
    """
    worker = (_waiting() if bounds.is_kept else None) or _start(path)
    is_usable = False
    try:
        surface = _read(worker, module, path, bounds)
        is_usable = True
    except MapError:
        is_usable = worker.alive
        raise
    finally:
        if bounds.is_kept and is_usable:
            _idle.append(worker)
        else:
            worker.end()
    return surface


def close() -> None:
    """End the workers that wait; the next file gets a new one."""
    while worker := _waiting():
        worker.end()


def raise_memory_limit(size: int) -> None:
    """Let a file take so many bytes more, once its samples are known to be there. No effect outside the worker."""
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    if soft != resource.RLIM_INFINITY:
        more = soft + size
        resource.setrlimit(resource.RLIMIT_AS, (more if hard == resource.RLIM_INFINITY else min(more, hard), hard))


def _waiting() -> WorkerProcess | None:
    """Return a worker that waits and lives; those that have died are removed."""
    while _idle:
        with suppress(IndexError):  # another thread took the last one
            worker = _idle.pop()
            if worker.alive:
                return worker
            worker.end()
    return None


def _start(path: Path) -> WorkerProcess:
    try:
        worker = WorkerProcess(TARGET, "the map reader", threads=1)
        worker.start()
    except WorkerError as error:
        raise MapError(f"{path}: {error}") from ChildProcessError(errno.ECHILD, str(error), str(path))
    return worker


def _read(worker: WorkerProcess, module: str, path: Path, bounds: ResourceLimits) -> SurfaceMap:
    whole = path.absolute()  # the process may have changed its folder since it started
    try:
        limit = bounds.of(whole.stat().st_size)
    except OSError as error:
        raise MapError(f"{path}: cannot be read: {error.strerror}") from error
    try:
        answer, arrays = worker.request({"module": module, "path": str(whole)}, limit=limit)
        reason, number = answer["reason"], answer["errno"]
        if not isinstance(reason, str) or not isinstance(number, int):
            raise TypeError(answer)
        surface = None if reason else _map(_head_type().validate_python(answer["map"]), arrays["height_nm"], whole)
    except WorkerError as error:
        raise MapError(f"{path}: {error}. The file is broken.") from error
    except ComputeError as error:
        raise MapError(f"{path}: {error}") from error
    except (ValueError, TypeError, KeyError, MemoryError, RecursionError) as error:
        worker.end()
        why = f"the map reader returned no valid map ({type(error).__name__})"
        raise MapError(f"{path}: {why}. The file is broken.") from error
    if surface is None:
        cause = OSError(number, os.strerror(number), str(path)) if number in errno.errorcode else None
        raise MapError(reason.replace(str(whole), str(path), 1)) from cause
    return surface


@cache
def _head_type() -> TypeAdapter[MapHead]:
    """Built at its first use: it is slow, and most commands load the plugin and read no map in a worker."""
    return TypeAdapter(MapHead)


def _map(head: MapHead, height_nm: NDArray[Any], whole: Path) -> SurfaceMap:
    if height_nm.ndim != 2 or height_nm.dtype != np.float64:
        raise ValueError("the heights are no matrix")
    fields = {name: getattr(head, name) for name in MapHead.__slots__ if name != "has_path"}
    return SurfaceMap(height_nm, path=whole if head.has_path else None, **fields)


def start_worker() -> tuple[dict[str, Any], AnswerFunction]:
    """Prepare this process to read maps: what the library takes is not counted as a file's."""
    importlib.import_module("h5py")
    return {}, _answer


def _answer(message: Mapping[str, Any], _: Mapping[str, NDArray[Any]]) -> Message:
    """Return the map, or the reason why there is none and the number of the system's error behind it, else 0."""
    path = Path(message["path"])
    number = 0
    try:
        surface = importlib.import_module(message["module"]).parse(path)
        return {"reason": "", "errno": 0, "map": _head(surface)}, {
            "height_nm": np.asarray(surface.height_nm, np.float64)
        }
    except MapError as error:
        reason, number = str(error), _number(error.__cause__)
    except MemoryError:
        reason = f"{path}: exceeded its memory limit. The file is broken."
    except Exception as error:  # noqa: BLE001  a plugin's parser may raise anything
        reason, number = f"{path}: cannot be read: {type(error).__name__}: {str(error)[:300]}", _number(error)
    return {"reason": reason, "errno": number}, {}


def _head(surface: SurfaceMap) -> dict[str, Any]:
    """Return a map without its heights, as values of JSON."""
    head = {name: getattr(surface, name) for name in MapHead.__slots__ if hasattr(surface, name)}
    head["has_path"] = surface.path is not None
    head["taken_at"] = None if surface.taken_at is None else surface.taken_at.isoformat()
    head["unsaid"] = sorted(surface.unsaid)
    head["history"] = None if surface.history is None else json.loads(surface.history.to_json())
    return {key: _unicode(value) for key, value in head.items()}


def _unicode(value: Any) -> Any:
    """Return the value with each lone surrogate of its text as its escape."""
    if isinstance(value, str):
        return value.encode(errors="backslashreplace").decode()
    if isinstance(value, Mapping):
        return {_unicode(str(key)): _unicode(one) for key, one in value.items()}
    return [_unicode(one) for one in value] if isinstance(value, list | tuple) else value


def _number(error: BaseException | None) -> int:
    return (error.errno or 0) if isinstance(error, OSError) else 0


atexit.register(close)
