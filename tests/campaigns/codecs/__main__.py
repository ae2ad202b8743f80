"""``make replies``: every driver's talk, seed after seed, until each has had so many malformed or late replies.

Goes on where an earlier sitting ended, on whichever machine that was; the table is in docs/reference/results.md.
"""

from __future__ import annotations

import argparse
import logging
import math
import sys
import time

import pytest

from tests.campaigns import beside
from tests.campaigns.codecs.kept import BEGIN, DRIVERS, END, PAGE, Kept, bad, text

A_SEED = 20_000
"""Malformed and late replies."""


def parser() -> argparse.ArgumentParser:
    """The command line."""
    parse = argparse.ArgumentParser(prog="make replies", description=__doc__)
    parse.add_argument("--replies", type=int, default=1_000_000, metavar="N", help="malformed or late ones, a driver")
    parse.add_argument("--driver", action="append", choices=DRIVERS, help="these alone")
    parse.add_argument("--minutes", type=float, default=math.inf, help="of this sitting; what was begun is ended")
    return parse


def main() -> int:
    """1 where a reply was taken for a value that it is not."""
    options = parser().parse_args()
    logging.disable()  # pymodbus tells of each broken reply
    kept, until_s = Kept(), time.monotonic() + 60 * options.minutes
    try:
        for name in options.driver or DRIVERS:
            while bad(row := kept.row(name)) < options.replies and time.monotonic() < until_s:
                with pytest.MonkeyPatch.context() as patch:
                    kept.add(name, DRIVERS[name].told(patch, A_SEED, row["seeds"]))
                row = kept.row(name)
                print(
                    f"{name}: {bad(row):,} of {options.replies:,}, taken: {row['taken']}", file=sys.stderr, flush=True
                )
    finally:
        beside.write(PAGE, BEGIN, END, text(kept))
    return int(any(row["taken"] for row in kept.rows()))


if __name__ == "__main__":
    sys.exit(main())
