"""What a campaign came to, beside its page in docs/ and in git: a line of JSON for each result; every machine adds.

A result bears the hash of the sources that it depends on: one of other sources stands until it is measured anew.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from polishd.util.files import write_atomic
from tests.system.sim_rig import ROOT

Row = dict[str, Any]


def read(path: Path) -> list[Row]:
    """All results; none where there is no file."""
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def keep(path: Path, rows: Iterable[Row]) -> None:
    """All results, durable when this returns."""
    write_atomic(path, "".join(json.dumps(row, ensure_ascii=False) + "\n" for row in rows).encode())


def sources(scope: Iterable[str], root: Path = ROOT) -> str:
    """Return the hash of the Python files below these folders of the project, by path and content.

    A module that is a single file counts as a folder, and so does a file that is named with its ending.
    FileNotFoundError where there is none of that name.
    """
    content = hashlib.sha256()
    for name in sorted(set(scope)):
        path = root / name
        files = sorted(path.rglob("*.py")) if path.is_dir() else [path if path.exists() else root / f"{name}.py"]
        for file in files:
            content.update(str(file.relative_to(root)).encode() + b"\0" + file.read_bytes())
    return content.hexdigest()[:8]


def first_line(error: Exception) -> str:
    """Return the first line of an error, its class where it has no text."""
    return next(iter(str(error).splitlines()), type(error).__name__)


def when(row: Row) -> str:
    """For the page: the day, and the hash of the sources."""
    return f"{row['date']}, {row['of'] or 'sources not noted'}"


def today() -> str:
    """In UTC."""
    return f"{datetime.now(UTC):%Y-%m-%d}"


def written(page: Path, begin: str, end: str) -> str:
    """What stands between the page's marks."""
    return page.read_text().partition(begin)[2].partition(end)[0]


def write(page: Path, begin: str, end: str, text: str) -> None:
    """Put it between the page's marks; nothing is written where it stands there."""
    whole = page.read_text()
    before, _, rest = whole.partition(begin)
    if (done := before + begin + text + end + rest.partition(end)[2]) != whole:
        write_atomic(page, done.encode())


def side_by_side(work: Sequence[Callable[[], int]], jobs: int, until_s: float) -> int:
    """So many at a time; none begins after that time (``time.monotonic``). The sum of what they give."""
    waiting, total = iter(work), 0
    running: set[Future[int]] = set()
    with ThreadPoolExecutor(jobs) as pool:
        while True:
            while len(running) < jobs and time.monotonic() < until_s:
                one = next(waiting, None)
                if one is None:
                    break
                running.add(pool.submit(one))
            if not running:
                return total
            done, running = wait(running, return_when=FIRST_COMPLETED)
            total += sum(future.result() for future in done)
