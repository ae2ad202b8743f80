"""The fixture that fails a test which leaves something running: it must see a leak, and only a leak."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

HEAD = """
import asyncio, multiprocessing, subprocess, sys, pytest
SLEEP = [sys.executable, "-c", "import time; time.sleep(60)"]
kept = []

@pytest.fixture
async def closing():
    task = asyncio.ensure_future(asyncio.sleep(60))
    yield
    task.cancel()

@pytest.fixture
async def leaking():
    kept.append(asyncio.ensure_future(asyncio.sleep(60)))
    yield
"""

CLEAN = """
async def test_a_group(closing):
    async with asyncio.TaskGroup() as group:
        group.create_task(asyncio.sleep(0))

def test_a_process():
    subprocess.run(["true"], check=True)

def test_a_spawned_process():
    process = multiprocessing.get_context("spawn").Process(target=print)
    process.start()
    process.join()
"""

LEAKS = {
    "task": "async def test(): kept.append(asyncio.ensure_future(asyncio.sleep(60)))",
    "task of a fixture": "async def test(leaking): pass",
    "process": "def test(): kept.append(subprocess.Popen(SLEEP))",
    "process of a coroutine": "async def test(): kept.append(await asyncio.create_subprocess_exec(*SLEEP))",
}


def run(tmp_path: Path, text: str) -> str:
    """Run pytest on these tests, with the project's conftest and settings, less patient; what it printed."""
    conftest = (ROOT / "tests" / "conftest.py").read_text()
    assert "SETTLE_S = 10.0" in conftest
    (tmp_path / "conftest.py").write_text(conftest.replace("SETTLE_S = 10.0", "SETTLE_S = 0.3"))
    (tmp_path / "test_it.py").write_text(HEAD + text)
    pytest_ = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-c", str(ROOT / "pyproject.toml")]
    result = subprocess.run([*pytest_, str(tmp_path)], cwd=tmp_path, capture_output=True, text=True, check=False)
    return result.stdout + result.stderr


@pytest.fixture(scope="module")
def output(tmp_path_factory: pytest.TempPathFactory) -> str:
    """What is printed of all of them."""
    leaks = [text.replace("test(", f"test_{name.replace(' ', '_')}(") for name, text in LEAKS.items()]
    return run(tmp_path_factory.mktemp("leaks"), "\n".join([CLEAN, *leaks]))


@pytest.mark.full
def test_what_ends_is_no_leak(output: str) -> None:
    assert re.search(rf"\b{3 + len(LEAKS)} passed, {len(LEAKS)} errors", output), output
    for name in ("a_group", "a_process", "a_spawned_process"):
        assert f"teardown of test_{name} " not in output, output


@pytest.mark.parametrize("leak", LEAKS)
def test_a_leak_fails_the_test(output: str, leak: str) -> None:
    assert re.search(rf"ERROR at teardown of test_{leak.replace(' ', '_')} _+\n.*left running", output), output
