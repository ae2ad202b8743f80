"""Commands as steps: their environment, their failures, and the end of all their processes."""

from __future__ import annotations

import asyncio
import os
import sys
from asyncio.subprocess import Process
from pathlib import Path
from typing import Any

import pytest

from polishd.daemon.job.part_handling import run_command
from polishd.model.errors import HandlingError
from polishd.model.part_handling import HandlingStep
from tests.time_limits import SOON_S

HANGS = """
import os, subprocess, sys, time
child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
open("pids", "w").write(f"{os.getpid()} {child.pid}")
time.sleep(600)
"""


def python(code: str, folder: Path, timeout_s: float = SOON_S) -> HandlingStep:
    return HandlingStep(command=(sys.executable, "-c", code), folder=folder, timeout_s=timeout_s)


def gone(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
    except OSError:
        return True


async def until_gone(folder: Path) -> None:
    """Wait for the processes with the written pids. pytest's timeout is the limit."""
    for pid in map(int, (folder / "pids").read_text().split()):
        while not gone(pid):  # noqa: ASYNC110
            await asyncio.sleep(0.01)


async def test_it_runs_in_its_folder_with_its_environment(tmp_path: Path) -> None:
    code = "import os; open('said', 'w').write(os.environ['POLISHD_PART'] + ' ' + os.environ['PATH'])"
    await run_command("clean", python(code, tmp_path), {"POLISHD_PART": "P-1"})
    assert (tmp_path / "said").read_text() == f"P-1 {os.environ['PATH']}"


@pytest.mark.parametrize(
    ("code", "said"),
    [
        (
            "print('a'); print('no water'); raise SystemExit(3)",
            r"clean: .* exit code 3: no water\. Correct the cause, then run polishd resume",
        ),
        ("raise SystemExit(2)", "exit code 2: no output"),
        ("import os; os.kill(os.getpid(), 9)", "exit code -9"),
        ("print('x' * 9000); raise SystemExit(1)", r"exit code 1: x{400}\."),
    ],
)
async def test_a_failure_says_its_last_line(tmp_path: Path, code: str, said: str) -> None:
    with pytest.raises(HandlingError, match=said):
        await run_command("clean", python(code, tmp_path), {})


async def test_a_command_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(HandlingError, match=r"\./wash cannot be started: .*Correct part_handling\.clean\.command"):
        await run_command("clean", HandlingStep(command=("./wash",), folder=tmp_path), {})


async def test_one_that_takes_too_long_is_killed_with_all_that_it_started(tmp_path: Path) -> None:
    task = asyncio.ensure_future(run_command("clean", python(HANGS, tmp_path, timeout_s=2.0), {}))
    with pytest.raises(HandlingError, match=r"within 2 s \(part_handling\.clean\.timeout_s\)"):
        await task
    if (tmp_path / "pids").exists():  # a busy machine may not have got so far
        await until_gone(tmp_path)


async def test_a_hold_kills_it_too(tmp_path: Path) -> None:
    task = asyncio.ensure_future(run_command("clean", python(HANGS, tmp_path), {}))
    while not (tmp_path / "pids").exists() or not (tmp_path / "pids").read_text():  # noqa: ASYNC110
        await asyncio.sleep(0.01)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    await until_gone(tmp_path)


async def test_a_hold_that_comes_while_it_starts_kills_it_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    start = asyncio.create_subprocess_exec

    async def slowly(*words: str, **how: Any) -> Process:
        process = await start(*words, **how)
        while not (tmp_path / "pids").exists() or not (tmp_path / "pids").read_text():  # noqa: ASYNC110
            await asyncio.sleep(0.01)
        task.cancel()
        await asyncio.sleep(0.01)
        return process

    monkeypatch.setattr(asyncio, "create_subprocess_exec", slowly)
    task = asyncio.ensure_future(run_command("clean", python(HANGS, tmp_path), {}))
    with pytest.raises(asyncio.CancelledError):
        await task
    await until_gone(tmp_path)
