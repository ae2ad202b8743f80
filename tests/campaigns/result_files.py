"""Result files of campaigns in docs/data: a line of JSON for each result, from any machine.

A result has the hash of the sources that it depends on; one of other sources stays until it is measured again.
"""

from __future__ import annotations

import ast
import hashlib
import json
import re
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

from polishd.util.files import write_atomic
from tests.system.sim_rig import ROOT

Row = dict[str, Any]
ACTING = (
    "polishd/daemon/cell",
    "polishd/daemon/contact",
    "polishd/daemon/journal",
    "polishd/daemon/runtime",
    "polishd/daemon/cycle",
    "polishd/daemon/job/job",
    "polishd/daemon/job_runner",
    "polishd/daemon/state_machine",
    "polishd/model/devices",
    "polishd/model/events",
    "polishd/model/states",
)
"""What a daemon with a tool on the part does. Queue, socket, config checks and maps have no part in it."""


def read(path: Path) -> list[Row]:
    """All results; none where there is no file."""
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def keep(path: Path, rows: Iterable[Row]) -> None:
    """All results, durable when this returns."""
    write_atomic(path, "".join(json.dumps(row, ensure_ascii=False) + "\n" for row in rows).encode())


def sources(scope: Iterable[str], root: Path = ROOT) -> str:
    """Return the hash of the Python files below these folders of the project, by path and code.

    Comments and docstrings are no part of it: a better explanation makes no measurement old. A module that is a single
    file counts as a folder, and so does a file that is named with its ending, of another language as it is.
    FileNotFoundError where there is none of that name.
    """
    content = hashlib.sha256()
    for name in sorted(set(scope)):
        path = root / name
        files = sorted(path.rglob("*.py")) if path.is_dir() else [path if path.exists() else root / f"{name}.py"]
        for file in files:
            text = file.read_bytes()
            content.update(
                str(file.relative_to(root)).encode() + b"\0" + (code(text) if file.suffix == ".py" else text)
            )
    return content.hexdigest()[:8]


QUOTED_OR_COMMENT = re.compile(
    rb'''("""(?:\\.|[^\\])*?"""|'{3}(?:\\.|[^\\])*?'{3}|"(?:\\.|[^"\\\n])*"|'(?:\\.|[^'\\\n])*')|[ \t]*\#[^\n]*''',
    re.DOTALL | re.VERBOSE,
)
REMOVED = b"\0"


@cache
def code(text: bytes) -> bytes:
    """Return the Python source without comments and docstrings, and without the lines of nothing else."""
    lines = text.split(b"\n")
    for node in _docstrings(ast.parse(text).body):
        first, last = node.lineno - 1, (node.end_lineno or node.lineno) - 1
        lines[first] = lines[first][: node.col_offset].rstrip() + REMOVED + lines[last][node.end_col_offset :]
        lines[first + 1 : last + 1] = [REMOVED] * (last - first)
    bare = QUOTED_OR_COMMENT.sub(lambda found: found[1] or REMOVED, b"\n".join(lines))
    return b"\n".join(line.replace(REMOVED, b"") for line in bare.split(b"\n") if line.strip(REMOVED) or not line)


def _docstrings(body: Sequence[ast.stmt]) -> Iterator[ast.Expr]:
    """Statements that are nothing but a text, of a module, its classes and functions."""
    for node in body:
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield node
        elif isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            yield from _docstrings(node.body)


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
