"""A HAL component for the operator's pendant: the feed override wheel, and an interlock that inhibits feed.

    loadusr -Wn polishd-pendant /usr/bin/python3 pendant.py /mnt/pendant
    net override polishd-pendant.counts => halui.feed-override.counts
    net inhibit  polishd-pendant.inhibit => motion.feed-inhibit

It reads both from a file with two whole numbers: hundredths of a percent, and 1 where feed is inhibited. LinuxCNC
reports its program as running under either of them. The component needs only LinuxCNC's own Python.
"""

from __future__ import annotations

import contextlib
import importlib
import sys
import time
from pathlib import Path
from typing import Any

LOOK_S = 0.005
FULL = 10000
"""100 %, in counts of the wheel."""
COUNT = 1e-4
"""Fraction of the programmed feed in one count of the wheel."""


def write(path: Path, fraction: float, *, inhibit: bool) -> None:
    """Turn the wheel to that fraction, and set or clear the interlock."""
    beside = path.with_suffix(".new")
    beside.write_text(f"{round(fraction * FULL)} {int(inhibit)}\n")
    beside.replace(path)


def read(path: Path) -> tuple[int, bool]:
    """Return the counts of the wheel, and True where feed is inhibited."""
    counts, inhibit = path.read_text().split()
    return int(counts), inhibit != "0"


def main(file: str) -> None:
    """Run as a HAL component until LinuxCNC ends it."""
    hal: Any = importlib.import_module("hal")  # LinuxCNC supplies it
    component = hal.component("polishd-pendant")
    component.newpin("counts", hal.HAL_S32, hal.HAL_OUT)
    component.newpin("inhibit", hal.HAL_BIT, hal.HAL_OUT)
    component["counts"] = FULL
    component.ready()
    while True:
        time.sleep(LOOK_S)
        with contextlib.suppress(FileNotFoundError):
            component["counts"], component["inhibit"] = read(Path(file))


if __name__ == "__main__":
    main(*sys.argv[1:])
