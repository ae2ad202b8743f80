"""What every test gets: no task, process or niceness outlives it, and hypothesis behaves alike on every machine."""

from __future__ import annotations

import asyncio
import gc
import gzip
import inspect
import os
import signal
import sys
import time
from collections.abc import AsyncIterator, Generator, Iterator
from multiprocessing import forkserver, resource_tracker
from pathlib import Path

import hypothesis
import pytest

from polishd.plugins.interferometer.formats import sandbox
from tests.kinds import mark_others_full

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT / "tests" / "data"

# Of a log that is shown.
LAST_LINES = 15

# What is ending when the test ends may take this long to be gone.
SETTLE_S = 10.0

# A shared machine is sometimes slow: pytest's own timeout catches what hangs. Same examples everywhere.
hypothesis.settings.register_profile("polishd", deadline=None, derandomize=True, database=None)
hypothesis.settings.load_profile("polishd")

# Hundreds of processes are started here: what they import is compiled once, whatever the environment says of that.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# pytest-xdist sets it for its workers: tables would be as narrow in them.
os.environ.pop("COLUMNS", None)


# Looking for garbage may take a second of a busy machine, in which a fake device that shares the process says nothing:
# it is looked for between tests. What collecting makes stays to the end.
gc.disable()
ALLOCATIONS = 100_000
TURNS = 10


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Before -m chooses."""
    mark_others_full(items)


def pytest_collection_finish() -> None:
    """What is there now is no garbage."""
    gc.freeze()


def pytest_runtest_logfinish() -> None:
    """Between two tests, once there is enough to look at. What stayed is looked at again in every tenth turn only."""
    young, _, turns = gc.get_count()
    if young > ALLOCATIONS:
        gc.collect(1 if turns < TURNS else 2)


class MeasuredMaps:
    """``maps / name`` is the file; the test is skipped where it is neither in tests/data nor beside the project."""

    def __init__(self, unpacked: Path) -> None:
        self._unpacked = unpacked

    def __truediv__(self, name: str) -> Path:
        packed, unpacked = DATA / f"{name}.gz", self._unpacked / name
        if packed.exists() and not unpacked.exists():
            unpacked.write_bytes(gzip.decompress(packed.read_bytes()))
        for path in (DATA / name, unpacked, ROOT.parent / "shared" / "data" / name):
            if path.exists():
                return path
        pytest.skip(f"{name} is not in tests/data, and there is no ../shared/data beside the project")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """A test that failed on a simulated cell tells how the cell's logs ended: its folder is soon gone."""
    report = yield
    folder = getattr(item, "funcargs", {}).get("tmp_path")
    if report.when == "call" and report.failed and folder is not None:
        for log in sorted((*folder.rglob("sim.log"), *folder.rglob("sim.stderr"))):
            lines = log.read_text(errors="replace").splitlines()[-LAST_LINES:]
            report.sections.append((str(log), "\n".join(lines)))
    return report


@pytest.fixture(scope="session")
def shared_data(tmp_path_factory: pytest.TempPathFactory) -> MeasuredMaps:
    """Maps that were really measured, by their file's name."""
    return MeasuredMaps(tmp_path_factory.mktemp("maps"))


@pytest.fixture(autouse=True)
def leaves_nothing_running(request: pytest.FixtureRequest) -> Iterator[None]:
    """Fail a test that leaves asyncio tasks or child processes running (and end those processes), or this one nicer."""
    if inspect.iscoroutinefunction(getattr(request, "function", None)):
        request.getfixturevalue("leaves_no_task")
    before, nice = children(), os.getpriority(os.PRIO_PROCESS, 0)
    yield
    assert os.getpriority(os.PRIO_PROCESS, 0) == nice, "the tests that follow in this process run at another priority"
    left = settled_children(before)
    for pid in left:
        os.kill(pid, signal.SIGKILL)
    if left:
        pytest.fail(f"child processes left running: {left}", pytrace=False)


@pytest.fixture
async def leaves_no_task() -> AsyncIterator[None]:
    """Fail an async test that leaves tasks running on its loop."""
    yield
    left = asyncio.all_tasks() - {asyncio.current_task()}
    if left:
        _, left = await asyncio.wait(left, timeout=SETTLE_S)
    if left:
        pytest.fail(f"asyncio tasks left running: {sorted(map(repr, left))}", pytrace=False)


def children() -> dict[int, str]:
    """Command lines of our live child processes by pid. Linux only: elsewhere there seem to be none.

    Called twice a test, where each thread is a file: without Path, which takes three times as long.
    """
    try:
        threads = os.listdir("/proc/self/task")  # noqa: PTH208 -- see above
    except OSError:
        return {}
    pids = [int(pid) for thread in threads for pid in read(f"/proc/self/task/{thread}/children").split()]
    # Python's own helpers and the reader of maps, at most one each per process and meant to stay
    helpers = {
        getattr(resource_tracker._resource_tracker, "_pid", None),
        getattr(forkserver._forkserver, "_forkserver_pid", None),
    }
    found = {}
    for pid in pids:
        if pid in helpers:
            continue
        state = read(f"/proc/{pid}/stat").rpartition(b")")[2].split()[:1]
        command = read(f"/proc/{pid}/cmdline").decode(errors="replace").replace("\0", " ").strip()
        if state not in ([], [b"Z"]) and sandbox.TARGET not in command:
            found[pid] = command
    return found


def settled_children(before: dict[int, str]) -> dict[int, str]:
    """Children that were not there before, once those that are ending have had time to."""
    deadline = time.monotonic() + SETTLE_S
    while True:
        left = {pid: command for pid, command in children().items() if pid not in before}
        if not left or time.monotonic() > deadline:
            return left
        time.sleep(0.02)


def read(path: str) -> bytes:
    """The file's content, or nothing where the process has just gone."""
    try:
        file = os.open(path, os.O_RDONLY)
    except OSError:
        return b""
    try:
        return os.read(file, 1 << 16)
    except OSError:
        return b""
    finally:
        os.close(file)
