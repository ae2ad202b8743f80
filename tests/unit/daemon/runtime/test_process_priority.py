"""Priority: the loop first where allowed, the solver last; all settings are restored."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
from typing import Any

import pytest

from polishd.daemon.runtime import process
from polishd.daemon.runtime.process import BEHIND, LOOP_NICE, PriorityResult, cores_to_compute, host, loop_first

RAISED = """
import json, os, subprocess, sys, threading
from pathlib import Path
from polishd.daemon.runtime.process import loop_first

def nice():
    return os.getpriority(os.PRIO_PROCESS, 0)

def locked_kb():
    status = Path("/proc/self/status").read_text()
    return int(status.partition("VmLck:")[2].split()[0])

found = {}
with loop_first() as granted:
    found["granted"] = granted.first, granted.locked
    found["loop"], found["locked"] = nice(), locked_kb() > 0
    thread = threading.Thread(target=lambda: found.update(thread=nice()))
    thread.start()
    thread.join()
    get = "print(os.getpriority(os.PRIO_PROCESS, 0))"
    last = "from polishd.daemon.runtime.process import compute_last; compute_last()"
    for name, code in {"child": f"import os; {get}", "computing": f"import os; {last}; {get}"}.items():
        found[name] = int(subprocess.check_output([sys.executable, "-c", code]))
found["after"], found["locked_after"] = nice(), locked_kb() > 0
print(json.dumps(found))
"""


TRIED = """
import os
try:
    os.setpriority(os.PRIO_PROCESS, 0, -10)
except PermissionError:
    print("false")
else:
    print("true")
"""

NICE = os.getpriority(os.PRIO_PROCESS, 0)
"""What the tests themselves run at."""


def ran(code: str) -> Any:
    """Output of another process, so that this one keeps its priority."""
    return json.loads(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout)


def test_only_the_loop_is_raised_and_only_for_a_time() -> None:
    found = ran(RAISED)
    first, locked = found["granted"]
    assert found["loop"] == (LOOP_NICE if first else NICE)
    assert found["locked"] == locked
    assert found["thread"] == found["child"] == (0 if first else NICE)
    assert (found["after"], found["locked_after"]) == (NICE, False)
    assert found["computing"] == (0 if first else NICE + BEHIND)


def test_what_is_granted_is_what_the_computer_allows() -> None:
    with loop_first() as granted:
        assert granted.first == ran(TRIED)
    assert os.getpriority(os.PRIO_PROCESS, 0) == NICE


def test_where_nothing_is_allowed_it_runs_all_the_same_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(which: int, who: int, nice: int) -> None:
        if nice < 0:
            raise PermissionError

    monkeypatch.setattr(os, "setpriority", refused)
    monkeypatch.setattr(resource, "getrlimit", lambda what: (8 << 20, 8 << 20))
    monkeypatch.setattr(process, "_may_lock", lambda: False)
    with loop_first() as granted:
        assert (granted.first, granted.locked) == (False, False)
    assert host().startswith("nice -10 is not allowed: no priority, memory may be swapped out, ")
    assert host().endswith("(docs/how-to/host.md)")


@pytest.mark.parametrize(
    ("cores", "words"),
    [(2, "2 cores: no core to keep free"), (8, "8 cores: one core kept free of computing")],
)
def test_in_words(cores: int, words: str) -> None:
    assert (
        str(PriorityResult(first=True, locked=True, cores=cores)) == f"contact loop at nice -10, memory locked, {words}"
    )


@pytest.mark.parametrize(("allowed", "used"), [({0}, {0}), ({4, 5}, {4, 5}), ({2, 3, 7}, {3, 7})])
def test_one_core_is_left_to_the_loop_where_there_are_three(allowed: set[int], used: set[int]) -> None:
    assert cores_to_compute(allowed) == used
