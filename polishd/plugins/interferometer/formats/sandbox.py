"""Reading in a process of its own: what C code does with a broken file never happens to the daemon.

HDF5 2.0 allocates the length a text states before it looks, walks some broken heaps for ever, and crashes on others.
A worker parses the file within bounds of memory and time and hands the map back; where it does not, the file is a
BadMap, and the next file gets a new worker. A worker is kept for the next file, as it takes half a second to start.

Both sides speak JSON and plain arrays: what a file makes of the worker runs nothing in the daemon. The worker inherits
no secrets.
"""

from __future__ import annotations

import atexit
import errno
import json
import os
import resource
import signal
import socket
import subprocess
import sys
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import datetime
from multiprocessing import ProcessError
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import NonNegativeInt, TypeAdapter

from polishd.api import MapError, SurfaceMap
from polishd.model.surface import DateFrom, MapStep, MaskCount
from polishd.util.secret_files import environment_without_secrets

WORKER = "polishd.plugins.interferometer.formats.sandbox_worker"
STARTS_WITHIN_S = 60.0
DIES_WITHIN_S = 10.0
"""From the end of its line to its own."""
_THREADS = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


class ResourceLimits(NamedTuple):
    """What a file may take, beside what the worker holds before it."""

    memory_bytes: int = 64 * 2**20
    """The library's own tables, and small files."""
    memory_per_byte: int = 4
    cpu_s: float = 2.0
    bytes_per_cpu_s: int = 16 * 2**20
    wall_s: float = 60.0
    is_kept: bool = True
    """Whether the worker may read the next file too."""


MOST_HEAD_BYTES = 1 << 22
"""Of a map without its heights, as JSON."""


@dataclass(frozen=True, slots=True)
class MapHead:
    """A map without its heights, as the worker states it: fields of ``SurfaceMap``."""

    shape: tuple[NonNegativeInt, NonNegativeInt]
    """Rows and columns of the heights, which follow as 64-bit floats."""
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
    masks: tuple[MaskCount, ...] = ()
    history: MapStep | None = None


USUAL = ResourceLimits()
_idle: list[_Worker] = []
"""Workers that wait for a file. Each reads for one caller at a time, so that no cell waits for another's file; more
are never kept than read at the same time."""


def read(module: str, path: Path, bounds: ResourceLimits = USUAL) -> SurfaceMap:
    """What the module's ``parse(path)`` makes of a file, in a worker. BadMap where it raises that, dies or hangs.

    What says nothing about the file (the share is away, the worker cannot start) has an OSError with a number as cause.
    """
    worker = (_waiting() if bounds.is_kept else None) or _Worker(path)
    try:
        return worker.read(module, path, bounds)
    finally:
        if bounds.is_kept and worker.is_idle:
            _idle.append(worker)
        else:  # it died, or what it would say now would be of this file
            worker.kill()


def _waiting() -> _Worker | None:
    """A worker that waits and lives; those that have died meanwhile go."""
    while _idle:
        with suppress(IndexError):  # another thread took the last one
            worker = _idle.pop()
            if worker.is_alive:
                return worker
            worker.kill()
    return None


def close() -> None:
    """End the workers that wait; the next file gets a new one."""
    while worker := _waiting():
        worker.kill()


def raise_memory_limit(size: int) -> None:
    """Let a file take so many bytes more, once its samples are known to be there. Nothing outside the worker."""
    soft = resource.getrlimit(resource.RLIMIT_AS)[0]
    if soft != resource.RLIM_INFINITY:
        limit(resource.RLIMIT_AS, soft + size)


def limit(what: int, most: int) -> None:
    """Set the soft limit of this process, as far as its hard one lets it."""
    hard = resource.getrlimit(what)[1]
    resource.setrlimit(what, (most if hard == resource.RLIM_INFINITY else min(most, hard), hard))


_HEAD = TypeAdapter(MapHead)


class _Worker:
    """The process and the line to it."""

    def __init__(self, path: Path) -> None:
        ours, theirs = socket.socketpair()
        self.is_idle = True
        with theirs:
            # -P: the working folder stays off its path
            command = [sys.executable, "-P", "-m", WORKER, str(theirs.fileno())]
            try:
                self._process = subprocess.Popen(
                    command,
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    stderr=subprocess.DEVNULL,
                    pass_fds=(theirs.fileno(),),
                    env=environment_without_secrets(_THREADS),
                )
            except OSError as error:
                ours.close()
                raise MapError(f"{path}: no process to read it in: {error.strerror}") from error
        self._line = Connection(ours.detach())
        self._await_start(path)

    def _await_start(self, path: Path) -> None:
        try:
            if self._line.poll(STARTS_WITHIN_S):
                self._line.recv_bytes()
                return
            why = f"did not start within {STARTS_WITHIN_S:g} s"
        except (EOFError, OSError):
            why = f"{self._end()} before it read anything: does {Path(sys.executable).name} -P find polishd?"
        self.kill()
        why = f"the process that would read it {why}"
        raise MapError(f"{path}: {why}") from ChildProcessError(errno.ECHILD, why, str(path))

    @property
    def is_alive(self) -> bool:
        return self._process.poll() is None

    def read(self, module: str, path: Path, bounds: ResourceLimits) -> SurfaceMap:
        self.is_idle = False
        whole = path.absolute()  # the process may have moved since it started
        try:
            self._line.send_bytes(json.dumps([module, str(whole), bounds]).encode())
            if not self._line.poll(bounds.wall_s):
                raise MapError(f"{path}: was not read within {bounds.wall_s:g} s")
            reason, number, head = self._answer()
            surface = None if head is None else self._map(head, whole)
        except (EOFError, OSError) as error:
            raise MapError(f"{path}: the process that reads it {self._end()}: the file is broken") from error
        except (ValueError, TypeError, MemoryError, RecursionError, ProcessError) as error:
            why = f"the process that reads it answered what is no map ({type(error).__name__})"
            raise MapError(f"{path}: {why}: the file is broken") from error
        self.is_idle = True
        if surface is None:
            reason = reason.replace(str(whole), str(path), 1)  # as it was named
            raise MapError(reason) from (OSError(number, os.strerror(number), str(path)) if number else None)
        return surface

    def _answer(self) -> tuple[str, int, MapHead | None]:
        """Return why there is no map, the system's number of an error behind it, and the map's head."""
        reason, number, head = json.loads(self._line.recv_bytes(MOST_HEAD_BYTES))
        if not isinstance(reason, str) or not isinstance(number, int) or bool(reason) == (head is not None):
            raise ValueError("neither a reason nor a map")
        return reason, number, None if head is None else _HEAD.validate_python(head)

    def _map(self, head: MapHead, whole: Path) -> SurfaceMap:
        height_nm = np.empty(head.shape, dtype=np.float64)
        if height_nm.size and self._line.recv_bytes_into(height_nm.reshape(-1).view(np.uint8)) != height_nm.nbytes:
            raise ValueError("fewer heights than its shape has")
        fields = {name: getattr(head, name) for name in MapHead.__slots__ if name not in {"shape", "has_path"}}
        return SurfaceMap(height_nm, path=whole if head.has_path else None, **fields)

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()
        self._line.close()

    def _end(self) -> str:
        try:
            code = self._process.wait(DIES_WITHIN_S)
        except subprocess.TimeoutExpired:
            return "hung up"
        return f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with {code}"


atexit.register(close)
