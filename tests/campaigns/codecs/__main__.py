"""``make replies``: send malformed, doubled and late replies to each driver, seed after seed.

Continues where an earlier run ended, also that of another machine; the table is in docs/reference/results.md.
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import sys
import threading
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial

from tests.campaigns import result_files
from tests.campaigns.codecs.results import BEGIN, DRIVERS, END, PAGE, Results, bad, seed_counts, text

A_SEED = 20_000
"""Malformed and late replies."""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    parse = argparse.ArgumentParser(prog="make replies", description=__doc__)
    parse.add_argument("--replies", type=int, default=1_000_000, metavar="N", help="malformed or late ones, per driver")
    parse.add_argument("--driver", action="append", choices=DRIVERS, help="only these")
    parse.add_argument("--minutes", type=float, default=math.inf, help="begin no seed after this time")
    parse.add_argument("--jobs", type=int, default=1, metavar="N", help="drivers at a time, each in a process")
    return parse


def run(names: Sequence[str], replies: int, until_s: float, jobs: int, results: Results) -> None:
    """Run seeds of each driver until it has had so many replies; begin none after that time."""
    writing = threading.Lock()
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:

        def one(name: str) -> int:
            with writing:
                row = results.row(name)
            while bad(row) < replies and time.monotonic() < until_s:
                counts = pool.submit(seed_counts, name, A_SEED, row["seeds"]).result()
                with writing:
                    results.add(name, counts)
                    row = results.row(name)
                print(f"{name}: {bad(row):,} of {replies:,}, taken: {row['taken']}", file=sys.stderr, flush=True)
            return 0

        result_files.side_by_side([partial(one, name) for name in names], jobs, until_s)


def main() -> int:
    """1 where a reply was taken for a value that it is not."""
    options, results = parser().parse_args(), Results()
    try:
        until_s = time.monotonic() + 60 * options.minutes
        run(options.driver or list(DRIVERS), options.replies, until_s, options.jobs, results)
    finally:
        result_files.write(PAGE, BEGIN, END, text(results))
    return int(any(row["taken"] for row in results.rows()))


if __name__ == "__main__":
    sys.exit(main())
