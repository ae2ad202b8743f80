"""The race of large parts at a million points: only by name (``make bench ARGS=dwell_million``)."""

from __future__ import annotations

from collections.abc import Iterator

from benchmarks import dwell_peers as peers
from benchmarks.bench_dwell_large import GAP, cold
from benchmarks.dwell_cases import Case, build
from benchmarks.harness import Progress, Row

LARGEST = Case(1130, 20, 3e-4)


def rows(progress: Progress) -> Iterator[Row]:
    """A cold start."""
    progress(f"dwell, a million: preparing {LARGEST.name}")
    problem = build(LARGEST)
    yield cold(LARGEST, problem, peers.reference(problem, GAP), progress)
