"""Run a Dask scheduler and workers over TCP on loopback with their usual commands."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Self

WITHIN_S = 120.0
"""Time limit for the start of a Dask process on a busy machine."""


class Cluster:
    """Scheduler with the workers that were started so far, each with one thread."""

    def __init__(self, folder: Path, workers: int) -> None:
        """Start scheduler and workers; the ``with`` block ends them."""
        self._folder, self._file = folder, folder / "scheduler.json"
        self._file.unlink(missing_ok=True)  # of a run before: its address is stale
        self._log = (folder / "dask.log").open("wb")
        self._scheduler = self._start("scheduler", "--host", "127.0.0.1", "--port", "0")
        self.workers: list[subprocess.Popen[bytes]] = []
        for _ in range(workers):
            self.add_worker()

    def add_worker(self) -> None:
        """Start one more worker, which is not restarted."""
        words = ("--nthreads", "1", "--no-nanny", "--host", "127.0.0.1", "--local-directory", str(self._folder))
        self.workers.append(self._start("worker", *words))

    @property
    def address(self) -> str:
        """Return the address of the scheduler, which writes it to a file when it listens."""
        end_s = time.monotonic() + WITHIN_S
        while time.monotonic() < end_s:
            try:
                return str(json.loads(self._file.read_text())["address"])
            except (OSError, ValueError):  # not there, or half written
                time.sleep(0.1)
        raise TimeoutError(f"no Dask scheduler within {WITHIN_S:g} s; read {self._log.name}")

    def _start(self, what: str, *more: str) -> subprocess.Popen[bytes]:
        words = (sys.executable, "-m", "dask", what, *more, "--no-dashboard", "--scheduler-file", str(self._file))
        return subprocess.Popen(words, stdout=self._log, stderr=self._log)

    def __enter__(self) -> Self:
        """Return the cluster."""
        return self

    def __exit__(self, *_: object) -> None:
        """Kill scheduler and workers."""
        for process in (*self.workers, self._scheduler):
            process.kill()
            process.wait()
        self._log.close()
