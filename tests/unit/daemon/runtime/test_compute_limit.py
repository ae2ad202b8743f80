"""What a process has used, as the kernel counts it."""

from __future__ import annotations

import os
import subprocess
import sys
import time

import pytest

from polishd.daemon.runtime.compute import process_cpu_s

NAMED = """
import time
open("/proc/self/comm", "w").write("a) S 1 (b")
while time.process_time() < 0.3:
    pass
print("ready", flush=True)
input()
"""


def test_all_threads_count() -> None:
    assert abs(process_cpu_s(os.getpid()) - time.process_time()) < 0.1


@pytest.mark.full
def test_a_name_with_brackets_is_read_past() -> None:
    command = [sys.executable, "-c", NAMED]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdin is not None
        process.stdout.readline()
        assert 0.25 < process_cpu_s(process.pid) < 2.0
        process.stdin.write("\n")


def test_one_that_is_gone_has_used_nothing() -> None:
    with subprocess.Popen([sys.executable, "-c", ""]) as process:
        process.wait()
    assert process_cpu_s(process.pid) == 0.0
