"""Seconds from a finished file to a map in the daemon: the watched folder with its default options.

Wall time, over real sleeps: the waiting is measured. Several folders are watched at once, each with an instrument that
writes a map of 1024 x 1024 in chunks, at moments independent of the polls. There are no peers; the benchmark fails
where the longest time is above 3 s.
"""

from __future__ import annotations

import asyncio
import statistics
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.harness import Progress, Row
from polishd.api import DeviceContext
from polishd.plugins.interferometer.formats.metropro import METROPRO
from polishd.plugins.interferometer.watched_folder import FolderOptions, WatchedFolder
from polishd.sim_backends.common.metropro import DatMap, pack

FOLDERS, MAPS = 6, 18
"""Side by side, and one after another in each."""
CHUNKS = 8
SIZE = 1024
MOST_S = 3.0


def rows(progress: Progress) -> Iterator[Row]:
    """Least, median, 95 % and longest of 108 maps."""
    with tempfile.TemporaryDirectory() as scratch:
        taken = sorted(asyncio.run(_all(Path(scratch), progress)))
    percentile = statistics.quantiles(taken, n=20)[-1]
    figures = {"min": taken[0], "median": statistics.median(taken), "p95": percentile, "max": taken[-1]}
    for name, value in figures.items():
        yield Row(f"watched folder, finished file to map, {SIZE} x {SIZE}, {len(taken)} maps, {name}", value, {})
    if taken[-1] > MOST_S:
        raise RuntimeError(f"a map was taken {taken[-1]:.2f} s after it was finished, later than {MOST_S:g} s")


async def _all(scratch: Path, progress: Progress) -> list[float]:
    async with asyncio.TaskGroup() as group:
        cells = [group.create_task(_one(scratch / str(number), number, progress)) for number in range(FOLDERS)]
    return [latency for cell in cells for latency in cell.result()]


async def _one(base: Path, number: int, progress: Progress) -> list[float]:
    rng = np.random.default_rng(number)
    folder = base / "maps"
    folder.mkdir(parents=True)
    options = FolderOptions.model_validate({"folder": "maps"})
    device = WatchedFolder(options, DeviceContext(base, base / "state", "P", (METROPRO,)))
    await device.open()
    height_nm = rng.normal(0.0, 30.0, (SIZE, SIZE))
    taken, after = [], None
    for turn in range(MAPS):
        height_nm[0, 0] = turn
        data = pack(DatMap(height_nm, 0.1, part="P", taken_s=int(time.time()) + 60))
        waiting = asyncio.create_task(device.next_map(after))
        await asyncio.sleep(float(rng.uniform(0.3, 1.0)))
        finished_s = await asyncio.to_thread(_write, folder / f"map-{turn}.dat", data)
        after = (await waiting).sha256
        taken.append(time.monotonic() - finished_s)
        progress(f"folder {number}: {turn + 1}/{MAPS}")
    await device.close()
    return taken


def _write(path: Path, data: bytes) -> float:
    """Write in chunks; return the monotonic time of the last byte."""
    step = -(-len(data) // CHUNKS)
    with path.open("wb") as file:
        for start in range(0, len(data), step):
            time.sleep(0.02)
            file.write(data[start : start + step])
            file.flush()
    return time.monotonic()
