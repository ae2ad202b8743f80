"""Worker processes: what hangs, crashes, grows or breaks the protocol is ended and described, and leaves nothing."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from polishd.model.errors import ComputeError, FrameError, WorkerError
from polishd.util import array_stream
from polishd.util.worker_process import WorkerLimit, WorkerProcess, process_cpu_s
from tests.time_limits import SOON_S

TARGETS = "tests.unit.util.worker_targets"


@pytest.fixture
def worker() -> Iterator[WorkerProcess]:
    with WorkerProcess(f"{TARGETS}:start", "the worker") as found:
        yield found


def open_files() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


def gone(pid: int) -> None:
    """Wait until the process has ended; it need not be a child."""
    until = time.monotonic() + SOON_S
    while time.monotonic() < until:
        try:
            if Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z":
                return
        except OSError:
            return
        time.sleep(0.005)
    pytest.fail(f"process {pid} still runs")


def test_messages_and_arrays_go_and_come_back(worker: WorkerProcess) -> None:
    arrays = {
        "large": np.arange(600_000.0).reshape(600, 1000),
        "none": np.zeros((0, 3)),
        "bytes": np.frombuffer(b"abc", np.uint8),
        "whole": np.arange(3),
        "columns": np.arange(6.0).reshape(2, 3).T,
    }
    message, back = worker.request({"do": "echo", "what": {"a": [1, None, "ü"], "b": np.float64(0.5)}}, arrays)
    assert message["echo"] == {"a": [1, None, "ü"], "b": 0.5}
    assert list(back) == list(arrays)
    for name, values in arrays.items():
        np.testing.assert_array_equal(back[name], values)
        assert back[name].dtype == (np.uint8 if name == "bytes" else np.float64)
        assert back[name].flags.writeable
    assert worker.start() == {"pid": worker.pid}
    assert worker.alive


def test_a_refusal_is_an_error_and_the_worker_goes_on(worker: WorkerProcess) -> None:
    with pytest.raises(ComputeError, match=r"^torn$") as caught:
        worker.request({"do": "refuse"})
    assert not isinstance(caught.value, WorkerError)
    with pytest.raises(ComputeError, match="JSON line has 4194"):
        worker.request({"do": "large head"})
    with pytest.raises(FrameError, match="JSON line has 4194"):
        worker.request({"do": "echo", "what": "x" * (1 << 22)})
    assert worker.request({"do": "echo"})[0]["echo"] is None


@pytest.mark.parametrize(
    ("what", "how"),
    [
        ("exit", "the worker ended with exit code 7: out of luck"),
        ("raise", "the worker ended with exit code 1: ZeroDivisionError: of a target"),
        ("crash", "the worker was ended by SIGSEGV"),
        ("kill", r"the worker was ended by SIGKILL \(is the computer out of memory\?\)"),
    ],
)
def test_a_worker_that_ends_is_described_with_what_it_printed_last(worker: WorkerProcess, what: str, how: str) -> None:
    with pytest.raises(WorkerError, match=f"(?m)^{how}$") as caught:
        worker.request({"do": what})
    if what in {"exit", "raise"}:
        assert {"exit": "first\n", "raise": "Traceback"}[what] in caught.value.__notes__[0]
    assert not worker.alive
    with pytest.raises(WorkerError):
        worker.request({"do": "echo"})


def test_one_that_dies_between_requests_is_not_alive(worker: WorkerProcess) -> None:
    worker.start()
    os.kill(worker.pid, signal.SIGKILL)
    os.waitid(os.P_PID, worker.pid, os.WEXITED | os.WNOWAIT)
    assert not worker.alive
    with pytest.raises(WorkerError, match="SIGKILL"):
        worker.request({"do": "echo"}, {"large": np.zeros(1 << 20)})


@pytest.mark.full
@pytest.mark.parametrize("what", ["burn", "burn in threads"])
def test_a_worker_is_ended_when_its_cpu_time_is_used(worker: WorkerProcess, what: str) -> None:
    worker.start()
    limit = WorkerLimit(wall_s=600.0, cpu_s=0.2, key="dwell.cpu_limit_s")
    with pytest.raises(
        WorkerError,
        match=r"^the worker exceeded its limit: \d\.\d s of CPU time \(limit 0\.2 s\) in \d+\.\d s \(limit 600 s\)\. "
        r"Increase dwell\.cpu_limit_s\.$",
    ):
        worker.request({"do": what}, limit=limit)
    gone(worker.pid)


def test_a_worker_that_hangs_is_ended_when_its_wall_time_is_over(worker: WorkerProcess) -> None:
    worker.start()
    with pytest.raises(WorkerError, match=r"exceeded its limit: \d+\.\d s \(limit 1 s\)") as caught:
        worker.request({"do": "hang while printing"}, limit=WorkerLimit(wall_s=1.0))
    assert caught.value.__notes__ == ["about to hang"]
    gone(worker.pid)


def test_a_worker_that_does_not_read_is_ended_too(worker: WorkerProcess) -> None:
    worker.start()
    os.kill(worker.pid, signal.SIGSTOP)
    with pytest.raises(WorkerError, match="exceeded its limit"):
        worker.request({"do": "echo"}, {"large": np.zeros(1 << 20)}, WorkerLimit(wall_s=0.2))
    gone(worker.pid)


def test_a_stopped_worker_uses_no_cpu_time(worker: WorkerProcess) -> None:
    worker.start()
    os.kill(worker.pid, signal.SIGSTOP)
    awake = threading.Timer(0.5, os.kill, (worker.pid, signal.SIGCONT))
    awake.start()
    assert worker.request({"do": "echo"}, limit=WorkerLimit(cpu_s=0.4))[0] == {"echo": None, "arrays": []}
    awake.join()


@pytest.mark.full
def test_starting_does_not_count() -> None:
    with WorkerProcess(f"{TARGETS}:start_slowly", "the worker") as worker:
        assert worker.request({"do": "echo"}, limit=WorkerLimit(cpu_s=0.5))
        assert process_cpu_s(worker.pid) > 1.0


@pytest.mark.parametrize("function", ["fail", "nothing", "hang"])
def test_a_worker_that_does_not_start(function: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if function == "hang":
        monkeypatch.setattr("polishd.util.worker_process.START_LIMIT", WorkerLimit(wall_s=2.0))
    how = {
        "fail": "ended with exit code 1: ModuleNotFoundError: no module named so",
        "nothing": "ended with exit code 1: AttributeError: .*'nothing'",
        "hang": "exceeded its limit",
    }[function]
    with (
        WorkerProcess(f"{TARGETS}:{function}", "the worker") as worker,
        pytest.raises(WorkerError, match=f"the worker did not start: {how}"),
    ):
        worker.start()
    gone(worker.pid)


def test_a_program_that_cannot_be_run(monkeypatch: pytest.MonkeyPatch) -> None:
    before = open_files()
    monkeypatch.setattr(sys, "executable", "/no/such/python")
    with pytest.raises(WorkerError, match="the worker cannot be started: No such file"):
        WorkerProcess(f"{TARGETS}:start", "the worker")
    assert open_files() == before


@pytest.mark.full
def test_memory_is_limited_for_each_request(worker: WorkerProcess) -> None:
    large = {"do": "allocate", "bytes": 256 << 20}
    assert worker.request(large, limit=WorkerLimit(memory_bytes=64 << 20))[0]["refused"]
    assert not worker.request(large, limit=WorkerLimit(memory_bytes=512 << 20))[0]["refused"]
    with pytest.raises(WorkerError, match=r"ended with exit code 1: \S*MemoryError: Unable to allocate"):
        worker.request({**large, "do": "allocate and die"}, limit=WorkerLimit(memory_bytes=64 << 20))


@pytest.mark.parametrize(
    ("sent", "times", "why"),
    [
        ("x" * 100 + "\n", 1, "a message begins with a line of JSON"),
        ("[" * 100_000 + "\n", 1, "a message begins with a line of JSON"),
        ("[1]\n", 1, "a message begins with a line of JSON"),
        ('{"arrays": [{"name": "a", "type": "f8", "shape": [3, -1]}]}\n', 1, "a message begins with"),
        ('{"arrays": [{"name": "a", "type": "O", "shape": [3]}]}\n', 1, "a message begins with"),
        ('{"arrays": [{"name": "a", "type": "f8", "shape": [1073741824, 1073741824]}]}\n', 1, "a message begins with"),
        ("x" * 100, 50_000, "longer than 4194304 bytes"),
    ],
    ids=["no JSON", "deep JSON", "list", "negative", "objects", "oversized array", "oversized line"],
)
def test_a_worker_that_breaks_the_protocol_is_ended(worker: WorkerProcess, sent: str, times: int, why: str) -> None:
    with pytest.raises(WorkerError, match=f"^the worker broke the protocol: .*{why}"):
        worker.request({"do": "send", "what": sent, "times": times})
    gone(worker.pid)


@pytest.mark.parametrize("sent", ['{"half": ', '{"arrays": [{"name": "a", "type": "f8", "shape": [3]}]}\nabc', ""])
def test_one_that_ends_within_its_answer_is_described_by_its_end(worker: WorkerProcess, sent: str) -> None:
    with pytest.raises(WorkerError, match=r"^the worker ended with exit code 3$"):
        worker.request({"do": "send", "what": sent, "then": "exit"})


def test_printing_disturbs_no_answer_and_blocks_no_worker(worker: WorkerProcess) -> None:
    assert worker.request({"do": "print"}, limit=WorkerLimit(wall_s=SOON_S))[0] == {"arrays": []}
    assert worker.request({"do": "echo"})[0]["echo"] is None
    worker.end()
    assert worker.stderr_tail.endswith("last of all")
    assert len(worker.stderr_tail) <= 4096


@pytest.mark.full
def test_what_it_prints_goes_to_the_log_where_it_has_one(capfd: pytest.CaptureFixture[str]) -> None:
    for has_log in (False, True):
        with WorkerProcess(f"{TARGETS}:start", "the worker", has_log=has_log) as worker:
            worker.request({"do": "print"})
        captured = capfd.readouterr()
        assert captured.out == ""
        assert ("last of all" in captured.err) == has_log


def test_it_inherits_no_secrets_and_not_the_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MAIL_PASSWORD", "s3cret")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", ["", *sys.path])
    with WorkerProcess(f"{TARGETS}:start", "the worker", threads=3, environment={"PYTHONHASHSEED": "0"}) as worker:
        found = worker.request({"do": "environment"})[0]
    assert "MAIL_PASSWORD" not in found["names"]
    assert found["names"]["OPENBLAS_NUM_THREADS"] == found["names"]["NUMBA_NUM_THREADS"] == "3"
    assert found["names"]["PYTHONHASHSEED"] == "0"
    assert not {"", str(tmp_path)} & set(found["path"])


def test_interrupts_are_for_the_parent(worker: WorkerProcess) -> None:
    worker.start()
    assert os.getpgid(worker.pid) != os.getpgid(0)
    for number in (signal.SIGINT, signal.SIGTERM):
        os.kill(worker.pid, number)
    assert worker.request({"do": "echo"})[0]["echo"] is None


def test_the_kernel_ends_it_before_its_parent(worker: WorkerProcess) -> None:
    worker.start()
    own, its = (int(Path(f"/proc/{pid}/oom_score_adj").read_text()) for pid in ("self", worker.pid))
    assert its > own


def test_what_it_started_reads_no_requests_and_is_killed_with_it(worker: WorkerProcess) -> None:
    assert worker.request({"do": "child reads"})[0]["read"] == ""
    child = worker.request({"do": "child"})[0]["pid"]
    worker.end()
    gone(child)


def test_kill_from_another_thread_ends_the_request(worker: WorkerProcess) -> None:
    worker.start()
    timer = threading.Timer(0.1, worker.kill)
    timer.start()
    with pytest.raises(WorkerError, match=r"^the worker was ended by SIGKILL \(by polishd\)$"):
        worker.request({"do": "hang"})
    timer.join()


def test_an_interrupted_request_is_not_answered_to_the_next(
    worker: WorkerProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    worker.start()

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(array_stream, "read", interrupted)
        with pytest.raises(KeyboardInterrupt):
            worker.request({"do": "echo"})
    assert not worker.alive


@pytest.mark.full
def test_its_end_leaves_no_open_files() -> None:
    before = open_files()
    for _ in range(3):
        with WorkerProcess(f"{TARGETS}:start", "the worker") as worker:
            worker.start()
        worker.end()
    assert open_files() == before


PARENT = f"""
import os, sys, threading
from polishd.util.worker_process import WorkerProcess
found = []
thread = threading.Thread(target=lambda: found.append(WorkerProcess("{TARGETS}:start", "the worker")))
thread.start()
thread.join()
found[0].start()
print(found[0].pid, flush=True)
if sys.argv[1] != "idle":
    found[0].request({{"do": sys.argv[1]}})
sys.stdin.read()
"""


@pytest.mark.parametrize("what", ["idle", "burn", "hang"])
def test_it_ends_when_its_parent_is_killed(what: str) -> None:
    """Also where it hangs in C; and not when only the thread ends that started it."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    command = [sys.executable, "-c", PARENT, what]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment) as parent:
        assert parent.stdout is not None
        worker = int(parent.stdout.readline())
        os.kill(worker, 0)
        parent.kill()
    gone(worker)


NAMED = """
import time
open("/proc/self/comm", "w").write("a) S 1 (b")
while time.process_time() < 0.3:
    pass
print("ready", flush=True)
input()
"""


def test_cpu_time_of_all_threads_counts() -> None:
    assert abs(process_cpu_s(os.getpid()) - time.process_time()) < 0.1


@pytest.mark.full
def test_a_process_name_with_brackets_is_read_past() -> None:
    command = [sys.executable, "-c", NAMED]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdin is not None
        process.stdout.readline()
        assert 0.25 < process_cpu_s(process.pid) < 2.0
        process.stdin.write("\n")


def test_a_process_that_is_gone_has_used_nothing() -> None:
    with subprocess.Popen([sys.executable, "-c", ""]) as process:
        process.wait()
    assert process_cpu_s(process.pid) == 0.0
