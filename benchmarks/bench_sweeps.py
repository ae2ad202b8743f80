"""A sweep of jobs in a closed loop on a Dask cluster of this machine beside the pool: wall seconds a job, in turns.

Both have two workers, which are ready before the first turn; the cluster is a scheduler and two workers over TCP on
loopback. A pool of one worker beside them shows the scaling. The ratio is the cluster's throughput over the pool's:
the aim is 0.9. Quartiles are of the turns. A second row has cases that take next to no time: the overhead of an
executor.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from distributed import LocalCluster

from benchmarks.harness import Progress, Row
from polishd.config.sweep import load_swept
from polishd.studies.cases import Case, cases_of
from polishd.studies.engine import DaskCluster, Executor, LocalPool, work

EXAMPLES = Path(__file__).parents[1] / "examples"
WORKERS = 2
OURS = "ours"
"""The cluster."""
TURNS = 3
JOBS, SPOTS = 12, 1000
SPOT = """
kind = "spots"
title = "One spot at many speeds"
[spots.one]
size_mm = 20.0
rpm = 1000.0
force_n = 12.0
dip_deg = 15.0
[[sweep.group]]
over.seconds = {{ linear = [1.0, 100.0], count = {count} }}
"""


def rows(progress: Progress) -> Iterator[Row]:
    """Seconds a job, and a spot."""
    with TemporaryDirectory() as scratch:
        spots = Path(scratch) / "spots.toml"
        spots.write_text(SPOT.format(count=SPOTS))
        jobs = EXAMPLES / "robustness.toml"
        whole = LocalCluster(
            n_workers=WORKERS, threads_per_worker=1, host="127.0.0.1", dashboard_address=None, local_directory=scratch
        )  # type: ignore[no-untyped-call]
        with whole, LocalPool(WORKERS) as pool, LocalPool(1) as one, DaskCluster(whole.scheduler_address) as cluster:
            where: dict[str, Executor] = {OURS: cluster, "pool": pool, "pool of one": one}
            yield _row(f"a job of a sweep, {WORKERS} workers, {TURNS} turns of {JOBS}", jobs, JOBS, where, progress)
            yield _row(f"a spot of a sweep, {WORKERS} workers, {TURNS} turns of {SPOTS}", spots, SPOTS, where, progress)


def _row(name: str, study: Path, count: int, where: Mapping[str, Executor], progress: Progress) -> Row:
    cases = cases_of(load_swept(study))[:count]
    taken: dict[str, list[float]] = {executor: [] for executor in where}
    for turn in range(TURNS + 1):
        for executor, runs in where.items():
            progress(f"{name}: {executor} {turn}/{TURNS}")
            each_s = _each_s(study, cases, runs)
            if turn:  # the first one starts processes
                taken[executor].append(each_s)
    middle = {executor: statistics.median(values) for executor, values in taken.items()}
    ends = {executor: _quartiles(values) for executor, values in taken.items()}
    return Row(name, middle.pop(OURS), middle, "s", ends)


def _each_s(study: Path, cases: Sequence[Case], executor: Executor) -> float:
    begun = time.perf_counter()
    done = list(work(study, cases, executor))
    if wrong := [one.answer.error for one in done if one.answer.error]:
        raise RuntimeError(f"a case failed: {wrong[0]}")
    return (time.perf_counter() - begun) / len(cases)


def _quartiles(values: Sequence[float]) -> tuple[float, float]:
    low, _, high = statistics.quantiles(values, n=4, method="inclusive")
    return low, high
