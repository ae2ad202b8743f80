"""Programs of 100,000 to 2 million blocks from their text to the report: peak memory of each stage.

Each size runs in a separate process. The peak is the kernel's VmHWM, which is reset for each stage, beside the memory
in use when the stage began. Disk: bytes of the journal and of executed.csv for a block, beside the estimate of
``pipeline.disk_space``.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

from benchmarks.harness import Progress, Row, memory_bytes, reset_peak
from benchmarks.long_path import (
    BOUNDS,
    FIXED_MB,
    WRITING,
    Stage,
    kept_stages,
    language_program,
    language_stages,
    nc_program,
    nc_stages,
)
from polishd.pipeline.disk_space import CSV_BYTES, ROW_BYTES

BLOCKS = (100_000, 1_000_000, 2_000_000)
LINES = 1_000_000
ON_DISK = {"journal, on disk": ROW_BYTES, "executed.csv, on disk": CSV_BYTES}
LANGUAGE_MB = 200.0
"""Of a robot language, a million lines."""


def rows(progress: Progress) -> Iterator[Row]:
    """Each stage at each size, their files, and two languages."""
    for blocks in BLOCKS:
        progress(f"long_programs: {blocks} blocks")
        found = _child("nc", blocks)
        for name, cost in found.items():
            row = f"long_programs: {blocks} blocks, {name}"
            if name in ON_DISK:
                yield Row(row, cost, {"what polishd counts with": ON_DISK[name]}, "B/block")
            else:
                yield Row(row, cost / 1e6, {"limit": FIXED_MB + BOUNDS[name] * blocks / 1e6}, "MB")
    for language in WRITING:
        progress(f"long_programs: {LINES} lines of {language}")
        for name, cost in _child(language, LINES).items():
            yield Row(f"long_programs: {LINES} lines, {name}", cost / 1e6, {"limit": LANGUAGE_MB}, "MB")


def _child(what: str, count: int) -> dict[str, float]:
    command = [sys.executable, "-m", __name__, what, str(count)]
    answer = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    return {name: float(cost) for name, cost in json.loads(answer).items()}


def measured(stages: Iterator[Stage]) -> dict[str, float]:
    """Peak of each stage beside the memory in use before it, bytes."""
    found = dict[str, float]()
    for name, run in stages:
        before = reset_peak()
        run()
        found[name] = float(memory_bytes("VmHWM") - before)
    return found


def main(what: str, count: int) -> None:
    """Return the share of one process, as JSON."""
    if what != "nc":
        print(json.dumps(measured(language_stages(what, language_program(what, count)))))
        return
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        found = measured(chain(nc_stages(nc_program(count)), kept_stages(count, folder)))
        run = folder / "run"
        files = run / "journal.sqlite", run / "cycle-00" / "executed.csv"
        sizes = {name: path.stat().st_size / count for name, path in zip(ON_DISK, files, strict=True)}
    print(json.dumps({**found, **sizes}))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
