"""``make robustness-dask``: compare jobs of ``robustness.toml`` on a Dask cluster that loses a worker with the pool's.

A scheduler and two workers over TCP on loopback; one of them is killed (``kill -9``) once half of the jobs are done.
Every column of every row is compared with what the pool made of the same jobs, but for times.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from polishd.studies.result_store import JOURNAL, read_table
from tests.campaigns import result_files
from tests.system.sim_rig import ROOT
from tests.unit.studies.dask_rig import Cluster

STUDY = ROOT / "examples" / "robustness.toml"
POOL, OURS = ROOT / "build" / "robustness", ROOT / "build" / "robustness-dask"
PAGE = ROOT / "docs" / "reference" / "results.md"
BEGIN, END = "<!-- written by make robustness-dask -->\n", "<!-- end of what make robustness-dask writes -->\n"
WORKERS, JOBS = 2, 2200
TIMES = ("wall_s", "cpu_s")


@dataclass(frozen=True, slots=True)
class Ran:
    """Run of the study on the cluster."""

    killed_after: int
    """Number of jobs that were done when the worker was killed."""
    seconds: float
    load: float
    """System load at the end."""


def differences(here: list[dict[str, Any]], there: list[dict[str, Any]]) -> list[str]:
    """Return the differences of the cluster's rows from the pool's, to the last bit: JSON keeps floats exactly."""
    known = {row["case"]: row for row in there}
    wrong = []
    for row in here:
        other = known.get(row["case"])
        if other is None:
            wrong.append(f"case {row['case']}: the pool has no such row")
            continue
        columns = [name for name in {**row, **other} if name not in TIMES]
        wrong += [
            f"case {row['case']}: {name}: {row.get(name)!r} here, {other.get(name)!r} there"
            for name in columns
            if json.dumps(row.get(name)) != json.dumps(other.get(name))
        ]
    return wrong


def run_on_cluster(count: int) -> Ran:
    """Run jobs on a new cluster that loses a worker half way. RuntimeError where the study fails."""
    shutil.rmtree(OURS, ignore_errors=True)
    OURS.mkdir(parents=True)
    with Cluster(OURS, WORKERS) as cluster:
        address, began_s = cluster.address, time.monotonic()
        study = subprocess.Popen(_command(OURS, count, "--scheduler", address), stdout=subprocess.DEVNULL)
        try:
            while study.poll() is None and (done := _done(OURS)) < count // 2:
                time.sleep(0.2)
            cluster.workers[0].kill()
            code = study.wait()
        finally:
            study.kill()
    if code:
        raise RuntimeError(f"the study on the cluster ended with exit code {code}; read {OURS / 'dask.log'}")
    return Ran(done, time.monotonic() - began_s, os.getloadavg()[0])


def table(ran: Ran, rows: list[dict[str, Any]], wrong: list[str]) -> str:
    """Return the table of the page."""
    columns = sorted({name for row in rows for name in row} - {*TIMES})
    lines = [
        ("jobs on a Dask scheduler and two workers over TCP", f"the first {len(rows)} of {JOBS}"),
        ("`kill -9` of one of both", f"after {ran.killed_after} jobs; the other one did the rest"),
        ("took", f"{ran.seconds:.0f} s, {ran.load:.1f} processes that wanted the two cores at the end"),
        ("jobs that ended by an error", str(sum(bool(row["error"]) for row in rows))),
        ("columns compared with the pool's, to the last bit", f"{len(columns)}: all but `wall_s`, `cpu_s`"),
        ("that differ", str(len(wrong))),
        ("last run", f"{result_files.today()}, sources {result_files.sources(['polishd'])}"),
    ]
    return "\n".join(["| | |", "|---|---|", *(f"| {name} | {value} |" for name, value in lines), ""])


def main() -> int:
    """Run the campaign and return the exit code: 1 where anything differs."""
    parse = argparse.ArgumentParser(prog="make robustness-dask", description=__doc__)
    parse.add_argument("--limit", type=int, default=JOBS, help="the first N jobs")
    count = parse.parse_args().limit
    subprocess.run(_command(POOL, count, "--workers", str(WORKERS)), check=True, stdout=subprocess.DEVNULL)
    ran = run_on_cluster(count)
    (rows, _), (pool, _) = read_table(OURS), read_table(POOL)
    wrong = differences(rows, pool)
    if len(rows) != count:
        wrong.append(f"{len(rows)} rows for {count} jobs")
    result_files.write(PAGE, BEGIN, END, text := table(ran, rows, wrong))
    print(text, *wrong[:20], sep="\n")
    return int(bool(wrong))


def _command(out: Path, count: int, *more: str) -> list[str]:
    return [sys.executable, "-m", "polishd", "study", str(STUDY), "--out", str(out), "--limit", str(count), *more]


def _done(out: Path) -> int:
    path = out / JOURNAL
    return path.read_bytes().count(b"\n") if path.exists() else 0


if __name__ == "__main__":
    sys.exit(main())
