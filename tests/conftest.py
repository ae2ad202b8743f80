"""Rules for every test: it leaves no task, process or priority behind, and hypothesis is deterministic."""

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
from tests.selection import mark_others_full

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT / "tests" / "data"

# Number of lines of a simulator's log that a failed test shows.
LAST_LINES = 15

# Time that a process or task may take to end after the test.
SETTLE_S = 10.0

# A shared machine is sometimes slow: pytest's own timeout catches what hangs. Same examples everywhere.
hypothesis.settings.register_profile("polishd", deadline=None, derandomize=True, database=None)
hypothesis.settings.load_profile("polishd")

# The tests start hundreds of processes: what these import is compiled once, whatever the environment sets.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# A shell ignores Ctrl-C in what it starts in the background, and children inherit that: an interrupt would not end it.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# pytest-xdist sets it for its workers: tables would be as narrow in them.
os.environ.pop("COLUMNS", None)


# A garbage collection may take a second on a busy machine, during which a fake device in this process does not answer:
# it runs between tests only. Objects that exist after the collection of tests are excluded from it.
gc.disable()
ALLOCATIONS = 100_000
TURNS = 10


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests as ``full`` before ``-m`` selects."""
    mark_others_full(items)


def pytest_collection_finish() -> None:
    """Exclude the objects that exist now from garbage collection."""
    gc.freeze()


def pytest_runtest_logfinish() -> None:
    """Collect garbage between two tests, once there are enough new objects; old objects in every tenth turn only."""
    young, _, turns = gc.get_count()
    if young > ALLOCATIONS:
        gc.collect(1 if turns < TURNS else 2)


class MeasuredMaps:
    """Measured maps: ``maps / name`` is the path of one. The test is skipped where the file does not exist."""

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
    """Add the end of the simulator's logs to the report of a failed test, because its folder is deleted soon."""
    report = yield
    fixtures = getattr(item, "funcargs", {})
    folder = fixtures.get("rig_folder", fixtures.get("tmp_path"))
    if report.when == "call" and report.failed and folder is not None:
        for log in sorted((*folder.rglob("sim.log"), *folder.rglob("sim.stderr"))):
            lines = log.read_text(errors="replace").splitlines()[-LAST_LINES:]
            report.sections.append((str(log), "\n".join(lines)))
    return report


@pytest.fixture(scope="session")
def shared_data(tmp_path_factory: pytest.TempPathFactory) -> MeasuredMaps:
    """Return the measured maps by file name."""
    return MeasuredMaps(tmp_path_factory.mktemp("maps"))


@pytest.fixture(autouse=True)
def leaves_nothing_running(request: pytest.FixtureRequest) -> Iterator[None]:
    """Fail a test that leaves tasks or child processes running (and kill these), or changes the priority."""
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
    """Return the command lines of the live child processes by pid; empty on other systems than Linux.

    It is called twice for each test and reads a file for each thread: Path would take three times as long.
    """
    try:
        threads = os.listdir("/proc/self/task")  # noqa: PTH208 -- see above
    except OSError:
        return {}
    pids = [int(pid) for thread in threads for pid in read(f"/proc/self/task/{thread}/children").split()]
    # helpers of Python and the reader of maps: at most one each per process, and they stay
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
    """Return the child processes that are new and do not end within ``SETTLE_S``."""
    deadline = time.monotonic() + SETTLE_S
    while True:
        left = {pid: command for pid, command in children().items() if pid not in before}
        if not left or time.monotonic() > deadline:
            return left
        time.sleep(0.02)


def read(path: str) -> bytes:
    """Return the content of a file; empty where the process has just ended."""
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
